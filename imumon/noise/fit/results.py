"""Channel: its fit as it is given out, in SI.

Points follow every curve. Limits, status and times are those of the last renewal (`renewal`); the limits have
moved along with their value since.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from imumon.noise.allan import AllanCurve
from imumon.noise.fit.confidence import Known, Status
from imumon.noise.fit.covariance import TERMS
from imumon.noise.fit.leastsquares import Problems, solve
from imumon.noise.fit.model_selection import QUANTISATION, RAMP, Choice, as_chosen
from imumon.noise.fit.quantiles import chi2_quantile, few_differences_quantile
from imumon.noise.fit.slope_reading import Readings, read_slopes
from imumon.noise.fit.time_to_precision import TimeTo
from imumon.samples import Bools, Floats

_AGREES = 5.0  # standard deviations


@dataclass(frozen=True, slots=True, kw_only=True)
class Coefficient:
    """N, B or K in SI with its 95 % limits; `value` is None unless measured."""

    value: float | None = None
    low: float | None = None
    high: float | None = None
    status: Status = "pending"
    reason: str | None = None
    reason_code: str | None = None  # see `imumon.report.Coefficient`


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChannelFit:
    """What is known of one channel.

    Attributes
    ----------
    N, B, K : channel unit times sqrt(s), 1, 1/sqrt(s).
    quantisation : channel unit times s, Q; None unless the data demand it.
    ramp : channel unit per s, R; None unless the data demand it.
    chi2, dof, p_value : of the misfit; None while there is nothing to test.
    model : (k,) channel unit, fitted Allan deviation; NaN-free, 0.0 where there is no fit.
    used : (k,) octaves that the fit rests on.
    low, high : (k,) channel unit, 95 % limits of the Allan deviation; 0.0 where there is no difference.
    edf : (k,) 1, equivalent degrees of freedom; 0.0 where there is no difference.
    time_to : s, still to record.
    readings : classical slope readings.
    caveats : words; ``misfit`` (what is left is no model, or rests on fewer than half of the octaves),
        ``vibration`` and ``correlated`` (octaves left out, mostly above or below the model),
        ``quantised``, ``ramp``.
    """

    N: Coefficient
    B: Coefficient
    K: Coefficient
    quantisation: float | None = None
    ramp: float | None = None
    chi2: float | None = None
    dof: int | None = None
    p_value: float | None = None
    model: Floats
    used: Bools
    low: Floats
    high: Floats
    edf: Floats
    time_to: TimeTo = field(default_factory=TimeTo)
    readings: Readings = field(default_factory=Readings)
    caveats: tuple[str, ...] = ()


def nothing(octaves: int, reason: str, code: str | None = None) -> ChannelFit:
    """The fit of a channel of which nothing can be said."""
    none = Coefficient(reason=reason, reason_code=code)
    zeros = np.zeros(octaves)
    unused = np.zeros(octaves, dtype=bool)
    return ChannelFit(N=none, B=none, K=none, model=zeros, used=unused, low=zeros, high=zeros, edf=zeros)


def channel_fits(
    curve: AllanCurve, channels: Sequence[int], problems: Problems, known: Sequence[Known]
) -> list[ChannelFit]:
    """Fits of some channels of a curve.

    Parameters
    ----------
    problems, known : (b) one a channel, in the order of `channels`.
    """
    problems = as_chosen(problems, [item.choice for item in known])
    used = problems.used
    frame = problems.frame()
    p = solve(frame, problems.free, start=np.array([item.choice.p for item in known]))
    whole = p * np.where(np.arange(len(TERMS)) == QUANTISATION, p > 0.0, 1.0)
    every = replace(problems, used=np.ones_like(used), excess=np.zeros(len(known))).frame()
    model = every.model(whole)
    variance = np.einsum("bii->bi", every.covariance(whole, model))
    model = np.where(used, frame.model(p), model)
    edf = 2.0 / variance
    low, high = np.sqrt(edf / chi2_quantile(0.975, edf)), 1.0 / np.sqrt(few_differences_quantile(edf))
    return [
        _channel(curve, channel, p[row], known[row], used[row], model[row], edf[row], (low[row], high[row]))
        for row, channel in enumerate(channels)
    ]


def _channel(
    curve: AllanCurve,
    channel: int,
    p: Floats,
    known: Known,
    used: Bools,
    model: Floats,
    edf: Floats,
    limits: tuple[Floats, Floats],
) -> ChannelFit:
    """Everything about one channel in SI; `limits` are those of the Allan deviation over the one found."""
    total, k = len(curve.m), model.size
    tau0 = curve.tau0
    unit = np.sqrt(np.array([tau0, 1.0, 1.0 / tau0, tau0**2, 1.0 / tau0**2]))
    there = curve.terms[:k, channel] > 0
    sigma = curve.sigma[:k, channel]
    low, high = (np.where(there, sigma * limit, 0.0) for limit in limits)
    choice = known.choice
    clear = there & (sigma > 0.0)
    caveats = _caveats(replace(choice, p=p), used, there, sigma**2, model, edf)
    return ChannelFit(
        **{name: _coefficient(p, known, term, float(unit[term])) for term, name in enumerate(TERMS[:3])},
        quantisation=float(math.sqrt(p[QUANTISATION]) * unit[QUANTISATION])
        if "quantised" in caveats
        else None,
        ramp=float(math.sqrt(p[RAMP]) * unit[RAMP]) if p[RAMP] > 0.0 else None,
        chi2=choice.chi2,
        dof=choice.dof if choice.chi2 is not None else None,
        p_value=choice.p_value,
        model=_stretched(np.sqrt(model), total),
        used=_stretched(used, total),
        low=_stretched(low, total),
        high=_stretched(high, total),
        edf=_stretched(np.where(there, edf, 0.0), total),
        time_to=known.time_to,
        readings=read_slopes(curve.tau[:k][clear], sigma[clear]),
        caveats=caveats,
    )


def _coefficient(p: Floats, known: Known, term: int, unit: float) -> Coefficient:
    """One coefficient in SI; its limits moved along with its value since they were worked out."""
    status, then = known.status[term], known.choice.p[term]
    if status == "pending":
        return Coefficient(reason=known.reasons[term])
    high = math.sqrt(known.high[term]) * unit
    if status == "upper_bound":
        return Coefficient(low=0.0, high=high, status=status, reason=known.reasons[term])
    moved = math.sqrt(p[term] / then) if p[term] > 0.0 and then > 0.0 else 1.0
    value = math.sqrt(then) * moved * unit
    low = math.sqrt(known.low[term]) * unit
    return Coefficient(value=value, low=min(low * moved, value), high=max(high * moved, value), status=status)


def _caveats(
    choice: Choice, used: Bools, there: Bools, found: Floats, model: Floats, edf: Floats
) -> tuple[str, ...]:
    out = there & ~used
    words = ["misfit"] if not choice.cured or out.sum() > used.sum() else []
    below, agree = choice.p[QUANTISATION] < 0.0, True
    if np.any(out):
        z = (found[out] / model[out] - 1.0) * np.sqrt(edf[out] / 2.0)
        below, agree = bool(z[np.argmax(np.abs(z))] < 0.0), bool(np.abs(z).max() < _AGREES)
    first = int(np.argmax(used))
    leads = 3.0 * choice.p[QUANTISATION] / 4.0**first > choice.p[0] / 2.0**first
    if choice.p[QUANTISATION] > 0.0 and (agree or (below and leads)):
        words.append("quantised")  # rounding makes the shortest octaves too low, if anything
    elif np.any(out) or choice.p[QUANTISATION] != 0.0:
        words.append("correlated" if below else "vibration")
    if choice.free[RAMP]:
        words.append("ramp")
    return tuple(words)


def _stretched(values: np.ndarray, octaves: int) -> np.ndarray:
    """(octaves,) with zeros behind."""
    return np.concatenate([values, np.zeros(octaves - values.size, dtype=values.dtype)])
