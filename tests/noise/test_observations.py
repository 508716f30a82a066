"""Laws of what the likelihood compares: each frequency counts once, and every term has an expectation of everything."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.noise import OctaveCascade, synthesise
from imumon.noise.blocks import BlockMeans
from imumon.noise.fit.model import NOISE_TERMS, TERMS, WHITE, NoiseTerm
from imumon.noise.fit.observations import BAND_EDGES, block_series, meeting_frequency, spectral_powers


@pytest.mark.few
@pytest.mark.parametrize("samples", [2_000, 5_000, 20_000, 70_000])
def test_spectrum_and_blocks_meet_without_an_overlap(samples: int) -> None:
    """The lowest band that the spectrum has begins where the block means end."""
    cascade = OctaveCascade(1, tau0=1.0)
    cascade.update(np.random.default_rng(1).standard_normal((samples, 1)))
    sums = cascade.result().sums
    series = block_series(sums.blocks, 0)
    meeting = meeting_frequency(series)
    tops = np.sort(spectral_powers(sums, 0, averaged=True).top)
    edges = np.append(tops[0] * BAND_EDGES[0] / BAND_EDGES[1], tops)
    assert np.isclose(edges, meeting).any()


def test_every_term_has_a_positive_expectation_of_every_observation() -> None:
    cascade = OctaveCascade(1, tau0=1.0)
    cascade.update(np.random.default_rng(1).standard_normal((20_000, 1)))
    sums = cascade.result().sums
    series, bands = block_series(sums.blocks, 0), spectral_powers(sums, 0, averaged=False)
    for term in TERMS:
        assert (bands.expected[term] > 0.0).all(), term.letter
        assert (series.variances[term] > 0.0).all(), term.letter


@pytest.mark.parametrize("length", [1, 4])
@pytest.mark.parametrize("term", NOISE_TERMS)
def test_what_is_interpolated_across_holes_is_expected(term: NoiseTerm, length: int) -> None:
    """A twentieth is missing: white noise is 15 % more in the lowest tenth, a walk 6 % less in the upper half."""
    count, records = 256, 400
    strengths = {"N": 0.0, "B": 0.0, "K": 0.0, term.letter: 1.0}
    means = synthesise(count, 1.0, **{name: [size] * records for name, size in strengths.items()}, seed=5)
    for begin in range(10, count - 12, count * length // 12):
        means[begin : begin + length] = np.nan
    share, segment = np.isfinite(means).astype(np.float64), np.zeros(count, dtype=np.int64)
    blocks = BlockMeans(means, share, segment, 1, 1.0, np.zeros(records))
    ratios = []
    for column in range(records):
        series = block_series(blocks, column)
        assert series.count.tolist() == [count]
        ratios.append(series.y**2 / series.variances[term])
    mean = np.mean(ratios, axis=0)
    assert mean[:24].mean() == pytest.approx(1.0, abs=0.05)  # 9,600 squares: a standard error of 1.4 %
    assert mean[24 : count // 2].mean() == pytest.approx(1.0, abs=0.025)
    assert mean[count // 2 :].mean() == pytest.approx(1.0, abs=0.03)


@pytest.mark.few
@pytest.mark.parametrize("window", [1, 2, 8])
def test_expectations_are_positive_beside_missing_samples(window: int) -> None:
    """A moving average of two samples has no white noise at half the sampling rate."""
    values = np.random.default_rng(1).standard_normal((20_000, 1))
    valid = np.random.default_rng(2).random((20_000, 1)) >= 0.3
    cascade = OctaveCascade(1, tau0=1.0)
    cascade.update(values, valid)
    sums = cascade.result().sums
    bands = spectral_powers(sums, 0, averaged=False, window=window)
    for term in TERMS:
        assert (bands.expected[term] > 0.0).all(), term.letter


def test_interpolation_repeats_the_noise_of_the_blocks_beside_a_hole() -> None:
    """Of blocks at the border of a hole a part is missing, so that their means have more noise than the others."""
    values = np.random.default_rng(1).standard_normal((144_000, 24))
    valid = np.ones((144_000, 1), dtype=bool)
    for begin in np.random.default_rng(2).integers(0, 142_800, 20).tolist():
        valid[begin : begin + 1200] = False
    cascade = OctaveCascade(24, tau0=1.0)
    cascade.update(values, valid)
    sums = cascade.result().sums
    ratios = []
    for column in range(24):
        series = block_series(sums.blocks, column)
        assert series.count.size == 1
        low = series.order[2:80]
        ratios.append(series.y[low] ** 2 / series.variances[WHITE][low])
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.1)  # three standard errors; with the mean share, 1.25
