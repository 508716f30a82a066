"""Extreme values: a range that is too small is seen from the values alone, and nothing else looks like it."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.model.samples import Floats
from imumon.noise.statistics.extreme_values import ExtremeVisits
from imumon.noise.statistics.histogram import HistogramAccumulator

SAMPLES = 100_000


def clipped_at(values: Floats, chunk: int = 1000) -> tuple[float, ...]:
    extremes, histogram = ExtremeVisits([0]), HistogramAccumulator([0])
    for begin in range(0, len(values), chunk):
        extremes.update(values[begin : begin + chunk, None])
        histogram.update(values[begin : begin + chunk, None])
    (result,), (shape,) = extremes.result(), histogram.result()
    return result.clipped_at(shape)


def noise(seed: int = 1) -> Floats:
    return np.random.default_rng(seed).standard_normal(SAMPLES)


@pytest.mark.few
@pytest.mark.parametrize("limit", [0.5, 0.67, 1.0, 2.0, 3.0, 3.5])
def test_clipped_noise_is_seen(limit: float) -> None:
    assert clipped_at(np.clip(noise() + 0.1, -limit, limit)) == (-limit, limit)
    assert clipped_at(np.minimum(noise(), limit)) == (limit,)


# of steps of 0.2, a limit at three deviations makes N 0.3 % low, and is not seen in each record
@pytest.mark.few
@pytest.mark.parametrize(
    ("limit", "step"),
    [(0.5, 0.02), (0.67, 0.02), (1.0, 0.02), (3.0, 0.02), (0.5, 0.2), (1.0, 0.2), (2.0, 0.2)],
)
def test_it_is_seen_in_steps_too(limit: float, step: float) -> None:
    last = round(limit / step)
    assert len(clipped_at(np.clip(np.round(noise() / step), -last, last) * step)) == 2


@pytest.mark.few
@pytest.mark.parametrize("step", [0.0, 0.01, 0.1, 0.3, 1.0, 1.5])
@pytest.mark.parametrize("seed", range(4))
def test_noise_with_any_steps_is_not_clipped(step: float, seed: int) -> None:
    values = noise(seed)
    assert clipped_at(np.round(values / step) * step if step else values) == ()


def test_a_drift_that_settles_is_not_clipped() -> None:
    settling = 30.0 * np.exp(-np.arange(SAMPLES) / 5_000.0)
    assert clipped_at(np.round((settling + noise()) / 0.5) * 0.5) == ()
    assert clipped_at(np.round(settling + 0.6 * noise())) == ()


@pytest.mark.few
@pytest.mark.parametrize("levels", [1, 2, 3, 4])
def test_few_levels_are_not_clipped(levels: int) -> None:
    assert clipped_at(np.clip(np.round(noise()), 0.0, levels - 1.0)) == ()


def test_visits_do_not_depend_on_the_chunks() -> None:
    values = np.clip(noise(), -2.0, 2.0)
    whole, parts = ExtremeVisits([0]), ExtremeVisits([0])
    whole.update(values[:, None])
    rng, begin = np.random.default_rng(2), 0
    while begin < SAMPLES:
        end = begin + int(rng.integers(1, 500))
        parts.update(values[begin:end, None])
        begin = end
    assert whole.result() == parts.result()
