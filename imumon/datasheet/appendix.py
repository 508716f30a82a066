"""Appendix of a datasheet: what supports the numbers of its sheet, section by section; an empty one is left out."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from imumon.coefficients import unit_of
from imumon.datasheet.convergence_figure import convergence_svg, convergence_table, convergences
from imumon.datasheet.elements import AppendixSection, Caution, DataTable, Element, Figure, Paragraph
from imumon.datasheet.figures import curve_table, svg
from imumon.datasheet.signal_text import notes, spectral_lines, with_half_width
from imumon.datasheet.spectrum_figure import spectra, spectrum_svg
from imumon.datasheet.tables import (
    SENSOR_TITLES,
    driver_advice,
    event_rows,
    invalid_noun,
    readable_curves,
    stream_noun,
)
from imumon.datasheet.temperature_figure import temperature_elements
from imumon.ledger import ledger_text
from imumon.messages import CLOCKS, advice, caveats
from imumon.report import Channel, Report
from imumon.samples import INERTIAL
from imumon.units import counted, pretty


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
    spectral = {f"{name}, {pretty(c.unit)}": spectral_lines(c) for name, c in report.channels.items()}
    if rows := [(name, ", ".join(texts)) for name, texts in spectral.items() if texts]:
        yield DataTable(("", "strongest spectral lines, frequency and amplitude"), tuple(rows))


def _distribution(report: Report) -> Iterator[Element]:
    """Yield how the values are distributed, and what else each channel shows."""
    if not report.channels:
        return
    head = ("", "mean", "standard deviation", "minimum", "maximum", "drift per hour", "distribution")
    yield DataTable(head, tuple(_statistics_row(name, c) for name, c in report.channels.items()))
    yield Paragraph("Statistics of the samples that count, as received. Only the drift has 95 % limits.")
    for note, names in notes(report).items():
        yield Paragraph(f"{names}: {note}.")


def _statistics_row(name: str, channel: Channel) -> tuple[str, ...]:
    """Return mean, standard deviation, extremes, drift and shape of a channel; – where they are not known."""
    shape, drift = channel.distribution, channel.drift
    slope = ""
    if drift is not None:
        slope = with_half_width(drift.per_hour, drift.per_hour_low, drift.per_hour_high)
    statistics = (channel.mean, channel.std, channel.min, channel.max)
    cells = ("–" if value is None else f"{value:.4g}" for value in statistics)
    verdict = (shape.verdict if shape else None) or "–"
    return (f"{name}, {pretty(channel.unit)}", *cells, slope or "–", verdict)


def _convergence(report: Report) -> Iterator[Element]:
    """Yield what was stated of the inertial sensors when the record was shorter."""
    for sensor in INERTIAL:
        if convergences(report, sensor):
            caption = f"{SENSOR_TITLES[sensor]}, what was stated when the record was shorter, with the 95 % limits of "
            caption += "statistics; ▼ and <: 95 % upper bounds."
            yield Figure(caption, convergence_table(report, sensor), partial(convergence_svg, report, sensor))


def _magnetometer(report: Report) -> Iterator[Element]:
    """Yield the Allan deviation of the magnetometer: those of the inertial sensors are on the sheet."""
    if readable_curves(report, "mag"):
        caption = f"Allan deviation in {pretty(unit_of('mag', 'B').unit)}; marks as on the sheet."
        yield Figure(caption, curve_table(report, "mag"), partial(svg, report, "mag"))


def _record(report: Report) -> Iterator[Element]:
    """Yield the stream, what became of everything received, the settings of the sensor, and what happened."""
    device, session = report.device, report.session
    columns = report.recording.columns if report.recording is not None else ()
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
    rows += [("Ledger", text) for text in filter(None, [ledger_text(session.ledger)])]
    for name, value in device.settings.items():
        text = device.setting_texts.get(name)
        rows.append((f"Setting {name}", f"{text} ({value})" if text else value))
    rows += [(f"Column {c.name}", c.use or f"not used: {c.reason}") for c in columns]
    rows += [("Remark", text) for text in device.remarks]
    yield DataTable(("", ""), tuple(rows))
    if events := tuple(event_rows(report)):
        yield DataTable(("at", "event"), events)
