"""Oscillations of the mean: which of those that a model leaves out are real, their periods, and what they move.

A slow oscillation (a control loop, a pendulum, the air conditioning) is no noise. Where its period is steady,
`slow_terms` describes it by a regressor. Where the period wanders no regressor fits, and the coefficients of the block
means that it holds are left out of the likelihood. Neighbouring coefficients that are left out are one oscillation, of
the power that they have beyond the noise of the model (`Model.excess`), if that is beyond chance.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imumon.model.samples import Floats, Ints
from imumon.noise.fit.regressors import OSCILLATION
from imumon.noise.fit.search import Model
from imumon.noise.fit.slow_terms import CERTAIN


def oscillations(model: Model) -> list[Ints]:
    """Return the coefficients of each oscillation that is beyond chance."""
    noise = model.slow.noise_variances(model.surface)
    return [
        group
        for group in _left_out_runs(model)
        # the end of a slow change is no oscillation
        if not np.isin(group, model.slow.slowest).any()
        and float((model.excess[group] / noise[group]).sum()) > CERTAIN
    ]


def _left_out_runs(model: Model) -> Iterator[Ints]:
    """Yield neighbouring coefficients that are left out, but those of humps and lines."""
    series, held = model.slow.series, model.slow.masked & ~model.slow.left_out
    for begin, count in zip(series.begin - np.arange(series.begin.size), series.count, strict=True):
        left_out = np.flatnonzero(held[begin : begin + count - 1])
        for neighbours in np.split(left_out, np.flatnonzero(np.diff(left_out) > 1) + 1):
            if neighbours.size:
                yield begin + neighbours


def periods(model: Model, tau0: float) -> tuple[float, ...]:
    """Return the periods, s, of the oscillations: of those that are left out the middle of each."""
    left_out = []
    for group in oscillations(model):
        weight = model.excess[group]
        left_out.append(float(tau0 * weight.sum() / (weight @ model.slow.series.f[group])))
    described = [
        regressor.place * model.slow.series.length * tau0
        for regressor in model.slow.regressors
        if regressor.name == OSCILLATION[0]
    ]
    return tuple(sorted([*left_out, *described]))


def moved(model: Model) -> Floats:
    """Return (n,) channel unit, what moves the mean at each block; oscillations and slow changes as they are."""
    import scipy.fft

    series, beta = model.slow.series, model.surface.beta[model.surface.best]
    out = np.zeros(series.series.size)
    for regressor, value in zip(model.slow.regressors, beta.tolist(), strict=True):
        out = out + value * regressor.scale * regressor.series
    left_out = np.zeros(series.y.size)
    slow = [run for run in _left_out_runs(model) if np.isin(run, model.slow.slowest).any()]
    for group in [*oscillations(model), *slow]:
        left_out[group] = np.sqrt(model.excess[group])
    if left_out.any():
        # of an oscillation the excess is known, and its sign in each coefficient is that of the data
        left_out = np.copysign(left_out, series.y - series.transform(out))
        for number, (begin, count) in enumerate(zip(series.begin, series.count, strict=True)):
            segment = np.concatenate(([0.0], left_out[begin - number : begin - number + count - 1]))
            out[begin : begin + count] += scipy.fft.idct(segment, norm="ortho")
    return out
