"""Exact curves: the fully overlapping Allan deviation of a record, beside the curve of the fit.

The samples are all valid ones, also those that the guards exclude. The limits use the equivalent degrees of
freedom of the curve of the fit, interpolated over tau: the two curves overlap almost as much.
"""

from __future__ import annotations

import math
from typing import Literal, TypeAlias

import numpy as np

from imumon.noise.allan.overlapping import (
    SampleStore,
    averaging_lengths,
    overlapping_deviation,
)
from imumon.noise.statistics.moments import deviation_limits
from imumon.report import Allan, Channel, ExactCurve
from imumon.samples import Floats, Ints

Taus: TypeAlias = Literal["octave", "decade"] | tuple[float, ...]
"""Averaging times: octaves, ten per decade, or times in s, which become whole numbers of samples."""


def exact_curves(
    store: SampleStore, channels: dict[str, Channel], interval_s: float, *, begin: int, taus: Taus
) -> dict[str, ExactCurve]:
    """Return the exact curve of each channel that has an Allan curve.

    Parameters
    ----------
    store : samples of these channels, in this order.
    channels : of the report, those with a curve.
    interval_s : s between two samples.
    begin : samples of the grid at the beginning that do not count.
    taus : averaging times.
    """
    # The store keeps the warm-up, which ends when it is long past: `begin` leaves it out here.
    values, valid = store.result()
    lengths = _lengths(len(values) - begin, interval_s, taus)
    return {
        name: _curve(
            channel, *overlapping_deviation(values[begin:, k], valid[begin:, k], lengths), lengths, interval_s
        )
        for k, (name, channel) in enumerate(channels.items())
    }


def _lengths(samples: int, interval_s: float, taus: Taus) -> list[int]:
    """Return averaging times in samples, rising; those that the record has no pair of averages for are left out."""
    if isinstance(taus, str):
        return averaging_lengths(samples, octaves=taus == "octave")
    return sorted({m for tau in taus if 1 <= (m := round(tau / interval_s)) <= samples // 2})


def _curve(channel: Channel, sigma: Floats, terms: Ints, lengths: list[int], interval_s: float) -> ExactCurve:
    allan = channel.allan or Allan()
    known = [(math.log(t), edf) for t, edf in zip(allan.tau_s, allan.edf, strict=True) if edf]
    places, edfs = [tau for tau, _ in known], [edf for _, edf in known]
    kept = [k for k in range(len(lengths)) if terms[k] > 0]  # gaps may leave no pair of clusters this long
    low: list[float | None] = []
    high: list[float | None] = []
    differences: list[float | None] = []
    for k in kept:
        tau = lengths[k] * interval_s
        limits: tuple[float | None, float | None] = (None, None)
        # np.interp holds its ends: ten times per decade reach beyond the last octave of the fit
        if known and sigma[k] > 0.0:
            limits = deviation_limits(float(sigma[k]), float(np.interp(math.log(tau), places, edfs)))
        low.append(limits[0])
        high.append(limits[1])
        differences.append(_difference(allan, tau, float(sigma[k])))
    return ExactCurve(
        tau_s=tuple(lengths[k] * interval_s for k in kept),
        sigma=tuple(float(sigma[k]) for k in kept),
        low=tuple(low),
        high=tuple(high),
        terms=tuple(int(terms[k]) for k in kept),
        difference=tuple(differences),
    )


def _difference(allan: Allan, tau_s: float, sigma: float) -> float | None:
    """Return the deviation of the curve of the fit over `sigma`, minus 1; None at another averaging time."""
    for tau, of_fit in zip(allan.tau_s, allan.sigma, strict=True):
        if math.isclose(tau, tau_s) and sigma > 0.0:
            return of_fit / sigma - 1.0
    return None
