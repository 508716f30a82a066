"""Estimator: fits of all channels of a growing record, from its sums to what is stated.

The way of a channel through this package:

| step | module | from | to |
|---|---|---|---|
| can it be fitted? | `estimator` | curve, resolution | a reason why it is pending |
| what is compared | `observations` | `NoiseSums` | `Bands`, `Cosines` |
| which terms explain it | `search` (`ModelSearch`) | observations | `Model` |
| how likely are their powers | `likelihood` (`Likelihood`) | terms of `model`, `regressors` | `Surface` |
| what is stated | `statement` (`state_model`), `curve_statement` (`with_curve`) | `Model` | `ChannelFit` |

A fit is computed again when the record has grown by 2 % (`RENEWAL_GROWTH`); in between the last one holds, with the
curve of today. `time_to` is that of the last fit and is not counted down in between. A new fit keeps the upper end of
the last one (`search.ModelChoice`) until the data reject it or the record has doubled, so that a growing record does
not alternate between two. Its numbers therefore depend, within their limits, on when it was fitted before. With
`renew=True` they depend on the samples alone: so does the last report of a record, and a replay of it.

Two kinds of constants must not be confused. *Decisions* (a probability, odds) say what counts; each has an error rate.
*Resolutions* (grids, nodes, steps) only have to be fine enough: they say from which size on nothing changes.

Example: half a minute of white noise.

>>> from imumon.noise import OctaveCascade, synthesise
>>> cascade = OctaveCascade(1, tau0=0.01)
>>> cascade.update(synthesise(4096, 100.0, N=[1e-3], seed=1, averaged=False))
>>> (fit,) = fit_curve(cascade.result(), averaged=False)
>>> fit.N.low < 1e-3 < fit.N.high, fit.B.status, fit.K.status
(True, 'upper_bound', 'upper_bound')
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from imumon.model.coefficients import NOISE, default_precision
from imumon.model.samples import Floats
from imumon.noise.allan import AllanCurve
from imumon.noise.blocks import BlockMeans
from imumon.noise.fit.bias_curve import BiasFit, bias_curve
from imumon.noise.fit.curve_statement import with_curve
from imumon.noise.fit.normal_equations import LEAST_VARIANCE
from imumon.noise.fit.observations import BlockSeries, block_series
from imumon.noise.fit.search import ModelChoice, ModelSearch
from imumon.noise.fit.statement import (
    TOO_SHORT,
    ChannelFit,
    FittedModel,
    pending_fit,
    state_model,
)
from imumon.noise.noise_sums import NoiseSums
from imumon.noise.spectrum.level_sums import SUB_BAND
from imumon.noise.spectrum.power_spectrum import LEAST_AVERAGES
from imumon.noise.validity_groups import DITHERED, ROUNDING, ROUNDING_VARIANCE

COUNTED_FALL = 0.5
"""Coarse values are counts of an angle where the density of some octave is below this share. Unit: of the highest
octave.

Otherwise: a counting gyroscope is pending; at 1, a rounded rate counts as an angle by the scatter of its octaves.
Origin: rounding adds a quarter of the squared count there: below half of it, noise moves half a count a sample.
"""
RENEWAL_GROWTH = 1.02
"""A fit is computed again when the record has grown by this factor; in between the last one holds. Unit: of the
length.

Otherwise: a daemon spends its time on fits that change nothing. Origin: limits shrink by 1 % meanwhile
(`daemon_cost.py`).
"""

CUT = "gaps of unknown length cut the record into parts that are too short"
CONSTANT = "the channel is constant", "constant"
"""Text and code: no curve, and no block, shows any noise."""


class Pending(NamedTuple):
    """Why a channel has no fit: text, and the code of the report if there is one."""

    reason: str
    code: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class _Known:
    """Fit of a channel at one length of its record."""

    span: int
    fitted: FittedModel | Pending  # or why there is none


UNGUARDED = "unguarded"
"""Caveat of a fit to a curve alone: what steps and outliers of the samples do to N is unknown. A guard has nothing to
do with it: the name says that nothing protected the fit from them."""


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
    ) -> tuple[ChannelFit, ...]:
        """Fit every channel of a curve.

        Parameters
        ----------
        curve : of an `OctaveCascade`, with the sums of its noise.
        renew : True: compute everything again, without the choices of earlier fits; False: keep every fit that there
            is; None: compute again where the record has grown by 2 %, with the choice of the last fit.
        resolution : (c,) channel unit, least step between two values, 0.0 where there is none. Noise smaller
            than half of it shows in the rounding only, and no coefficient is given.
        kurtosis : (c,) 1, excess kurtosis of the samples that count, without exclusions and slow changes. It widens the
            limits of N: outliers that are the noise of a channel (`detection.outliers`) are counted so.
        """
        if curve.record is None or curve.record != self._record:
            self._known.clear()
        self._record = curve.record
        return tuple(
            self._fitted(
                curve,
                channel,
                renew,
                _of_channel(resolution, channel),
                _of_channel(kurtosis, channel),
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
    ) -> ChannelFit:
        """Return the fit of a channel, the last one while it is current; see `fit`."""
        reason = _why_pending(curve, channel, step)
        if reason is not None or curve.sums is None:
            self._known.pop(channel, None)
            return pending_fit(len(curve.m), *(reason or ("the curve has no sums of its noise",)))
        known = self._known.get(channel)
        current = known is not None and known.span <= curve.span < known.span * RENEWAL_GROWTH
        if known is None or renew or (renew is None and not current):
            previous = None if renew else known
            fitted = self._fit_model(curve.sums, channel, previous, kurtosis, step)
            known = self._known[channel] = _Known(curve.span, fitted)
        if isinstance(known.fitted, Pending):
            return pending_fit(len(curve.m), *known.fitted)
        return with_curve(known.fitted, curve, curve.sums, channel, self._is_averaged(channel))

    def fit_sums(
        self,
        sums: NoiseSums,
        span: int,
        resolution: Sequence[float] | None = None,
        kurtosis: Sequence[float] | None = None,
        like: Estimator | None = None,
        channels: Sequence[int] | None = None,
        only_with: str | None = None,
    ) -> tuple[ChannelFit, ...]:
        """Fit channels of the sums of a part of a record, without a curve.

        Parameters
        ----------
        span : samples of the part.
        resolution, kurtosis : see `fit`.
        like : estimator of the whole record, whose models the parts share, because a part shows
            less of the upper end than the whole; None: each part has its own, which
            is kept while the part grows.
        channels : which ones, in the order of the results; None: all.
        only_with : name of a regressor. A channel whose slow terms have no such regressor is not fitted, and its result
            is pending: that takes a fifth of the time. Beside a hump, a fit may have others. None: all are fitted.
        """
        out = []
        for channel in range(len(sums.group)) if channels is None else channels:
            step = _of_channel(resolution, channel)
            if (reason := _hidden(sums, channel, step)) is not None:
                out.append(pending_fit(0, *reason))
                continue
            known = self._parts.get(channel) if like is None else like._known.get(channel)
            if like is None and known is not None and known.span > span:
                known = None  # another part
            fitted = self._fit_model(
                sums,
                channel,
                known,
                _of_channel(kurtosis, channel),
                step,
                whole=like is None,
                only_with=only_with,
            )
            if like is None:
                self._parts[channel] = _Known(span, fitted)
            out.append(pending_fit(0, *fitted) if isinstance(fitted, Pending) else fitted.fit)
        return tuple(out)

    def bias_curves(
        self, sums: NoiseSums, extremes: tuple[float, float] | None = None
    ) -> tuple[BiasFit, ...]:
        """Return the bias of every channel against the temperature, with the noise of the last fit.

        Parameters
        ----------
        sums : of the whole record, with its warm-up.
        extremes : degC, least and greatest sample of the temperature; None: unknown.
        """
        out = []
        for channel in range(len(sums.group)):
            known = self._known.get(channel)
            fitted = None if known is None else known.fitted
            noise = fitted.surface if isinstance(fitted, FittedModel) else None
            out.append(bias_curve(sums.blocks, channel, sums.degrees, noise, extremes))
        return tuple(out)

    def _is_averaged(self, channel: int) -> bool:
        return self.averaged if isinstance(self.averaged, bool) else bool(self.averaged[channel])

    def _fit_model(
        self,
        sums: NoiseSums,
        channel: int,
        known: _Known | None,
        kurtosis: float,
        step: float,
        *,
        whole: bool = True,
        only_with: str | None = None,
    ) -> FittedModel | Pending:
        """Return the model of a channel with what it states, or why there is none.

        Parameters
        ----------
        step : channel unit, least step between two values, 0.0 where there is none.
        whole : the sums are those of which `known` is an earlier state, and settling, steps and bends are sought;
            False: a part of them that shares its model.
        only_with : see `fit_sums`.
        """
        series = _noisy_series(sums.blocks, channel, sums.degrees)
        if isinstance(series, Pending):
            return series
        previous: ModelChoice | None = None
        if known is not None and isinstance(known.fitted, FittedModel):
            choice = known.fitted.choice
            # B and K of a part have other limits: its grid begins again
            previous = choice if whole else replace(choice, grids=None, slow_grids=None)
        averaged = self._is_averaged(channel)
        counted = _counts_angle(sums, channel, step)
        search = ModelSearch(
            sums,
            channel,
            series,
            averaged=averaged,
            previous=previous,
            whole=whole,
            step=step,
            counted=counted,
        )
        if only_with is not None and not search.may_have(only_with):
            return Pending(f"its slow terms have no {only_with}")
        model = search.result()
        if isinstance(model, str):
            return Pending(model)
        precision = {letter: self.precision[letter] for letter in NOISE} if self._time_to else None
        return state_model(sums, channel, model, kurtosis, precision, step, counted=counted)


def _of_channel(values: Sequence[float] | None, channel: int) -> float:
    """Return what is known of a channel, 0.0 without any."""
    return 0.0 if values is None else float(values[channel])


def _noisy_series(blocks: BlockMeans, channel: int, degrees: Floats | None) -> BlockSeries | Pending:
    """Return the block means of a channel, or why they show no noise."""
    series = block_series(blocks, channel, degrees)
    if series is None:
        # one gap of unknown length may lie in any short record; more of them are the cause
        return Pending(TOO_SHORT if len(np.unique(blocks.segment)) <= 2 else CUT)
    if not np.var(series.series) > LEAST_VARIANCE:
        return Pending(*CONSTANT)
    # a simulator without noise, or a counter: what is left of the line is rounding
    steps = np.diff(series.series, 2)
    if not steps.size or float(steps @ steps) <= ROUNDING**2 * float(series.series @ series.series):
        return Pending("a straight line without noise")
    return series


def fit_curve(
    curve: AllanCurve,
    *,
    averaged: bool | Sequence[bool],
    time_to: bool = True,
    resolution: Sequence[float] | None = None,
    kurtosis: Sequence[float] | None = None,
) -> tuple[ChannelFit, ...]:
    """Fit N, B and K to every channel of a curve, once; see `Estimator`.

    A curve does not show the steps and the outliers of its samples. Without `resolution` and `kurtosis`, each fit has
    the caveat ``unguarded``: rounding that is coarser than the noise, and outliers, make N wrong, and its limits too
    narrow. `imumon.analyse` takes both from the samples.
    """
    fits = Estimator(averaged=averaged, time_to=time_to).fit(curve, resolution=resolution, kurtosis=kurtosis)
    if resolution is not None and kurtosis is not None:
        return fits
    return tuple(replace(fit, caveats=(*fit.caveats, UNGUARDED)) for fit in fits)


def _why_pending(curve: AllanCurve, channel: int, step: float) -> tuple[str, str | None] | None:
    """Return why a channel cannot be fitted, text and code; None if it can."""
    present = curve.terms[:, channel] > 0 if len(curve.m) else np.zeros(0, dtype=bool)
    if not present.any():
        return "no difference yet", None
    variance = curve.avar[present, channel]
    if not (variance > LEAST_VARIANCE).any():
        return CONSTANT
    # what rounding adds to white noise that moves the values over steps is no noise that moves them
    moving = variance[0] - ROUNDING_VARIANCE * step**2
    if moving < (DITHERED * step) ** 2 and not (
        curve.sums is not None and _counts_angle(curve.sums, channel, step)
    ):
        return _resolution_reason(step)
    return None


def _counts_angle(sums: NoiseSums, channel: int, step: float) -> bool:
    """Return whether coarse values are differences of an angle (or a velocity) in counts.

    The error of a count is one of the angle, which the next sample makes good: the density falls towards low
    frequencies. The error of a rounded rate stays, and its density does not fall.
    """
    densities = [
        _mean_density(sums, s, channel)
        for s, level in enumerate(sums.levels)
        if level.averages[sums.group[channel]] >= LEAST_AVERAGES
    ]
    if not densities or not 0.0 < densities[0] < step**2:
        return False  # finer steps need no other treatment: rounding errors are independent
    return min(densities) < COUNTED_FALL * densities[0]


def _hidden(sums: NoiseSums, channel: int, step: float) -> tuple[str, str] | None:
    """Return why the resolution hides the noise of a part of a record, text and code; None if it does not."""
    if not step or not sums.levels or not sums.levels[0].averages[sums.group[channel]]:
        return None
    if _counts_angle(sums, channel, step):
        return None
    return _resolution_reason(step) if _mean_density(sums, 0, channel) < (DITHERED * step) ** 2 else None


def _mean_density(sums: NoiseSums, s: int, channel: int) -> float:
    """Return the mean density of level s, (channel unit)^2 per cycle per sample of the record."""
    level, bins = sums.levels[s], SUB_BAND if sums.pooled else 1
    return float(level.power[channel].mean()) / bins / float(level.averages[sums.group[channel]]) * 2.0**s


def _resolution_reason(step: float) -> tuple[str, str]:
    return f"its resolution of {step:.3g} hides the noise", "resolution"
