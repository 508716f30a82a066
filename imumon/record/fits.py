"""Fits of a record, with its spectra and shapes: recomputed when the record has grown enough to show.

They cost many times what the samples of a second cost and hardly change in a second. A report therefore reuses the
last ones until the record has grown by a tenth, or by ten minutes. The curve, and what is stated of it, is that of the
last minute at most. Counts, means and everything else that is cheap belong to the moment of the report.

A coefficient of a fit is a bound if the likelihood does not show it, if a term beside it explains the same, or if the
model leaves the curve (`noise.fit.statement`, `noise.fit.curve_statement`). The record then makes K a bound, in this
order, where

1. no model of the record explains it (`_judged`; B and M, too),
2. its halves contradict each other (`_with_contradiction`),
3. the sensor still warms up (`_without_slow_values`; M, too).

Before a record is long enough, everything is pending (`_why_pending`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal, TypeAlias

import numpy as np

from imumon.model.coefficients import LIMIT_95, NOISE, QUARTERS, Estimate, Excess, MarkovEstimate
from imumon.model.grading import LIMITS, grade_sensor
from imumon.model.report import UNGRADED_SHARE, Channel, Report, SensorGrade
from imumon.model.samples import UNITS, WITH_CURVE, ChannelName, Stream
from imumon.model.units import counted, duration
from imumon.noise.allan import AllanCurve
from imumon.noise.fit import BiasFit, ChannelFit, Estimator
from imumon.noise.fit.likelihood import CHANCE
from imumon.noise.statistics.differences import RobustDeviation
from imumon.noise.statistics.distribution_shape import DistributionShape
from imumon.noise.stretches import Sums
from imumon.noise.stretches.change import (
    LEAST_CHANGE,
    CoefficientChange,
    compare,
    detect_changes,
    joined,
)
from imumon.noise.stretches.quarters import excess
from imumon.noise.stretches.warmup import still_settles
from imumon.record import report_builder
from imumon.record.combined_limits import with_combined
from imumon.record.convergence import StatementLog
from imumon.record.counts import Counts

GROWTH = 0.1
"""Growth of a record, as a share, after which it is fitted again: limits shrink by 5 % meanwhile. More often, a daemon
spends its time on fits that change nothing (`daemon_cost.py`)."""
SCATTER_GROWTH = 2.0
"""Growth of the record, as a factor, after which its quarters and halves are fitted again: four fits of each channel.
Otherwise, a daemon spends more time on them than on its samples."""
HALVES = "the halves of the record contradict each other"
LONGEST_PAUSE_S = 60.0
"""s, longest pause, so that the end of the curve moves every minute."""
LONGEST_FIT_PAUSE_S = 600.0
"""s, longest growth without a fit: who waits for a precision, or watches a sensor that degrades, waits no longer."""


Renewal: TypeAlias = Literal["all", "due", "none"]
"""Which results are computed again: all of them, from the samples alone; those that are due; or none that there are, as
of a daemon that has a second to end."""


def pause_s(elapsed_s: float) -> float:
    """Return the growth, s, after which the curve of a record of this length is computed again.

    >>> pause_s(10.0), pause_s(100.0), pause_s(86400.0)
    (1.0, 10.0, 60.0)
    """
    return min(GROWTH * elapsed_s, LONGEST_PAUSE_S)


def fit_pause_s(elapsed_s: float) -> float:
    """Return the growth, s, after which what is so long is fitted again.

    >>> fit_pause_s(100.0), fit_pause_s(86400.0)
    (10.0, 600.0)
    """
    return min(GROWTH * elapsed_s, LONGEST_FIT_PAUSE_S)


class Fits:
    """The expensive results of a record.

    Parameters
    ----------
    stream : of the record.
    precision : target of the 95 % half-width by coefficient, as a share of the value.
    guarded : disturbances and warm-up are excluded.

    Attributes
    ----------
    stream, guarded : as given.
    fits : by channel, of those with a curve.
    robust : by channel, of those with a curve, the robust companion of its shortest deviation.
    shapes : (c,) shape of the distribution of each channel; None without samples.
    channels : by channel, the fields of a report that come from the fits, with the combined limits.
    convergence : what was stated when the record was shorter.
    grades : headline of each graded sensor, from the fits alone.
    resolution : (c,) channel unit, quantisation steps of the channels with a curve; 0.0 without.
    heats_up : whether the temperature of the device has not come to rest.
    warming_up : whether it heats up, or the mean of an inertial channel settles.
    """

    def __init__(
        self,
        stream: Stream,
        *,
        precision: Mapping[str, float],
        guarded: bool,
    ) -> None:
        self.stream, self.guarded, averaged = stream, guarded, stream.averaged
        self._estimator = Estimator(averaged=averaged, precision=dict(precision))
        self._quarters = Estimator(averaged=averaged, time_to=False)
        self._scatter: dict[int, dict[str, tuple[float, Excess]]] = {}  # by column and letter
        self.half_changes: dict[int, tuple[CoefficientChange, ...]] = {}  # by column, of N and B
        self._bias_curves: dict[int, BiasFit] = {}  # by column
        self._slow_due_s = self._halves_due_s = 0.0
        self._contradictions: dict[int, float] = {}  # by column, greatest upper limit of K in the halves
        self._compared: set[int] = set()  # columns whose halves have been compared since they were due
        self.warming_up = self.heats_up = False
        self.convergence = StatementLog(sum(sensor in WITH_CURVE for sensor in stream.sensors))
        self._due_s = self._fit_due_s = 0.0  # length at which the curve is computed again, and the fit
        self._analysed = (-1, -1, 0.0, False)  # length, samples past the guard, warm-up, and `force`
        self.fits: dict[ChannelName, ChannelFit] = {}
        self.robust: dict[ChannelName, RobustDeviation | None] = {}
        self.shapes: list[DistributionShape | None] = []
        self.channels: dict[ChannelName, Channel] = {}
        self.grades: dict[str, SensorGrade] = {}
        self.resolution: list[float] | None = None

    def update(self, sums: Sums, counts: Counts, renewal: Renewal, bare: Report) -> None:
        """Recompute everything if it is due, or, with ``all``, if anything has changed.

        Parameters
        ----------
        bare : report without channels, of the device.
        """
        if renewal == "none" and self.channels:
            return
        force = renewal == "all"
        current = (counts.span, sums.position, counts.warmup_s, force)
        elapsed_s = counts.elapsed_s
        # A warm-up that has just been excluded changes every number: it makes the fits due at once.
        early = not force and elapsed_s < self._due_s and counts.warmup_s == self._analysed[2]
        if early or current == self._analysed:
            return
        if counts.warmup_s != self._analysed[2]:
            self._fit_due_s = self._slow_due_s = self._halves_due_s = 0.0
        self._analysed, self._due_s = current, elapsed_s + pause_s(elapsed_s)
        curve, kurtosis, fits = self._fit(sums, counts, force=force)
        self.robust = dict(
            zip(self.stream.channels, sums.differences.result(self.resolution or ()), strict=False)
        )
        self.fits = dict(zip(self.stream.channels, fits, strict=False))
        self._update_slowly(sums, elapsed_s, kurtosis, force=force)
        graded: dict[str, dict[str, Mapping[str, Estimate]]] = {}  # by sensor and axis
        for name, fit in zip(self.stream.channels, fits, strict=False):
            graded.setdefault(name.sensor, {})[name.axis] = fit.coefficients
        self.grades = {sensor: grade_sensor(sensor, graded[sensor]) for sensor in LIMITS if sensor in graded}
        moments = sums.moments().channels
        channels = {
            name: self._channel(sums, curve, column, name, moments[column].std)
            for column, name in enumerate(self.stream.channels)
        }
        self.channels = with_combined(replace(bare, channels=channels))

    def note_convergence(self, sums: Sums, counts: Counts) -> None:
        """Note what the record states at its present length, without the results that only a report needs."""
        self._fit_due_s = 0.0
        self._fit(sums, counts, force=False)

    def _fit(
        self, sums: Sums, counts: Counts, *, force: bool
    ) -> tuple[AllanCurve, list[float], Sequence[ChannelFit]]:
        """Return curve, excess kurtosis and fits of the record as it is now, and note what they state."""
        curve, self.shapes = sums.curve(), sums.histogram.result()
        shapes = self.shapes[: sums.allan_channels]
        self.resolution = [shape.step or 0.0 if shape else 0.0 for shape in shapes]
        # Slow drift does not enter the kurtosis. The relative variance of N^2 gains it over the number of samples.
        kurtosis = sums.differences.fast_kurtosis().tolist()
        fits = self._fitted(sums, counts, curve, kurtosis, force=force)
        self.convergence.add(counts.elapsed_s, fits)
        return curve, kurtosis, fits

    def _fitted(
        self, sums: Sums, counts: Counts, curve: AllanCurve, kurtosis: list[float], *, force: bool
    ) -> Sequence[ChannelFit]:
        """Return the fits, as far as the state of the record lets them count; decide whether it warms up."""
        renew: bool | None = force or (None if counts.elapsed_s >= self._fit_due_s else False)
        if renew is not False:
            self._fit_due_s = counts.elapsed_s + fit_pause_s(counts.elapsed_s)
        fits = self._estimator.fit(curve, renew=renew, resolution=self.resolution, kurtosis=kurtosis)
        fits = _judged_as_a_record(fits)
        excluded = (counts.excluded_variance() * counts.interval_s).tolist()
        fits = tuple(_with_tails(fit, power) for fit, power in zip(fits, excluded, strict=False))
        self._compare_halves(sums, counts.elapsed_s, fits, kurtosis, force=force)
        fits = tuple(
            _with_contradiction(fit, self._contradictions[c]) if c in self._contradictions else fit
            for c, fit in enumerate(fits)
        )
        inertial = [fits[c] for c in sums.warmup_channels if c < len(fits)]
        settles = still_settles(inertial, counts.elapsed_s - sums.begin_s)
        self.heats_up = self.guarded and sums.still_heats_up(curve)
        self.warming_up = self.heats_up or (self.guarded and settles)
        if self.warming_up:
            # A mean that settles looks like a random walk, so K would be a figure of the warm-up.
            fits = tuple(_without_slow_values(fit) for fit in fits)
        if (why := _why_pending(counts)) is not None:
            fits = tuple(_with_reason(fit, why) for fit in fits)
        return fits

    def _compare_halves(
        self,
        sums: Sums,
        elapsed_s: float,
        fits: Sequence[ChannelFit],
        kurtosis: list[float],
        *,
        force: bool,
    ) -> None:
        """Find the channels whose K in the halves contradict each other, when the record has grown enough.

        Not where the whole record shows nothing slow beside N, and so has no more than a bound of K: parts of it show
        less, and two fits of each such channel are saved.
        """
        if force or elapsed_s >= self._halves_due_s:
            self._halves_due_s = SCATTER_GROWTH * elapsed_s
            self._compared.clear()
        slow = {c for c, fit in enumerate(fits) if fit.K.status in ("measured", "indistinct")}
        columns = sorted(slow - self._compared)
        self._compared |= slow
        self._contradictions = {c: high for c, high in self._contradictions.items() if c in self._compared}
        if not columns or (halves := sums.equal_parts(2)) is None:
            return
        first, second = (
            self._quarters.fit_sums(
                part, span, self.resolution, kurtosis, like=self._estimator, channels=columns
            )
            for part, span in halves
        )
        for column, one, two in zip(columns, first, second, strict=True):
            self._contradictions.pop(column, None)
            if compare("K", one.K, two.K, pairs=len(fits)) is not None:
                self._contradictions[column] = max(one.K.high or 0.0, two.K.high or 0.0)

    def _channel(
        self, sums: Sums, curve: AllanCurve, column: int, name: ChannelName, std: float | None
    ) -> Channel:
        """Return the fields of a channel that come from the fits."""
        sensor, fit, shape = self.stream.sensors[column], self.fits.get(name), self.shapes[column]
        step = shape.step if shape is not None else None
        channel = Channel(
            unit=UNITS[sensor], std=std, resolution=step or None, histogram=report_builder.histogram(shape)
        )
        if fit is None:
            return channel
        spectrum = None if curve.sums is None else curve.sums.spectrum
        return replace(
            report_builder.with_fit(channel, sensor, curve, column, fit, self._scatter.get(column, {})),
            spectrum=None if spectrum is None else report_builder.spectrum(sensor, spectrum, column),
            drift=report_builder.drift(fit, sums.begin_s, _range(curve), self._bias_curves.get(column)),
            convergence=self.convergence.of_channel(column),
            time_to={
                letter: seconds if self.convergence.is_lasting(column, letter) else None
                for letter, seconds in fit.time_to.items()
            },
            robust=report_builder.robust(self.robust[name]),
            bias_curve=report_builder.bias_curve(sensor, self._bias_curves.get(column)),
        )

    def _update_slowly(self, sums: Sums, elapsed_s: float, kurtosis: Sequence[float], *, force: bool) -> None:
        """Compute the scatter between the quarters and the curves of the bias, when the record has grown enough."""
        if not force and elapsed_s < self._slow_due_s:
            return
        # Four fits, one per quarter, would cost more than all else; quarters that are longer by less show the same.
        self._slow_due_s = SCATTER_GROWTH * elapsed_s
        if (whole := sums.whole_sums()) is not None:
            self._bias_curves = dict(enumerate(self._estimator.bias_curves(whole, sums.temperature_range())))
        parts = [
            self._quarters.fit_sums(part, span, self.resolution, kurtosis, like=self._estimator)
            for part, span in sums.equal_parts(QUARTERS) or ()
        ]
        pairs = len(LEAST_CHANGE) * len(self.stream.sensors)
        self.half_changes = {
            column: detect_changes(
                *(joined([fit.coefficients for fit in half]) for half in (fits[:2], fits[2:])), pairs=pairs
            )
            for column, fits in enumerate(zip(*parts, strict=True))
        }
        self._scatter = {
            column: {
                letter: scatter
                for letter in NOISE
                if (scatter := _between([fit.coefficients[letter] for fit in fits])) is not None
            }
            for column, fits in enumerate(zip(*parts, strict=True))
        }


def _between(quarters: Sequence[Estimate]) -> tuple[float, Excess] | None:
    """Return the standard deviation between quarters, and which part of it is beyond statistics; None: unknown."""
    known = [(part.value, part.low, part.high) for part in quarters]
    # A quarter that shows a bound only may be anything below it: then the scatter of the others says nothing.
    if not all(value and low and high and low < high for value, low, high in known):
        return None
    values, low, high = np.array(known, dtype=np.float64).T
    return float(np.std(values, ddof=1)), excess(values, np.log(high / low) / (2.0 * LIMIT_95))


def _judged_as_a_record(fits: Sequence[ChannelFit]) -> tuple[ChannelFit, ...]:
    """Return the fits without the caveat `misfit` where it is one of several channels by chance (Bonferroni).

    Judged one by one, nine channels of noise that is exactly the model have it in 9 % of the records. What is left is
    noise of another kind: B, K and M, which say of which kind it is, are bounds.
    """
    chance = CHANCE / max(sum(fit.p_value is not None for fit in fits), 1)
    return tuple(_judged(fit, chance) for fit in fits)


def _judged(fit: ChannelFit, chance: float) -> ChannelFit:
    """Return the fit without its caveat `misfit`, or with bounds where it is less probable than `chance`."""
    if fit.p_value is None:
        return fit
    if fit.p_value >= chance:
        return replace(fit, caveats=tuple(caveat for caveat in fit.caveats if caveat != "misfit"))
    reason = "the model does not explain the record"
    return replace(
        fit,
        coefficients={**fit.coefficients, "B": _bounded(fit.B, reason), "K": _bounded(fit.K, reason)},
        markov=_without_size(fit.markov, reason),
        jumps=None,
    )


def _with_tails(fit: ChannelFit, power: float) -> ChannelFit:
    """Return the fit with an upper limit of N that holds the excluded end of its own tails, too.

    Parameters
    ----------
    power : SI, N^2 of the excluded samples by themselves; 0.0 where outliers are no noise.
    """
    if not power or fit.N.high is None:
        return fit
    white = replace(fit.N, high=math.hypot(fit.N.high, math.sqrt(power)))
    return replace(fit, coefficients={**fit.coefficients, "N": white})


def _with_contradiction(fit: ChannelFit, high: float) -> ChannelFit:
    """Return the fit with K as a bound that holds that of both halves, which contradict each other."""
    if fit.K.high is None:
        return fit
    walk = Estimate(low=0.0, high=max(fit.K.high, high), status="upper_bound", reason=HALVES)
    return replace(fit, coefficients={**fit.coefficients, "K": walk}, caveats=(*fit.caveats, "halves"))


def _without_slow_values(fit: ChannelFit) -> ChannelFit:
    """Return the fit with K and M as upper bounds: what settles may look like them."""
    reason = "the sensor is still warming up"
    coefficients = {**fit.coefficients, "K": _bounded(fit.K, reason)}
    return replace(fit, coefficients=coefficients, markov=_without_size(fit.markov, reason))


def _without_size(markov: MarkovEstimate | None, reason: str) -> MarkovEstimate | None:
    """Return Gauss–Markov noise with an upper bound of its standard deviation, and no value of its time constant."""
    if markov is None:
        return None
    time = markov.time_constant_s
    if time.status == "measured":
        time = replace(time, value=None, status="indistinct", reason=reason)
    return MarkovEstimate(sigma=_bounded(markov.sigma, reason), time_constant_s=time)


def _bounded(part: Estimate, reason: str) -> Estimate:
    """Return a measured value as an upper bound."""
    if part.status != "measured":
        return part
    return Estimate(low=0.0, high=part.high, status="upper_bound", reason=reason)


def _why_pending(counts: Counts) -> Estimate | None:
    """Return why coefficients are pending of a record most of which is excluded or missing; None: it is not."""
    if counts.excluded_share > UNGRADED_SHARE:
        return Estimate(reason="most of the record is excluded", reason_code="excluded")
    if counts.missing_share > UNGRADED_SHARE:
        missing = f"{counted(counts.gaps, 'gap')}, {duration(counts.missing * counts.interval_s)}"
        return Estimate(reason=f"{missing}, between parts that are too short", reason_code="gaps")
    return None


def _with_reason(fit: ChannelFit, why: Estimate) -> ChannelFit:
    """Return the fit with the reason why coefficients are pending."""
    known = {
        # a reason with a code says more: the values never change, or the resolution hides the noise
        name: part if part.status != "pending" or part.reason_code else why
        for name, part in fit.coefficients.items()
    }
    return replace(fit, coefficients=known)


def _range(curve: AllanCurve) -> tuple[float, float] | None:
    """Return the least and the greatest block mean of the temperature, degC; None: there is none."""
    degrees = None if curve.sums is None else curve.sums.degrees
    if degrees is None or not np.isfinite(degrees).any():
        return None
    return float(np.nanmin(degrees)), float(np.nanmax(degrees))
