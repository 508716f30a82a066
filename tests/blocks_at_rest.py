"""Blocks of samples of a sensor at rest."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np

from imumon.model.report import DeviceDescription, Report, SessionCounters, State
from imumon.model.samples import ACCEL, GYRO, SampleBlock, Stream
from imumon.record import Record

NOW = datetime(2026, 1, 2, tzinfo=UTC)
TICK = 10_000_000
DELTAS = Stream("deltas", GYRO + ACCEL, "binary", "startup")
LEVEL = np.array([0.01, 0.0, -0.01, 0.0, 0.0, -9.8])
SIGMA = np.array([6e-4] * 3 + [1.4e-2] * 3)


def block(n: int, start: int = 0, seed: int = 1, stream: Stream = DELTAS) -> SampleBlock:
    """Return n samples of 100 Hz from sample `start` on."""
    rng = np.random.default_rng(seed + start)
    values = LEVEL + SIGMA * rng.normal(size=(n, 6))
    time = (np.arange(n) + start) * TICK if stream.clock == "startup" else None
    return SampleBlock(stream, values, time, np.zeros(n, dtype=np.int64))


def report_of(record: Record, state: State = "running", id: str = "x") -> Report:
    """Return the report of a record whose device says nothing of itself."""
    return record.report(NOW, DeviceDescription(id=id), state, SessionCounters())
