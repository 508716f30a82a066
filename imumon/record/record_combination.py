"""Combination of the reports of several records of one sensor: N, B, K and M of the sensor, not of one day.

A record gives the coefficients of its hours with limits of its statistics. The sensor of tomorrow differs by more: its
coefficients vary from record to record. `noise.uncertainty.of_records` has the mean and its limits, which hold this
scatter. Rates and lengths of the records may differ, because a coefficient does not depend on them.

- Measured in every record: the mean of the logarithms.
- Measured in half of the records or more: the mean of these. A bound above it says nothing; one below it shows that the
  sensor varies, and counts as half of itself, within a factor of two (95 %).
- Measured in fewer: chance, or the day, made it large in those. The largest of their limits is a bound.
- Bounded in all: the geometric mean of the bounds. If each holds, it is a bound of the mean.
- Pending in a record: that record says nothing of it.

M is stated if every record shows it. A drift, a curve and a spectrum belong to their record: a combination has none.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import datetime

from imumon.model.coefficients import LIMIT_95, NOISE, NOT_WHITE, Estimate, MarkovEstimate
from imumon.model.errors import ImumonError
from imumon.model.grading import LIMITS, grade_sensor
from imumon.model.ledger import merged
from imumon.model.report import Channel, Report, SensorGrade, SessionCounters, stamp
from imumon.model.samples import INERTIAL, ChannelName
from imumon.noise.uncertainty import of_records
from imumon.record import report_builder
from imumon.record.combined_limits import shared_share

HALF_BOUND_ERROR = math.log(2.0) / LIMIT_95
"""1, standard error of the logarithm of half a bound: the bound itself is its upper 95 % limit."""

LEAST_ERROR = 1e-6
"""1, least standard error of a logarithm: a saved report rounds its limits."""

ADDED = ("elapsed_s", "samples", "missing", "gaps", "discarded_bytes", "bad_checksums", "disturbances", "excluded_s",
         "warmup_s", "duplicates", "received_bytes")  # fmt: skip
"""Counters of the session that add up."""


def combined_report(reports: Sequence[Report], now: datetime) -> Report:
    """Return the report of one sensor from the reports of at least two of its records.

    Raises
    ------
    ImumonError : they are of different sensors, or have no channel in common.
    """
    _check_one_sensor(reports)
    names = _common_channels(reports)
    channels = {name: _channel(name, reports) for name in names}
    first = reports[0]
    return Report(
        time=stamp(now),
        device=replace(
            first.device,
            port=None,
            sample_rate_hz=_common(report.device.sample_rate_hz for report in reports),
            remarks=tuple(_remarks(reports, channels)),
        ),
        state="stopped",
        session=_session(reports),
        grade=_grades(channels),
        channels=channels,
        caveats=tuple(dict.fromkeys(caveat for report in reports for caveat in report.caveats)),
        limits=LIMITS,
        limit_curves=first.limit_curves,
        precision=first.precision,
        alarm_limits=first.alarm_limits,
    )


def _check_one_sensor(reports: Sequence[Report]) -> None:
    """Raise `ImumonError` if there are fewer than two reports, or two serial numbers; a report may lack its own."""
    if len(reports) < 2:
        raise ImumonError(
            "too_few_records", "a combination needs two records", "give two or more of one sensor"
        )
    serials = {report.device.serial for report in reports if report.device.serial}
    if len(serials) > 1:
        text = f"the records are of different sensors: {', '.join(sorted(serials))}"
        raise ImumonError(
            "different_sensors", text, "combine records of one sensor, and compare those of several"
        )


def _common_channels(reports: Sequence[Report]) -> list[ChannelName]:
    """Return the channels that have coefficients in all reports, in the order of the first one.

    Raises
    ------
    ImumonError : there is none.
    """
    names = [name for name in reports[0].channels if all(name in report.channels for report in reports)]
    names = [name for name in names if all(r.channels[name].coefficients for r in reports)]
    if not names:
        raise ImumonError(
            "no_common_channel", "no channel is in all records", "combine records of the same sensor"
        )
    return names


def _grades(channels: Mapping[ChannelName, Channel]) -> dict[str, SensorGrade]:
    """Return the grade of each inertial sensor that has channels."""
    sensors = [s for s in INERTIAL if any(name.sensor == s for name in channels)]
    return {
        sensor: grade_sensor(
            sensor,
            {n.axis: c.coefficients for n, c in channels.items() if n.sensor == sensor},
        )
        for sensor in sensors
    }


def _channel(name: ChannelName, reports: Sequence[Report]) -> Channel:
    """Return the combination of a channel."""
    parts = [report.channels[name] for report in reports]
    letters = [*NOISE, *(["Q"] if all("Q" in part.coefficients for part in parts) else [])]
    coefficients = {}
    for letter in letters:
        estimates = [part.coefficients[letter] for part in parts if letter in part.coefficients]
        shared = max(shared_share(report, name, letter) for report in reports)
        coefficients[letter] = combined_estimate(estimates, shared)
        # what is not white in one record has no grade in all of them
        if any(part.reason_code == NOT_WHITE for part in estimates):
            coefficients[letter] = replace(coefficients[letter], reason_code=NOT_WHITE)
    sensor = name.sensor
    return Channel(
        unit=parts[0].unit,
        count=sum(part.count for part in parts),
        mean=_mean(parts),
        min=min((part.min for part in parts if part.min is not None), default=None),
        max=max((part.max for part in parts if part.max is not None), default=None),
        coefficients=coefficients,
        M=_correlated_noise(parts),
        grade=report_builder.channel_grade(sensor, coefficients),
        caveats=tuple(dict.fromkeys(caveat for part in parts for caveat in part.caveats)),
    )


def _mean(parts: Sequence[Channel]) -> float | None:
    """Return the mean of all samples of a channel; None if there is no sample, or a record has no mean."""
    count = sum(part.count for part in parts)
    weighted = [part.mean * part.count for part in parts if part.mean is not None]
    return sum(weighted) / count if count and len(weighted) == len(parts) else None


def _correlated_noise(parts: Sequence[Channel]) -> MarkovEstimate | None:
    """Return the combination of the correlated noise M of a channel; None unless every record shows it."""
    shown = [part.M for part in parts if part.M is not None]
    if len(shown) < len(parts):
        return None
    sigma = combined_estimate([part.sigma for part in shown])
    time = combined_estimate([part.time_constant_s for part in shown])
    return MarkovEstimate(sigma=sigma, time_constant_s=time)


def combined_estimate(estimates: Sequence[Estimate], systematic: float = 0.0) -> Estimate:
    """Return the coefficient of a sensor from those of its records.

    Parameters
    ----------
    systematic : 1, standard uncertainty that the records share, a share of the value.
    """
    unit = estimates[0].unit
    known = [part for part in estimates if part.status != "pending"]
    if not known:
        return replace(estimates[0], combined_low=None, combined_high=None, scatter=None, excess=None)
    measured = [part for part in known if part.status == "measured" and part.value]
    if not measured:
        return _mean_bound(known)
    if 2 * len(measured) < len(known):
        return _bound_of_few(measured, len(known), unit)
    pairs = _values_and_errors(known, measured)
    if len(pairs) == 1:
        only = measured[0]
        return replace(only, reason="the other records do not show it: the limits are of one record")
    mean = of_records([value for value, _ in pairs], [error for _, error in pairs], systematic)
    return Estimate(
        value=mean.value,
        low=mean.low,
        high=mean.high,
        combined_low=mean.combined_low,
        combined_high=mean.combined_high,
        status="measured",
        unit=unit,
        scatter=mean.scatter * mean.value,
        dof=mean.dof,
    )


def _mean_bound(known: Sequence[Estimate]) -> Estimate:
    """Return the geometric mean of the bounds of records none of which has a value."""
    high = math.exp(sum(math.log(part.stated.high or math.inf) for part in known) / len(known))
    indistinct = next((part for part in known if part.status == "indistinct"), None)
    bound = replace(indistinct or known[0], low=0.0, high=high, combined_low=0.0, combined_high=high)
    return replace(bound, value=None, scatter=None, excess=None)


def _bound_of_few(measured: Sequence[Estimate], records: int, unit: str) -> Estimate:
    """Return the bound of what fewer than half of the records show: the largest of their limits."""
    high = max(part.stated.high or math.inf for part in measured)
    reason = f"{len(measured)} of {records} records show it"
    bound = Estimate(low=0.0, high=high, combined_low=0.0, combined_high=high, unit=unit, reason=reason)
    return replace(bound, status="upper_bound")


def _values_and_errors(known: Sequence[Estimate], measured: Sequence[Estimate]) -> list[tuple[float, float]]:
    """Return values with the standard errors of their logarithms: the measured, then of each bound below them half."""
    pairs = [(part.value, _error(part)) for part in measured if part.value]
    middle = math.exp(sum(math.log(value) for value, _ in pairs) / len(pairs))
    lower = [part.high for part in known if part not in measured and part.high and part.high < middle]
    return pairs + [(high / 2.0, HALF_BOUND_ERROR) for high in lower]


def _error(part: Estimate) -> float:
    """Return the standard error of the logarithm of a measured coefficient by the statistics of its record."""
    if part.low and part.high and part.value:
        return max(math.log(part.high / part.low) / (2.0 * LIMIT_95), LEAST_ERROR)
    # a lower limit of 0: the upper one alone shows the width
    return max(
        math.log((part.high or 2.0 * (part.value or 1.0)) / (part.value or 1.0)) / LIMIT_95, LEAST_ERROR
    )


def _session(reports: Sequence[Report]) -> SessionCounters:
    """Return the sums of the counters of all records."""
    sums = {name: sum(getattr(report.session, name) for report in reports) for name in ADDED}
    by: dict[str, float] = {}
    for report in reports:
        for reason, seconds in report.session.excluded_by.items():
            by[reason] = by.get(reason, 0.0) + seconds
    started = [report.session.started for report in reports if report.session.started]
    ledger = merged(*(report.session.ledger for report in reports))
    return SessionCounters(started=min(started, default=None), excluded_by=by, ledger=ledger, **sums)


def _remarks(reports: Sequence[Report], channels: dict[ChannelName, Channel]) -> Iterable[str]:
    """Yield what was combined, and what of it no combination has."""
    rates = sorted({report.device.sample_rate_hz for report in reports if report.device.sample_rate_hz})
    listed = " and ".join(f"{rate:g} Hz" for rate in rates)
    each = f"combination of {len(reports)} records{f' at {listed}' if listed else ''}"
    yield f"{each}: the limits hold their scatter, and there is no curve"
    if len({report.device.stream for report in reports}) > 1:
        yield "the records are of different streams, whose noise may differ"
    for name in channels:
        shown = sum(report.channels[name].M is not None for report in reports)
        if 0 < shown < len(reports):
            yield f"{shown} of {len(reports)} records show correlated noise (M) of {name}: it is not stated"
    yield from dict.fromkeys(remark for report in reports for remark in report.device.remarks)


def _common(values: Iterable[float | None]) -> float | None:
    """Return the value that all have; None if they differ."""
    seen = set(values)
    return seen.pop() if len(seen) == 1 else None
