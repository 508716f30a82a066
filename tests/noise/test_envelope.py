"""Envelope: every extreme is in its column, for any chunking."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.model.samples import Bools, Floats
from imumon.noise.statistics.envelope import RECENT_COLUMNS, Envelope, EnvelopeColumns


def expected(values: Floats, valid: Bools, width: int, start: int) -> tuple[Floats, Floats]:
    """Return (k, c) extremes of the columns that begin at `start`."""
    marked = np.where(valid, values, np.nan)[start:]
    pad = -len(marked) % width
    marked = np.concatenate((marked, np.full((pad, values.shape[1]), np.nan))).reshape(
        -1, width, values.shape[1]
    )
    return np.fmin.reduce(marked, axis=1), np.fmax.reduce(marked, axis=1)


def record(n: int) -> tuple[Floats, Bools]:
    rng = np.random.default_rng(1)
    valid = rng.random((n, 1)) > 0.05
    valid[n // 3 : n // 3 + 70] = False
    return rng.standard_normal((n, 2)).cumsum(axis=0), valid


@pytest.mark.few
@pytest.mark.parametrize("n", [1, 19, 20, 2345, 2400, 30_011])
@pytest.mark.parametrize("chunk", [7, 40, 1000, 100_000])
def test_columns_have_the_extremes(n: int, chunk: int) -> None:
    if n > 10_000 and chunk < 40:
        pytest.skip("long enough with larger chunks")
    values, valid = record(n)
    envelope = Envelope((0, 0), 40.0)
    for i in range(0, n, chunk):
        envelope.update(values[i : i + chunk], valid[i : i + chunk])
    minute, hour, everything = envelope.minute(), envelope.hour(), envelope.everything()
    assert (minute.width, hour.width) == (20, 1200)
    assert len(minute.low) <= RECENT_COLUMNS
    assert len(everything.low) <= 2 * RECENT_COLUMNS
    assert everything.start == 0
    for columns in (minute, hour, everything):
        low, high = expected(values, valid, columns.width, columns.start)
        np.testing.assert_array_equal(columns.low, low)
        np.testing.assert_array_equal(columns.high, high)


def test_statistics_of_the_last_minute() -> None:
    values, valid = record(30_000)
    values += 1e4
    envelope = Envelope((0, 0), 40.0)
    for i in range(0, len(values), 300):
        envelope.update(values[i : i + 300], valid[i : i + 300])
    recent = envelope.recent()
    last = values[-2400:][valid[-2400:, 0]]
    np.testing.assert_allclose(recent.mean, last.mean(axis=0))
    np.testing.assert_allclose(recent.std, last.std(axis=0, ddof=1), rtol=1e-6)
    assert recent.count[0] == len(last)


def columns_equal(a: EnvelopeColumns, b: EnvelopeColumns) -> None:
    assert (a.start, a.width) == (b.start, b.width)
    np.testing.assert_array_equal(a.low, b.low)
    np.testing.assert_array_equal(a.high, b.high)


@pytest.mark.few
@pytest.mark.parametrize("exponent", [7, 12, 15])
def test_a_gap_of_any_length_is_arithmetic(exponent: int) -> None:
    envelope = Envelope([0], 100.0)
    envelope.update(np.ones((1000, 1)))
    envelope.skip(10**exponent)
    envelope.update(np.zeros((1000, 1)))
    low, high = envelope.everything().low, envelope.everything().high
    assert (np.nanmin(low), np.nanmax(high)) == (0.0, 1.0)
    assert np.nanmax(envelope.hour().high) == 0.0


@pytest.mark.few
@pytest.mark.parametrize("gap", [1, 15, 500, 5000, 400_000])
def test_a_gap_equals_as_many_invalid_samples(gap: int) -> None:
    values, valid = record(3000)
    skipped, filled = Envelope((0, 0), 40.0), Envelope((0, 0), 40.0)
    for envelope in (skipped, filled):
        envelope.update(values[:1005], valid[:1005])
        if envelope is skipped:
            envelope.skip(gap)
        else:
            for i in range(0, gap, 999):
                n = min(999, gap - i)
                envelope.update(np.zeros((n, 2)), np.zeros((n, 1), dtype=bool))
        envelope.update(values[1005:], valid[1005:])
    for view in (Envelope.minute, Envelope.hour, Envelope.everything):
        columns_equal(view(skipped), view(filled))
