"""Appendix of a datasheet: what supports the numbers of its sheet, section by section; an empty one is left out."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from functools import partial

from imumon.documents.convergence_figure import convergence_svg, convergences
from imumon.documents.elements import AppendixSection, Caution, DataTable, Element, Figure, Paragraph
from imumon.documents.figures import curve_table, svg
from imumon.documents.report_texts import (
    SENSOR_TITLES,
    driver_advice,
    invalid_noun,
    readable_curves,
    stream_noun,
)
from imumon.documents.spectrum_figure import spectra, spectrum_svg
from imumon.documents.temperature_figure import temperature_elements, with_error
from imumon.model.coefficients import SIGNIFICANT, unit_of
from imumon.model.ledger import ledger_text
from imumon.model.messages import CLOCKS, advice, caveats, drifts_with_temperature, joined
from imumon.model.report import Channel, Report
from imumon.model.samples import INERTIAL, ChannelName
from imumon.model.units import counted, duration, figures, pretty

MOST_LINES = 4  # spectral lines shown per channel, the strongest
CORRELATED = 0.3  # correlation from which two axes are reported as moving together
MOST_OF_A_KIND = 12
"""Events of one kind that are listed one by one; the forms json and csv have all."""


def appendix(report: Report) -> Iterator[AppendixSection]:
    """Yield the sections that the report has something for."""
    parts = {
        "caveats": _caveats,
        "spectrum": _spectrum,
        "distribution": _distribution,
        "convergence": _convergence,
        "temperature": temperature_elements,
        "magnetometer": _magnetometer,
        "record and events": _record,
    }
    for title, elements_of in parts.items():
        if elements := tuple(elements_of(report)):
            yield AppendixSection(title, elements)


def _caveats(report: Report) -> Iterator[Element]:
    """Yield the caveats with their consequence and what helps."""
    for caveat, channels in caveats(report).items():
        text = f"{advice(report, caveat)} {driver_advice(report, caveat) if caveat == 'aliased' else ''}"
        where = f" ({', '.join(channels)})" if channels else ""
        yield Caution(f"{caveat.replace('_', ' ')}{where}", text.strip())


def _spectrum(report: Report) -> Iterator[Element]:
    for sensor in SENSOR_TITLES:
        if spectra(report, sensor):
            caption = f"{SENSOR_TITLES[sensor]}, root of the power spectral density; dashed: N; dotted: spectral lines."
            yield Figure(caption, None, partial(spectrum_svg, report, sensor))
    spectral = {f"{name}, {pretty(c.unit)}": _lines(c) for name, c in report.channels.items()}
    if rows := [(name, ", ".join(texts)) for name, texts in spectral.items() if texts]:
        yield DataTable(("", "strongest spectral lines, frequency and amplitude"), tuple(rows))


def _lines(channel: Channel) -> list[str]:
    """Return the strongest spectral lines with frequency and amplitude, and how many more there are."""
    lines = channel.spectrum.lines if channel.spectrum is not None else ()
    texts = [
        f"{line.frequency_hz:.4g} Hz of {line.amplitude:.2g}" + (f" ({line.name})" if line.name else "")
        for line in lines[:MOST_LINES]
    ]
    return texts + ([f"{len(lines) - MOST_LINES} more"] if len(lines) > MOST_LINES else [])


def _distribution(report: Report) -> Iterator[Element]:
    """Yield how the values are distributed, and what only some channels show."""
    if not report.channels:
        return
    head = (
        *("", "mean", "standard deviation", "minimum", "maximum"),
        *("bias", "drift per hour", "distribution"),
    )
    yield DataTable(head, tuple(_statistics_row(name, c) for name, c in report.channels.items()))
    yield Paragraph("Statistics of the samples that count, as received. Bias and drift have 95 % limits.")
    by_note: dict[str, list[ChannelName]] = {}  # one that is true of several channels is written once
    for name, channel in report.channels.items():
        for note in _notes(name, channel, report):
            by_note.setdefault(note, []).append(name)
    for note, names in by_note.items():
        yield Paragraph(f"{names[0] if len(names) == 1 else joined(names)}: {note}.")


def _statistics_row(name: ChannelName, channel: Channel) -> tuple[str, ...]:
    """Return mean, standard deviation, extremes, bias, drift and shape of a channel; – where they are not known."""
    shape, drift = channel.distribution, channel.drift
    bias = slope = verdict = ""
    if shape is not None:
        bias = _with_limits(shape.bias, shape.bias_low, shape.bias_high) or shape.bias_reason or ""
        verdict = shape.verdict or ""
    if drift is not None:
        slope = _with_limits(drift.per_hour, drift.per_hour_low, drift.per_hour_high)
    statistics = (channel.mean, channel.std, channel.min, channel.max)
    cells = ("–" if value is None else f"{value:.4g}" for value in statistics)
    return (f"{name}, {pretty(channel.unit)}", *cells, bias or "–", slope or "–", verdict or "–")


def _with_limits(value: float | None, low: float | None, high: float | None) -> str:
    """Return a value with the half-width of its limits; empty if it is unknown."""
    if value is None:
        return ""
    return with_error(value, 0.0 if low is None or high is None else (high - low) / 2.0)


def _notes(name: ChannelName, channel: Channel, report: Report) -> Iterator[str]:
    """Yield the properties that only some channels have, one sentence each."""
    if channel.model is not None and (jumps := channel.model.jumps) is not None:
        times = f"for {duration(jumps.low_s)} and {duration(jumps.high_s)} on the average"
        yield f"jumps between {jumps.low:.4g} and {jumps.high:.4g} {pretty(channel.unit)}, {times}"
    if channel.drift is not None and channel.drift.significant:
        yield "the drift exceeds what the noise explains"
    if drifts_with_temperature(channel.drift):
        yield "time and temperature are not separable: the drift includes the effect of the temperature"
    if turn_on := _turn_on_text(name, channel):
        yield f"turn-on bias repeatability {turn_on}"
    yield from _correlations(name, report)


def _turn_on_text(name: ChannelName, channel: Channel) -> str:
    """Return the repeatability of the turn-on bias with its limits; empty if it is unknown."""
    shape = channel.distribution
    if shape is None or shape.turn_on_std is None:
        return ""
    unit = unit_of(name.sensor, "B", channel.unit)
    numbers = (shape.turn_on_std, shape.turn_on_low or 0.0, shape.turn_on_high or 0.0)
    std, low, high = (figures(number * unit.factor) for number in numbers)
    return f"{std} {pretty(unit.unit)} (95 %: {low} to {high}, {shape.turn_on_count} power-ups)"


def _correlations(name: ChannelName, report: Report) -> Iterator[str]:
    """Yield the later channels that this one correlates with beyond chance, so that each pair occurs once."""
    shape, names = report.channels[name].distribution, list(report.channels)
    others = [
        f"{other} ({r:+.2f})"
        for other, r in (shape.correlation.items() if shape is not None else ())
        if other in names[names.index(name) :]  # an earlier one has named this pair
        and abs(r) >= CORRELATED
        and abs(r) > SIGNIFICANT * _standard_error(report, name, ChannelName(other))
    ]
    if others:
        yield f"moves together with {', '.join(others)}"


def _standard_error(report: Report, *names: ChannelName) -> float:
    """Return the standard error of a correlation of 0 between two channels."""
    shapes = [report.channels[name].distribution for name in names]
    return math.sqrt(1.0 / min((shape and shape.effective_samples) or 1.0 for shape in shapes))


def _convergence(report: Report) -> Iterator[Element]:
    """Yield what was stated of the inertial sensors when the record was shorter."""
    for sensor in INERTIAL:
        if convergences(report, sensor):
            caption = f"{SENSOR_TITLES[sensor]}, what was stated when the record was shorter, with the 95 % limits of "
            caption += "statistics; ▼ and <: 95 % upper bounds."
            yield Figure(caption, None, partial(convergence_svg, report, sensor))


def _magnetometer(report: Report) -> Iterator[Element]:
    """Yield the Allan deviation of the magnetometer: those of the inertial sensors are on the sheet."""
    if readable_curves(report, "mag"):
        caption = f"Allan deviation in {pretty(unit_of('mag', 'B').unit)}; marks as on the sheet."
        yield Figure(caption, curve_table(report, "mag"), partial(svg, report, "mag"))


def _record(report: Report) -> Iterator[Element]:
    """Yield the stream, where it comes from, and what happened."""
    device, session = report.device, report.session
    times = report.recording.times if report.recording is not None else ()
    clock = CLOCKS.get(device.clock or "", "unknown")
    invalid = counted(session.bad_checksums, invalid_noun(device))
    identity = {"Model": device.model, "Serial number": device.serial, "Firmware": device.firmware}
    rows = [(label, value) for label, value in identity.items() if value]
    rows += [
        ("Stream", ", ".join(filter(None, (device.source, stream_noun(device))))),
        ("Rate", f"{device.sample_rate_hz:.6g} Hz" if device.sample_rate_hz else "unknown"),
        ("Time from", ", ".join([clock, *(f"column {name}" for name in times)])),
        ("Alias factor of N", f"{device.alias_factor:.3g}" if device.alias_factor else "unknown"),
        ("Start", session.started or "unknown"),
        ("Transmission", f"{invalid}, {counted(session.discarded_bytes, 'byte')} discarded"),
        ("Restarts", f"{session.restarts:,}"),
    ]
    yield DataTable(("", ""), (*rows, *_source_rows(report)))
    if events := tuple(event_rows(report)):
        yield DataTable(("at", "event"), events)


def _source_rows(report: Report) -> Iterator[tuple[str, str]]:
    """Yield what became of everything received, the settings of the sensor, the columns of a table, and remarks."""
    device = report.device
    if text := ledger_text(report.session.ledger):
        yield "Ledger", text
    for name, value in device.settings.items():
        text = device.setting_texts.get(name, "")
        yield f"Setting {name}", f"{text} ({value})" if text else value
    for column in report.recording.columns if report.recording is not None else ():
        yield f"Column {column.name}", column.use or f"not used: {column.reason}"
    yield from (("Remark", text) for text in device.remarks)


def event_rows(report: Report) -> Iterator[tuple[str, str]]:
    """Yield time and text of the events of a record; many of one kind are one row."""
    timed = [(event.elapsed_s, event) for event in report.events if event.elapsed_s is not None]
    counts = Counter(event.kind for _, event in timed)
    summed: set[str] = set()
    for begin_s, event in timed:
        if counts[event.kind] <= MOST_OF_A_KIND:
            yield f"{begin_s:,.1f} s", event.text
        elif event.kind not in summed:
            summed.add(event.kind)
            same = [(other_s, other) for other_s, other in timed if other.kind == event.kind]
            length_s = sum(other.length_s or 0.0 for _, other in same)
            whole = f", {length_s:,.1f} s in all" if length_s else ""
            count = counted(len(same), event.kind.replace("_", " "))
            yield f"{begin_s:,.1f} s", f"{count} until {same[-1][0]:,.1f} s{whole}"
