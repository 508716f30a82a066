"""Report builder: results of the mathematics as parts of `imumon.model.report`.

Each function turns one result into one part of the report. It scales units, selects rows and reduces the
number of points; it estimates nothing but the bias.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from imumon.model import report
from imumon.model.coefficients import (
    COEFFICIENTS,
    LIMIT_95,
    MARKOV,
    NOISE,
    SIGNIFICANT,
    Estimate,
    Excess,
    MarkovEstimate,
)
from imumon.model.grading import LIMITS, grade_channel
from imumon.model.messages import NO_THERMOMETER
from imumon.model.samples import UNITS, ChannelName, Floats, Ints
from imumon.model.units import FLICKER, HOUR, STANDARD_GRAVITY
from imumon.noise.allan import AllanCurve
from imumon.noise.fit import BiasFit, ChannelFit, RegressorEstimate, StepEstimate
from imumon.noise.spectrum import PowerSpectrum
from imumon.noise.statistics.differences import RobustDeviation
from imumon.noise.statistics.distribution_shape import DistributionShape
from imumon.noise.statistics.envelope import Envelope, EnvelopeColumns

NEARLY_VERTICAL = 0.95
"""Share of gravity that an axis must measure to have a bias: the excess of the vector's length says nothing
of axes across it, and the tilt of a more slanted axis adds more than its bias."""

NOT_GRAVITY = 0.5
"""Standard gravities by which the length of the accelerometer's mean differs from one if it is not that of gravity."""

GRAVITY_SPREAD = 0.027
"""m/s^2, greatest difference of gravity at sea level, equator and poles, from the standard one."""

HORIZONTAL_BIAS = 0.05
"""m/s^2, assumed limit of the bias of the axes beside the vertical one: 5 mg, that of a consumer sensor."""

REPORTED_BINS = 64
"""Most bins in a report, for the size of the message."""
POINTS_PER_DECADE = 24
"""Most points per decade of frequency in a report, for the size of the message."""
SIGNAL_DIGITS = 8
"""Significant digits in a signal view: gravity with noise of 1e-6 m/s^2 must not show steps."""
NOT_EVERY_QUARTER = "not every quarter of the record shows a value"
NO_SCATTER = f"scatter: {NOT_EVERY_QUARTER}"
"""Reason of a coefficient with a value and no scatter."""

CURVE_DIGITS = 5
"""Significant digits of a spectrum, for the size of the message."""
SHARE_DIGITS = 7
"""Significant digits of the shares of a model. A filter takes most of the noise: their sum loses two digits."""


def coefficients(
    sensor: str, fit: ChannelFit, scatter: Mapping[str, tuple[float, Excess]]
) -> dict[str, Estimate]:
    """Return the coefficients of a channel by letter, with their units and their scatter."""
    estimates = {}
    for letter, estimate in fit.coefficients.items():
        deviation, beyond_statistics = scatter.get(letter) or (None, None)
        # Quantisation and rate ramp have no scatter at all; of N, B and K its absence needs a reason.
        reason = estimate.reason or (NO_SCATTER if letter in NOISE and deviation is None else None)
        unit = COEFFICIENTS[letter].units[sensor].si
        estimates[letter] = replace(
            estimate, unit=unit, scatter=deviation, excess=beyond_statistics, reason=reason
        )
    return estimates


def correlated_noise(sensor: str, fit: ChannelFit) -> MarkovEstimate | None:
    """Return the Gauss–Markov noise of a channel with its units; None where the data do not ask for it."""
    if fit.markov is None:
        return None
    units = [COEFFICIENTS[letter].units[sensor].si for letter in MARKOV]
    parts = (fit.markov.sigma, fit.markov.time_constant_s)
    sigma, time_constant = (replace(part, unit=unit) for part, unit in zip(parts, units, strict=True))
    return MarkovEstimate(sigma=sigma, time_constant_s=time_constant)


def _jumps(fit: ChannelFit) -> report.Jumps | None:
    """Return the levels of popcorn noise; None where the curve, or the distribution, does not show it."""
    if fit.jumps is None or "popcorn" not in fit.caveats:
        return None
    (low, high), (low_s, high_s) = fit.jumps.levels, fit.jumps.dwell
    return report.Jumps(low=low, high=high, low_s=low_s, high_s=high_s)


def _rows(curve: AllanCurve, column: int) -> Ints:
    """Return the octaves of a channel that have a difference: the longest ones of a young record have none."""
    return np.flatnonzero(curve.terms[:, column] > 0)


def allan(curve: AllanCurve, column: int, fit: ChannelFit) -> report.Allan:
    """Return the curve of one channel, with every octave that has a difference."""
    rows = _rows(curve, column)
    return report.Allan(
        tau_s=tuple(curve.tau[rows].tolist()),
        sigma=tuple(curve.sigma[rows, column].tolist()),
        low=_positive(fit.low[rows]),
        high=_positive(fit.high[rows]),
        edf=_positive(fit.edf[rows]),
        model=_positive(fit.model[rows]),
        noise=_positive(fit.noise[rows]),
        used=tuple(fit.used[rows].tolist()),
    )


def with_fit(
    channel: report.Channel,
    sensor: str,
    curve: AllanCurve,
    column: int,
    fit: ChannelFit,
    scatter: Mapping[str, tuple[float, Excess]],
) -> report.Channel:
    """Return the channel with curve, coefficients and grade.

    Parameters
    ----------
    scatter : by letter, standard deviation between the quarters of the record in SI, and its excess.
    """
    return replace(
        channel,
        coefficients=coefficients(sensor, fit, scatter),
        M=correlated_noise(sensor, fit),
        model=noise_model(sensor, fit, _rows(curve, column)),
        grade=channel_grade(sensor, fit.coefficients),
        readings=fit.readings,
        time_to=fit.time_to,
        fit=report.FitQuality(chi2=fit.chi2, dof=fit.dof, p_value=fit.p_value),
        allan=allan(curve, column, fit),
    )


def channel_grade(sensor: str, estimates: Mapping[str, Estimate]) -> report.ChannelGrade | None:
    """Return the grade of a channel by its coefficients; None for a sensor that has no grades."""
    return report.ChannelGrade(meets=grade_channel(sensor, estimates)) if sensor in LIMITS else None


def distribution(
    shape: DistributionShape | None,
    recent: tuple[float, float],
    correlation: Mapping[str, float],
    effective_samples: float | None,
) -> report.Distribution:
    """Return the shape of a channel's values, its last minute, and its correlation with other axes.

    Parameters
    ----------
    recent : channel unit, mean and standard deviation of the last minute; NaN if unknown.
    """
    return report.Distribution(
        verdict=shape.verdict if shape else None,
        gaussian=shape.is_gaussian if shape else None,
        recent_mean=_finite(recent[0]),
        recent_std=_finite(recent[1]),
        correlation=correlation,
        effective_samples=effective_samples,
    )


def effective_samples(allan: report.Allan | None, std: float | None, count: int) -> float | None:
    """Return the number of independent samples whose mean has the variance of this mean.

    The mean of n independent samples has the variance std^2 / n. The mean of a record of length T has, if
    clusters of length tau were independent, the variance sigma^2(tau) tau / T. The largest one decides.

    Parameters
    ----------
    std : channel unit, standard deviation of the samples.
    count : number of samples.
    """
    if allan is None or not allan.tau_s or std is None:
        return None
    # sigma^2 tau is constant in white noise and grows with tau in slower noise: the largest is what moves the mean.
    largest = max(sigma**2 * tau for sigma, tau in zip(allan.sigma, allan.tau_s, strict=True))
    length_s = count * allan.tau_s[0]
    return min(std**2 * length_s / largest, float(count)) if largest > 0.0 else None


KNEE_DECADES = np.array([-8.0, -1.5, -1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 8.0])
"""(t,) decades around the knee of a limit curve: straight lines on log-log axes are within 1 %."""


def limit_curves(
    limits: Mapping[str, Mapping[str, Mapping[str, float]]],
) -> dict[str, dict[str, report.LimitCurve]]:
    """Return the Allan deviation at the limits of each grade: N^2 / tau + (2 ln 2 / pi) B^2 (IEEE Std 952).

    Parameters
    ----------
    limits : SI, by sensor, coefficient and grade.
    """
    curves: dict[str, dict[str, report.LimitCurve]] = {}
    for sensor, coefficients_of in limits.items():
        for grade, white in coefficients_of["N"].items():
            floor = (FLICKER * coefficients_of["B"][grade]) ** 2
            # the knee, where both are equal, is at tau = N^2 / floor
            tau = white**2 / floor * 10.0**KNEE_DECADES
            sigma = np.sqrt(white**2 / tau + floor)
            curve = report.LimitCurve(tau_s=_rounded(tau), sigma=_rounded(sigma))
            curves.setdefault(sensor, {})[grade] = curve
    return curves


def with_bias(
    distribution: report.Distribution,
    name: ChannelName,
    means: Mapping[ChannelName, float | None],
    fit: ChannelFit | None,
    length_s: float,
) -> report.Distribution:
    """Return the distribution with the difference of the mean from what a sensor at rest reads.

    A gyroscope at rest reads zero (the Earth turns at 7e-5 rad/s). Of an accelerometer only the length of the
    vector is known: gravity. Across gravity a bias cannot be distinguished from a tilt. Therefore only an
    axis that is nearly vertical has a bias. Its limits include the spread of gravity on Earth and the biases
    of the other axes, of which it measures the sine of its tilt. The limits are those of a mean over the
    record against the noise of as long a time, the Allan deviation at its whole length (IEEE Std 952
    annex C).

    Parameters
    ----------
    means : channel unit, of all channels by name.
    length_s : s, of the record.
    """
    mean = means[name]
    noise = None if fit is None or length_s <= 0.0 else _deviation(fit, length_s)
    sensor, extra = name.sensor, 0.0
    if mean is None or noise is None or sensor not in ("gyro", "accel"):
        return distribution
    if sensor == "accel":
        axes = [axis for channel, axis in means.items() if channel.sensor == sensor]
        length = math.hypot(*(a for a in axes if a is not None))
        # Without all three axes the length is not that of gravity; far from 1 g the sensor moves, or its unit is wrong.
        if len(axes) < 3 or None in axes or abs(length / STANDARD_GRAVITY - 1.0) > NOT_GRAVITY:
            return distribution
        cosine = (
            mean / length
        )  # of the angle between the axis and gravity; negative where the axis points down
        if abs(cosine) < NEARLY_VERTICAL:
            return replace(distribution, bias_reason="not separable from tilt")
        # A bias b of this axis changes the length of the vector by b cosine.
        mean = (length - STANDARD_GRAVITY) / cosine
        extra = GRAVITY_SPREAD + HORIZONTAL_BIAS * math.sqrt(1.0 - cosine**2)
    half = LIMIT_95 * noise + extra
    return replace(distribution, bias=mean, bias_low=mean - half, bias_high=mean + half)


def _deviation(fit: ChannelFit, tau_s: float) -> float | None:
    """Return the Allan deviation of the noise, with upper limits where there is no value; None: one is pending."""
    variance = 0.0
    if fit.markov is not None:
        size, time_s = (part.value or part.high for part in (fit.markov.sigma, fit.markov.time_constant_s))
        variance = ((size or 0.0) * COEFFICIENTS[MARKOV.sigma].deviation(tau_s, time_s)) ** 2
    for letter in NOISE:
        estimate = fit.coefficients[letter]
        size = estimate.value if estimate.value is not None else estimate.high
        if size is None:
            return None
        variance += (size * COEFFICIENTS[letter].deviation(tau_s)) ** 2
    return math.sqrt(variance)


def noise_model(sensor: str, fit: ChannelFit, rows: Ints) -> report.NoiseModel | None:
    """Return what describes the slow and the fast part of a channel; None without a fit.

    Parameters
    ----------
    rows : octaves of the curve that the report has.
    """
    if fit.highest_hz is None:
        return None
    unit = UNITS[sensor]
    units = {"drift": f"{unit}/s", "temperature": f"{unit}/degC"}
    units |= {f"temperature_{power}": f"{unit}/degC^{power}" for power in (2, 3)}
    return report.NoiseModel(
        columns=tuple(model_column(column, units.get(column.name, unit)) for column in fit.regressors),
        lines_hz=fit.lines_hz,
        vibration_hz=fit.hump_hz or (),
        vibration_mains_hz=fit.hump_mains_hz,
        oscillations_s=fit.oscillations_s,
        jumps=_jumps(fit),
        highest_hz=fit.highest_hz,
        shares={
            part: _rounded(share[rows], SHARE_DIGITS)
            for part, share in fit.shares.items()
            if part in NOISE or share[rows].any()
        },
    )


def model_column(column: RegressorEstimate, unit: str) -> report.ModelColumn:
    """Return the coefficient of a regressor as a message."""
    return report.ModelColumn(
        name=column.name,
        value=column.value,
        low=column.low,
        high=column.high,
        unit=unit,
        time_constant_s=column.time_constant_s,
    )


def step_change(step: StepEstimate) -> report.Change:
    """Return a step of the mean as a change of the bias."""
    return report.Change(
        against="time before",
        quantity="bias",
        before=step.before,
        now=step.after,
        ratio=None,
        sigma=step.sigma,
    )


def drift(
    fit: ChannelFit, begin_s: float, covered: tuple[float, float] | None, curve: BiasFit | None
) -> report.Drift | None:
    """Return slopes per hour and per degC with their limits; None without a fit."""
    time, temperature, reason = fit.regressor("drift"), fit.regressor("temperature"), fit.no_slope or None
    if time is None:
        return None
    # The curve looks at the values of the thermometer, the fit does not: without a temperature there is no slope.
    if curve is not None and curve.reason in NO_THERMOMETER:
        temperature, reason = None, curve.reason
    return report.Drift(
        per_hour=time.value * HOUR,
        per_hour_low=time.low * HOUR,
        per_hour_high=time.high * HOUR,
        # Where time and temperature move together, the slope in time may be that of the temperature.
        significant=None if fit.no_slope == "collinear" else time.sigma > SIGNIFICANT,
        begin_s=begin_s,
        reason=reason,
        temperature_min=covered[0] if covered else None,
        temperature_max=covered[1] if covered else None,
        per_degC=temperature.value if temperature else None,
        per_degC_low=temperature.low if temperature else None,
        per_degC_high=temperature.high if temperature else None,
        explained=fit.explained if temperature else None,
    )


def bias_curve(sensor: str, curve: BiasFit | None) -> report.BiasCurve | None:
    """Return the bias against the temperature as a message, with the units of its terms."""
    if curve is None:
        return None
    unit = UNITS[sensor]
    units = [unit, f"{unit}/degC"]
    return report.BiasCurve(
        reason=curve.reason,
        reference_degC=curve.reference_degC,
        terms=tuple(model_column(*pair) for pair in zip(curve.terms, units, strict=False)),
        degC=curve.degC,
        bias=curve.bias,
        low=curve.low,
        high=curve.high,
        std_without=curve.std_without,
        std_with=curve.std_with,
    )


def robust(deviation: RobustDeviation | None) -> report.Robust | None:
    """Return the robust companion of the shortest Allan deviation."""
    return None if deviation is None else report.Robust(sigma=deviation.sigma, ratio=deviation.ratio)


def correlations(axes: Sequence[str], covariance: Floats | None) -> dict[str, dict[str, float]]:
    """Return the correlation of each axis of a sensor with the others, -1 to 1, by channel.

    Parameters
    ----------
    axes : channels of the sensor, in the order of `covariance`, (a, a) (channel unit)^2.
    """
    if covariance is None or len(axes) < 2:
        return {axis: {} for axis in axes}
    std = np.sqrt(np.diagonal(covariance)).tolist()
    return {
        axis: {
            axes[column]: product / (std[row] * std[column])
            for column, product in enumerate(covariance[row].tolist())
            if column != row and std[row] > 0.0 and std[column] > 0.0
        }
        for row, axis in enumerate(axes)
    }


def histogram(shape: DistributionShape | None) -> report.Histogram | None:
    """Return the bins of a channel, at most `REPORTED_BINS`: equal numbers of neighbours are merged."""
    if shape is None:
        return None
    step = math.ceil(len(shape.counts) / REPORTED_BINS)
    starts = range(0, len(shape.counts), step)
    return report.Histogram(
        start=shape.start,
        width=shape.width * step,
        counts=tuple(sum(shape.counts[start : start + step]) for start in starts),
        gaussian=tuple(round(sum(shape.gaussian[start : start + step]), 2) for start in starts),
    )


def spectrum(sensor: str, density: PowerSpectrum, column: int) -> report.Spectrum | None:
    """Return the spectrum of one channel, at most `POINTS_PER_DECADE` points in each decade of frequency.

    Only a magnetometer senses the mains. In other sensors a line at its frequency is a machine and has no
    name.
    """
    rows = np.flatnonzero(density.averages[:, column] > 0)
    if not len(rows):
        return None
    frequency = density.frequency_hz[rows]
    power, averages = density.density[rows, column], density.averages[rows, column]
    positive = frequency > 0.0
    # Neighbours that share a part of a decade are one point: their mean, and the sum of their averages. Frequencies
    # rise, so the points begin where the part changes. 1.0 stands for a frequency of 0, which has no logarithm.
    bins = np.floor(np.log10(np.where(positive, frequency, 1.0)) * POINTS_PER_DECADE).astype(np.int64)
    starts = np.flatnonzero(np.diff(bins, prepend=bins[0] - 1))
    sizes = np.append(starts[1:], len(bins)) - starts
    lines = tuple(
        report.Line(
            frequency_hz=line.frequency_hz,
            amplitude=line.amplitude,
            aliases_hz=line.aliases_hz,
            name=line.name if sensor == "mag" else None,
        )
        for line in density.lines[column]
    )
    return report.Spectrum(
        frequency_hz=_rounded(np.add.reduceat(frequency, starts) / sizes),
        density=_rounded(np.add.reduceat(power, starts) / sizes),
        averages=tuple(np.add.reduceat(averages, starts).tolist()),
        lines=lines,
        white=_finite(float(density.white[column])),
    )


def signals(
    names: Sequence[ChannelName], envelope: Envelope, interval_s: float
) -> dict[str, Callable[[], report.Signal]]:
    """Return what makes the signal view of each channel as it is now: of the last minute, the last hour, everything.

    The columns are copies, which another thread may use: it makes a message only where somebody asks for one.
    """
    strips = envelope.minute(), envelope.hour(), envelope.everything()
    return {name: partial(_signal, name, strips, column, interval_s) for column, name in enumerate(names)}


def _signal(
    name: ChannelName, strips: Sequence[EnvelopeColumns], column: int, interval_s: float
) -> report.Signal:
    """Return the signal view of one channel."""
    minute, hour, everything = (_strip(columns, column, interval_s) for columns in strips)
    return report.Signal(
        channel=name,
        unit=UNITS[name.sensor],
        minute=minute,
        hour=hour,
        everything=everything,
    )


def _strip(columns: EnvelopeColumns, column: int, interval_s: float) -> report.Strip:
    """Return minimum and maximum per time column of one channel, in seconds."""
    return report.Strip(
        start_s=columns.start * interval_s,
        column_s=columns.width * interval_s,
        low=tuple(_finite(v, SIGNAL_DIGITS) for v in columns.low[:, column].tolist()),
        high=tuple(_finite(v, SIGNAL_DIGITS) for v in columns.high[:, column].tolist()),
    )


def _finite(value: float, digits: int | None = None) -> float | None:
    """Return a finite number, rounded to `digits` significant digits if given; None for any other."""
    if not math.isfinite(value):
        return None
    return value if digits is None else float(f"{value:.{digits}g}")


def _rounded(values: Floats, digits: int = CURVE_DIGITS) -> tuple[float, ...]:
    """Return (k,) numbers with some significant digits."""
    return tuple(float(f"{v:.{digits}g}") for v in values.tolist())


def _positive(values: Floats) -> tuple[float | None, ...]:
    """Return (k,) numbers, with None for 0.0, which means "none" in a fit."""
    return tuple(v if v > 0.0 else None for v in values.tolist())


LIMIT_CURVES = limit_curves(LIMITS)
"""Allan deviation at the limits of each grade of `imumon.model.grading`."""
