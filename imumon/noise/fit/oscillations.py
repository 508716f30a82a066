"""Oscillations of the mean: which of those that a model leaves out are real, their periods, and what they move.

A slow oscillation (a control loop, a pendulum, the air conditioning) is no noise. Where its period is steady,
`slow_terms` describes it by a column. Where the period wanders no column fits, and the coefficients of the block means
that it holds are left out of the likelihood. Neighbouring coefficients that are left out are one oscillation, of the
power that they have beyond the noise of the model (`Model.excess`), if that is beyond chance.

A line of the spectrum that is faster than the blocks is not named a second time: block means of length L see a line
of frequency f at its alias, the distance of f from the nearest multiple of 1/L, with sinc^2(f L) of its power.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imumon.model.samples import Floats, Ints
from imumon.noise.fit.regressors import OSCILLATION
from imumon.noise.fit.search import Model
from imumon.noise.fit.slow_terms import CERTAIN
from imumon.noise.noise_sums import NoiseSums

ALIAS_WIDTHS = 3.0
"""Distance up to which a slow oscillation is the alias of a line. Unit: widths of the line.

Otherwise: a strong hum is named twice, once with a false period, and with 1 the model of two recordings has an
oscillation that is none. Origin: the share of a Gaussian line beyond is 0.3 %.
"""


def line_bands(sums: NoiseSums, channel: int) -> Floats:
    """Return (l, 3) frequency and width, cycles per sample, and power of the lines of a channel, strongest first."""
    bands = () if sums.spectrum is None else sums.spectrum.bands[channel]
    scaled = [(band.frequency_hz * sums.tau0, band.width_hz * sums.tau0, band.power) for band in bands]
    return np.array(scaled).reshape(-1, 3)


def oscillations(model: Model, lines: Floats) -> list[Ints]:
    """Return the coefficients of each oscillation that is beyond chance and no alias of a line.

    A block averages over most of a line, and what remains of a strong one shows at the wrong frequency. A tenth of an
    oscillation is enough to say so: the power of a line in a block is known no better.

    Parameters
    ----------
    lines : (l, 3) frequency and width, cycles per sample, and power of each line of the spectrum.
    """
    series, groups = model.slow.series, []
    f, width, power = lines.T
    noise = model.slow.noise_variances(model.surface)
    aliases = np.abs(f - np.round(f * series.length) / series.length)
    remains = power / (np.pi * f * series.length) ** 2  # sinc^2 of the block, at most
    for group, count in _left_out_runs(model):
        if np.isin(group, model.slow.slowest).any():
            continue  # the end of a slow change is no oscillation
        step = 0.5 / (count * series.length)
        if float((model.excess[group] / noise[group]).sum()) > CERTAIN:
            low, high = series.f[group[[0, -1]]] + np.array([-step, step])
            reach = ALIAS_WIDTHS * width
            near = (low - reach <= aliases) & (aliases <= high + reach)
            if not (near & (remains > 0.1 * float(model.excess[group].sum()) / count)).any():
                groups.append(group)
    return groups


def _left_out_runs(model: Model) -> Iterator[tuple[Ints, int]]:
    """Yield neighbouring coefficients that are left out, and the number of blocks of their segment."""
    series = model.slow.series
    for begin, count in zip(series.begin - np.arange(series.begin.size), series.count, strict=True):
        left_out = np.flatnonzero(model.slow.masked[begin : begin + count - 1])
        for neighbours in np.split(left_out, np.flatnonzero(np.diff(left_out) > 1) + 1):
            if neighbours.size:
                yield begin + neighbours, int(count)


def periods(model: Model, lines: Floats, tau0: float) -> tuple[float, ...]:
    """Return the periods, s, of the oscillations: of those that are left out the middle of each."""
    left_out = []
    for group in oscillations(model, lines):
        weight = model.excess[group]
        left_out.append(float(tau0 * weight.sum() / (weight @ model.slow.series.f[group])))
    described = [
        column.place * model.slow.series.length * tau0
        for column in model.slow.regressors
        if column.name == OSCILLATION[0]
    ]
    return tuple(sorted([*left_out, *described]))


def moved(model: Model, lines: Floats) -> Floats:
    """Return (n,) channel unit, what moves the mean at each block; oscillations and slow changes as they are."""
    import scipy.fft

    series, beta = model.slow.series, model.surface.beta[model.surface.best]
    out = np.zeros(series.series.size)
    for column, value in zip(model.slow.regressors, beta.tolist(), strict=True):
        out = out + value * column.scale * column.series
    left_out = np.zeros(series.y.size)
    slow = [run for run, _ in _left_out_runs(model) if np.isin(run, model.slow.slowest).any()]
    for group in [*oscillations(model, lines), *slow]:
        left_out[group] = np.sqrt(model.excess[group])
    if left_out.any():
        # of an oscillation the excess is known, and its sign in each coefficient is that of the data
        left_out = np.copysign(left_out, series.y - series.transform(out))
        for number, (begin, count) in enumerate(zip(series.begin, series.count, strict=True)):
            segment = np.concatenate(([0.0], left_out[begin - number : begin - number + count - 1]))
            out[begin : begin + count] += scipy.fft.idct(segment, norm="ortho")
    return out
