"""Signal: what is in the values besides N, B and K, in lines of text.

A line a channel for what every channel has: bias, the last minute beside the whole record, drift. Below it
a line for what only some have: values that are not Gaussian, spectral lines, an effect of temperature, axes
that move together, what has changed.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator

from imumon.datasheet.text_table import coefficient
from imumon.messages import follows_temperature
from imumon.report import COEFFICIENTS, Channel, Report
from imumon.samples import sensor_of
from imumon.units import READABLE, ReadableUnit, figures, pretty

LINES = 4
"""Spectral lines told of a channel."""
TOGETHER = 0.3
"""Correlation from which two axes are said to move together."""
CERTAIN = 5.0
"""Standard errors by which it must differ from none: one is 1 / sqrt(n) of n independent samples."""
LEAST = 60
"""Cells that a note is broken at, at least."""


def signal(made: Report, width: int | None = None) -> list[str]:
    """Lines of text; none before the first sample.

    Parameters
    ----------
    width : cells of the terminal; None: no line is broken.
    """
    lines, before = [], ""
    for name, channel in made.channels.items():
        if channel.mean is not None:
            lines += [_heading(channel)] if sensor_of(name) != before else []
            lines.append(_row(name, channel))
            before = sensor_of(name)
    for name, channel in made.channels.items() if lines else ():
        for note in (*_notes(name, channel), *_together(name, made)):
            text = f"{name}: {note}"
            lines += (
                [text] if width is None else textwrap.wrap(text, max(width, LEAST), subsequent_indent="  ")
            )
    return lines


def _heading(channel: Channel) -> str:
    unit = f"in {pretty(channel.unit)}"
    return f"{unit:<12}{'bias, 95 %':>24}{'last minute':>12}{'std':>10}{'drift per hour':>21}"


def _row(name: str, channel: Channel) -> str:
    shape, drift = channel.distribution, channel.drift
    bias = minute = spread = slope = ""
    if shape is not None:
        bias = _about(shape.bias, shape.bias_low, shape.bias_high) or shape.bias_reason or ""
        minute = "" if shape.recent_mean is None else f"{shape.recent_mean:.4e}"
        spread = "" if shape.recent_std is None else f"{shape.recent_std:.2e}"
    if drift is not None:
        slope = _about(drift.per_hour, drift.per_hour_low, drift.per_hour_high)
    return f"{name:<12}{bias:>24}{minute:>12}{spread:>10}{slope:>21}".rstrip()


def _about(value: float | None, low: float | None, high: float | None) -> str:
    """Value and half-width of its limits.

    >>> _about(1.2e-3, 1.1e-3, 1.3e-3), _about(None, None, None)
    ('1.200e-03 ±1.0e-04', '')
    """
    if value is None:
        return ""
    half = "" if low is None or high is None else f" ±{(high - low) / 2.0:.1e}"
    return f"{value:.3e}{half}"


def _notes(name: str, channel: Channel) -> Iterator[str]:
    """What only some channels have, a sentence each."""
    unit, shape, drift = pretty(channel.unit), channel.distribution, channel.drift
    if shape is not None and shape.gaussian is False and shape.verdict:
        yield shape.verdict
    if channel.spectrum is not None and channel.spectrum.lines:
        told = [
            f"{line.frequency_hz:.4g} Hz of {line.amplitude:.2g} {unit}"
            + (f" ({line.name})" if line.name else "")
            for line in channel.spectrum.lines[:LINES]
        ]
        more = len(channel.spectrum.lines) - LINES
        yield f"lines at {', '.join(told)}" + (f" and {more} more" if more > 0 else "")
    if drift is not None and drift.significant:
        yield "the drift is more than the noise makes"
    if drift is not None and drift.per_degC is not None and follows_temperature(drift):
        half = "" if drift.per_degC_high is None else f" ±{drift.per_degC_high - drift.per_degC:.1e}"
        share = "" if drift.explained is None else f", {drift.explained:.0%} of what is slow"
        steady = ", ".join(
            f"{letter} {coefficient(found)} {pretty(READABLE[sensor_of(name), letter].unit)}"
            for letter in COEFFICIENTS
            if (found := getattr(drift, f"steady_{letter}")) is not None
        )
        yield (
            f"follows the temperature by {drift.per_degC:.2e}{half} {unit} a degree{share}; "
            f"without that (the table is with it) {steady}"
        )
    for change in channel.changes:
        scale = READABLE.get((sensor_of(name), change.quantity), ReadableUnit(1.0, channel.unit))
        before, now = (figures(value * scale.factor) for value in (change.before, change.now))
        yield f"{change.quantity} was {before}, is {now} {pretty(scale.unit)} (against the {change.against})"


def unchanged(made: Report, baseline: Report) -> str | None:
    """A line where no channel differs from a baseline, or none could; None where the notes tell what does."""
    if any(change.against == "baseline" for channel in made.channels.values() for change in channel.changes):
        return None
    measured = (
        [getattr(one.channels.get(name), letter, None) for one in (made, baseline)]
        for name in made.channels
        for letter in ("N", "B")
    )
    if any(all(part is not None and part.status == "measured" for part in pair) for pair in measured):
        return "nothing changed against the baseline"
    return "nothing to compare with the baseline: no N or B is measured in both"


def _together(name: str, made: Report) -> Iterator[str]:
    """Axes behind this one that it moves together with for certain, so that each pair is told once."""
    channel, names = made.channels[name], list(made.channels)
    shape = channel.distribution
    beside = [
        f"{other} ({r:+.2f})"
        for other, r in (shape.correlation.items() if shape is not None else ())
        if other in names[names.index(name) :]
        and abs(r) >= TOGETHER
        and r * r * min(_independent(channel), _independent(made.channels[other])) > CERTAIN**2
    ]
    if beside:
        yield f"moves together with {', '.join(beside)}"


def _independent(channel: Channel) -> float:
    """Samples that would be worth as much if they were independent, for the error of a mean or a correlation.

    The mean of n independent samples has the variance std^2 / n. Of clusters of tau it is sigma^2(tau), of
    the record of length T, were they independent, sigma^2(tau) tau / T: the worst tau tells how many
    samples the record is worth. None before there is a curve.
    """
    allan, count = channel.allan, channel.count
    if allan is None or not allan.tau_s or channel.std is None:
        return 0.0
    worst = max(sigma**2 * tau for sigma, tau in zip(allan.sigma, allan.tau_s, strict=True))
    length = count * allan.tau_s[0]
    return min(channel.std**2 * length / worst, float(count)) if worst > 0.0 else 0.0
