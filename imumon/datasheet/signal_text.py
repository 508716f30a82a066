"""Lines of text about the values of each channel, besides N, B and K.

One line per channel: bias, the last minute beside the whole record, drift. Below, one line for each property
that only some channels have: values that are not Gaussian, spectral lines, an effect of temperature, correlated
axes, changes.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator

from imumon.coefficients import BIAS_SLOPE, GRADED, SIGNIFICANT, mean_unit, unit_of
from imumon.messages import drifts_with_temperature, follows_temperature, joined
from imumon.report import Change, Channel, Drift, Report
from imumon.samples import sensor_of
from imumon.units import duration, figures, pretty, share_text

MOST_LINES = 4  # spectral lines shown per channel, the strongest
CORRELATED = 0.3  # correlation from which two axes are reported as moving together


def signal_lines(report: Report, width: int | None = None) -> list[str]:
    """Return a line for each channel and one for each of its properties; none before the first sample.

    Parameters
    ----------
    width : cells of the terminal; None: no line is broken.
    """
    lines, before = [], ""
    for name, channel in report.channels.items():
        if channel.mean is not None:
            lines += [_heading(sensor_of(name), channel)] if sensor_of(name) != before else []
            lines.append(_row(name, channel))
            before = sensor_of(name)
    for note, names in notes(report).items() if lines else ():
        text = f"{names}: {note}"
        lines += textwrap.wrap(text, width or len(text), subsequent_indent="  ")
    return lines


def notes(report: Report) -> dict[str, str]:
    """Return the properties that only some channels have: the channels by sentence."""
    channels: dict[str, list[str]] = {}  # one that is true of several is written once
    for name, channel in report.channels.items():
        for note in (*_notes(name, channel), *_correlations(name, report)):
            channels.setdefault(note, []).append(name)
    return {note: names[0] if len(names) == 1 else joined(names) for note, names in channels.items()}


def _heading(sensor: str, channel: Channel) -> str:
    unit = f"in {pretty(mean_unit(sensor, channel.unit)[1])}"
    return f"{unit:<12}{'bias, 95 %':>24}{'last minute':>12}{'std':>10}{'drift per hour':>21}"


def _row(name: str, channel: Channel) -> str:
    """Return bias, last minute and drift of a channel, below `_heading`."""
    shape, drift = channel.distribution, channel.drift
    factor, _ = mean_unit(sensor_of(name), channel.unit)
    bias = minute = spread = slope = ""
    if shape is not None:
        limits = (shape.bias, shape.bias_low, shape.bias_high)
        bias = with_half_width(*limits, factor=factor) or shape.bias_reason or ""
        minute = "" if shape.recent_mean is None else f"{factor * shape.recent_mean:.4e}"
        spread = "" if shape.recent_std is None else f"{factor * shape.recent_std:.2e}"
    if drift is not None:
        slope = with_half_width(drift.per_hour, drift.per_hour_low, drift.per_hour_high, factor=factor)
    return f"{name:<12}{bias:>24}{minute:>12}{spread:>10}{slope:>21}".rstrip()


def with_half_width(
    value: float | None, low: float | None, high: float | None, digits: int = 3, factor: float = 1.0
) -> str:
    """Return a value with some decimals and the half-width of its limits, `factor` times as large.

    >>> with_half_width(1.2e-3, 1.1e-3, 1.3e-3), with_half_width(None, None, None)
    ('1.200e-03 ±1.0e-04', '')
    """
    if value is None:
        return ""
    half = "" if low is None or high is None else f" ±{factor * (high - low) / 2.0:.1e}"
    return f"{factor * value:.{digits}e}{half}"


def spectral_lines(channel: Channel, unit: str = "", factor: float = 1.0) -> list[str]:
    """Return the strongest spectral lines with frequency and amplitude in a unit, and how many more there are."""
    lines = channel.spectrum.lines if channel.spectrum is not None else ()
    texts = [
        f"{line.frequency_hz:.4g} Hz of {factor * line.amplitude:.2g}{unit}"
        + (f" ({line.name})" if line.name else "")
        for line in lines[:MOST_LINES]
    ]
    return texts + ([f"{len(lines) - MOST_LINES} more"] if len(lines) > MOST_LINES else [])


def turn_on_text(name: str, channel: Channel) -> str:
    """Return the repeatability of the turn-on bias with its limits; empty if it is unknown."""
    shape = channel.distribution
    if shape is None or shape.turn_on_std is None:
        return ""
    unit = unit_of(sensor_of(name), "B", channel.unit)
    numbers = (shape.turn_on_std, shape.turn_on_low or 0.0, shape.turn_on_high or 0.0)
    std, low, high = (figures(number * unit.factor) for number in numbers)
    return f"{std} {pretty(unit.unit)} (95 %: {low} to {high}, {shape.turn_on_count} power-ups)"


def _slope(drift: Drift, unit: str, factor: float) -> str:
    """Return how a mean follows the temperature, as a sentence."""
    slope = with_half_width(drift.per_degC or 0.0, drift.per_degC_low, drift.per_degC_high, 2, factor)
    share = "" if drift.explained is None else f", {share_text(drift.explained)} of the slow variance"
    if drift.temperature_min is not None and drift.temperature_max is not None:
        share += f", from {drift.temperature_min:.1f} to {drift.temperature_max:.1f} {pretty('degC')}"
    text = f"follows the temperature by {slope} {unit} per degree{share}"
    return f"{text}; the coefficients are without this effect"


def _notes(name: str, channel: Channel) -> Iterator[str]:
    """Yield the properties that only some channels have, one sentence each."""
    factor, readable = mean_unit(sensor_of(name), channel.unit)
    unit, shape, drift = pretty(readable), channel.distribution, channel.drift
    if shape is not None and shape.gaussian is False and shape.verdict:
        yield shape.verdict
    if texts := spectral_lines(channel, f" {unit}", factor):
        yield f"lines at {', '.join(texts)}"
    if channel.model is not None and channel.model.oscillations_s:
        periods = [duration(period) for period in channel.model.oscillations_s]
        yield f"oscillates with a period of {', '.join(periods)}"
    if channel.model is not None and (jumps := channel.model.jumps) is not None:
        times = f"for {duration(jumps.low_s)} and {duration(jumps.high_s)} on the average"
        yield f"jumps between {factor * jumps.low:.4g} and {factor * jumps.high:.4g} {unit}, {times}"
    if drift is not None and drift.significant:
        yield "the drift exceeds what the noise explains"
    yield from _temperature_notes(channel, unit, factor)
    if turn_on := turn_on_text(name, channel):
        yield f"turn-on bias repeatability {turn_on}"
    yield from (_change_note(name, channel.unit, change) for change in channel.changes)


def _change_note(name: str, unit: str, change: Change) -> str:
    """Return a change as a sentence, with what it is against."""
    si = f"{unit}/degC" if change.quantity == BIAS_SLOPE else unit
    scale = unit_of(sensor_of(name), change.quantity, si)
    before, now = (figures(value * scale.factor) for value in (change.before, change.now))
    against = f"against the {change.against}"
    if change.since is not None and change.p_value is not None:
        against += f", since {change.since[:10]}, p = {change.p_value:.0e}"
    return f"{change.quantity} was {before}, is {now} {pretty(scale.unit)} ({against})"


def _temperature_notes(channel: Channel, unit: str, factor: float) -> Iterator[str]:
    """Yield how the bias of a channel follows the temperature, one sentence each."""
    drift, curve = channel.drift, channel.bias_curve
    if drifts_with_temperature(drift):
        yield "time and temperature are not separable: the drift includes the effect of the temperature"
    if drift is not None and follows_temperature(drift):
        yield _slope(drift, unit, factor)
    if curve is not None and curve.is_known and follows_temperature(drift):
        slope = with_half_width(*curve.terms[1].limits(factor))
        span = f"{curve.degC[0]:.1f} to {curve.degC[-1]:.1f} {pretty('degC')}"
        yield f"bias against the temperature, {span}: {slope} {unit} per degree"


def baseline_summary(report: Report, baseline: Report) -> str | None:
    """Return a line if no channel differs from a baseline or none can; None if the notes say what differs."""
    changes = (change for channel in report.channels.values() for change in channel.changes)
    if any(change.against == "baseline" for change in changes):
        return None
    pairs = [
        [one.channels[name].coefficients[letter].status for one in (report, baseline)]
        for name in report.channels.keys() & baseline.channels.keys()
        for letter in GRADED
        if letter in report.channels[name].coefficients and letter in baseline.channels[name].coefficients
    ]
    if ["measured", "measured"] in pairs:
        return "nothing changed against the baseline"
    return "nothing to compare with the baseline: no N or B is measured in both"


def _correlations(name: str, report: Report) -> Iterator[str]:
    """Yield the later channels that this one correlates with beyond chance, so that each pair occurs once."""
    shape, names = report.channels[name].distribution, list(report.channels)
    others = [
        f"{other} ({r:+.2f})"
        for other, r in (shape.correlation.items() if shape is not None else ())
        if other in names[names.index(name) :]  # an earlier one has named this pair
        and abs(r) >= CORRELATED
        and abs(r) > SIGNIFICANT * _standard_error(report, name, other)
    ]
    if others:
        yield f"moves together with {', '.join(others)}"


def _standard_error(report: Report, *names: str) -> float:
    """Return the standard error of a correlation of 0 between two channels."""
    shapes = [report.channels[name].distribution for name in names]
    return math.sqrt(1.0 / min((shape and shape.effective_samples) or 1.0 for shape in shapes))
