"""Time that a record must still grow until a coefficient is as precise as requested.

The covariance V that gives the limits now also gives those of a longer record of the same noise: the variance
of generalised least squares, (A' V^-1 A)^-1 (Aitken 1935; `intervals.deviations`), needs no data. The next
`EXACT_DOUBLINGS` doublings use the tables of such records. Longer records follow by scaling: a record 2^q
times as long resembles, at its long octaves, the last of these with N^2 smaller and K^2 larger by 2^q, and
its q shortest octaves are ignored. Precision grows at least as the square root of the length,
because a record contains its parts. A coefficient that the record does not show yet has no time, because it
may be zero: a bound limits it but does not measure it.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from imumon.noise.fit.covariance import tables
from imumon.noise.fit.intervals import deviations
from imumon.noise.fit.leastsquares import FitProblems
from imumon.samples import Bools, Floats

EXACT_DOUBLINGS = 6
"""Doublings of the record that are computed with their own tables. Sensitivity: halved 16 %, doubled 0 %
(gyro x time_to N of the record "mixed")."""

MAX_SECONDS = 3.15576e7
"""s, one year: longer times are not reported, because no sensor stays the same that long. Not critical."""

LEAST_OCTAVES_LEFT = 7
"""Octaves that scaling leaves at least. Not critical."""

LEAST_QUANTILE = 0.5
"""1, least ratio of a half-width to the standard deviation. Not critical."""

MAX_QUANTILE = 3.0
"""1, largest ratio of a half-width to the standard deviation. Sensitivity: halved 96 %, doubled 0 % (gyro z
time_to B of the record "mixed")."""

USUAL_QUANTILE = 2.0
"""1, the ratio where it is not known. Not critical."""


def seconds_to(
    problems: FitProblems, p: Floats, widths: Floats, span: int, tau0: float, precision: Floats
) -> Floats:
    """Return the seconds still to record until the half-widths of N, B and K are as requested.

    Parameters
    ----------
    problems : (b) the channels as they are fitted now.
    p : (b, 5) powers in units of tau0.
    widths : (b, 3) 1, half-widths of N, B and K now, relative to the value; inf where not measured.
    span : samples, length of the record.
    tau0 : s
    precision : (3,) 1, requested relative half-widths.

    Returns
    -------
    (b, 3) s; nan where a coefficient is not measured, or not as precise within `MAX_SECONDS`.
    """
    seconds = np.full((len(p), 3), np.nan)
    measured = np.isfinite(widths) & (p[:, :3] > 0.0)
    seconds[measured & (widths <= precision)] = 0.0
    rows = np.flatnonzero((measured & (widths > precision)).any(axis=1))
    if rows.size:
        samples = _samples_to(problems.take(rows), p[rows], widths[rows], span, precision)
        seconds[rows] = np.where(widths[rows] > precision, samples * tau0, seconds[rows])
    return np.where(np.nan_to_num(seconds, nan=np.inf) < MAX_SECONDS, seconds, np.nan)


def _samples_to(problems: FitProblems, p: Floats, widths: Floats, span: int, precision: Floats) -> Floats:
    """Return (b, 3) samples still to record, as `seconds_to`; nan where not measured or never."""
    lengths, spread = _spreads(problems, p, span)
    plain = problems.excess == 0.0
    growth = np.sqrt(lengths / lengths[0])
    spread[plain] = np.fmin(spread[plain], spread[plain, :1] / growth[:, None])
    # The present limits set the scale; the covariance gives the change relative to them.
    known = np.isfinite(widths) & (spread[:, 0] > 0.0) & np.isfinite(spread[:, 0])
    quantile = np.where(known, widths, USUAL_QUANTILE) / np.where(known, spread[:, 0], 1.0)
    expected = spread * np.clip(quantile, LEAST_QUANTILE, MAX_QUANTILE)[:, None, :]
    samples = np.full((len(p), 3), np.nan)
    for channel, term in np.argwhere(np.isfinite(widths) & (p[:, :3] > 0.0)):
        reached = np.flatnonzero(expected[channel, 1:, term] <= precision[term]) + 1
        if reached.size:
            part = slice(int(reached[0]) - 1, int(reached[0]) + 1)
            length = _crossing(lengths[part], expected[channel, part, term], float(precision[term]))
            samples[channel, term] = max(length - span, 0.0)
    return samples


def _spreads(problems: FitProblems, p: Floats, span: int) -> tuple[Floats, Floats]:
    """Return lengths of records, (s,) samples, and relative deviations of N, B, K there, (b, s, 3)."""
    lengths, spreads = [float(span)], [_relative_deviations(problems, p)]
    excluded = ~problems.used
    longest = problems
    for octaves in range(span.bit_length(), span.bit_length() + EXACT_DOUBLINGS):
        used = np.ones((len(p), octaves), dtype=bool)
        used[:, : excluded.shape[1]] = ~excluded | _beyond(problems)
        longest = replace(
            problems,
            tables=tuple(tables(1 << octaves, octaves, averaged=t.averaged) for t in problems.tables),
            variance=np.ones(used.shape),
            thinning=np.ones(used.shape),
            used=used,
            offset=np.zeros(used.shape),
            extra=np.zeros((*used.shape, octaves)),
            changing=np.zeros((*used.shape, octaves)),
        )
        lengths.append(float(1 << octaves))
        spreads.append(_relative_deviations(longest, p))
    k = longest.used.shape[1]
    steps = np.arange(1, k - LEAST_OCTAVES_LEFT + 1)
    scale = 2.0**steps
    used = np.ones((steps.size, *longest.used.shape), dtype=bool)
    for row, step in enumerate(steps):
        used[row, :, : k - step] = longest.used[:, step:]
    factors = np.stack([1.0 / scale, np.ones_like(scale), scale, 1.0 / scale**2, scale**2], axis=1)
    powers = (p * factors[:, None]).reshape(-1, p.shape[1])
    scaled = replace(longest.take(np.tile(np.arange(len(p)), steps.size)), used=used.reshape(-1, k))
    far = _relative_deviations(scaled, powers).reshape(steps.size, len(p), 3).swapaxes(0, 1)
    lengths += (lengths[-1] * scale).tolist()
    return np.array(lengths), np.concatenate([np.stack(spreads, axis=1), far], axis=1)


def _beyond(problems: FitProblems) -> Bools:
    """Return the octaves that are not excluded but have no difference yet."""
    k = problems.used.shape[1]
    last = k - 1 - np.argmax(problems.used[:, ::-1], axis=1)
    return np.asarray(np.arange(k) > last[:, None])


def _relative_deviations(problems: FitProblems, p: Floats) -> Floats:
    """Return (b, 3) relative standard deviations of N, B, K: half of those of their squares; inf at zero."""
    deviation = deviations(problems.prepare(), problems.free, p)[:, :3]
    positive = p[:, :3] > 0.0
    return np.asarray(np.where(positive, deviation / (2.0 * np.where(positive, p[:, :3], 1.0)), np.inf))


def _crossing(length: Floats, width: Floats, precision: float) -> float:
    """Return the length at which the width passes the requested one, on logarithmic scales."""
    if not np.isfinite(width[0]) or width[0] <= precision or width[1] >= width[0]:
        return float(length[1])
    part = math.log(width[0] / precision) / math.log(width[0] / width[1])
    return float(length[0] * (length[1] / length[0]) ** part)
