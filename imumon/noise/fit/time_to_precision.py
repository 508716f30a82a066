"""Outlook: how much longer a record must become for a coefficient to be known as well as asked.

The same covariance V that gives the limits now gives them for a longer record of the same noise: the variance
of generalised least squares, (A' V^-1 A)^-1 (Aitken 1935; `intervals.deviations`), asks for no data. For the
next `NEAR` doublings of its length the tables are those of such records. Beyond, scale serves: a record 2^q
times as long looks, at its long octaves, like the last of these with N^2 smaller and K^2 larger by 2^q, and
the q shortest octaves are forgone. No record is worth less than its part: precision grows at least as the
square root of the length. What the record does not show yet is not foretold: it may be nothing at all, and a
bound says how much it may be, not how much it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from imumon.noise.fit.covariance import doublings
from imumon.noise.fit.intervals import deviations
from imumon.noise.fit.leastsquares import Problems
from imumon.samples import Bools, Floats

NEAR = 6
_YEAR = 3.15576e7


@dataclass(frozen=True, slots=True)
class TimeTo:
    """Seconds of record still to come until the asked precision; 0 once reached; None while not measured, or
    not within a year."""

    N: float | None = None
    B: float | None = None
    K: float | None = None


def seconds_to(problems: Problems, p: Floats, wide: Floats, span: int, tau0: float, asked: Floats) -> Floats:
    """Seconds still to record until the half-widths of N, B and K are as asked.

    Parameters
    ----------
    problems : (b) the channels as they are fitted now.
    p : (b, 5) powers in units of tau0.
    wide : (b, 3) 1, half-widths of N, B and K now, relative to the value; inf where not measured.
    span : samples, length of the record.
    asked : (3,) 1, relative half-widths.

    Returns
    -------
    (b, 3) s; nan where it is not measured, or will not come within a year.
    """
    found = np.full((len(p), 3), np.nan)
    measured = np.isfinite(wide) & (p[:, :3] > 0.0)
    found[measured & (wide <= asked)] = 0.0
    rows = np.flatnonzero((measured & (wide > asked)).any(axis=1))
    if rows.size:
        still = _still(problems.take(rows), p[rows], wide[rows], span, asked) * tau0
        found[rows] = np.where(wide[rows] > asked, still, found[rows])
    return np.where(np.nan_to_num(found, nan=np.inf) < _YEAR, found, np.nan)


def _still(problems: Problems, p: Floats, wide: Floats, span: int, asked: Floats) -> Floats:
    """(b, 3) samples still to record, as `seconds_to`; nan where it is not measured or never comes."""
    lengths, spread = _spreads(problems, p, span)
    plain = problems.excess == 0.0
    since = np.sqrt(lengths / lengths[0])
    spread[plain] = np.fmin(spread[plain], spread[plain, :1] / since[:, None])
    # the limits now are the anchor: what is relative to them is what the covariance foretells
    told = np.isfinite(wide) & (spread[:, 0] > 0.0) & np.isfinite(spread[:, 0])
    quantile = np.where(told, wide, 2.0) / np.where(told, spread[:, 0], 1.0)
    width = spread * np.clip(quantile, 0.5, 3.0)[:, None, :]
    found = np.full((len(p), 3), np.nan)
    for channel, term in np.argwhere(np.isfinite(wide) & (p[:, :3] > 0.0)):
        reached = np.flatnonzero(width[channel, 1:, term] <= asked[term]) + 1
        if reached.size:
            at = int(reached[0])
            length = _crossing(
                lengths[at - 1 : at + 1], width[channel, at - 1 : at + 1, term], float(asked[term])
            )
            found[channel, term] = max(length - span, 0.0)
    return found


def _spreads(problems: Problems, p: Floats, span: int) -> tuple[Floats, Floats]:
    """Lengths of records, (s,) samples, and relative deviations of the powers then, (b, s, 3)."""
    lengths, found = [float(span)], [_relative(problems, p)]
    out = ~problems.used
    longest = problems
    kinds = [doublings(span.bit_length(), averaged=kind.averaged) for kind in problems.tables]
    for each in islice(zip(*kinds, strict=True), NEAR):
        length, octaves = each[0].span, each[0].full.size
        used = np.ones((len(p), octaves), dtype=bool)
        used[:, : out.shape[1]] = ~out | _not_yet(problems)
        longest = replace(
            problems,
            tables=each,
            variance=np.ones(used.shape),
            thinning=np.ones(used.shape),
            used=used,
        )
        lengths.append(float(length))
        found.append(_relative(longest, p))
    k = longest.used.shape[1]
    steps = np.arange(1, k - 6)
    scale = 2.0**steps
    used = np.ones((steps.size, *longest.used.shape), dtype=bool)
    for row, step in enumerate(steps):
        used[row, :, : k - step] = longest.used[:, step:]
    powers = (
        p * np.stack([1.0 / scale, np.ones_like(scale), scale, 1.0 / scale**2, scale**2], axis=1)[:, None]
    )
    every = longest.take(np.tile(np.arange(len(p)), steps.size))
    far = _relative(replace(every, used=used.reshape(-1, k)), powers.reshape(-1, p.shape[1]))
    lengths += (lengths[NEAR] * scale).tolist()
    return np.array(lengths), np.concatenate(
        [np.stack(found, axis=1), far.reshape(steps.size, *found[0].shape).swapaxes(0, 1)], axis=1
    )


def _not_yet(problems: Problems) -> Bools:
    """Octaves that are not left out but have no difference yet."""
    k = problems.used.shape[1]
    last = k - 1 - np.argmax(problems.used[:, ::-1], axis=1)
    return np.asarray(np.arange(k) > last[:, None])


def _relative(problems: Problems, p: Floats) -> Floats:
    """(b, 3) relative standard deviations of N, B, K: half of those of their squares; inf without."""
    spread = deviations(problems.frame(), problems.free, p)[:, :3]
    return np.asarray(
        np.where(p[:, :3] > 0.0, spread / (2.0 * np.where(p[:, :3] > 0.0, p[:, :3], 1.0)), np.inf)
    )


def _crossing(length: Floats, width: Floats, asked: float) -> float:
    """Length at which the width passes what is asked, on logarithmic scales."""
    if not np.isfinite(width[0]) or width[0] <= asked or width[1] >= width[0]:
        return float(length[1])
    part = math.log(width[0] / asked) / math.log(width[0] / width[1])
    return float(length[0] * (length[1] / length[0]) ** part)
