"""Elements of a datasheet on the record: stream, counters, settings, events, and the values as received."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from imumon.datasheet.elements import DataTable, Element, Heading, Paragraph
from imumon.datasheet.evidence import excluding_events
from imumon.datasheet.signal_text import spectral_lines, turn_on_text, with_half_width
from imumon.datasheet.tables import event_rows, invalid_noun
from imumon.ledger import ledger_text
from imumon.messages import CLOCKS, exclusions
from imumon.report import Channel, DeviceDescription, Report, SessionCounters
from imumon.units import counted, duration, pretty, share_text


def record_elements(report: Report) -> Iterator[Element]:
    """Yield the stream, its counters and settings, and the events that are not listed under traceability."""
    device, session = report.device, report.session
    excluded = exclusions(report, _seconds)
    disturbances = counted(session.disturbances, "disturbance")
    invalid = counted(session.bad_checksums, invalid_noun(device))
    discarded = counted(session.discarded_bytes, "byte")
    length = f"{duration(session.elapsed_s)} ({session.elapsed_s:,.0f} s)"
    rows = [
        ("Stream", _stream_text(device)),
        ("Rate", f"{device.sample_rate_hz:.6g} Hz" if device.sample_rate_hz else "unknown"),
        ("Time from", _time_text(report)),
        ("Alias factor of N", f"{device.alias_factor:.3g}" if device.alias_factor else "unknown"),
        ("Start", session.started or "unknown"),
        ("Length", f"{length}, {counted(session.samples, 'sample')}"),
        ("Missing", _missing_text(session)),
        ("Excluded as disturbed", f"{', '.join(excluded)}; {disturbances}" if excluded else "none"),
        ("Excluded as warm-up", _seconds(session.warmup_s)),
        ("Transmission", f"{invalid}, {discarded} discarded"),
        ("Ledger", ledger_text(session.ledger) or "none is kept"),
        ("Restarts", f"{session.restarts:,}"),
    ]
    identity = {"Model": device.model, "Serial number": device.serial, "Firmware": device.firmware}
    # an item that the user describes has a table of its own with these
    rows += [(label, value) for label, value in identity.items() if value and report.item is None]
    for name, value in device.settings.items():
        text = device.setting_texts.get(name)
        rows.append((f"Setting {name}", f"{text} ({value})" if text else value))
    rows += _column_rows(report)
    rows += [("Remark", text) for text in device.remarks]
    yield Heading("The record")
    yield DataTable(("", ""), tuple(rows))
    if rows := list(event_rows(_without_traced(report))):
        yield DataTable(("at", "event"), tuple(rows))


def _time_text(report: Report) -> str:
    columns = report.recording.times if report.recording is not None else ()
    clock = CLOCKS.get(report.device.clock or "", "unknown")
    return ", ".join([clock, *(f"column {name}" for name in columns)])


def _column_rows(report: Report) -> list[tuple[str, str]]:
    """Return what became of each column of a file or of lines."""
    columns = report.recording.columns if report.recording is not None else ()
    return [(f"Column {c.name}", c.use or f"not used: {c.reason}") for c in columns]


def _without_traced(report: Report) -> Report:
    """Return the report without the events that are listed under traceability."""
    if report.evaluation is None or report.evaluation.provenance is None:
        return report
    listed = excluding_events(report)
    return replace(report, events=tuple(event for event in report.events if event not in listed))


def _missing_text(session: SessionCounters) -> str:
    if not session.missing:
        return "none"
    share = session.missing / (session.samples + session.missing)
    return f"{counted(session.missing, 'sample')} in {counted(session.gaps, 'gap')}, {share_text(share)}"


def _stream_text(device: DeviceDescription) -> str:
    kind = "not stated whether compensated" if device.stream == "unknown" else device.stream
    return ", ".join(part for part in (device.source, kind) if part) or "unknown"


def _seconds(seconds: float) -> str:
    if seconds <= 0.0:
        return "none"
    return duration(seconds) if seconds >= 60.0 else f"{seconds:.1f} s"


def value_elements(report: Report) -> Iterator[Element]:
    """Yield how the values are distributed, which lines they have, and how the bias differs between power-ups."""
    rows = [_statistics_row(name, channel) for name, channel in report.channels.items()]
    if rows:
        head = ("", "mean", "standard deviation", "minimum", "maximum", "drift per hour", "distribution")
        yield Heading("The values")
        yield DataTable(head, tuple(rows))
        yield Paragraph("Statistics of the samples that count, as received. Only the drift has 95 % limits.")
    turn_on = [(name, text) for name, c in report.channels.items() if (text := turn_on_text(name, c))]
    if turn_on:
        yield DataTable(("", "turn-on bias repeatability"), tuple(turn_on))
    spectral = {f"{name}, {pretty(c.unit)}": spectral_lines(c) for name, c in report.channels.items()}
    if any(spectral.values()):
        lines = [(name, ", ".join(texts)) for name, texts in spectral.items() if texts]
        yield DataTable(("", "strongest spectral lines, frequency and amplitude"), tuple(lines))


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
