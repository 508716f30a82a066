"""Cost of `imumon replay` as a whole process, beside another tool that does less with the same file, in one run.

| file | beside it |
|---|---|
| binary, 62-byte packets at 800 Hz, nine channels | allantools' octaves of six axes, loaded as an array |
| `.npz`, six axes | the same, of this file |
| CSV, six axes and time | `numpy.loadtxt` of the file |
| MCAP of `sensor_msgs/Imu` | rosbags reads and decodes the messages, and does nothing with them |
| `$VNYMR` sentences | – |

All are whole processes. Both take turns, so that other work on the machine meets both; the figure is the median of the
ratios of processor time, user and kernel. Peak memory is that of the replaying process.

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
IMU_BYTES = 4 + 16 + 296
"""Bytes of a `sensor_msgs/Imu` in CDR with the frame "imu": header, stamp and name, and 37 doubles with padding."""

SAMPLES_PER_S = 400_000
"""Goal for sentences."""
MOST_MB = 110.0
"""MB, goal for the peak memory of a replay of any length."""

ARITHMETIC = """
import sys, allantools, numpy as np
axes = np.load(sys.argv[1])
if hasattr(axes, "files"):
    axes = np.hstack([axes["gyro_rads"], axes["accel"]])
for k in range(6):
    allantools.oadev(axes[:, k], rate=float(sys.argv[2]), data_type="freq", taus="octave")
"""
LOADTXT = "import sys, numpy as np; np.loadtxt(sys.argv[1], delimiter=',', skiprows=1)"
MESSAGES = """
import sys
from pathlib import Path
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
store = get_typestore(Stores.ROS2_HUMBLE)
with Reader(Path(sys.argv[1])) as bag:
    for connection, _, message in bag.messages():
        store.deserialize_cdr(message, connection.msgtype)
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
    """Elapsed time, processor time and the part of it in the kernel, s, and the peak memory if it says it, MB."""

    elapsed: float
    processor: float
    kernel: float
    memory: float = 0.0


def process(code: str, *arguments: str) -> Cost:
    """Run a program."""
    command = [sys.executable, "-c", code, *arguments]
    began, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    elapsed, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    kernel = after.ru_stime - before.ru_stime
    memory = int(done.stderr.split()[-1]) / 1024 if code == REPLAY else 0.0
    return Cost(elapsed, after.ru_utime - before.ru_utime + kernel, kernel, memory)


def replay(path: Path, *options: str) -> Cost:
    return process(REPLAY, "replay", str(path), "--json", *options)


def compared(
    what: str,
    goal: float | None,
    beside: str,
    ours: Callable[[], Cost],
    theirs: Callable[[], Cost],
    repeat: int,
) -> Iterator[Figure]:
    """Yield the ratio of the processor times of two programs that run in turns, and the peak memory of the first."""
    pairs = [(ours(), theirs()) for _ in range(repeat)]
    ratio = statistics.median(one.processor / other.processor for one, other in pairs)
    mine, other = (min((pair[k] for pair in pairs), key=lambda cost: cost.processor) for k in (0, 1))
    note = (
        f"{beside}: {other.processor:.2f} s, elapsed {other.elapsed:.2f} s; imumon: {mine.processor:.2f} s, "
    )
    note += f"elapsed {mine.elapsed:.2f} s, {100.0 * mine.kernel / mine.processor:.0f} % of it in the kernel"
    yield Figure(what, f"{ratio:.3g} ×", note) if goal is None else at_most(what, ratio, goal, "×", note)
    if mine.memory:
        yield at_most("its peak memory", max(one.memory for one, _ in pairs), MOST_MB, "MB")


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


def make_table(path: Path, samples: int) -> None:
    """Write samples at 100 Hz as CSV."""
    with path.open("w") as file:
        file.write("t [s],gx [rad/s],gy [rad/s],gz [rad/s],ax [m/s2],ay [m/s2],az [m/s2]\n")
        rows = np.column_stack([np.arange(samples) * 0.01, axes_at_rest(samples)])
        np.savetxt(file, rows, fmt="%.9g", delimiter=",")


def make_archive(path: Path, samples: int) -> None:
    """Write samples at 200 Hz as NumPy archive."""
    axes = axes_at_rest(samples)
    np.savez(path, time_s=np.arange(samples) * 0.005, gyro_rads=axes[:, :3], accel=axes[:, 3:])


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
    """Yield what replays cost: of `hours` of binary messages, and of two and a half times as many of an archive."""
    whole = hours >= 2.0  # of shorter files, the start of the program is most of it
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path, axes = folder / "long.bin", folder / "axes.npy"
        np.save(axes, make_binary(path, round(hours * 3600 * RATE)))
        yield from compared(
            f"`imumon replay` of {hours:g} h of nine channels at {RATE:g} Hz, over allantools' octaves of six",
            1.3 if whole else None,
            "allantools",
            lambda: replay(path),
            lambda: process(ARITHMETIC, str(axes), str(RATE)),
            repeat,
        )
        archive = folder / "a.npz"
        make_archive(archive, round(2.5 * hours * 3600 * 200))
        yield from compared(
            f"`imumon replay` of {2.5 * hours:g} h of six axes at 200 Hz, `.npz`, over allantools' octaves",
            1.3 if whole else None,
            "allantools",
            lambda: replay(archive),
            lambda: process(ARITHMETIC, str(archive), "200"),
            repeat,
        )
        table = folder / "a.csv"
        make_table(table, rows)
        yield from compared(
            f"`imumon replay` of {rows:,} rows of six axes, CSV, over `numpy.loadtxt`",
            2.5 if whole else None,
            "`numpy.loadtxt`",
            lambda: replay(table),
            lambda: process(LOADTXT, str(table)),
            repeat,
        )
        bag = folder / "bag"
        make_bag(bag, messages)
        yield from compared(
            f"`imumon replay` of an MCAP file of {messages:,} messages, over reading it",
            1.5 if whole else None,
            "rosbags",
            lambda: replay(bag),
            lambda: process(MESSAGES, str(bag)),
            repeat,
        )
        text = folder / "text.txt"
        make_sentences(text, sentences)
        best = min((replay(text, "--rate", "200") for _ in range(repeat)), key=lambda cost: cost.elapsed)
        speed = sentences / best.elapsed
        met = speed >= SAMPLES_PER_S if whole else None
        goal = f"≥ {SAMPLES_PER_S:,}/s" if whole else ""
        what = f"`imumon replay` of {sentences:,} `$VNYMR` sentences"
        yield Figure(what, f"{speed:,.0f}/s", f"processor {best.processor:.1f} s", goal, met)


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
