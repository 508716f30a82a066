"""Results of the mathematics in the words of the report.

Each function turns one result into one part of `imumon.report`; nothing is computed here but unit factors.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np

from imumon import report
from imumon.noise.allan import AllanCurve
from imumon.noise.fit import ChannelFit
from imumon.noise.grading import LIMITS, grade_channel, grade_sensor
from imumon.noise.nonstationarity.change import Change
from imumon.noise.nonstationarity.drift import Step, Trend
from imumon.noise.nonstationarity.mean_covariance import MeanCovariance
from imumon.noise.statistics.envelope import Columns
from imumon.noise.statistics.envelope import Envelope as Strips
from imumon.noise.statistics.histogram import DistributionShape
from imumon.noise.statistics.moments import ChannelMoments
from imumon.noise.statistics.psd import Density
from imumon.samples import UNITS, Floats, sensor_of
from imumon.units import HOUR, READABLE, SI, STANDARD_GRAVITY

VERTICAL = 0.95
"""Share of gravity that an axis must carry for the length of the vector to say something of its bias."""

GRAVITY_SPREAD = 0.027
"""m/s^2 by which gravity at sea level differs from the standard one at most, equator and poles."""

OTHER_BIAS = 0.05
"""m/s^2 that the axes beside the vertical one are taken to be wrong by at most: 5 mg."""

BINS_SHOWN = 64
POINTS_A_DECADE = 24


class Estimated(Protocol):
    """A coefficient as the fit gives it, SI."""

    @property
    def value(self) -> float | None: ...
    @property
    def low(self) -> float | None: ...
    @property
    def high(self) -> float | None: ...
    @property
    def status(self) -> report.Status: ...
    @property
    def reason(self) -> str | None: ...


def coefficient(sensor: str, name: str, estimate: Estimated) -> report.Coefficient:
    """N, B or K of a channel in SI and in readable units."""
    shown = READABLE[sensor, name]

    def scaled(value: float | None) -> float | None:
        return None if value is None else value * shown.factor

    return report.Coefficient(
        value=estimate.value,
        low=estimate.low,
        high=estimate.high,
        status=estimate.status,
        unit=SI[sensor, name],
        reason=estimate.reason,
        readable=report.Readable(
            value=scaled(estimate.value),
            low=scaled(estimate.low),
            high=scaled(estimate.high),
            unit=shown.unit,
        ),
    )


def allan(curve: AllanCurve, column: int, fit: ChannelFit) -> report.Allan:
    """The curve of one channel, with every octave that has a difference."""
    rows = np.flatnonzero(curve.terms[:, column] > 0)
    return report.Allan(
        tau_s=numbers(curve.tau[rows]),
        sigma=numbers(curve.sigma[rows, column]),
        low=known(fit.low[rows]),
        high=known(fit.high[rows]),
        edf=known(fit.edf[rows]),
        model=known(fit.model[rows]),
        used=tuple(bool(u) for u in fit.used[rows]),
    )


def channel_grade(sensor: str, fit: ChannelFit) -> report.ChannelGrade:
    """Grades of one channel's N and B."""
    found = grade_channel(sensor, N=fit.N, B=fit.B)
    return report.ChannelGrade(
        N=report.Grading(nearest=found.N.nearest, meets=found.N.meets),
        B=report.Grading(nearest=found.B.nearest, meets=found.B.meets),
        nearest=found.nearest,
        meets=found.meets,
    )


def sensor_grade(sensor: str, fits: Mapping[str, ChannelFit]) -> report.SensorGrade:
    """Headline of a sensor from the fits of its axes."""
    found = grade_sensor(sensor, {axis: {"N": f.N, "B": f.B} for axis, f in fits.items()})
    return report.SensorGrade(
        nearest=found.nearest,
        meets=found.meets,
        decided_by=report.DecidedBy(axis=found.decided_by.axis, coefficient=found.decided_by.coefficient)
        if found.decided_by
        else None,
        provisional=found.provisional,
        reason=found.reason,
    )


def running(
    channel: report.Channel,
    running: ChannelMoments,
    *,
    distribution: report.Distribution,
    grade: report.ChannelGrade | None,
    changes: tuple[report.Change, ...],
    caveats: tuple[str, ...],
) -> report.Channel:
    """The same with what is of this moment: its running statistics, and what they mean."""
    return replace(
        channel,
        distribution=distribution,
        grade=grade,
        changes=changes,
        caveats=caveats,
        count=running.count,
        mean=running.mean,
        std=running.std,
        min=running.min,
        max=running.max,
        skewness=running.skewness,
        excess_kurtosis=running.excess_kurtosis,
        last=running.last,
    )


def with_fit(
    channel: report.Channel, sensor: str, curve: AllanCurve, column: int, fit: ChannelFit
) -> report.Channel:
    """The same with curve, coefficients and grade."""
    return replace(
        channel,
        N=coefficient(sensor, "N", fit.N),
        B=coefficient(sensor, "B", fit.B),
        K=coefficient(sensor, "K", fit.K),
        grade=channel_grade(sensor, fit) if sensor in LIMITS else None,
        readings=report.Readings(N=fit.readings.N, B=fit.readings.B, K=fit.readings.K),
        time_to=report.TimeTo(N=fit.time_to.N, B=fit.time_to.B, K=fit.time_to.K),
        fit=report.FitQuality(chi2=fit.chi2, dof=fit.dof, p_value=fit.p_value),
        allan=allan(curve, column, fit),
    )


class Bias(NamedTuple):
    """Mean less what a sensor at rest reads, channel unit, with its 95 % limits; or why there is none."""

    value: float | None = None
    low: float | None = None
    high: float | None = None
    reason: str | None = None


def distribution(
    shape: DistributionShape | None,
    recent: tuple[float, float],
    bias: Bias,
    correlation: Mapping[str, float],
    effective_samples: float | None,
) -> report.Distribution:
    """Shape of a channel's values, beside its last minute, its bias and the sensor's other axes.

    Parameters
    ----------
    recent : channel unit, mean and deviation of the last minute; NaN where unknown.
    """
    return report.Distribution(
        verdict=shape.verdict if shape else None,
        gaussian=shape.is_gaussian if shape else None,
        modes=shape.modes if shape else (),
        recent_mean=number(recent[0]),
        recent_std=number(recent[1]),
        bias=bias.value,
        bias_low=bias.low,
        bias_high=bias.high,
        bias_reason=bias.reason,
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
    for sensor, of in limits.items():
        for grade, white in of["N"].items():
            floor = 2.0 * math.log(2.0) / math.pi * of["B"][grade] ** 2
            tau = white**2 / floor * 10.0**KNEE_DECADES
            sigma = np.sqrt(white**2 / tau + floor)
            curve = report.LimitCurve(tau_s=rounded(tau), sigma=rounded(sigma))
            curves.setdefault(sensor, {})[grade] = curve
    return curves


def bias(name: str, means: Mapping[str, float | None], fit: ChannelFit | None, length_s: float) -> Bias:
    """The mean of a channel against what a sensor at rest reads, and its 95 % limits.

    A gyroscope at rest reads zero (the Earth turns at 7e-5 rad/s). Of an accelerometer only the length of
    the vector is known, that of gravity, and its excess speaks for the direction of gravity alone: across it
    a bias looks as a tilt does. So only an axis that is nearly vertical has one, as far as the gravity of the
    place and the other axes' biases, of which it sees the sine of its tilt, leave it known. The limits are
    those of a mean over the record against the noise of as long a time, the Allan deviation at its whole
    length (IEEE Std 952 annex C), with what is not known added to them.

    Parameters
    ----------
    means : channel unit, of all channels by name.
    length_s : s, of the record.
    """
    mean = means[name]
    wander = None if fit is None else MeanCovariance.of(fit)
    sensor, unknown = sensor_of(name), 0.0
    if mean is None or wander is None or length_s <= 0.0 or sensor not in ("gyro", "accel"):
        return Bias()
    if sensor == "accel":
        axes = [axis for channel, axis in means.items() if sensor_of(channel) == sensor]
        length = math.hypot(*(a for a in axes if a is not None))
        if len(axes) < 3 or None in axes or not 0.5 < length / STANDARD_GRAVITY < 2.0:
            return Bias()
        upright = mean / length
        if abs(upright) < VERTICAL:
            return Bias(reason="cannot be told from tilt")
        mean = (length - STANDARD_GRAVITY) / upright
        unknown = GRAVITY_SPREAD + OTHER_BIAS * math.sqrt(1.0 - upright**2)
    flicker = 2.0 * math.log(2.0) / math.pi
    variance = wander.N**2 / length_s + flicker * wander.B**2 + wander.K**2 * length_s / 3.0
    half = 1.96 * math.sqrt(variance) + unknown
    return Bias(mean, mean - half, mean + half)


def drift(sensor: str, trend: Trend | None, steady: ChannelFit | None) -> report.Drift | None:
    """Slopes per hour and per degree with their limits, and the noise at a steady temperature."""
    if trend is None:
        return None
    time, heat = trend.time, trend.temperature
    return report.Drift(
        per_hour=time.value * HOUR,
        per_hour_low=time.low * HOUR,
        per_hour_high=time.high * HOUR,
        significant=time.significant,
        per_degC=heat.value if heat else None,
        per_degC_low=heat.low if heat else None,
        per_degC_high=heat.high if heat else None,
        explained=trend.explained if heat else None,
        steady_N=coefficient(sensor, "N", steady.N) if steady else None,
        steady_B=coefficient(sensor, "B", steady.B) if steady else None,
        steady_K=coefficient(sensor, "K", steady.K) if steady else None,
    )


def change(found: Change, against: str) -> report.Change:
    """A change of N, B or bias."""
    return report.Change(
        against=against,
        quantity=found.quantity,
        before=found.before,
        now=found.now,
        ratio=found.ratio,
        sigma=found.sigma,
    )


def step(found: Step) -> report.Change:
    """A sudden change of the bias."""
    return report.Change(
        against="time before",
        quantity="bias",
        before=found.before,
        now=found.behind,
        ratio=None,
        sigma=found.sigma,
    )


def sentence(channel: str, found: report.Change) -> str:
    """A change in words: ``gyro/x: N has grown by 40 % against the baseline``."""
    against = f"against the {found.against}"
    if found.ratio is None:
        return f"{channel}: the bias has moved from {found.before:.3g} to {found.now:.3g} {against}"
    verb = "grown" if found.ratio > 1.0 else "fallen"
    return f"{channel}: {found.quantity} has {verb} by {abs(found.ratio - 1.0):.0%} {against}"


def correlations(axes: Sequence[str], covariance: Floats | None) -> dict[str, dict[str, float]]:
    """Correlation of each axis of a sensor with the others, -1 to 1, by their names.

    Parameters
    ----------
    axes : channels of the sensor, in the order of `covariance`, (a, a) (channel unit)^2.
    """
    if covariance is None or len(axes) < 2:
        return {axis: {} for axis in axes}
    spread = np.sqrt(np.diagonal(covariance)).tolist()
    return {
        axis: {
            other: common / (mine * its)
            for other, its, common in zip(axes, spread, row, strict=True)
            if other != axis and mine > 0.0 and its > 0.0
        }
        for axis, mine, row in zip(axes, spread, covariance.tolist(), strict=True)
    }


def histogram(shape: DistributionShape | None) -> report.Histogram | None:
    """Bins of a channel, at most `BINS_SHOWN`: neighbours are put together in equal numbers."""
    if shape is None:
        return None
    step = -(-len(shape.counts) // BINS_SHOWN)
    return report.Histogram(
        start=shape.start,
        width=shape.width * step,
        counts=tuple(sum(shape.counts[at : at + step]) for at in range(0, len(shape.counts), step)),
        gaussian=tuple(
            round(sum(shape.gaussian[at : at + step]), 2) for at in range(0, len(shape.gaussian), step)
        ),
    )


def spectrum(sensor: str, density: Density, column: int) -> report.Spectrum | None:
    """Spectrum of one channel, `POINTS_A_DECADE` points at most in each decade of frequency.

    Only a magnetometer hears the mains: elsewhere a line at their place is a machine, and goes unnamed.
    """
    rows = np.flatnonzero(density.averages[:, column] > 0)
    if not len(rows):
        return None
    frequency = density.frequency_hz[rows]
    power, averages = density.density[rows, column], density.averages[rows, column]
    positive = frequency > 0.0
    bins = np.floor(np.log10(np.where(positive, frequency, 1.0)) * POINTS_A_DECADE).astype(np.int64)
    starts = np.flatnonzero(np.diff(bins, prepend=bins[0] - 1))
    ends = np.append(starts[1:], len(bins))
    white = number(float(density.white[column]))
    return report.Spectrum(
        frequency_hz=rounded(np.add.reduceat(frequency, starts) / (ends - starts)),
        density=rounded(np.add.reduceat(power, starts) / (ends - starts)),
        averages=tuple(int(n) for n in np.add.reduceat(averages, starts)),
        lines=tuple(
            report.Line(
                frequency_hz=line.frequency_hz,
                amplitude=line.amplitude,
                aliases_hz=line.aliases_hz,
                name=line.name if sensor == "mag" else None,
            )
            for line in density.lines[column]
        ),
        white=white,
    )


def signal(name: str, strips: Strips, column: int, interval_s: float) -> report.Signal:
    """What a signal view draws of one channel."""
    return report.Signal(
        channel=name,
        unit=UNITS[sensor_of(name)],
        minute=strip(strips.minute(), column, interval_s),
        hour=strip(strips.hour(), column, interval_s),
        everything=strip(strips.everything(), column, interval_s),
    )


def strip(columns: Columns, column: int, interval_s: float) -> report.Strip:
    """Least and greatest values of one channel, in seconds."""
    return report.Strip(
        start_s=columns.start * interval_s,
        column_s=columns.width * interval_s,
        low=tuple(drawn(v) for v in columns.low[:, column]),
        high=tuple(drawn(v) for v in columns.high[:, column]),
    )


def drawn(value: float) -> float | None:
    """Finite number with the digits that a drawing needs, or None."""
    return float(f"{value:.8g}") if math.isfinite(value) else None


def number(value: float) -> float | None:
    """Finite number, or None."""
    return float(value) if math.isfinite(value) else None


def numbers(values: Floats) -> tuple[float, ...]:
    """(k,) numbers as they are, all finite."""
    return tuple(float(v) for v in values)


def rounded(values: Floats) -> tuple[float, ...]:
    """(k,) numbers for drawing: five digits keep the message small."""
    return tuple(float(f"{v:.5g}") for v in values)


def known(values: Floats) -> tuple[float | None, ...]:
    """(k,) numbers, and None for the 0.0 that stands for "none" in the mathematics."""
    return tuple(float(v) if v > 0.0 else None for v in values)
