"""Samples that are no numbers: counted, excluded, never an exception."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest

from imumon.model.report import DeviceDescription, Report, SessionCounters
from imumon.model.samples import ACCEL, GYRO, Clock, SampleBlock, Stream
from imumon.record import Record

SAMPLES = 3000
INTERVAL_NS = 10_000_000


def report_of(values: np.ndarray, clock: Clock, block: int = 50) -> tuple[Report, list[str]]:
    stream = Stream("uncompensated", (*GYRO, *ACCEL, "temperature"), "test", clock)
    monitor = Record(rate_hz=100.0)
    for at in range(0, len(values), block):
        some = values[at : at + block]
        time = (at + np.arange(len(some))) * INTERVAL_NS if clock == "startup" else None
        monitor.feed(SampleBlock(stream, some, time, np.zeros(len(some), np.int64)))
    monitor.flush()
    made = monitor.report(datetime.now(UTC), DeviceDescription(id="x"), "stopped", SessionCounters())
    return made, [event.kind for event in monitor.events()]


def noise() -> np.ndarray:
    values = np.random.default_rng(1).normal(0.0, 1e-3, (SAMPLES, 7))
    values[:, 6] += 25.0
    return values


@pytest.mark.few
@pytest.mark.parametrize("clock", ["startup", "none"])
@pytest.mark.parametrize(("bad", "block"), [(np.nan, 50), (np.inf, 50), (1e300, 50), (np.nan, 1)])
def test_a_sample_without_a_number_is_missing(clock: Clock, bad: float, block: int) -> None:
    values = noise()
    bad_rows = np.array([50, 51, 52, 99, 149, 1000, 2345])
    values[bad_rows, [0, 1, 2, 3, 4, 5, 0]] = bad
    made, kinds = report_of(values, clock, block)
    assert made.session.samples == SAMPLES - len(bad_rows)
    assert made.session.missing == len(bad_rows)
    assert made.session.excluded_by == {}
    assert all(made.channels[name].coefficients["N"].value for name in (*GYRO, *ACCEL))
    assert kinds.count("garbage") == 1


@pytest.mark.few
@pytest.mark.parametrize("rows", [slice(None), slice(None, None, 7), slice(1500, None)])
def test_a_temperature_without_a_number_is_unknown_there(rows: slice) -> None:
    values = noise()
    values[rows, 6] = np.nan
    made, kinds = report_of(values, "startup")
    temperature = made.channels["temperature"]
    known = np.isfinite(values[:, 6])
    assert temperature.count == known.sum()
    assert (temperature.mean is None) == (not known.any())
    assert made.session.samples == SAMPLES
    assert made.channels["gyro/x"].coefficients["N"].value == pytest.approx(1e-4, rel=0.1)
    assert "garbage" not in kinds


def test_a_sensor_that_sends_no_number_at_all_gives_no_sample() -> None:
    values = noise()
    values[:, 3:6] = np.nan
    made, kinds = report_of(values, "startup")
    assert made.session.samples == 0
    assert kinds == ["garbage"]
