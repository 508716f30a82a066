"""Limits, status and time to precision of a channel, computed again only as its record grows.

Rules:

1. A coefficient is ``measured`` where its score at zero exceeds `DETECTED_SCORE`; then it has a value and
   two-sided limits. Else it is an ``upper_bound``: no value, but a one-sided bound. The levels are such that
   the limits hold in 95 % of all records, whatever the status: 2.2 % beyond each limit, 3.9 % beyond a bound,
   1.4 % false detections. They are set on simulated records, where a few per mille more lie beyond than these
   normal quantiles predict, because the other terms are fitted to the same data.
2. ``pending``: too few octaves to distinguish the terms; the reason says so.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from imumon.noise.fit import intervals
from imumon.noise.fit.leastsquares import FitProblems
from imumon.noise.fit.model_selection import SelectedModel, select_models, with_selection
from imumon.noise.fit.time_to_precision import seconds_to
from imumon.report import Status, TimeTo
from imumon.samples import Floats

OCTAVES_FOR_N = 3
"""Octaves without which N is pending: two terms, N and B, and one degree of freedom. Not critical."""
OCTAVES_FOR_B_K = 5
"""Octaves without which B and K are pending: three terms and two degrees of freedom. Sensitivity: halved 0 %,
doubled changes which values appear (gyro x drift steady_K low of the record "warm-up")."""

DETECTED_SCORE = float(ndtri(0.986))
"""Standard deviations from which on a coefficient is measured: 1.4 % false detections, see rule 1."""

BOUND_SCORE = -float(ndtri(0.961))
"""Standard deviations, score of an upper bound: 3.9 % of the true values lie beyond, see rule 1."""

LIMIT_SCORE = float(ndtri(0.9783))
"""Standard deviations, score of each of two limits: 2.2 % of the true values lie beyond, see rule 1."""

LEAST_BOUND_SCORE = 0.002
"""Standard deviations by which a bound is at least above zero, so that no bound is zero. Sensitivity: halved
29 %, doubled 29 % (gyro z B high of the record "temperature")."""


@dataclass(frozen=True, slots=True, eq=False)
class ChannelConfidence:
    """Selected model, limits and times of a channel at one length of its record.

    Attributes
    ----------
    span : samples, length of the record at that time.
    model : selected octaves and terms, and the powers at that time.
    low, high : (3,) units of tau0, limits of the powers of N, B and K.
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


def confidences(
    problems: FitProblems,
    previous: Sequence[SelectedModel | None],
    span: int,
    tau0: float,
    precision: Floats | None,
) -> list[ChannelConfidence]:
    """Select models and compute limits and times for some channels.

    Parameters
    ----------
    problems : (b) one per channel, which uses all octaves that have data.
    previous : selection for each on a shorter part of the same record.
    span : samples, length of the record.
    tau0 : s
    precision : (3,) 1, requested half-widths of N, B and K relative to the value; None: no `time_to`.
    """
    models = select_models(problems, previous)
    fitted = with_selection(problems, models)
    powers = np.array([model.p for model in models])
    low, high, status, reasons = _limits(fitted, powers)
    times = [TimeTo()] * len(models)
    if precision is not None:
        widths = _half_widths(powers, low, high, status)
        seconds = seconds_to(fitted, powers, widths, span, tau0, precision)
        known = ([None if math.isnan(s) else float(s) for s in row] for row in seconds)
        times = [TimeTo(N=n, B=b, K=k) for n, b, k in known]
    rows = zip(models, low, high, status, reasons, times, strict=True)
    return [ChannelConfidence(span, *row) for row in rows]


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
    detected = tested & (at_zero > DETECTED_SCORE) & (p[:, :3].ravel() > 0.0)
    begin[~detected, term[~detected]] = 0.0
    # One search finds all limits: the lower ones of detected terms, and every upper one.
    rows = np.concatenate([np.flatnonzero(detected), np.flatnonzero(tested)])
    upper = np.arange(rows.size) >= detected.sum()
    bound = np.minimum(BOUND_SCORE, at_zero - LEAST_BOUND_SCORE)
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
        return "the record does not show it"
    if octaves < needed:
        return f"{octaves} octaves, {needed} are needed"
    return "the record is too short to bound it"
