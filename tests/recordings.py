"""Writers of recordings of one sensor, of each kind that imumon reads."""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bags import messages, write_checked_mcap, write_imu
from logs import COMBINED, DataFlash, ulog

Samples = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Times in s (n,), angular velocity in rad/s and acceleration in m/s^2 (n, 3), as of `tables.truth`."""
NAMES = [
    "t [s]",
    *(f"gyro_{axis} [rad/s]" for axis in "xyz"),
    *(f"accel_{axis} [m/s^2]" for axis in "xyz"),
]


def text(path: Path, samples: Samples, sep: str = ",") -> Path:
    """Write a table with all digits: what a cell says is the number, exactly."""
    lines = [sep.join(NAMES), *(sep.join(map(repr, row)) for row in np.column_stack(samples).tolist()), ""]
    data = "\n".join(lines).encode()
    path.write_bytes(gzip.compress(data) if path.suffix == ".gz" else data)
    return path


def records(path: Path, samples: Samples) -> Path:
    """Write a line of JSON for each sample."""
    rows = (dict(zip(NAMES, row, strict=True)) for row in np.column_stack(samples).tolist())
    path.write_text("".join(json.dumps(row).replace("NaN", "null") + "\n" for row in rows))
    return path


def archive(path: Path, samples: Samples) -> Path:
    np.savez(path, **dict(zip(("t_s", "gyro_rads", "accel_mss"), samples, strict=True)))
    return path


def matlab(path: Path, samples: Samples) -> Path:
    from scipy.io import savemat

    savemat(path, dict(zip(("t_s", "gyro_rads", "accel_mss"), samples, strict=True)), do_compression=True)
    return path


def parquet(path: Path, samples: Samples) -> Path:
    arrow = pytest.importorskip("pyarrow", reason="pyarrow is not installed (extra fast)")
    from pyarrow.parquet import write_table

    table = arrow.table(dict(zip(NAMES, np.column_stack(samples).T, strict=True)))
    write_table(table, path, write_page_checksum=True)
    return path


def px4(path: Path, samples: Samples) -> Path:
    pytest.importorskip("pyulog", reason="pyulog is not installed (extra px4)")
    rows = [(round(1e6 * t), *gyro, 10_000, *accel, 10_000) for t, gyro, accel in zip(*samples, strict=True)]
    return ulog(path, [("sensor_combined", 0, COMBINED, rows)])


def ardupilot(path: Path, samples: Samples) -> Path:
    pytest.importorskip("pymavlink", reason="pymavlink is not installed (extra ardupilot)")
    log = DataFlash()
    log.imu(*samples[1:], step_us=10_000)
    return log.write(path)


WRITERS: dict[str, Callable[[Path, Samples], Path]] = {
    "a.csv": text,
    "a.csv.gz": text,
    "a.tsv": lambda path, samples: text(path, samples, "\t"),
    "a.jsonl": records,
    "a.npz": archive,
    "a.mat": matlab,
    "a.parquet": parquet,
    "a.bag": lambda path, samples: write_imu(path, messages(*samples), "ROS1"),
    "bag2": lambda path, samples: write_imu(path, messages(*samples)),
    "mcap": lambda path, samples: write_checked_mcap(path, messages(*samples)),
    "mcap without checksums": lambda path, samples: write_imu(path, messages(*samples), "MCAP"),
    "a.ulg": px4,
    "a.BIN": ardupilot,
}
"""By the name of the file; a name without a dot is a directory. What a row says is the number, exactly, but for the
single precision of the logs of autopilots."""
EXACT = [name for name in WRITERS if not name.endswith((".ulg", ".BIN"))]
IN_PROCESS = [name for name in WRITERS if "." not in name or name.endswith((".bag", ".ulg", ".BIN"))]
"""Kinds that a process of their own reads."""
