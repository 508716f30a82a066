"""Fit of N, B and K to an Allan curve: values, intervals, what they are worth and how long it still takes.

    sigma^2(tau) = N^2/tau + (2 ln2/pi) B^2 + K^2 tau/3  [+ 3 Q^2/tau^2 quantisation + R^2 tau^2/2 ramp]

by generalised least squares with the exact covariance (`covariance`, `leastsquares`), over the octaves and
terms that describe the channel (`choice`), with limits from score tests (`intervals`).

The rules
---------
1. A coefficient is ``measured`` where its score at zero says beyond `_SEEN` that it is there; then it has a
   value and two-sided limits. Else it is ``upper_bound``: no value, and the one-sided bound a larger one
   would have passed. The levels are such that the limits hold in 95 % of all records, whichever of the two
   each is told to be: 2.2 % each side beyond, 3.9 % for a bound, 1.4 % false alarms. They were set on
   simulated records, where a few per mille more lie beyond than these normal quantiles say, since
   the other terms come from the same data.
2. ``pending``: too few octaves to tell the terms apart, or nothing to fit; the reason says which.
3. Points are cheap and follow every call. Limits, choice and times are renewed when the record has grown by
   2 %; in between limits move with their value.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

import numpy as np

from imumon.noise.allan import AllanCurve
from imumon.noise.fit import intervals
from imumon.noise.fit.choice import QUANTISATION, RAMP, Choice, choose
from imumon.noise.fit.covariance import TERMS, octaves_in, tables
from imumon.noise.fit.leastsquares import Problems, solve
from imumon.noise.fit.outlook import seconds_to
from imumon.noise.fit.quantiles import chi2_quantile, few_differences_quantile, normal_quantile
from imumon.noise.fit.readings import Readings, read_slopes
from imumon.samples import Bools, Floats

Status: TypeAlias = Literal["measured", "upper_bound", "pending"]

PRECISION = {"N": 0.01, "B": 0.20, "K": 0.50}
"""Asked 95 % half-widths relative to the value."""

GROWTH = 1.02  # of the record between two renewals of the limits
_SEEN = normal_quantile(0.986)
_BOUND = -normal_quantile(0.961)
_TWO_SIDED = normal_quantile(0.9783)
_NARROW = 0.002  # a bound never falls below what moves the score by this much: it is never zero
_OCTAVES_N, _OCTAVES = 3, 5
_AGREES = 5.0  # standard deviations
_LEAST, _MOST = 1e-100, 1e100  # variances between which squares of them are numbers


@dataclass(frozen=True, slots=True, kw_only=True)
class Coefficient:
    """N, B or K in SI with its 95 % limits; `value` is None unless measured."""

    value: float | None = None
    low: float | None = None
    high: float | None = None
    status: Status = "pending"
    reason: str | None = None


@dataclass(frozen=True, slots=True)
class TimeTo:
    """Seconds of record still to come until the asked precision; 0 once reached; None while not measured, or
    not within a year."""

    N: float | None = None
    B: float | None = None
    K: float | None = None


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


@dataclass(frozen=True, slots=True, eq=False)
class _Known:
    """What was worked out for a channel at the last renewal.

    Attributes
    ----------
    span : samples, record then.
    low, high : (3,) units of tau0, limits of the powers; the value then was `choice.p`.
    status : (3,)
    """

    span: int
    choice: Choice
    low: Floats
    high: Floats
    status: tuple[Status, ...]
    reasons: tuple[str | None, ...]
    time_to: TimeTo


class Estimator:
    """Fits of a growing curve; remembers what need not be worked out again.

    Parameters
    ----------
    averaged : the samples are true averages over their interval (delta angles), else point samples; one
        for all channels, or (c,) one for each. A curve may be of the first few of them alone.
    precision : asked 95 % half-widths by coefficient, for `time_to`.
    outlook : work out `time_to`, which takes as long as all the rest.
    """

    def __init__(
        self,
        *,
        averaged: bool | Sequence[bool],
        precision: dict[str, float] | None = None,
        outlook: bool = True,
    ) -> None:
        self.averaged, self.outlook = averaged, outlook
        self.precision = PRECISION | (precision or {})
        self._known: dict[int, _Known] = {}

    def fit(
        self, curve: AllanCurve, *, renew: bool | None = None, resolution: Sequence[float] | None = None
    ) -> tuple[ChannelFit, ...]:
        """Fit every channel of a curve.

        Parameters
        ----------
        resolution : (c,) channel unit, least step between two values, 0.0 where there is none. Noise that is
            smaller than half of it shows in the rounding only, and no coefficient is given.
        renew : work out limits, octaves, terms and times anew; default: where the record has grown by 2 %.
        """
        octaves = min(len(curve.m), octaves_in(curve.span))
        if octaves == 0:
            return tuple(_nothing(len(curve.m), "no difference yet") for _ in curve.valid)
        count = curve.valid.size
        flags = [self.averaged] * count if isinstance(self.averaged, bool) else self.averaged[:count]
        problems, reasons = _problems(curve, octaves, flags, resolution)
        due = []
        for channel, reason in enumerate(reasons):
            known = self._known.get(channel)
            if reason is not None:
                self._known.pop(channel, None)
            elif known is None or (_grown(known.span, curve.span) if renew is None else renew):
                due.append(channel)
        self._renew(problems, due, curve)
        return self._assembled(curve, problems, reasons)

    def _renew(self, problems: Problems, due: list[int], curve: AllanCurve) -> None:
        """Work out choice, limits and times of some channels anew."""
        if not due:
            return
        former = [self._known[channel].choice if channel in self._known else None for channel in due]
        fitted = problems.take(np.array(due))
        chosen = choose(fitted, former)
        fitted = _as_chosen(fitted, chosen)
        low, high, status, reasons = _limits(fitted, np.array([choice.p for choice in chosen]))
        powers = np.array([choice.p for choice in chosen])
        still = np.full((len(due), 3), np.nan)
        if self.outlook:
            asked = np.array([self.precision[name] for name in TERMS[:3]])
            wide = _half_widths(powers, low, high, status)
            still = seconds_to(fitted, powers, wide, curve.span, curve.tau0, asked)
        for row, channel in enumerate(due):
            times = TimeTo(*(None if math.isnan(s) else float(s) for s in still[row]))
            self._known[channel] = _Known(
                curve.span, chosen[row], low[row], high[row], status[row], reasons[row], times
            )

    def _assembled(
        self, curve: AllanCurve, problems: Problems, reasons: list[str | None]
    ) -> tuple[ChannelFit, ...]:
        rows = [channel for channel, reason in enumerate(reasons) if reason is None]
        fits = [_nothing(len(curve.m), reason or "") for reason in reasons]
        if not rows:
            return tuple(fits)
        known = [self._known[channel] for channel in rows]
        part = problems.take(np.array(rows))
        part = _as_chosen(part, [item.choice for item in known])
        used = part.used
        frame = part.frame()
        p = solve(frame, part.free, start=np.array([item.choice.p for item in known]))
        whole = p * np.where(np.arange(len(TERMS)) == QUANTISATION, p > 0.0, 1.0)
        every = replace(part, used=np.ones_like(used), excess=np.zeros(len(rows))).frame()
        model = every.model(whole)
        variance = np.einsum("bii->bi", every.covariance(whole, model))
        model = np.where(used, frame.model(p), model)
        edf = 2.0 / variance
        low, high = np.sqrt(edf / chi2_quantile(0.975, edf)), 1.0 / np.sqrt(few_differences_quantile(edf))
        for row, channel in enumerate(rows):
            limits = low[row], high[row]
            fits[channel] = _channel(
                curve, channel, p[row], known[row], used[row], model[row], edf[row], limits
            )
        return tuple(fits)


def _grown(before: int, now: int) -> bool:
    return now >= before * GROWTH or now < before


def fit_curve(
    curve: AllanCurve, *, averaged: bool | Sequence[bool], outlook: bool = True
) -> tuple[ChannelFit, ...]:
    """Fit N, B and K to every channel of a curve, once; see `Estimator`."""
    return Estimator(averaged=averaged, outlook=outlook).fit(curve)


def _problems(
    curve: AllanCurve, k: int, averaged: Sequence[bool], resolution: Sequence[float] | None
) -> tuple[Problems, list[str | None]]:
    """The first k octaves of the curve as problems, one a channel, and why a channel has none."""
    kinds = sorted(set(averaged))
    table = tuple(tables(curve.span, k, averaged=kind) for kind in kinds)
    terms = curve.terms[:k].T
    variance = curve.avar[:k].T
    used = (terms > 0) & (variance > _LEAST) & (variance < _MOST)
    thinning = np.sqrt(table[0].full / np.maximum(terms, 1))
    reasons: list[str | None] = []
    for row in range(len(used)):
        seen = terms[row] > 0
        if not seen.any():
            reasons.append("no difference yet")
        elif not used[row].any():
            reasons.append("the channel is constant")
        elif resolution is not None and variance[row, 0] < 0.25 * resolution[row] ** 2:
            reasons.append(f"its resolution of {resolution[row]:.3g} hides the noise")
        elif used[row].sum() < _OCTAVES_N:
            reasons.append(f"{int(used[row].sum())} octaves, {_OCTAVES_N} are needed")
        else:
            reasons.append(None)
    problems = Problems(
        table,
        np.array([kinds.index(kind) for kind in averaged]),
        np.where(used, variance, 1.0),
        thinning,
        used,
        np.repeat((np.arange(len(TERMS)) < 3)[None], len(used), axis=0),
        np.zeros(len(used)),
    )
    return problems, reasons


def _as_chosen(problems: Problems, choices: list[Choice]) -> Problems:
    """The problems with the octaves and terms that were chosen for them."""
    k = problems.used.shape[1]
    return replace(
        problems,
        used=np.array([_fit_length(choice.used, k, True) for choice in choices]) & problems.used,
        free=np.array([choice.free for choice in choices]),
        excess=np.array([choice.excess for choice in choices]),
    )


def _limits(
    problems: Problems, p: Floats
) -> tuple[Floats, Floats, list[tuple[Status, ...]], list[tuple[str | None, ...]]]:
    """Limits of N^2, B^2 and K^2 of some channels, their status, and why they are not known.

    Returns
    -------
    low, high : (c, 3) units of tau0.
    status, reasons : one tuple of three a channel.
    """
    count = len(p)
    channel = np.repeat(np.arange(count), 3)
    term = np.tile(np.arange(3), count)
    each = problems.take(channel)
    octaves = each.used.sum(axis=1)
    need = np.where(term == 0, _OCTAVES_N, _OCTAVES)
    spread = intervals.deviations(problems.frame(), problems.free, p)[:, :3].ravel()
    told = np.isfinite(spread) & (octaves >= need)
    zero = np.full(term.size, -np.inf)
    some = each.take(told)
    start = p[channel][told]
    zero[told] = intervals.score(some.frame(), some.free, term[told], np.zeros(len(start)), start)[0]
    seen = told & (zero > _SEEN) & (p[:, :3].ravel() > 0.0)
    begin = p[channel]
    begin[~seen, term[~seen]] = 0.0
    # one search for all limits: the lower ones of what is seen, and every upper one
    rows = np.concatenate([np.flatnonzero(seen), np.flatnonzero(told)])
    upper = np.arange(rows.size) >= seen.sum()
    here = np.where(seen, 0.0, zero)[rows]
    bound = np.where(seen, -_TWO_SIDED, np.minimum(_BOUND, zero - _NARROW))[rows]
    some = each.take(rows)
    found = intervals.limits(
        some.frame(),
        some.free,
        term[rows],
        begin[rows],
        here,
        spread[rows],
        np.where(upper, bound, _TWO_SIDED),
        upper,
    )
    low, high = np.zeros(term.size), np.full(term.size, np.inf)
    low[rows[~upper]] = found[~upper]
    high[rows[upper]] = found[upper]
    bounded = told & np.isfinite(high)
    status: list[Status] = [
        ("measured" if s else "upper_bound") if b else "pending" for s, b in zip(seen, bounded, strict=True)
    ]
    reasons = [_reason(*row) for row in zip(status, octaves.tolist(), need.tolist(), strict=True)]
    return (
        low.reshape(count, 3),
        high.reshape(count, 3),
        [tuple(status[3 * row : 3 * row + 3]) for row in range(count)],
        [tuple(reasons[3 * row : 3 * row + 3]) for row in range(count)],
    )


def _half_widths(p: Floats, low: Floats, high: Floats, status: list[tuple[Status, ...]]) -> Floats:
    """(c, 3) 1, half-widths of N, B and K relative to their values; inf where not measured."""
    seen = np.array([[word == "measured" for word in row] for row in status]) & (p[:, :3] > 0.0)
    value = np.sqrt(np.where(seen, p[:, :3], 1.0))
    return np.where(seen, (np.sqrt(np.where(seen, high, 0.0)) - np.sqrt(low)) / 2.0 / value, np.inf)


def _reason(status: Status, octaves: int, need: int) -> str | None:
    if status == "measured":
        return None
    if status == "upper_bound":
        return "the record does not show it"
    if octaves < need:
        return f"{octaves} octaves, {need} are needed"
    return "the record is too short to bound it"


def _channel(
    curve: AllanCurve,
    channel: int,
    p: Floats,
    known: _Known,
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
        used=_fit_length(used, total, False),
        low=_stretched(low, total),
        high=_stretched(high, total),
        edf=_stretched(np.where(there, edf, 0.0), total),
        time_to=known.time_to,
        readings=read_slopes(curve.tau[:k][clear], sigma[clear]),
        caveats=caveats,
    )


def _coefficient(p: Floats, known: _Known, term: int, unit: float) -> Coefficient:
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


def _nothing(octaves: int, reason: str) -> ChannelFit:
    nothing = Coefficient(reason=reason)
    zeros = np.zeros(octaves)
    none = np.zeros(octaves, dtype=bool)
    return ChannelFit(
        N=nothing, B=nothing, K=nothing, model=zeros, used=none, low=zeros, high=zeros, edf=zeros
    )


def _fit_length(used: Bools, octaves: int, rest: bool) -> Bools:
    """(octaves,) a mask on a curve of another length."""
    return np.asarray(np.concatenate([used, np.full(max(0, octaves - used.size), rest)])[:octaves])


def _stretched(values: Floats, octaves: int) -> Floats:
    return np.concatenate([values, np.zeros(octaves - values.size)])
