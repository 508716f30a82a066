"""Laws of the sums of a record: statistics from the first sample on, every sample counted once."""

from __future__ import annotations

import numpy as np
import pytest
from placed import PlacedRecord

from imumon.model.samples import ACCEL, GYRO
from imumon.noise.fit import fit_curve

LEVEL = np.array([0.01, 0.0, -0.01, 0.0, 0.0, -9.8])
SIGMA = np.array([6e-4] * 3 + [1.4e-2] * 3)


@pytest.mark.few
@pytest.mark.parametrize("rate", [0.1, 1.0, 100.0, 800.0])
def test_statistics_begin_with_the_first_samples(rate: float) -> None:
    """The first assessment of the guard delays nothing and removes nothing that a report has shown."""
    made = PlacedRecord(GYRO + ACCEL, rate)
    record = made.record
    values = LEVEL + SIGMA * np.random.default_rng(1).normal(size=(4000 if rate == 800.0 else 1500, 6))
    counts = []
    for row in range(len(values)):
        made.feed(values[row : row + 1], np.ones(1, dtype=np.int64))
        if row in range(1, 60) or row % 100 == 0:
            counts.append(record._shown_sums().moments().channels[0].count)
        if row == 1:
            now = record._shown_sums().moments().channels[0]
            assert (now.count, now.last) == (2, values[1, 0])
            assert now.mean == pytest.approx(values[:2, 0].mean())
        if row == 29:
            assert fit_curve(record._shown_sums().curve(), averaged=True)[0].N.status != "pending"
            assert record._shown_sums().histogram.result()[0] is not None
    assert counts == sorted(counts)
    assert record._shown_sums().moments().channels[0].count == record.samples - record.guard.held
    assert record.guard.held <= 2 * max(10, rate)


def test_missing_share_is_that_of_the_grid() -> None:
    made = PlacedRecord(GYRO + ACCEL, 100.0)
    values = LEVEL + SIGMA * np.random.default_rng(1).normal(size=(1000, 6))
    made.feed(values, np.array([1, 2] * 500))
    assert made.record.counts().missing_share == pytest.approx(1 / 3, abs=1e-3)
