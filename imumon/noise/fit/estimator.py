"""Fit of N, B and K to an Allan curve: values, intervals, what they are worth and how long it still takes.

    sigma^2(tau) = N^2/tau + (2 ln2/pi) B^2 + K^2 tau/3  [+ 3 Q^2/tau^2 quantisation + R^2 tau^2/2 ramp]

by generalised least squares with the exact covariance (`covariance`, `leastsquares`), over the octaves and
terms that describe the channel (`choice`), with limits from score tests (`intervals`).

Points are cheap and follow every call (`channel`). Limits, choice and times (`outlook`) are renewed when the
record has grown by 2 % (`renewal`, which has the rules of what is measured and what only bounded); in between
limits move with their value. A channel without enough to fit is ``pending``, and the reason says why.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imumon.noise.allan import AllanCurve
from imumon.noise.fit.confidence import OCTAVES_N, Known, renewed
from imumon.noise.fit.covariance import TERMS, octaves_in, tables
from imumon.noise.fit.leastsquares import Problems
from imumon.noise.fit.results import ChannelFit, Coefficient, channel_fits, nothing
from imumon.noise.fit.time_to_precision import TimeTo

__all__ = ["PRECISION", "ChannelFit", "Coefficient", "Estimator", "TimeTo", "fit_curve"]

PRECISION = {"N": 0.01, "B": 0.20, "K": 0.50}
"""Asked 95 % half-widths relative to the value."""

GROWTH = 1.02  # of the record between two renewals of the limits
_LEAST, _MOST = 1e-100, 1e100  # variances between which squares of them are numbers


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
        self._known: dict[int, Known] = {}

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
            return tuple(nothing(len(curve.m), "no difference yet") for _ in curve.valid)
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
        if due:
            self._renew(problems.take(np.array(due)), due, curve)
        fits = [nothing(len(curve.m), *(reason or ("", None))) for reason in reasons]
        if rows := [channel for channel, reason in enumerate(reasons) if reason is None]:
            part = problems.take(np.array(rows))
            made = channel_fits(curve, rows, part, [self._known[channel] for channel in rows])
            for channel, fit in zip(rows, made, strict=True):
                fits[channel] = fit
        return tuple(fits)

    def _renew(self, problems: Problems, due: list[int], curve: AllanCurve) -> None:
        """Work out choice, limits and times of some channels anew; one problem each."""
        formers = [self._known[channel].choice if channel in self._known else None for channel in due]
        asked = np.array([self.precision[name] for name in TERMS[:3]]) if self.outlook else None
        self._known.update(zip(due, renewed(problems, formers, curve.span, curve.tau0, asked), strict=True))


def _grown(before: int, now: int) -> bool:
    return now >= before * GROWTH or now < before


def fit_curve(
    curve: AllanCurve, *, averaged: bool | Sequence[bool], outlook: bool = True
) -> tuple[ChannelFit, ...]:
    """Fit N, B and K to every channel of a curve, once; see `Estimator`."""
    return Estimator(averaged=averaged, outlook=outlook).fit(curve)


def _problems(
    curve: AllanCurve, k: int, averaged: Sequence[bool], resolution: Sequence[float] | None
) -> tuple[Problems, list[tuple[str, str | None] | None]]:
    """The first k octaves of the curve as problems, one a channel, and why a channel has none."""
    kinds = sorted(set(averaged))
    table = tuple(tables(curve.span, k, averaged=kind) for kind in kinds)
    terms = curve.terms[:k].T
    variance = curve.avar[:k].T
    used = (terms > 0) & (variance > _LEAST) & (variance < _MOST)
    thinning = np.sqrt(table[0].full / np.maximum(terms, 1))
    reasons: list[tuple[str, str | None] | None] = []  # text and code
    for row in range(len(used)):
        seen = terms[row] > 0
        if not seen.any():
            reasons.append(("no difference yet", None))
        elif not used[row].any():
            reasons.append(("the channel is constant", "constant"))
        elif resolution is not None and variance[row, 0] < 0.25 * resolution[row] ** 2:
            reasons.append((f"its resolution of {resolution[row]:.3g} hides the noise", "resolution"))
        elif used[row].sum() < OCTAVES_N:
            reasons.append((f"{int(used[row].sum())} octaves, {OCTAVES_N} are needed", None))
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
