"""Cost of `imumon replay` as a whole process, compared with the arithmetic of an offline tool in the same run.

A binary recording (62-byte packets: TimeStartup, ImuStatus, UncompMag, UncompAccel, UncompGyro, Temp, Pres,
at 800 Hz) is made and replayed with `--json`; `allantools.oadev(taus="octave")` then works on the six
axes, given as arrays. The goal is at most three times its time for two hours. Processor time
is shown beside the elapsed time: on a busy machine it varies less. Peak memory is that of the replaying
process, for the whole length and for a quarter of it: it must not depend on the length.

    python benchmarks/replay.py [--hours 2] [--sentences 200000]
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from figures import Figure, at_most, show

from imumon.devices.vn100 import ascii, binary
from imumon.noise.synthesis import NoiseStream

RATE = 800.0
LAYOUT = binary.BinaryLayout.of({binary.TIME: 0x0001, binary.IMU: 0x003F})
BLOCK = 80_000
N = np.array([6.1e-5] * 3 + [1.37e-3] * 3 + [1.4e-4] * 3)


def make(path: Path, samples: int) -> np.ndarray:
    """Write a recording of n samples; return gyroscope and accelerometer, (n, 6)."""
    noise = NoiseStream(RATE, N, N / 3, 0.0, seed=1)
    level = np.array([0.01, -0.01, 0.005, 0.0, 0.0, -9.79, 0.2, 0.0, 0.4])
    kept = []
    with path.open("wb") as file:
        for start in range(0, samples, BLOCK):
            n = min(BLOCK, samples - start)
            values = (noise.generate(n) + level).astype(np.float32)
            file.write(
                LAYOUT.encode(
                    {
                        "timeStartup": (np.arange(n) + start) * 1_250_000 + 10**9,
                        "uncompMag": values[:, 6:],
                        "uncompAccel": values[:, 3:6],
                        "uncompGyro": values[:, :3],
                        "temp": np.full(n, 30.0),
                        "pres": np.full(n, 101.2),
                    }
                )
            )
            kept.append(values[:, :6])
    return np.concatenate(kept).astype(np.float64)


def make_ascii(path: Path, samples: int) -> None:
    """Write a recording of `$VNYMR` sentences."""
    rows = np.random.default_rng(2).normal(0.0, 1e-3, (samples, 12))
    rows[:, 8] -= 9.79
    with path.open("wb") as file:
        for row in rows:
            file.write(ascii.encode(ascii.sentence("VNYMR", row)))


def replay(path: Path, *options: str) -> tuple[float, float, float]:
    """Return elapsed s, processor s and peak MB of a replaying process."""
    code = (
        "import sys; from imumon.cli import main; code = main(sys.argv[1:]);"
        "peak = next(l for l in open('/proc/self/status') if l.startswith('VmHWM'));"
        "print(peak.split()[1], file=sys.stderr); sys.exit(code)"
    )
    command = [sys.executable, "-c", code, "replay", str(path), "--json", *options]
    began, spent = time.perf_counter(), children()
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return time.perf_counter() - began, children() - spent, int(done.stderr.split()[-1]) / 1024


def children() -> float:
    """Return the processor s of all children so far."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def measure(hours: float = 2.0, sentences: int = 200_000) -> Iterator[Figure]:
    import allantools

    samples = round(hours * 3600 * RATE)
    with tempfile.TemporaryDirectory() as folder:
        path, short, text = (Path(folder) / name for name in ("long.bin", "short.bin", "text.txt"))
        axes = make(path, samples)
        make(short, samples // 4)
        make_ascii(text, sentences)
        ours, ours_cpu, memory = replay(path)
        began, spent = time.perf_counter(), time.process_time()
        for column in range(6):
            allantools.oadev(axes[:, column], rate=RATE, data_type="freq", taus="octave")
        theirs, theirs_cpu = time.perf_counter() - began, time.process_time() - spent
        bare, bare_cpu, _ = replay(path, "--no-guards")
        _, _, memory_short = replay(short)
        spoken, spoken_cpu, _ = replay(text, "--rate", "200")
    what = f"{hours:g} h of nine channels at {RATE:g} Hz"
    yield Figure(
        f"`imumon replay`, {what}, as a whole process",
        f"{samples / ours:,.0f} samples/s, processor {ours_cpu:.1f} s",
        f"allantools offline, six axes as arrays: {samples / theirs:,.0f} samples/s, {theirs_cpu:.1f} s",
    )
    ratio = ours_cpu / theirs_cpu
    what = "its processor time over that of allantools"
    whole = hours >= 2.0  # in a shorter one the start costs more
    yield at_most(what, ratio, 3.0, "×") if whole else Figure(what, f"{ratio:.3g} ×")
    yield Figure(
        "the same with `--no-guards`", f"{samples / bare:,.0f} samples/s, processor {bare_cpu:.1f} s"
    )
    yield Figure(
        f"the same of {sentences:,} `$VNYMR` sentences",
        f"{sentences / spoken:,.0f} samples/s, processor {spoken_cpu:.1f} s",
    )
    yield Figure("its peak memory", f"{memory:.0f} MB", f"for a quarter of the length {memory_short:.0f} MB")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--hours", type=float, default=2.0)
    parser.add_argument("--sentences", type=int, default=200_000)
    arguments = parser.parse_args()
    show(measure(arguments.hours, arguments.sentences))
