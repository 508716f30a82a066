"""A record that is mostly excluded says why, and what to try."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np

from imumon.model.report import DeviceDescription, Report, SessionCounters
from imumon.model.samples import ACCEL, GYRO, Bools, Floats, SampleBlock, Stream
from imumon.record import Record

RATE = 100.0
ROWS = 12_000


def record(gyro: Floats | float = 0.0) -> Floats:
    """Return (n, 6) noise of a quiet sensor, with an addition to the gyroscope."""
    noise = np.random.default_rng(1).standard_normal((ROWS, 6)) * ([1e-3] * 3 + [1e-2] * 3)
    noise[:, :3] += gyro
    return np.asarray(noise + np.array([0.0, 0.0, 0.0, 0.0, 0.0, -9.8]))


def report(values: Floats, saturated: Bools | None = None) -> Report:
    monitor, n = Record(), len(values)
    stream = Stream("deltas", GYRO + ACCEL, "table", "startup")
    time_ns = np.arange(n) * round(1e9 / RATE)
    monitor.feed(SampleBlock(stream, values, time_ns, np.zeros(n, dtype=np.int64), saturated=saturated))
    monitor.flush()
    device, now = DeviceDescription(id="x"), datetime(2026, 1, 2, tzinfo=UTC)
    return monitor.report(now, device, "stopped", SessionCounters())


def reasons(current: Report) -> set[str | None]:
    """Return why each sensor has no grade."""
    assert all(grade.meets is None for grade in current.grade.values())
    return {grade.reason for grade in current.grade.values()}


def test_a_table_in_degrees_names_motion_and_the_unit() -> None:
    """Noise of 0.06 deg/s and a bias of 0.66 deg/s, read as rad/s."""
    current = report(record(np.degrees(record()[:, :3] + np.array([0.005, -0.01, 0.003]))))
    (reason,) = reasons(current)
    assert reason == "100 % excluded as motion: keep it still, or check its unit (deg/s?)"
    assert "not_at_rest" in current.caveats


def test_motion_after_rest_is_no_question_of_the_unit() -> None:
    turn = np.where(np.arange(ROWS) > 0.7 * ROWS, np.radians(10.0), 0.0)
    assert reasons(report(record(turn[:, None]))) == {"the sensor is not at rest"}


def test_knock_after_knock() -> None:
    knocks = np.where(np.arange(ROWS) % 250 < 20, 0.1, 0.0)
    (reason,) = reasons(report(record(knocks[:, None])))
    assert reason.endswith("% excluded as knock: put it where nothing touches it")


def test_a_range_that_is_exceeded() -> None:
    (reason,) = reasons(report(record(), np.arange(ROWS) % 150 < 10))
    assert reason is not None
    assert "excluded as clipped: " in reason
