"""Laws of what the likelihood compares: each frequency counts once, and every term has an expectation of everything."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.noise import OctaveCascade, synthesise
from imumon.noise.blocks import BlockMeans
from imumon.noise.fit.fit_rules import BAND_EDGES
from imumon.noise.fit.model import TERMS, WALK
from imumon.noise.fit.observations import block_series, meeting_frequency, spectral_powers


@pytest.mark.parametrize("samples", [2_000, 5_000, 20_000, 70_000])
def test_spectrum_and_blocks_meet_without_an_overlap(samples: int) -> None:
    """The lowest band that the spectrum has begins where the block means end."""
    cascade = OctaveCascade(1, tau0=1.0)
    cascade.update(np.random.default_rng(1).standard_normal((samples, 1)))
    sums = cascade.result().sums
    assert sums is not None
    series = block_series(sums.blocks, 0)
    assert series is not None
    meeting = meeting_frequency(series)
    tops = np.sort(spectral_powers(sums, 0, averaged=True).top)
    edges = np.append(tops[0] * BAND_EDGES[0] / BAND_EDGES[1], tops)
    assert np.isclose(edges, meeting).any()


def test_every_term_has_a_positive_expectation_of_every_observation() -> None:
    cascade = OctaveCascade(1, tau0=1.0)
    cascade.update(np.random.default_rng(1).standard_normal((20_000, 1)))
    sums = cascade.result().sums
    assert sums is not None
    series, bands = block_series(sums.blocks, 0), spectral_powers(sums, 0, averaged=False)
    assert series is not None
    for term in TERMS:
        assert (bands.expected[term] > 0.0).all(), term.letter
        assert (series.variances[term] > 0.0).all(), term.letter


@pytest.mark.parametrize("length", [1, 4])
def test_what_is_interpolated_across_holes_is_expected(length: int) -> None:
    """A twentieth of the blocks of walks is missing; without the bridges, the upper half is 6 % too low."""
    count, walks = 256, 400
    means = synthesise(count, 1.0, K=[1.0] * walks, seed=5)
    for begin in range(10, count - 12, count * length // 12):
        means[begin : begin + length] = np.nan
    share, segment = np.isfinite(means).astype(np.float64), np.zeros(count, dtype=np.int64)
    blocks = BlockMeans(means, share, segment, 1, 1.0, np.zeros(walks))
    ratios = []
    for column in range(walks):
        series = block_series(blocks, column)
        assert series is not None
        assert series.count.tolist() == [count]
        ratios.append(series.y**2 / series.variances[WALK])
    low, high = np.split(np.mean(ratios, axis=0), [count // 2])
    assert low.mean() == pytest.approx(1.0, abs=0.02)  # 51,000 squares: a standard error of 0.6 %
    assert high.mean() == pytest.approx(1.0, abs=0.03)  # of means, a bridge over one block is a little lower
