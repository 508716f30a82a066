"""Cost of `imumon replay` as a whole process, beside another tool that does less with the same file, in one run.

| file | beside it |
|---|---|
| binary, 62-byte packets at 800 Hz, nine channels | allantools' octave arithmetic of six axes in memory, no start |
| `.npz`, six axes | a process that loads it with numpy and does the same arithmetic |
| CSV, six axes and time | a process with `numpy.loadtxt` of the file |
| MCAP of `sensor_msgs/Imu` | a process that reads the messages with rosbags and does nothing with them |
| `$VNYMR` sentences | – |

Both take turns, so that other work on the machine meets both; the figure is the median of the ratios of elapsed time.
Processor time, of all processes together, is shown beside it: on a busy machine it says more. Peak memory is that of
the replaying process, for the whole length of the binary recording and for a quarter of it: it must not depend on it.

    python benchmarks/replay.py [--hours 2] [--rows 1000000] [--messages 2000000] [--sentences 2000000] [--repeat 3]
"""

from __future__ import annotations

import argparse
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from document_tables import Figure, at_most, show

from imumon.noise.synthesis import NoiseStream
from imumon.sources.vn100 import ascii, binary

RATE = 800.0
LAYOUT = binary.BinaryLayout.of({binary.Group.TIME: 0x0001, binary.Group.IMU: 0x003F})
BLOCK = 80_000
N = np.array([6.1e-5] * 3 + [1.37e-3] * 3 + [1.4e-4] * 3)
IMU_BYTES = 4 + 12 + 308
"""Bytes of a `sensor_msgs/Imu` in CDR with the frame "imu": header, stamp and name, and 37 doubles with padding."""

SAMPLES_PER_S = 400_000
"""Goal for sentences."""

ARITHMETIC = """
import sys, time, allantools, numpy as np
axes = np.load(sys.argv[1])
if hasattr(axes, "files"):
    axes = np.hstack([axes["gyro_rads"], axes["accel"]])
began, spent = time.perf_counter(), time.process_time()
for k in range(6):
    allantools.oadev(axes[:, k], rate=float(sys.argv[2]), data_type="freq", taus="octave")
print(time.perf_counter() - began, time.process_time() - spent)
"""
LOADTXT = "import sys, numpy as np; np.loadtxt(sys.argv[1], delimiter=',', skiprows=1)"
MESSAGES = """
import sys
from pathlib import Path
from rosbags.rosbag2 import Reader
with Reader(Path(sys.argv[1])) as bag:
    for message in bag.messages():
        pass
"""
READ = """
import sys
from imumon.sources.files import ReadOptions, open_recording
for blocks in open_recording(sys.argv[1], ReadOptions()):
    pass
"""
REPLAY = """
import sys
from imumon.cli import main
code = main(sys.argv[1:])
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(peak.split()[1], file=sys.stderr)
sys.exit(code)
"""


class Cost(NamedTuple):
    """Elapsed and processor time of a process and its children in s, and its peak memory in MB if it says it."""

    elapsed: float
    processor: float
    memory: float = 0.0


def process(code: str, *arguments: str) -> Cost:
    """Run a program; one that prints two numbers has measured its times itself."""
    command = [sys.executable, "-c", code, *arguments]
    began, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    elapsed, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    if code == ARITHMETIC and arguments[0].endswith(".npy"):
        return Cost(*map(float, done.stdout.split()))
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Cost(elapsed, spent, int(done.stderr.split()[-1]) / 1024 if code == REPLAY else 0.0)


def replay(path: Path, *options: str) -> Cost:
    return process(REPLAY, "replay", str(path), "--json", *options)


def compared(
    what: str,
    goal: float | None,
    beside: str,
    ours: Callable[[], Cost],
    theirs: Callable[[], Cost],
    repeat: int,
) -> Figure:
    """Return the ratio of two costs that are measured in turns."""
    pairs = [(ours(), theirs()) for _ in range(repeat)]
    ratio = statistics.median(one.elapsed / other.elapsed for one, other in pairs)
    spent = statistics.median(one.processor / other.processor for one, other in pairs)
    mine, other = (min(pair[k].elapsed for pair in pairs) for k in (0, 1))
    note = f"{beside}: {other:.2f} s, imumon {mine:.2f} s; processor {spent:.2g} ×"
    return Figure(what, f"{ratio:.3g} ×", note) if goal is None else at_most(what, ratio, goal, "×", note)


# ---------------------------------------------------------------- files


def make_binary(path: Path, samples: int) -> np.ndarray:
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


def make_sentences(path: Path, samples: int) -> None:
    """Write a recording of `$VNYMR` sentences."""
    rows = np.zeros((samples, 12))  # yaw, pitch, roll, then magnetic field, acceleration and angular rate
    rows[:, 3:] = NoiseStream(200.0, N[[6, 7, 8, 3, 4, 5, 0, 1, 2]], 1e-5, 0.0, seed=2).generate(samples)
    rows[:, 8] -= 9.79
    with path.open("wb") as file:
        file.writelines(ascii.encode(ascii.sentence("VNYMR", row)) for row in rows)


def axes_at_rest(samples: int) -> np.ndarray:
    """Return gyroscope and accelerometer, (n, 6)."""
    level = np.array([0.001, -0.002, 0.0005, 0.1, -0.2, -9.79])
    return NoiseStream(100.0, N[:6], N[:6] / 3, 0.0, seed=3).generate(samples) + level


def make_tables(folder: Path, samples: int) -> tuple[Path, Path]:
    """Write the same samples at 100 Hz as CSV and as NumPy archive."""
    axes, times = axes_at_rest(samples), np.arange(samples) * 0.01
    table, archive = folder / "a.csv", folder / "a.npz"
    with table.open("w") as file:
        file.write("t [s],gx [rad/s],gy [rad/s],gz [rad/s],ax [m/s2],ay [m/s2],az [m/s2]\n")
        np.savetxt(file, np.column_stack([times, axes]), fmt="%.9g", delimiter=",")
    np.savez(archive, t=times, gyro_rads=axes[:, :3], accel=axes[:, 3:])
    return table, archive


def make_bag(path: Path, samples: int) -> None:
    """Write an MCAP file of `sensor_msgs/Imu` at 200 Hz."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store, axes = get_typestore(Stores.ROS2_HUMBLE), axes_at_rest(samples)
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        connection = bag.add_connection("/imu/data", "sensor_msgs/msg/Imu", typestore=store)
        for start in range(0, samples, BLOCK):
            stamps = 1_700_000_000 * 10**9 + np.arange(start, min(start + BLOCK, samples)) * 5_000_000
            for stamp, message in zip(
                stamps.tolist(), imus(stamps, axes[start : start + BLOCK]), strict=True
            ):
                bag.write(connection, stamp, message.tobytes())


def imus(stamps: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Return (n, IMU_BYTES) messages in CDR."""
    messages = np.zeros((len(stamps), IMU_BYTES), dtype=np.uint8)
    messages[:, 1] = 1  # little-endian
    words = messages[:, 4:].view("<u4")
    words[:, 0], words[:, 1] = stamps // 10**9, stamps % 10**9
    words[:, 2] = 4
    messages[:, 16:19] = np.frombuffer(b"imu", np.uint8)
    numbers = messages[:, 20:].view(
        "<f8"
    )  # orientation and covariance 13, angular velocity 3 + 9, acceleration 3 + 9
    numbers[:, 13:16], numbers[:, 25:28] = axes[:, :3], axes[:, 3:]
    return messages


# ---------------------------------------------------------------- figures


def measure(
    hours: float = 2.0,
    sentences: int = 2_000_000,
    rows: int = 1_000_000,
    messages: int = 2_000_000,
    repeat: int = 3,
) -> Iterator[Figure]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        yield from _binary(folder, hours, repeat)
        table, archive = make_tables(folder, rows)
        whole = rows >= 1_000_000  # of fewer, the start of the program is most of it
        what = f"`imumon replay` of {rows:,} samples of six axes,"
        yield compared(
            f"{what} `.npz`, over allantools with loading",
            2.0 if whole else None,
            "allantools",
            lambda: replay(archive),
            lambda: process(ARITHMETIC, str(archive), "100"),
            repeat,
        )
        yield compared(
            f"{what} CSV, over `numpy.loadtxt`",
            2.0 if whole else None,
            "`numpy.loadtxt`",
            lambda: replay(table),
            lambda: process(LOADTXT, str(table)),
            repeat,
        )
        yield compared(
            "the same, reading alone",
            None,
            "`numpy.loadtxt`",
            lambda: process(READ, str(table)),
            lambda: process(LOADTXT, str(table)),
            repeat,
        )
        bag = folder / "bag"
        make_bag(bag, messages)
        yield compared(
            f"`imumon replay` of an MCAP file of {messages:,} messages, over reading it",
            1.5 if messages >= 2_000_000 else None,
            "rosbags",
            lambda: replay(bag),
            lambda: process(MESSAGES, str(bag)),
            repeat,
        )
        yield compared(
            "the same, reading alone",
            None,
            "rosbags",
            lambda: process(READ, str(bag)),
            lambda: process(MESSAGES, str(bag)),
            repeat,
        )
        text = folder / "text.txt"
        make_sentences(text, sentences)
        best = min((replay(text, "--rate", "200") for _ in range(repeat)), key=lambda cost: cost.elapsed)
        speed = sentences / best.elapsed
        met = speed >= SAMPLES_PER_S if sentences >= 400_000 else None  # of fewer, the start is most of it
        goal = "" if met is None else f"≥ {SAMPLES_PER_S:,}/s"
        what = f"`imumon replay` of {sentences:,} `$VNYMR` sentences"
        yield Figure(what, f"{speed:,.0f}/s", f"processor {best.processor:.1f} s", goal, met)


def _binary(folder: Path, hours: float, repeat: int) -> Iterator[Figure]:
    samples = round(hours * 3600 * RATE)
    path, short, axes = folder / "long.bin", folder / "short.bin", folder / "axes.npy"
    np.save(axes, make_binary(path, samples))
    make_binary(short, samples // 4)
    costs: list[Cost] = []

    def ours() -> Cost:
        costs.append(replay(path))
        return costs[-1]

    what = f"`imumon replay`, {hours:g} h of nine channels at {RATE:g} Hz, over allantools' arithmetic of six axes"
    goal = 0.7 if hours >= 2.0 else None
    yield compared(what, goal, "allantools", ours, lambda: process(ARITHMETIC, str(axes), str(RATE)), repeat)
    bare = replay(path, "--no-guards")
    note = f"{samples / costs[0].elapsed:,.0f} samples/s with"
    yield Figure("the same with `--no-guards`", f"{samples / bare.elapsed:,.0f} samples/s", note)
    note = f"for a quarter of the length {replay(short).memory:.0f} MB"
    yield Figure("its peak memory", f"{costs[0].memory:.0f} MB", note)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--hours", type=float, default=2.0)
    for option, default in (
        ("rows", 1_000_000),
        ("messages", 2_000_000),
        ("sentences", 2_000_000),
        ("repeat", 3),
    ):
        parser.add_argument(f"--{option}", type=int, default=default)
    arguments = parser.parse_args()
    show(
        "replay",
        measure(arguments.hours, arguments.sentences, arguments.rows, arguments.messages, arguments.repeat),
    )
