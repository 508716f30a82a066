"""A record played backwards: time reversal changes no second moment, so it changes no statement but of order in time.

Block means of whole blocks are the same numbers from behind. Segments of the spectrum are not: filters between its
levels look back, so that each level leaves out another end of the record. What that moves is bounded here. An
exponential from the beginning is about order in time: channels in which one is in doubt have limits of their own.
"""

from __future__ import annotations

import pytest

from imumon.model.samples import Floats
from imumon.noise import Estimator, OctaveCascade, synthesise
from imumon.noise.fit.likelihood import EVIDENCE, evidence
from imumon.noise.fit.model import WALK
from imumon.noise.fit.observations import block_series
from imumon.noise.fit.slow_terms import SlowTermSearch

WHOLE = 1 << 17
"""Samples: 1,024 whole blocks."""


def stated(
    values: Floats,
) -> tuple[Estimator, list[SlowTermSearch], list[dict[str, tuple[float, float, str]]]]:
    """Return the estimator, the slow terms, and limits and status of N, B and K of each channel."""
    cascade, estimator = OctaveCascade(values.shape[1], tau0=0.025), Estimator(averaged=False, time_to=False)
    cascade.update(values)
    curve = cascade.result()
    fits = estimator.fit(curve)
    searches = []
    for channel in range(values.shape[1]):
        series = block_series(curve.sums.blocks, channel)
        searches.append(SlowTermSearch(series, None))
        searches[-1].result()
    limits = [
        {letter: (part.low, part.high, part.status) for letter, part in fit.coefficients.items()}
        for fit in fits
    ]
    return estimator, searches, limits


@pytest.mark.parametrize("K", [0.0, 3e-6])
def test_a_record_played_backwards_states_the_same(K: float) -> None:
    values = synthesise(WHOLE, 40.0, N=[6.1e-5] * 8, B=[2.4e-5] * 8, K=[K] * 8, seed=11, averaged=False)
    forwards, backwards = stated(values), stated(values[::-1].copy())
    compared = 0
    for channel in range(8):
        one, two = (searches[channel] for _, searches, _ in (forwards, backwards))
        assert evidence(one.surface, WALK) == pytest.approx(evidence(two.surface, WALK), rel=1e-6, abs=1e-6)
        assert one.terms.slowest.tolist() == two.terms.slowest.tolist()
        assert one.terms.masked.sum() == two.terms.masked.sum()
        if one.terms.doubtful or two.terms.doubtful:
            continue
        compared += 1
        for letter, (low, high, status) in forwards[2][channel].items():
            low_back, high_back, status_back = backwards[2][channel][letter]
            assert abs(high - high_back) < 0.25 * (high - low)
            if status == status_back:
                assert abs(low - low_back) < 0.25 * (high - low)
            else:
                # only where chance decides whether it shows
                surfaces = [
                    estimator._known[channel].fitted.surface for estimator in (forwards[0], backwards[0])
                ]
                assert letter == "K"
                assert all(abs(evidence(surface, WALK) - EVIDENCE) < 1.0 for surface in surfaces)
    assert compared >= 4
