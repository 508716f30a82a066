"""Numbers for filters with their comments: what the settings of other software are made of.

Rules: `white` is N, `walk` is the random walk of `filter_report`: the smallest that keeps a Kalman filter consistent
up to the horizon. It covers B, K and M together, where a program has no state for correlated noise. Where a
program takes one number for three axes, the worst axis decides. A coefficient that the record does not show counts
with half its 95 % upper bound. A setting is a comment with this bound unless every axis is measured, and a comment
without a number where not even a bound is known. Every number carries its unit, where it comes from, its factor
against plain K, and the length of the record. Every caveat comes first. No margin for the vehicle is added.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass

from imumon.documents.report_texts import (
    SENSOR_TITLES,
    filter_warning,
    record_title,
    sensor_axes,
    sensor_title,
)
from imumon.model.coefficients import MARKOV, NOISE, Estimate
from imumon.model.filter_report import FIX_WORDS, FilterReport
from imumon.model.messages import (
    FILTER_NOT_KNOWN,
    caveats,
    joined,
    line,
    no_value_text,
)
from imumon.model.readiness import USUAL_RECORD_S
from imumon.model.report import Report
from imumon.model.samples import INERTIAL, ChannelName
from imumon.model.units import duration, figures

NAMES = {sensor: SENSOR_TITLES[sensor].lower() for sensor in INERTIAL}
MEANINGS = {"N": "white noise density", "K": "random walk of the bias"}
CURES = {
    "constant": "find out why it is dead or stuck, and record again",
    "resolution": "record with more digits, or a finer range",
    "excluded": "keep the sensor still, or correct the unit of its columns, and record again",
}
"""What to do about a coefficient that more data will not give, by its `reason_code`."""

BOUNDED = "does not show in this record: it counts with half its 95 % upper bound"
"""Comment after a number that rests on a bound."""
INDISTINCT = "does not show apart from B or M in this record: it counts with half its 95 % upper bound"
"""Comment after a walk that rests on coefficients which the record does not separate."""


@dataclass(frozen=True, slots=True)
class FilterValue:
    """A number for a filter: of one axis, or the largest of three."""

    value: float | None  # SI, None if it is unknown for every axis
    lines: tuple[str, ...]  # comments: meaning, unit and origin of the value, and every axis
    bound: str = ""  # what the value rests on if it is not measured; else empty


def axis_values(report: Report, filters: FilterReport, sensor: str, letter: str) -> dict[str, float]:
    """Return white noise ("N") or walk ("K") of the axes where it is known, SI."""
    values = {}
    for axis, channel in sensor_axes(report, sensor):
        parameters = filters.channels.get(ChannelName(f"{sensor}/{axis}"))
        if letter == "K":
            size = parameters.walk if parameters is not None else None
        else:
            n = channel.coefficients.get("N")
            size = n.size if n is not None else None
        if size is not None:
            values[axis] = size
    return values


def worst_axis(report: Report, filters: FilterReport, sensor: str, letter: str) -> FilterValue:
    """Return the white noise ("N") or walk ("K") of a sensor for a setting that takes one number."""
    parts = {
        axis: channel.coefficients[letter]
        for axis, channel in sensor_axes(report, sensor)
        if letter in channel.coefficients
    }
    values = axis_values(report, filters, sensor, letter)
    title = f"{NAMES[sensor]} {'N' if letter == 'N' else 'walk'}, {MEANINGS[letter]}"
    if not values:
        return FilterValue(None, (f"{title}: {_unknown(sensor, parts)}; do not guess",))
    axis = max(values, key=lambda name: values[name])
    lines = [f"{title}, {parts[axis].unit}; worst axis {axis}"]
    if letter == "N":
        lines += [f"  {name}: {value_text(part)}" for name, part in parts.items()]
        lines.append(f"  N of the fit; rests on {_rests_on(report)}")
    else:
        lines += [
            f"  {name}: {_walk_text(report, filters, ChannelName(f'{sensor}/{name}'))}" for name in parts
        ]
        lines += [
            f"  from {_origin(filters, sensor)}: the smallest with NEES <= 1.25 "
            f"for 1 to {filters.horizon_s:g} s without a fix;",
            f"  rests on {_rests_on(report)}",
        ]
    return FilterValue(values[axis], tuple(lines), bound_text(letter, {axis: parts[axis], **parts}))


def bound_text(letter: str, axes: Mapping[str, Estimate]) -> str:
    """Return what a number for some axes rests on where a coefficient is not measured; empty if all are."""
    for axis, part in axes.items():
        if part.status == "measured":
            continue
        if part.high is None:
            return f"{letter} of {axis} is not known"
        text = INDISTINCT if part.status == "indistinct" else BOUNDED
        return f"{letter} of {axis} {text}, {part.stated.high:.3e}"
    return ""


def _origin(filters: FilterReport, sensor: str) -> str:
    """Return the coefficients that the walks of a sensor are made from."""
    channels = [channel for name, channel in filters.channels.items() if name.sensor == sensor]
    letters = [*NOISE, *([MARKOV.sigma] if any(channel.markov is not None for channel in channels) else [])]
    return f"{', '.join(letters[:-1])} and {letters[-1]}"


def _walk_text(report: Report, filters: FilterReport, name: ChannelName) -> str:
    """Return the walk of a channel, its factor against K, and K."""
    part, parameters = report.channels[name].coefficients.get("K"), filters.channels.get(name)
    if parameters is None or part is None:
        return f"not known: {' or '.join(NOISE)} is unknown"
    if parameters.walk_factor is None:
        k = parameters.assumed.K
        share = f"{figures(parameters.walk / k, 2)} times" if k > 0.0 else "made for"
        text = f"{parameters.walk:.4e}, {share} K {k:.3e}: half its bound, K {value_text(part)}"
    else:
        text = f"{parameters.walk:.4e}, {figures(parameters.walk_factor, 2)} times K {value_text(part)}"
    markov = parameters.markov
    if markov is None:
        return text
    return f"{text}; with M {markov.sigma:.3e}, {figures(markov.time_constant_s)} s"


def _rests_on(report: Report) -> str:
    """Return the length of the record, and what of it counts."""
    session = report.session
    excluded = session.excluded_s + session.warmup_s
    length = f"{duration(session.elapsed_s)} of record"
    return f"{length}, {duration(excluded)} of them excluded" if excluded else length


def _unknown(sensor: str, parts: Mapping[str, Estimate]) -> str:
    """Return why no axis has even a bound, and what to do."""
    if not parts:
        return f"the record holds no {NAMES[sensor]}; make one that does"
    for part in parts.values():
        if part.reason_code in CURES:
            return f"will not be known ({no_value_text(part)}); {CURES[part.reason_code]}"
    reason = next((part.reason for part in parts.values() if part.reason), "too few samples")
    return f"not known yet ({reason}); record longer"


def value_text(part: Estimate) -> str:
    """Return a coefficient with the limits that documents state."""

    def value(value: float, low: float | None, high: float | None) -> str:
        limits = "" if low is None or high is None else f" (95 %: {low:.3e} to {high:.3e})"
        return f"{value:.4e}{limits}"

    pending = no_value_text(part) or "not known yet"
    seen = "not seen" if part.status == "upper_bound" else part.reason
    return part.stated.text(value, lambda high: f"< {high:.3e} (95 %), {seen}", pending, indistinct="")


def settings_header(report: Report, filters: FilterReport) -> list[str]:
    """Return the comments in front of every format: sensor, record, horizon and caveats."""
    excluded = report.session.excluded_s + report.session.warmup_s
    lines = [
        f"{sensor_title(report)}: noise at rest, measured by imumon, {report.time}",
        f"{record_title(report)}, {duration(excluded) if excluded else 'nothing'} excluded",
        f"walks for at most {filters.horizon_s:g} s without a fix: imumon report --horizon",
    ]
    lines.append("a number behind a # is not shown by this record: remove the # to use it")
    lines += textwrap.wrap(FIX_WORDS)
    if (short := short_record_text(report)) is not None:
        lines.append(f"WARNING: {short}")
    return [
        *lines,
        *caveat_lines(report),
        "No margin is added: vibration, temperature and mounting may need one",
    ]


def caveat_lines(report: Report) -> list[str]:
    """Return a warning for each caveat of the record, of a gyroscope or an accelerometer, as comments."""
    lines, device, by_caveat = [], report.device, caveats(report)
    if "aliased" in by_caveat:
        by = f" by {device.alias_factor:.2f}" if device.alias_factor else ""
        lines.append(f"WARNING: aliased: N is too high{by}: right for this stream, wrong for the sensor")
    if (warning := filter_warning(report)) is not None:
        lines.append(f"WARNING: {FILTER_NOT_KNOWN}: {warning.replace('√', 'sqrt')}")
    for caveat, every in by_caveat.items():
        channels = [name for name in every if name.sensor in INERTIAL]
        if caveat != "aliased" and (channels or not every):
            where = f" ({joined(channels)})" if channels else ""
            lines.append(f"WARNING: {caveat.replace('_', ' ')}{where}: {line(caveat)}")
    return lines


def short_record_text(report: Report) -> str | None:
    """Return a warning about a short record; None if it is long enough, or shows what programs take."""
    axes = [channel.estimates for name, channel in report.channels.items() if name.sensor in INERTIAL]
    shown = [known[letter].status == "measured" for known in axes for letter in "NK" if letter in known]
    if report.session.elapsed_s >= USUAL_RECORD_S or (shown and all(shown)):
        return None
    return (
        f"recorded {duration(report.session.elapsed_s)}: what the record does not show is a comment; "
        f"record at least {USUAL_RECORD_S / 3600.0:.0f} h"
    )
