"""Benchmark of the emulator: its share of a core, its timing, and the speed of time-lapse.

    python benchmarks/emulator.py [--seconds 10]

Each row is an emulator on its pseudo-terminal, streaming to a reader. `lost` counts packets that are missing
according to their time stamps, or invalid; `late` is the time between two reads, median and 95 % quantile;
`drift` is that of the sensor clock against the host clock over the run. For time-lapse, `x` is sensor time
per processor time of the emulator: the speed at which one core is fully used.
"""

from __future__ import annotations

import argparse
import os
import select
import time
from pathlib import Path

import numpy as np
import serial
from document_tables import head, row

from imumon.devices.vn100.binary import BinaryLayout
from imumon.devices.vn100.emulator import EmulatorProcess, EmulatorSettings, spawn

CASES = (
    ("time, deltas, 44 bytes", 115200, 200, "1,4,06,0001,00C0", BinaryLayout.of({2: 0x0001, 3: 0x00C0})),
    ("time, mag, deltas, 62 bytes", 115200, 100, "1,8,01,0C01", BinaryLayout.of({1: 0x0C01})),
    ("time, deltas, 44 bytes", 921600, 800, "1,1,06,0001,00C0", BinaryLayout.of({2: 0x0001, 3: 0x00C0})),
)
LAPSE = ("1,8,05,0001,00F2", BinaryLayout.of({1: 0x0001, 3: 0x00F2}))


def processor_time(pid: int) -> float:
    """Return the processor time of a process, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def stream(sensor: EmulatorProcess, baud: int, output: str, seconds: float) -> tuple[bytes, np.ndarray]:
    """Return what a reader receives, and when each read returned (s)."""
    with serial.Serial(sensor.path, baud, timeout=1.0) as port:
        for command in ("VNASY,0", "VNWRG,06,0", f"VNWRG,75,{output}", "VNASY,1"):
            port.write(f"${command}*XX\r\n".encode())
            time.sleep(0.05)
        port.reset_input_buffer()
        received, times, end = [], [], time.monotonic() + seconds
        while time.monotonic() < end:
            select.select([port.fileno()], [], [], 1.0)
            received.append(os.read(port.fileno(), 1 << 16))
            times.append(time.monotonic())
    return b"".join(received), np.array(times)


def stamps(data: bytes, layout: BinaryLayout) -> tuple[np.ndarray, int]:
    """Return the time stamps in ns, and the number of invalid packets."""
    start = data.index(layout.header)
    count = (len(data) - start) // layout.length
    valid = layout.count_valid(data, start, count)
    name = next(name for name in layout.fields if name.endswith("timeStartup"))
    return layout.decode(data, start, valid)[name][:, 0].astype(np.int64), count - valid


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=10.0)
    seconds = parser.parse_args().seconds
    columns = ("share of a core, %", "between reads, median and 95 %, ms", "drift, ms")
    print(head("emulator", "stream", "baud", "Hz", f"lost in {seconds:g} s", *columns))
    for name, baud, rate, output, layout in CASES:
        with spawn(EmulatorSettings(seed=1, baud=baud)) as sensor:
            used = -processor_time(sensor.pid)
            data, times = stream(sensor, baud, output, seconds)
            used += processor_time(sensor.pid)
        made, bad = stamps(data, layout)
        lost = bad + int(np.rint(np.diff(made) * rate / 1e9 - 1).sum())
        late = np.percentile(np.diff(times) * 1e3, [50, 95])
        drift = (made[-1] - made[0]) / 1e6 - (times[-1] - times[0]) * 1e3
        cells = (f"{100 * used / seconds:.0f}", f"{late[0]:.1f} / {late[1]:.1f}", f"{drift:.0f}")
        print(row([name, baud, rate, lost, *cells]))
    for speed in (60, 600):
        with spawn(EmulatorSettings(seed=1, speed=speed)) as sensor:
            used = -processor_time(sensor.pid)
            data, _ = stream(sensor, 115200, LAPSE[0], seconds / 2)
            used += processor_time(sensor.pid)
        made, bad = stamps(data, LAPSE[1])
        lapsed = (made[-1] - made[0]) / 1e9
        print(
            f"time-lapse, --speed {speed}: {lapsed / seconds * 2:.0f} s of the sensor in a second, "
            f"{100 * used / seconds * 2:.0f} % of a core, x = {lapsed / used:.0f}, invalid {bad}"
        )


if __name__ == "__main__":
    main()
