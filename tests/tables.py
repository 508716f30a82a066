"""Tables for tests: a sensor at rest, written and read."""

from __future__ import annotations

import gzip
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from imumon.api.replay import replay
from imumon.api.replay_options import ReplayOptions
from imumon.model.report import Report
from imumon.model.samples import SampleBlock
from imumon.record import RecordOptions
from imumon.sources.files.base import ReadOptions
from imumon.sources.vn100 import ascii

RATE = 100.0
DEG, G = np.pi / 180.0, 9.80665


def truth(n: int = 400, seed: int = 3) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return time in s, gyro rad/s and accel m/s^2 of a sensor at rest."""
    rng = np.random.default_rng(seed)
    t = 12.0 + np.arange(n) / RATE
    return t, rng.normal(0.001, 7e-4, (n, 3)), rng.normal((0.1, -0.2, -9.8), 0.013, (n, 3))


def csv(path: Path, names: Iterable[str], *columns: np.ndarray, sep: str = ",") -> Path:
    rows = [sep.join(f"{value:.12g}" for value in row) for row in np.column_stack(columns)]
    data = (sep.join(names) + "\n" + "\n".join(rows) + "\n").encode()
    path.write_bytes(gzip.compress(data) if path.suffix == ".gz" else data)
    return path


def options(path: Path, **more: object) -> ReplayOptions:
    """Return the options to read a file; what its columns do not state is accepted."""
    read = ReadOptions(**({"accept": True} | more))  # type: ignore[arg-type]
    return ReplayOptions(path=str(path), read=read, record=RecordOptions(guarded=False))


def read(path: Path, **more: object) -> SampleBlock:
    """Return all samples of a file as one block; what its columns do not state is accepted."""
    recording = options(path, **more).open()
    blocks = [item for items in recording for item in items if isinstance(item, SampleBlock)]
    return SampleBlock(
        blocks[0].stream,
        np.concatenate([block.values for block in blocks]),
        None
        if blocks[0].time_ns is None
        else np.concatenate([b.time_ns for b in blocks if b.time_ns is not None]),
        np.concatenate([block.lost for block in blocks]),
    )


def replayed(path: Path, **more: object) -> tuple[Report, str]:
    """Return the report of a file, and the remarks on it."""
    remarks: list[str] = []
    report = replay(options(path, **more), remark=remarks.append)
    assert [text.removeprefix(f"{path}: ") for text in remarks] == list(report.device.remarks)
    return report, "\n".join(remarks)


def sentences(n: int, seed: int = 2) -> tuple[np.ndarray, list[str]]:
    """Return (n, 9) values of mag, accel and gyro in the order of `$VNYMR`, and the sentences."""
    rng = np.random.default_rng(seed)
    rows = np.hstack([np.zeros((n, 3)), rng.normal(0.0, 2e-2, (n, 9))])
    rows[:, 8] -= 9.79
    return rows[:, 3:], [ascii.encode(ascii.sentence("VNYMR", row)).decode().strip() for row in rows]
