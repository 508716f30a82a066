"""Every format of a recording gives the numbers of its samples as arrays."""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bags import messages, write_bag1, write_bag2, write_checked_mcap
from commands import imumon as command

import imumon
from imumon.model.report import Report, from_json

ROWS, RATE = 6_000, 100.0
MESSAGES = messages(ROWS)
STAMP_NS = np.array([stamp for stamp, _, _ in MESSAGES])
GYRO, ACCEL = (np.array([message[i] for message in MESSAGES]) for i in (1, 2))
NAMES = [
    f"{sensor}_{axis} [{unit}]" for sensor, unit in (("gyro", "rad/s"), ("accel", "m/s^2")) for axis in "xyz"
]


def text(path: Path, sep: str = ",") -> Path:
    """Write a table with all digits: what a cell says is the number, exactly."""
    rows = np.column_stack((np.arange(ROWS) / RATE, GYRO, ACCEL)).tolist()
    lines = (sep.join(map(repr, row)) for row in rows)
    path.write_text("\n".join([sep.join(["t [s]", *NAMES]), *lines, ""]))
    return path


def zipped(path: Path) -> Path:
    path.write_bytes(gzip.compress(text(path).read_bytes()))
    return path


def records(path: Path) -> Path:
    """Write a line of JSON for each sample."""
    rows = np.column_stack((np.arange(ROWS) / RATE, GYRO, ACCEL)).tolist()
    path.write_text(
        "".join(json.dumps(dict(zip(["t [s]", *NAMES], row, strict=True))) + "\n" for row in rows)
    )
    return path


def archive(path: Path) -> Path:
    np.savez(path, t_s=np.arange(ROWS) / RATE, gyro_rads=GYRO, accel_mss=ACCEL)
    return path


def matlab(path: Path) -> Path:
    from scipy.io import savemat

    savemat(path, {"t_s": np.arange(ROWS) / RATE, "gyro_rads": GYRO, "accel_mss": ACCEL})
    return path


def parquet(path: Path) -> Path:
    arrow = pytest.importorskip("pyarrow", reason="the extra fast is not installed")
    from pyarrow import parquet as format

    columns = {"t [s]": np.arange(ROWS) / RATE, **dict(zip(NAMES, np.hstack((GYRO, ACCEL)).T, strict=True))}
    format.write_table(arrow.table(columns), path)
    return path


WRITERS: dict[str, Callable[[Path], Path]] = {
    "a.csv": text,
    "a.csv.gz": zipped,
    "a.tsv": lambda path: text(path, "\t"),
    "a.jsonl": records,
    "a.npz": archive,
    "a.mat": matlab,
    "a.parquet": parquet,
    "a.bag": lambda path: write_bag1(path, MESSAGES),
    "bag2": lambda path: write_bag2(path, MESSAGES),
    "mcap": lambda path: write_checked_mcap(path, MESSAGES),
}


@pytest.fixture(scope="module")
def of_arrays() -> Report:
    units = {"gyro": "rad/s", "accel": "m/s2"}  # as a file says them
    return imumon.analyse(gyro=GYRO, accel=ACCEL, time_s=np.arange(ROWS) / RATE, units=units).report


@pytest.mark.few(3)
@pytest.mark.parametrize("name", WRITERS)
def test_a_format_gives_the_numbers_of_its_samples(tmp_path: Path, of_arrays: Report, name: str) -> None:
    path = WRITERS[name](tmp_path / name)
    of_file = imumon.analyse(path, accept=True).report
    assert of_file.channels == of_arrays.channels
    assert of_file.session.samples == of_arrays.session.samples == ROWS
    assert from_json(Report, command("replay", path, "--json")).channels == of_file.channels
