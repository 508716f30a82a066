"""Results of the mathematics in the words of the report.

Each function turns one result into one part of `imumon.report`; nothing is computed here but unit factors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Protocol

import numpy as np

from imumon import report
from imumon.noise.allan import AllanCurve
from imumon.noise.fit import ChannelFit
from imumon.noise.grade import LIMITS, grade_channel, grade_sensor
from imumon.noise.moments import ChannelMoments
from imumon.samples import UNITS, Floats, sensor_of
from imumon.units import READABLE, SI


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


def channel(
    name: str,
    column: int,
    running: ChannelMoments,
    curve: AllanCurve,
    fit: ChannelFit | None,
    caveats: tuple[str, ...],
) -> report.Channel:
    """Everything the report says of one channel.

    Parameters
    ----------
    fit : None for a channel without an Allan curve.
    caveats : those that hold for the whole record.
    """
    sensor = sensor_of(name)
    whole = report.Channel(
        unit=UNITS[sensor],
        count=running.count,
        mean=running.mean,
        std=running.std,
        min=running.min,
        max=running.max,
        skewness=running.skewness,
        excess_kurtosis=running.excess_kurtosis,
        last=running.last,
    )
    if fit is None:
        return whole
    return replace(
        whole,
        N=coefficient(sensor, "N", fit.N),
        B=coefficient(sensor, "B", fit.B),
        K=coefficient(sensor, "K", fit.K),
        grade=channel_grade(sensor, fit) if sensor in LIMITS else None,
        readings=report.Readings(N=fit.readings.N, B=fit.readings.B, K=fit.readings.K),
        time_to=report.TimeTo(N=fit.time_to.N, B=fit.time_to.B, K=fit.time_to.K),
        fit=report.FitQuality(chi2=fit.chi2, dof=fit.dof, p_value=fit.p_value),
        caveats=tuple(dict.fromkeys((*caveats, *fit.caveats))),
        allan=allan(curve, column, fit),
    )


def numbers(values: Floats) -> tuple[float, ...]:
    return tuple(float(v) for v in values)


def known(values: Floats) -> tuple[float | None, ...]:
    """Numbers, and None for the 0.0 that stands for "none" in the mathematics."""
    return tuple(float(v) if v > 0.0 else None for v in values)
