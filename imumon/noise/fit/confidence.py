"""Limits, status and time to precision of a channel, computed again only as its record grows.

Rules:

1. A coefficient is ``measured`` where its score at zero exceeds `DETECTED_SCORE`; then it has a value and
   two-sided limits. Else it is an ``upper_bound``: no value, but a one-sided bound. The levels are such that
   the limits hold in 95 % of all records, whatever the status: 2.2 % beyond each limit, 3.9 % beyond a bound,
   1.4 % false detections. They are set on simulated records, where a few per mille more lie beyond than these
   normal quantiles predict, because the other terms are fitted to the same data. K from block means has its own
   test, with 2.5 % in each tail; it is measured where its lower limit is above zero.
2. The bound of a term that the data put below zero is that of data which put it at zero: half of the records
   without the term have a higher one.
3. Where several descriptions pass, the limits are the union of theirs, and a coefficient is ``measured`` only
   if each of them shows it.
4. ``pending``: too few octaves to distinguish the terms, no description that fits, or a term above the curve
   itself; the reason says so. Of several descriptions, those with a term above the curve do not count.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaincinv, ndtri

from imumon.noise.fit import intervals
from imumon.noise.fit.covariance import FLICKER_FLOOR
from imumon.noise.fit.leastsquares import RAMP, SIGNED, FitProblems, solve
from imumon.noise.fit.model_selection import SelectedModel, select_models, with_selection
from imumon.noise.fit.restricted_likelihood import BlockMeans, fit_slow_terms
from imumon.noise.fit.time_to_precision import seconds_to
from imumon.report import Status, TimeTo
from imumon.samples import Bools, Floats

OCTAVES_FOR_N = 3
"""Octaves without which N is pending: two terms, N and B, and one degree of freedom. Not critical."""
OCTAVES_FOR_B_K = 5
"""Octaves without which B and K are pending: three terms and two degrees of freedom. Sensitivity: halved 0 %,
doubled changes which values appear (gyro x drift steady_K low of the record "warm-up")."""

FALSE_DETECTION = 0.014
"""1, share of records in which a coefficient is measured that is zero, see rule 1. Not critical."""

DETECTED_SCORE = float(ndtri(1.0 - FALSE_DETECTION))
"""Standard deviations from which on a coefficient is measured: 1.4 % false detections, see rule 1."""

BOUND_SCORE = -float(ndtri(0.961))
"""Standard deviations, score of an upper bound: 3.9 % of the true values lie beyond, see rule 1."""

LIMIT_SCORE = float(ndtri(0.9783))
"""Standard deviations, score of each of two limits: 2.2 % of the true values lie beyond, see rule 1."""

NO_DESCRIPTION = "no description fits the data"
"""Reason of rule 4."""

NOT_SHOWN = "the record does not show it"
TOO_SHORT = "the record is too short to bound it"

LAW_PROBABILITY = 0.001
"""1, probability with which an Allan variance lies so far below its expectation that a term alone exceeds it;
then the description is wrong. Not critical."""

EARLY_BLOCKS = 2.0
"""Blocks; a walk that exceeds the other noise at a tau of this many is measured on the curve. Not critical."""

GUESS = 1e-9
"""1, share of the whole fit added to that of the short octaves, so that no model vanishes. Not critical."""

LEAST_B_K_S = 10.0
"""s, shortest record for B and K: before, a filter, a vibration, and the start look like them. Not critical."""


@dataclass(frozen=True, slots=True, eq=False)
class ChannelConfidence:
    """Selected model, limits and times of a channel at one length of its record.

    Attributes
    ----------
    span : samples, length of the record at that time.
    model : selected octaves and terms, and the powers at that time.
    low, high : (3,) units of tau0, limits of the powers of N, B and K.
    walk : units of tau0, K^2 from block means; None: K^2 is that of the curve.
    status, reasons : (3,) of N, B and K.
    time_to : s, until each is as precise as requested.
    """

    span: int
    model: SelectedModel
    low: Floats
    high: Floats
    status: tuple[Status, ...]
    reasons: tuple[str | None, ...]
    time_to: TimeTo
    walk: float | None = None


def confidences(
    problems: FitProblems,
    previous: Sequence[SelectedModel | None],
    span: int,
    tau0: float,
    precision: Floats | None,
    blocks: BlockMeans | None = None,
    *,
    spectrum: bool = True,
) -> list[ChannelConfidence]:
    """Select models and compute limits and times for some channels.

    Parameters
    ----------
    problems : (b) one per channel, which uses all octaves that have data.
    previous : selection for each on a shorter part of the same record.
    span : samples, length of the record.
    tau0 : s
    precision : (3,) 1, requested half-widths of N, B and K relative to the value; None: no `time_to`.
    blocks : means of the channels over stretches of the record; None: K comes from the curve.
    spectrum : whether the lines are known, see `select_models`.
    """
    models = _below_curve(problems, select_models(problems, previous, spectrum=spectrum))
    fitted = with_selection(problems, models)
    powers = np.array([model.p for model in models])
    low, high, status, reasons = _united_limits(problems, models, span * tau0)
    walks = _walk_limits(blocks, fitted, powers, tau0, (low, high, status, reasons))
    times = [TimeTo()] * len(models)
    if precision is not None:
        widths = _half_widths(powers, low, high, status)
        seconds = seconds_to(fitted, powers, widths, span, tau0, precision)
        known = ([None if math.isnan(s) else float(s) for s in row] for row in seconds)
        times = [TimeTo(N=n, B=b, K=k) for n, b, k in known]
    rows = zip(models, low, high, status, reasons, times, walks, strict=True)
    return [ChannelConfidence(span, *row) for row in rows]


def _below_curve(problems: FitProblems, models: Sequence[SelectedModel]) -> list[SelectedModel]:
    """Return the models without the descriptions that have a term above the curve, if any remains."""
    groups = [(model, *model.others) for model in models]
    owner = np.repeat(np.arange(len(groups)), [len(group) for group in groups])
    every, each = problems.take(owner), [model for group in groups for model in group]
    powers = np.array([model.p for model in each])
    wrong = np.asarray(_exceeds_curve(every, with_selection(every, each), powers).any(axis=1))
    sound = []
    for row, group in enumerate(groups):
        left = [model for model, above in zip(group, wrong[owner == row], strict=True) if not above]
        sound.append(replace(left[0], others=tuple(left[1:])) if left else group[0])
    return sound


def _united_limits(
    problems: FitProblems, models: Sequence[SelectedModel], span_s: float
) -> tuple[Floats, Floats, list[tuple[Status, ...]], list[tuple[str | None, ...]]]:
    """Return the limits of some channels, the union of those of all their descriptions; see `_limits`."""
    rows = [(row, each) for row, model in enumerate(models) for each in (model, *model.others)]
    owner = np.array([row for row, _ in rows])
    batch = with_selection(problems.take(owner), [model for _, model in rows])
    powers = np.array([model.p for _, model in rows])
    low, high, status, reasons = _limits(batch, powers)
    exceeds = _exceeds_curve(problems.take(owner), batch, powers)
    for at, (row, model) in enumerate(rows):
        long_end = model.used[: problems.used.shape[1]] & problems.used[row, : model.used.size]
        last = np.flatnonzero(problems.used[row])[-1]
        pending = exceeds[at] | (not model.fits)
        pending[2] |= not (last < long_end.size and long_end[last])
        low[at, pending], high[at, pending] = 0.0, np.inf
        early = np.array([False, True, True]) & (span_s < LEAST_B_K_S)
        reason = [
            NO_DESCRIPTION if p else TOO_SHORT if e else None for p, e in zip(pending, early, strict=True)
        ]
        status[at] = tuple("pending" if r else s for r, s in zip(reason, status[at], strict=True))
        reasons[at] = tuple(r or s for r, s in zip(reason, reasons[at], strict=True))
    merged_status, merged_reasons = [], []
    merged_low, merged_high = np.zeros((len(models), 3)), np.zeros((len(models), 3))
    for row in range(len(models)):
        own = np.flatnonzero(owner == row)
        merged_low[row], merged_high[row] = low[own].min(axis=0), high[own].max(axis=0)
        names = [_united([status[at][term] for at in own]) for term in range(3)]
        merged_status.append(tuple(names))
        of_status = [
            next(reasons[at][term] for at in own if status[at][term] == name)
            for term, name in enumerate(names)
        ]
        merged_reasons.append(tuple(of_status))
    return merged_low, merged_high, merged_status, merged_reasons


def _walk_limits(
    blocks: BlockMeans | None,
    fitted: FitProblems,
    p: Floats,
    tau0: float,
    limits: tuple[Floats, Floats, list[tuple[Status, ...]], list[tuple[str | None, ...]]],
) -> list[float | None]:
    """Replace the limits of K by those of block means, which know drift and temperature; return their K^2.

    K of a channel without N stays pending. Beside the means, what the octaves up to the length of a block say of
    B is used; the longer ones would count twice. The curve keeps its K where the walk exceeds flicker already at
    a tau of few blocks: a drift does not show there, and the blocks are too long.
    """
    low, high, status, reasons = limits
    if blocks is None:
        return [None] * len(p)
    short = fitted.used & (tau0 * 2.0 ** np.arange(fitted.used.shape[1]) <= blocks.length_s)
    few = short.sum(axis=1) < OCTAVES_FOR_N
    used = np.where(few[:, None], fitted.used, short)
    part = replace(fitted, used=used, free=fitted.free & (np.arange(p.shape[1]) != RAMP))
    prepared = part.prepare()
    alone = solve(prepared, part.free)
    error = intervals.deviations(prepared, part.free, np.where(alone > 0.0, alone, 0.0) + GUESS * p)[:, 1]
    known = (p[:, 0] > 0.0) & np.array([names[0] != "pending" for names in status])
    terms = fit_slow_terms(
        blocks.means,
        blocks.length_s,
        np.where(known, p[:, 0], 1.0) * tau0,
        alone[:, 1],
        B2_error=np.where(few, np.inf, error),
        share=blocks.share,
        temperature=blocks.temperature,
        settling=True,
    )
    walks: list[float | None] = []
    for row in range(len(p)):
        k2, bounds = terms.K2[row] * tau0, (terms.K2_low[row] * tau0, terms.K2_high[row] * tau0)
        floor = max(p[row, 1], 0.0) * FLICKER_FLOOR + p[row, 0] * tau0 / blocks.length_s
        early = k2 * (EARLY_BLOCKS * blocks.length_s / tau0) / 3.0 > floor
        if not known[row] or not np.isfinite(k2) or (early and status[row][2] == "measured"):
            walks.append(None)
            continue
        shows = bool(bounds[0] > 0.0)
        low[row, 2], high[row, 2] = bounds[0] if shows else 0.0, bounds[1]
        status[row] = (*status[row][:2], "measured" if shows else "upper_bound")
        reasons[row] = (*reasons[row][:2], None if shows else NOT_SHOWN)
        walks.append(float(k2))
    return walks


def _united(names: list[Status]) -> Status:
    """Return the status of a coefficient from those in its descriptions, the one in use first.

    >>> _united(["measured", "measured"]), _united(["measured", "upper_bound"]), _united(["measured", "pending"])
    ('measured', 'upper_bound', 'pending')
    """
    return "pending" if "pending" in names else "upper_bound" if "upper_bound" in names else "measured"


def _exceeds_curve(every: FitProblems, fitted: FitProblems, p: Floats) -> Bools:
    """Return (b, 3) whether N, B or K alone lie above the curve, from the first octave in use on.

    A correlation over a short time lowers the first octaves, so its negative term counts with each.

    Parameters
    ----------
    every : with all octaves that have data.
    fitted : with the octaves of the fit.
    """
    prepared = replace(every, excess=fitted.excess).prepare()
    positive = np.maximum(p, 0.0)
    model = prepared.model(positive)
    edf = 2.0 / np.einsum("bii->bi", prepared.covariance(positive, model))
    with np.errstate(divide="ignore"):  # too few differences for an upper limit: it is infinite
        upper = every.variance * edf / (2.0 * gammaincinv(0.5 * edf, LAW_PROBABILITY))
    first = fitted.used.argmax(axis=1)
    from_first = np.arange(every.used.shape[1]) >= first[:, None]
    correlation = prepared.design[:, :, SIGNED] * np.minimum(p[:, None, SIGNED], 0.0)
    alone = prepared.design[:, :, :3] * positive[:, None, :3] + correlation[:, :, None]
    above = (alone > upper[:, :, None]) & (every.used & from_first)[:, :, None]
    return np.asarray(above.any(axis=1))


def _limits(
    problems: FitProblems, p: Floats
) -> tuple[Floats, Floats, list[tuple[Status, ...]], list[tuple[str | None, ...]]]:
    """Return the limits of N^2, B^2 and K^2, their status, and the reasons why there is no value.

    Returns
    -------
    low, high : (c, 3) units of tau0.
    status, reasons : one tuple of three per channel.
    """
    count = len(p)
    channel = np.repeat(np.arange(count), 3)
    term = np.tile(np.arange(3), count)
    each = problems.take(channel)
    octaves = each.used.sum(axis=1)
    needed = np.where(term == 0, OCTAVES_FOR_N, OCTAVES_FOR_B_K)
    deviation = intervals.deviations(problems.prepare(), problems.free, p)[:, :3].ravel()
    tested = np.isfinite(deviation) & (octaves >= needed)
    at_zero = np.full(term.size, -np.inf)
    part, begin = each.take(tested), p[channel]
    zeros = np.zeros(int(tested.sum()))
    at_zero[tested] = intervals.score(part.prepare(), part.free, term[tested], zeros, begin[tested])[0]
    estimate = p[:, :3].ravel()
    # The score at zero weights the octaves as if the term were absent. Where the term makes most of the curve,
    # these weights are far off, and the score may even be negative: then the estimate decides.
    contradicts = tested & (at_zero < 0.0) & (estimate > 0.0)
    at_zero[contradicts] = estimate[contradicts] / deviation[contradicts]
    detected = tested & (at_zero > DETECTED_SCORE) & (estimate > 0.0)
    begin[~detected, term[~detected]] = 0.0
    # One search finds all limits: the lower ones of detected terms, and every upper one.
    rows = np.concatenate([np.flatnonzero(detected), np.flatnonzero(tested)])
    upper = np.arange(rows.size) >= detected.sum()
    bound = BOUND_SCORE + np.minimum(at_zero, 0.0)  # rule 2
    target = np.where(upper, np.where(detected, -LIMIT_SCORE, bound)[rows], LIMIT_SCORE)
    part = each.take(rows)
    score = np.where(detected, 0.0, at_zero)[rows]
    values = intervals.limits(
        part.prepare(), part.free, term[rows], begin[rows], score, deviation[rows], target, upper
    )
    low, high = np.zeros(term.size), np.full(term.size, np.inf)
    low[rows[~upper]] = values[~upper]
    high[rows[upper]] = values[upper]
    bounded = tested & np.isfinite(high)
    status: list[Status] = [
        ("measured" if d else "upper_bound") if b else "pending"
        for d, b in zip(detected, bounded, strict=True)
    ]
    reasons = [_reason(*row) for row in zip(status, octaves.tolist(), needed.tolist(), strict=True)]
    parts = [slice(3 * row, 3 * row + 3) for row in range(count)]
    statuses, texts = [tuple(status[part]) for part in parts], [tuple(reasons[part]) for part in parts]
    return low.reshape(count, 3), high.reshape(count, 3), statuses, texts


def _half_widths(p: Floats, low: Floats, high: Floats, status: list[tuple[Status, ...]]) -> Floats:
    """Return (c, 3) 1, half-widths of N, B and K relative to their values; inf where not measured."""
    measured = np.array([[name == "measured" for name in row] for row in status]) & (p[:, :3] > 0.0)
    value = np.sqrt(np.where(measured, p[:, :3], 1.0))
    half = (np.sqrt(np.where(measured, high, 0.0)) - np.sqrt(low)) / 2.0
    return np.where(measured, half / value, np.inf)


def _reason(status: Status, octaves: int, needed: int) -> str | None:
    if status == "measured":
        return None
    if status == "upper_bound":
        return NOT_SHOWN
    if octaves < needed:
        return f"{octaves} octaves, {needed} are needed"
    return TOO_SHORT
