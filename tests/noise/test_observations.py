"""Laws of what the likelihood compares: each frequency counts once, and every term has an expectation of everything."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.noise import OctaveCascade
from imumon.noise.fit.fit_rules import BAND_EDGES
from imumon.noise.fit.model import TERMS
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
