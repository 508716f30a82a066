"""Fit of N, B and K to the sums of a record: one likelihood, and everything that follows from it.

`description` finds the terms, `likelihood` gives the numbers, `channel_results` states them in SI, and `stated_curve`
gives the Allan curve that they imply. A fit is computed again when the record has grown by 2 %; in between the last one
holds, with the curve of today.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imumon.coefficients import NOISE, default_precision
from imumon.noise.allan import AllanCurve
from imumon.noise.fit.bias_curve import bias_curve
from imumon.noise.fit.channel_results import TOO_SHORT, stated
from imumon.noise.fit.description import Choice, Describer
from imumon.noise.fit.observations import LEAST_VARIANCE, block_series
from imumon.noise.fit.results import ChannelFit, pending_fit
from imumon.noise.fit.stated_curve import Stated, with_curve
from imumon.noise.noise_sums import NoiseSums
from imumon.noise.spectrum.level_sums import SUB_BAND
from imumon.noise.validity_groups import DITHERED, ROUNDING
from imumon.report import BiasCurve
from imumon.samples import Floats

CUT = "gaps of unknown length cut the record into parts that are too short"
RENEWAL_GROWTH = 1.02
"""1, growth of the record after which a fit is computed again: limits shrink by 1 % meanwhile."""


@dataclass(frozen=True, slots=True, eq=False)
class _Known:
    """Fit of a channel at one length of its record."""

    span: int
    found: Stated | str


class Estimator:
    """Fits of a growing record; each is kept until the record has grown enough to change it.

    A fit belongs to one record (`AllanCurve.record`). A curve of another record, or of an unknown one, is fitted from
    scratch, so that no limit of one record is returned for another.

    Parameters
    ----------
    averaged : the samples are true averages over their interval (delta angles), else point samples; one value
        for all channels, or (c,) one for each. A curve may consist of the first few of them.
    precision : requested 95 % half-widths by coefficient, for `time_to`; default `default_precision`.
    time_to : compute `time_to`.
    """

    def __init__(
        self,
        *,
        averaged: bool | Sequence[bool],
        precision: dict[str, float] | None = None,
        time_to: bool = True,
    ) -> None:
        self.averaged, self._time_to = averaged, time_to
        self.precision = default_precision() | (precision or {})
        self._record: Hashable = None
        self._known: dict[int, _Known] = {}
        self._parts: dict[int, _Known] = {}  # of the part in progress

    def fit(
        self,
        curve: AllanCurve,
        *,
        renew: bool | None = None,
        resolution: Sequence[float] | None = None,
        kurtosis: Sequence[float] | None = None,
        degrees: Floats | None = None,
    ) -> tuple[ChannelFit, ...]:
        """Fit every channel of a curve.

        Parameters
        ----------
        curve : of an `OctaveCascade`, with the sums of its noise.
        renew : compute everything again, whatever was found before; default: where the record has grown by 2 %.
        resolution : (c,) channel unit, least step between two values, 0.0 where there is none. Noise smaller
            than half of it shows in the rounding only, and no coefficient is given.
        kurtosis : (c,) 1, excess kurtosis of the samples about slow changes, which widens the limits of N.
        degrees : (blocks,) degC, temperature over the blocks of the sums; None: that of the sums.
        """
        if degrees is None and curve.sums is not None:
            degrees = curve.sums.degrees
        if curve.record is None or curve.record != self._record:
            self._known.clear()
        self._record = curve.record
        return tuple(
            self._fitted(
                curve,
                channel,
                renew,
                0.0 if resolution is None else float(resolution[channel]),
                0.0 if kurtosis is None else float(kurtosis[channel]),
                degrees,
            )
            for channel in range(curve.valid.size)
        )

    def _fitted(
        self,
        curve: AllanCurve,
        channel: int,
        renew: bool | None,
        step: float,
        kurtosis: float,
        degrees: Floats | None,
    ) -> ChannelFit:
        """Return the fit of a channel, with what was found last while it is current; see `fit`."""
        reason = _why_pending(curve, channel, step)
        if reason is not None or curve.sums is None:
            self._known.pop(channel, None)
            return pending_fit(len(curve.m), *(reason or ("the curve has no sums of its noise",)))
        known = self._known.get(channel)
        current = known is not None and known.span <= curve.span < known.span * RENEWAL_GROWTH
        if known is None or renew or (renew is None and not current):
            found = self._stated(curve.sums, channel, None if renew else known, degrees, kurtosis)
            known = self._known[channel] = _Known(curve.span, found)
        if isinstance(known.found, str):
            return pending_fit(len(curve.m), known.found)
        return with_curve(known.found, curve, curve.sums, channel, self._flag(channel))

    def fit_sums(
        self,
        sums: NoiseSums,
        span: int,
        resolution: Sequence[float] | None = None,
        kurtosis: Sequence[float] | None = None,
        like: Estimator | None = None,
    ) -> tuple[ChannelFit, ...]:
        """Fit every channel of the sums of a part of a record, without a curve.

        Parameters
        ----------
        span : samples of the part.
        resolution, kurtosis : see `fit`.
        like : estimator of the whole record, whose descriptions the parts share; None: each part has its own, which
            is kept while the part grows.
        """
        out = []
        for channel in range(len(sums.group)):
            step = 0.0 if resolution is None else float(resolution[channel])
            if (reason := _hidden(sums, channel, step)) is not None:
                out.append(pending_fit(0, *reason))
                continue
            known = self._parts.get(channel) if like is None else like._known.get(channel)
            if like is None and known is not None and known.span > span:
                known = None  # another part
            excess = 0.0 if kurtosis is None else float(kurtosis[channel])
            found = self._stated(sums, channel, known, sums.degrees, excess, whole=like is None)
            if like is None:
                self._parts[channel] = _Known(span, found)
            out.append(pending_fit(0, found) if isinstance(found, str) else found.fit)
        return tuple(out)

    def bias_curves(
        self, sums: NoiseSums, extremes: tuple[float, float] | None = None
    ) -> tuple[BiasCurve, ...]:
        """Return the bias of every channel against the temperature, with the noise of the last fit.

        Parameters
        ----------
        sums : of the whole record, with its warm-up.
        extremes : degC, least and greatest sample of the temperature; None: unknown.
        """
        out = []
        for channel in range(len(sums.group)):
            known = self._known.get(channel)
            noise = None if known is None or isinstance(known.found, str) else known.found.found.surface
            out.append(bias_curve(sums.blocks, channel, sums.degrees, noise, extremes))
        return tuple(out)

    def _flag(self, channel: int) -> bool:
        return self.averaged if isinstance(self.averaged, bool) else bool(self.averaged[channel])

    def _stated(
        self,
        sums: NoiseSums,
        channel: int,
        known: _Known | None,
        degrees: Floats | None,
        kurtosis: float,
        *,
        whole: bool = True,
    ) -> Stated | str:
        """Return what the description of a channel states, or why there is none.

        Parameters
        ----------
        whole : the sums are those of which `known` is an earlier state, else a part of them.
        """
        series = block_series(sums.blocks, channel, degrees)
        if series is None:
            return TOO_SHORT if len(np.unique(sums.blocks.segment)) <= 2 else CUT
        if not np.var(series.series) > LEAST_VARIANCE:
            return "the channel is constant"
        steps = np.diff(series.series, 2)
        if not steps.size or float(steps @ steps) <= ROUNDING**2 * float(series.series @ series.series):
            return "a straight line without noise"
        previous: Choice | None = None
        if known is not None and not isinstance(known.found, str):
            choice = known.found.found.choice
            previous = choice if whole else replace(choice, grids=(None, None))
        describer = Describer(
            sums,
            channel,
            series,
            averaged=self._flag(channel),
            previous=previous,
            slow_terms=whole,
        )
        found = describer.describe()
        if isinstance(found, str):
            return found
        precision = np.array([self.precision[name] for name in NOISE]) if self._time_to else None
        return stated(sums, channel, found, kurtosis, precision)


def fit_curve(
    curve: AllanCurve,
    *,
    averaged: bool | Sequence[bool],
    time_to: bool = True,
) -> tuple[ChannelFit, ...]:
    """Fit N, B and K to every channel of a curve, once; see `Estimator`."""
    return Estimator(averaged=averaged, time_to=time_to).fit(curve)


def _why_pending(curve: AllanCurve, channel: int, step: float) -> tuple[str, str | None] | None:
    """Return why a channel cannot be fitted, text and code; None if it can."""
    present = curve.terms[:, channel] > 0 if len(curve.m) else np.zeros(0, dtype=bool)
    if not present.any():
        return "no difference yet", None
    variance = curve.avar[present, channel]
    if not (variance > LEAST_VARIANCE).any():
        return "the channel is constant", "constant"
    if variance[0] < (DITHERED * step) ** 2:
        return _resolution_reason(step)
    return None


def _hidden(sums: NoiseSums, channel: int, step: float) -> tuple[str, str] | None:
    """Return why the resolution hides the noise of a part of a record, text and code; None if it does not."""
    if not step or not sums.levels or not sums.levels[0].averages[sums.group[channel]]:
        return None
    white = float(sums.levels[0].power[channel].mean()) / float(sums.levels[0].averages[sums.group[channel]])
    bins = SUB_BAND if sums.pooled else 1
    return _resolution_reason(step) if white / bins < (DITHERED * step) ** 2 else None


def _resolution_reason(step: float) -> tuple[str, str]:
    return f"its resolution of {step:.3g} hides the noise", "resolution"
