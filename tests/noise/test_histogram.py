"""Histogram: exact counts in bounded bins, and a verdict by effect size."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from imumon.model.samples import Floats
from imumon.noise.statistics.distribution_shape import DistributionShape
from imumon.noise.statistics.histogram import HISTOGRAM_BINS, HistogramAccumulator, quantum


def shape(values: Floats, chunk: int = 5000) -> DistributionShape:
    histogram = HistogramAccumulator((0,))
    for i in range(0, len(values), chunk):
        histogram.update(values[i : i + chunk, None])
    (result,) = histogram.result()
    return result


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.mark.few
@pytest.mark.parametrize("n", [256, 3000, 100_000, 1_000_000])
@pytest.mark.parametrize("level", [0.0, -9.8])
def test_gaussian_noise_is_gaussian_at_any_length(n: int, level: float) -> None:
    result = shape(level + 1e-2 * rng(n).standard_normal(n))
    assert result.is_gaussian
    assert result.verdict == "Gaussian"
    assert sum(result.counts) == n
    assert sum(result.gaussian) == pytest.approx(n, rel=1e-2)


CASES: dict[str, tuple[Callable[[int], Floats], str]] = {
    "laplace": (lambda n: rng().laplace(size=n), "heavy tails"),
    "exponential": (lambda n: rng().exponential(size=n), "skewed"),
    "uniform": (lambda n: rng().uniform(size=n), "light tails"),
    "two": (lambda n: rng().standard_normal(n) + np.where(rng(2).random(n) < 0.4, 4.0, 0.0), "light tails"),
    "three": (lambda n: rng().standard_normal(n) + 6.0 * rng(2).integers(0, 3, n), "light tails"),
    "levels": (lambda n: np.rint(0.5 * rng().standard_normal(n)) * 0.001, "quantised"),
    "knocked": (lambda n: rng().standard_normal(n) * np.where(rng(2).random(n) < 0.02, 6.0, 1.0), "heavy"),
}


@pytest.mark.few
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("n", [5000, 300_000])
def test_verdict_names_how_values_differ_from_a_gaussian(case: str, n: int) -> None:
    make, reason = CASES[case]
    result = shape(np.asarray(make(n), dtype=np.float64))
    assert result.is_gaussian is False
    assert reason in result.verdict


@pytest.mark.few
@pytest.mark.parametrize("unit", [2.0**-60, 2.0**150])
def test_the_unit_has_no_effect(unit: float) -> None:
    values = rng().gamma(9.0, size=20_000)
    one, other = shape(values), shape(values * unit)
    assert (other.verdict, other.counts) == (one.verdict, one.counts)


def test_counts_are_exact_and_any_chunking_gives_the_same() -> None:
    values = rng().standard_normal((20_000, 3)) * [1.0, 1e-3, 5.0] + [0.0, 9.8, -3.0]
    values[:, 2] = np.rint(values[:, 2] * 10) / 10
    values[7000:, 0] *= 30.0
    valid = rng(2).random((20_000, 2)) > 0.1
    results = []
    for chunk in (20_000, 977, 61):
        histogram = HistogramAccumulator((0, 0, 1))
        for i in range(0, len(values), chunk):
            histogram.update(values[i : i + chunk], valid[i : i + chunk])
        results.append(histogram.result())
    assert results[0] == results[1] == results[2]
    for c, result in enumerate(results[0]):
        assert len(result.counts) <= HISTOGRAM_BINS
        edges = result.start + result.width * np.arange(len(result.counts) + 1)
        counted, _ = np.histogram(values[valid[:, c // 2], c], edges)
        assert result.counts == tuple(counted.tolist())


def test_one_huge_value_costs_resolution_only() -> None:
    values = rng().standard_normal(10_000)
    values[5000] = 1e30
    result = shape(values, 100)
    assert sum(result.counts) == 10_000
    assert result.counts[-1] == 1


def test_steps_are_estimated_from_the_values() -> None:
    x = rng().standard_normal(256)
    assert quantum(x) == 0.0
    assert quantum(x.astype(np.float32).astype(np.float64)) == 0.0
    assert quantum(np.rint(x * 14) * 0.001 - 9.8) == pytest.approx(0.001)
    assert quantum(25.0 + np.rint(x) * 0.1) == pytest.approx(0.1)
    ten_digits = (25.0 + np.rint(x) * 0.1) * (1.0 + 1e-11 * x)
    assert quantum(ten_digits) == pytest.approx(0.1)
    assert quantum(np.full(256, 25.0)) == 0.0
