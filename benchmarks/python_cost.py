"""Cost of `imumon.analyse`: processor time against allantools in the same run, memory, and the time of the import.

    python -m benchmarks.python_cost [--hours 5] [--rate 200]

Six channels: gyroscope and accelerometer. allantools computes overlapping Allan deviations of octaves, `analyse` all
of a report. Memory is what the largest resident size of a process exceeds that with the modules and the arrays.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # of allantools, too

import allantools
import numpy as np

import imumon

MEMORY = """
import sys
import numpy as np
import imumon
with np.load(sys.argv[1]) as archive:
    gyro, accel = archive["gyro"], archive["accel"]
imumon.analyse(gyro[:60_000], rate_hz=200.0)  # the modules
def resident(name):  # kB; that of resource begins with the parent's
    with open("/proc/self/status") as file:
        return next(int(line.split()[1]) for line in file if line.startswith(name))
before = resident("VmRSS")
with open("/proc/self/clear_refs", "w") as file:
    file.write("5")  # the largest size begins again: loading the arrays is not counted
imumon.analyse(gyro=gyro, accel=accel, rate_hz=float(sys.argv[2]), kind="average")
print((resident("VmHWM") - before) / 1e3)
"""


def processor_s(call: Callable[[], object]) -> float:
    begin = time.process_time()
    call()
    return time.process_time() - begin


def output_of(code: str, *words: str) -> float:
    return float(subprocess.check_output([sys.executable, "-c", code, *words]))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--hours", type=float, default=5.0)
    parser.add_argument("--rate", type=float, default=200.0)
    given = parser.parse_args()
    code = "import time; begin = time.perf_counter(); import imumon; print(time.perf_counter() - begin)"
    imports = [output_of(code) for _ in range(5)]
    n = int(given.hours * 3600 * given.rate)
    gyro = imumon.simulate(n, given.rate, N=[6.1e-5] * 3, B=2.4e-5, seed=1)
    accel = imumon.simulate(n, given.rate, N=[1e-3] * 3, B=2e-4, bias=[0.0, 0.0, 9.80665], seed=2)
    imumon.analyse(gyro[:20_000], rate_hz=given.rate)  # modules, once

    def of_allantools() -> None:
        for column in np.hstack([gyro, accel]).T:
            allantools.oadev(column, rate=given.rate, data_type="freq", taus="octave")

    here = processor_s(lambda: imumon.analyse(gyro=gyro, accel=accel, rate_hz=given.rate, kind="average"))
    there = processor_s(of_allantools)
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "arrays.npz"
        np.savez(path, gyro=gyro, accel=accel)
        memory = output_of(MEMORY, str(path), str(given.rate))
    print(f"import imumon: {1e3 * min(imports):.1f} ms, the shortest of 5")
    print(
        f"{given.hours:g} h at {given.rate:g} Hz, 6 channels: {(gyro.nbytes + accel.nbytes) / 1e6:.0f} MB of arrays"
    )
    print(f"processor time: analyse {here:.1f} s, allantools {there:.1f} s, {here / there:.1f} times as much")
    print(f"memory beside arrays and modules: {memory:.0f} MB")


if __name__ == "__main__":
    main()
