"""Envelope: every extreme is in its column, for any chunking."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.noise.statistics.envelope import ALL_COLUMNS, RECENT_COLUMNS, Envelope, EnvelopeColumns
from imumon.samples import Bools, Floats


def expected(values: Floats, valid: Bools, width: int, start: int) -> tuple[Floats, Floats]:
    """(k, c) extremes of the columns that begin at `start`."""
    shown = np.where(valid, values, np.nan)[start:]
    pad = -len(shown) % width
    shown = np.concatenate((shown, np.full((pad, values.shape[1]), np.nan))).reshape(
        -1, width, values.shape[1]
    )
    return np.fmin.reduce(shown, axis=1), np.fmax.reduce(shown, axis=1)


def record(n: int) -> tuple[Floats, Bools]:
    rng = np.random.default_rng(1)
    valid = rng.random((n, 1)) > 0.05
    valid[n // 3 : n // 3 + 70] = False
    return rng.standard_normal((n, 2)).cumsum(axis=0), valid


@pytest.mark.parametrize("n", [1, 19, 20, 2345, 2400, 30_011])
@pytest.mark.parametrize("chunk", [7, 40, 1000, 100_000])
def test_columns_hold_the_extremes(n: int, chunk: int) -> None:
    if n > 10_000 and chunk < 40:
        pytest.skip("long enough with larger chunks")
    values, valid = record(n)
    strip = Envelope((0, 0), 40.0)
    for i in range(0, n, chunk):
        strip.update(values[i : i + chunk], valid[i : i + chunk])
    minute, hour, everything = strip.minute(), strip.hour(), strip.everything()
    assert (minute.width, hour.width) == (20, 1200)
    assert len(minute.low) <= RECENT_COLUMNS
    assert len(everything.low) <= ALL_COLUMNS
    assert everything.start == 0
    for columns in (minute, hour, everything):
        low, high = expected(values, valid, columns.width, columns.start)
        np.testing.assert_array_equal(columns.low, low)
        np.testing.assert_array_equal(columns.high, high)


def test_the_last_minute() -> None:
    values, valid = record(30_000)
    values += 1e4
    strip = Envelope((0, 0), 40.0)
    for i in range(0, len(values), 300):
        strip.update(values[i : i + 300], valid[i : i + 300])
    recent = strip.recent()
    last = values[-2400:][valid[-2400:, 0]]
    np.testing.assert_allclose(recent.mean, last.mean(axis=0))
    np.testing.assert_allclose(recent.std, last.std(axis=0, ddof=1), rtol=1e-6)
    assert recent.count[0] == len(last)


def columns_equal(a: EnvelopeColumns, b: EnvelopeColumns) -> None:
    assert (a.start, a.width) == (b.start, b.width)
    np.testing.assert_array_equal(a.low, b.low)
    np.testing.assert_array_equal(a.high, b.high)


@pytest.mark.parametrize("hole", [1, 15, 500, 5000, 400_000])
def test_a_gap_equals_as_many_invalid_samples(hole: int) -> None:
    values, valid = record(3000)
    skipped, filled = Envelope((0, 0), 40.0), Envelope((0, 0), 40.0)
    for strip in (skipped, filled):
        strip.update(values[:1005], valid[:1005])
        if strip is skipped:
            strip.skip(hole)
        else:
            for i in range(0, hole, 999):
                n = min(999, hole - i)
                strip.update(np.zeros((n, 2)), np.zeros((n, 1), dtype=bool))
        strip.update(values[1005:], valid[1005:])
    for view in (Envelope.minute, Envelope.hour, Envelope.everything):
        columns_equal(view(skipped), view(filled))


def test_save_and_restore_continue_identically() -> None:
    values, valid = record(9000)
    whole, first = Envelope((0, 0), 40.0), Envelope((0, 0), 40.0)
    whole.update(values, valid)
    first.update(values[:4321], valid[:4321])
    second = Envelope.restore(first.save())
    second.update(values[4321:], valid[4321:])
    for view in (Envelope.minute, Envelope.hour, Envelope.everything):
        columns_equal(view(whole), view(second))
    np.testing.assert_allclose(whole.recent().mean, second.recent().mean)


def test_nothing_yet() -> None:
    strip = Envelope((0,), 40.0)
    assert strip.minute().low.shape == (0, 1)
    assert np.isnan(strip.recent().mean).all()
