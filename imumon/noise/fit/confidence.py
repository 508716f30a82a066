"""Renewal: what of a channel is worked out anew only as its record grows: octaves, terms, limits and times.

The rules
---------
1. A coefficient is ``measured`` where its score at zero says beyond `_SEEN` that it is there; then it has a
   value and two-sided limits. Else it is ``upper_bound``: no value, and the one-sided bound a larger one
   would have passed. The levels are such that the limits hold in 95 % of all records, whichever of the two
   each is told to be: 2.2 % each side beyond, 3.9 % for a bound, 1.4 % false alarms. They were set on
   simulated records, where a few per mille more lie beyond than these normal quantiles say, since
   the other terms come from the same data.
2. ``pending``: too few octaves to tell the terms apart; the reason says so.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from imumon.noise.fit import intervals
from imumon.noise.fit.leastsquares import Problems
from imumon.noise.fit.model_selection import Choice, as_chosen, choose
from imumon.noise.fit.quantiles import normal_quantile
from imumon.noise.fit.time_to_precision import TimeTo, seconds_to
from imumon.samples import Floats

Status: TypeAlias = Literal["measured", "upper_bound", "pending"]

OCTAVES_N, OCTAVES = 3, 5
"""Octaves that N needs, and B and K."""

_SEEN = normal_quantile(0.986)
_BOUND = -normal_quantile(0.961)
_TWO_SIDED = normal_quantile(0.9783)
_NARROW = 0.002  # a bound never falls below what moves the score by this much: it is never zero


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """What was worked out for a channel at its last renewal.

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


def renewed(
    problems: Problems,
    formers: Sequence[Choice | None],
    span: int,
    tau0: float,
    asked: Floats | None,
) -> list[Known]:
    """What is known of some channels, worked out anew.

    Parameters
    ----------
    problems : (b) one a channel, all octaves that have data in use.
    formers : (b) what was chosen before for each, on a shorter record.
    span : samples, length of the record.
    tau0 : s
    asked : (3,) 1, half-widths of N, B and K relative to the value, for `time_to`; None: it is not asked for.
    """
    choices = choose(problems, formers)
    fitted = as_chosen(problems, choices)
    powers = np.array([choice.p for choice in choices])
    low, high, status, reasons = _limits(fitted, powers)
    still = np.full((len(choices), 3), np.nan)
    if asked is not None:
        still = seconds_to(fitted, powers, _half_widths(powers, low, high, status), span, tau0, asked)
    times = [TimeTo(*(None if math.isnan(s) else float(s) for s in row)) for row in still]
    rows = zip(choices, low, high, status, reasons, times, strict=True)
    return [Known(span, *row) for row in rows]


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
    need = np.where(term == 0, OCTAVES_N, OCTAVES)
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
