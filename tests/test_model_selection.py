"""Laws of the selection of descriptions, on records behind filters."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imumon.noise import Estimator, OctaveCascade, synthesise
from imumon.noise.fit.model_selection import SelectedModel
from imumon.noise.fit.results import ChannelFit
from imumon.samples import Floats

N, B, RATE, CHANNELS = 6.1e-5, 2.4e-5, 40.0, 8


@pytest.fixture(scope="module")
def quiet() -> Floats:
    return synthesise(1 << 18, RATE, N=[N] * CHANNELS, B=B, K=0.0, seed=4, averaged=False)


def fitted(values: Floats) -> list[tuple[ChannelFit, SelectedModel]]:
    cascade, estimator = OctaveCascade(values.shape[1], tau0=1.0 / RATE), Estimator(averaged=False)
    cascade.update(values)
    fits = estimator.fit(cascade.result())
    return [(fit, estimator._confidences[c].model) for c, fit in enumerate(fits)]


def filtered(values: Floats, numerator: list[float], denominator: list[float]) -> Floats:
    """Return values behind a filter of second order, (b0, b1, b2) over (1, a1, a2)."""
    (b0, b1, b2), (a1, a2) = numerator, denominator
    out = np.zeros_like(values)
    for at in range(2, len(values)):
        out[at] = b0 * values[at] + b1 * values[at - 1] + b2 * values[at - 2]
        out[at] -= a1 * out[at - 1] + a2 * out[at - 2]
    return out[100:]


@pytest.mark.parametrize("length", [2, 3, 4, 5, 8])
def test_a_moving_average_has_one_description(quiet: Floats, length: int) -> None:
    """Beyond its length, the term in 1/tau^2 describes it exactly: nothing is left to unite."""
    total = np.cumsum(quiet, axis=0)
    averaged = (total[length:] - total[:-length]) / length
    found = fitted(averaged)
    assert sum(not model.others for _, model in found) >= CHANNELS - 1
    assert sum(fit.N.low <= N <= fit.N.high for fit, _ in found) >= CHANNELS - 1
    most = 0.02 * math.sqrt(2.0 ** math.ceil(math.log2(length)))
    assert np.median([(fit.N.high - fit.N.low) / N for fit, _ in found]) < most


def test_a_description_that_the_data_decide_against_does_not_widen_the_limits(quiet: Floats) -> None:
    """The tolerance of the fit lets a description pass whose first octave is 1 % off; the next one is not."""
    corner = math.tan(math.pi * 0.1)
    whole = 1.0 + math.sqrt(2.0) * corner + corner**2
    gain = corner**2 / whole
    turns = [2.0 * (corner**2 - 1.0) / whole, (1.0 - math.sqrt(2.0) * corner + corner**2) / whole]
    found = fitted(filtered(quiet, [gain, 2.0 * gain, gain], turns))
    assert sum(fit.N.low <= N <= fit.N.high for fit, _ in found) >= CHANNELS - 1
    assert np.median([fit.N.high - fit.N.low for fit, _ in found]) < 0.06 * N
    for _, model in found:
        for other in model.others:
            assert model.chi2 is not None
            assert other.chi2 is not None
            assert abs(model.chi2 - other.chi2) <= 10.0 * abs(model.dof - other.dof)


@pytest.mark.parametrize("length", [2, 4])
def test_the_limits_behind_a_moving_average_do_not_alternate(quiet: Floats, length: int) -> None:
    total = np.cumsum(quiet[: 1 << 16], axis=0)
    averaged = (total[length:] - total[:-length]) / length
    cascade, estimator = OctaveCascade(CHANNELS, tau0=1.0 / RATE), Estimator(averaged=False, time_to=False)
    at, widths = 8_000, []
    cascade.update(averaged[:at])
    while at < len(averaged):
        widths.append(
            [fit.N.high - fit.N.low for fit in estimator.fit(cascade.result(), bands=[()] * CHANNELS)]
        )
        part = averaged[at : round(1.05 * at)]
        cascade.update(part)
        at += len(part)
    jumps = np.abs(np.diff(np.log(np.array(widths, dtype=float)), axis=0)) > np.log(1.4)
    assert jumps.sum() <= 2 * CHANNELS  # of 43 reports of each channel
