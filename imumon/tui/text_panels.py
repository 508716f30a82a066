"""Device, events, sensors and drift as lines of text."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest

from imumon.model.messages import (
    CLOCKS,
    caveat_lines,
    caveats,
    drifts_with_temperature,
    excluded_by,
    follows_temperature,
    grade_text,
)
from imumon.model.report import Channel, Drift, Event, Report, SensorGrade
from imumon.model.samples import INERTIAL, TEMPERATURE
from imumon.model.units import duration, number, plus_minus, pretty, share_text
from imumon.tui.formatting import (
    Line,
    approximate_duration,
    fitted,
    length,
    marked,
    padded,
    with_background,
    wrap,
)
from imumon.tui.view_state import ViewState


def _pair(name: str, value: object, note: str = "", role: str = "text") -> Line:
    """Return a line with a name, its value, and a remark."""
    text = "–" if value is None else str(value)
    return [
        (f"  {name:<18}", "muted"),
        (text, "faint" if value is None else role),
        (f"   {note}" if note else "", "faint"),
    ]


def _title(text: str) -> Line:
    return [(f" {text}", "title")]


def device(state: ViewState, width: int, height: int = 0) -> list[Line]:
    """Return identity and settings of the sensor, what its numbers describe, and the transmission."""
    report = state.report
    wide = width >= 110
    half = width // 2 if wide else width
    first = [_identity(report), _stream(report), _notes(report, half)]
    second = [_transmission(report), _excluded(report)]
    settings = _settings(report, width)
    if not wide:
        cards = [*first, settings, *second]
        return [padded(line, width) for card in cards if card for line in [*card, []]]
    # each card is followed by an empty line; a card without lines is left out
    left, right = ([line for card in cards if card for line in [*card, []]] for cards in (first, second))
    blank: Line = []
    pairs = zip_longest(left, right, fillvalue=blank)
    both = [padded(a, half) + padded(b, width - half) for a, b in pairs]
    return both + [padded(line, width) for line in settings]


def _identity(report: Report) -> list[Line]:
    """Return model, serial number, firmware and port of the device."""
    d = report.device
    return [
        _title("Sensor"),
        _pair("name", d.id, role="strong"),
        _pair("model", d.model),
        _pair("serial number", d.serial),
        _pair("firmware", d.firmware),
        _pair("port", d.port),
        _pair("baud", None if d.baud is None else f"{d.baud:,}"),
    ]


def _stream(report: Report) -> list[Line]:
    """Return what the samples are, and by how much aliasing inflates N."""
    d = report.device
    kinds = {
        "deltas": "averages over each interval",
        "uncompensated": "before the bias filter",
        "compensated": "after the bias filter",
        "unknown": "samples, compensated or not",
    }
    alias, note, role = None, "unknown, like the sensor's filter", "text"
    if d.alias_factor == 1.0:
        alias, note = "1.00", "N is not inflated"
    elif d.alias_factor is not None:
        alias, note, role = f"{d.alias_factor:.2f}", "N is nominally too high by it", "warn"
    rate = None if d.sample_rate_hz is None else f"{d.sample_rate_hz:.6g} Hz"
    return [
        _title("What the numbers describe"),
        _pair("stream", d.stream, kinds.get(d.stream or "", ""), "strong"),
        _pair("message", d.source),
        _pair("sample rate", rate),
        _pair("time from", CLOCKS.get(d.clock or "", d.clock)),
        _pair("alias factor", alias, note, role),
    ]


def _settings(report: Report, width: int) -> list[Line]:
    """Return each setting by name, with what it does and its value, or the value alone."""
    settings = report.device.settings
    lines = [_title("Settings that change the data")]
    if not settings:
        return [*lines, [("  not read from the sensor", "faint")]]
    name_width = min(max(map(len, settings)), max(width // 2 - 6, 1))
    for name, value in settings.items():
        text = report.device.setting_texts.get(name)
        rows = zip_longest(wrap(name, name_width), wrap(text or value, width - name_width - 5), fillvalue="")
        both: list[Line] = [
            [(f"  {left:<{name_width}}   ", "muted"), (right, "text")] for left, right in rows
        ]
        raw: Line = [(f"   {value}", "faint")] if text else []
        lines += [*both[:-1], fitted([both[-1], raw], width)]
    return lines


def _transmission(report: Report) -> list[Line]:
    """Return what arrived since when, and what was lost on the way."""
    s = report.session
    expected = s.samples + s.missing
    share = share_text(s.missing / expected) if s.missing and expected else ""
    received = f"of {s.received_bytes:,}" if s.received_bytes else ""
    return [
        _title("Transmission"),
        _pair("since", None if s.started is None else s.started[:19].replace("T", " ") + " UTC"),
        _pair("elapsed", duration(s.elapsed_s)),
        _pair("samples", f"{s.samples:,}"),
        _pair("missing", f"{s.missing:,}", share, "warn" if s.missing else "text"),
        _pair("gaps", f"{s.gaps:,}", role="warn" if s.gaps else "text"),
        _pair("failed checksums", f"{s.bad_checksums:,}", role="warn" if s.bad_checksums else "text"),
        _pair("discarded bytes", f"{s.discarded_bytes:,}", received),
        _pair("overruns", f"{s.overruns:,}", role="warn" if s.overruns else "text"),
        _pair("duplicates", f"{s.duplicates:,}"),
        _pair("restarts", f"{s.restarts:,}"),
    ]


def _excluded(report: Report) -> list[Line]:
    """Return how much of the record was excluded, and why."""
    s = report.session
    reasons, mag_only = excluded_by(report)
    return [
        _title("Excluded"),
        _pair("disturbances", f"{s.disturbances:,}"),
        _pair("disturbed", duration(s.excluded_s)),
        *(_pair(f"  by {reason}", duration(seconds)) for reason, seconds in reasons.items()),
        *([_pair("magnetometer only", duration(mag_only))] if mag_only else []),
        _pair("warm-up", "continues" if "warming_up" in caveats(report) else duration(s.warmup_s)),
    ]


def _notes(report: Report, width: int) -> list[Line]:
    """Return the caveats of the numbers and the remarks about the sensor."""
    lines = marked((*caveat_lines(report), *report.device.remarks), width, "text")
    return [_title("Caveats"), *lines] if lines else []


STATUS = 19
"""Cells of the status of a device in the list of sensors."""
_LEVEL_ROLES = {"debug": "faint", "info": "text", "notice": "good", "warning": "warn", "error": "bad"}


def filtered_events(events: Sequence[Event], filter_text: str) -> list[Event]:
    """Return the events whose level, kind, channel and text contain every word of the filter."""
    words = filter_text.casefold().split()
    texts = [f"{e.level} {e.kind} {e.channel or ''} {e.text}".casefold() for e in events]
    return [event for event, text in zip(events, texts, strict=True) if all(w in text for w in words)]


def events(state: ViewState, width: int, height: int = 0) -> list[Line]:
    """Return the events, newest first."""
    shown = filtered_events(state.events, state.filter_text)
    count = f"{len(shown)} of {len(state.events)}" if state.filter_text else f"{len(shown)}"
    head: Line = [(" events ", "title"), (count, "muted")]
    if state.filter_text:
        head += [(f"   with '{state.filter_text}'", "bound"), ("   esc", "key"), (" shows all", "muted")]
    else:
        head += [("   /", "key"), (" filters", "muted")]
    lines: list[Line] = [padded(head, width), []]
    if not shown:
        lines.append([(" no events yet" if not state.events else " no event matches", "faint")])
    for event in reversed(shown):
        role = _LEVEL_ROLES[event.level]
        mark = "!" if event.level in ("warning", "error") else " "
        prefix: Line = [
            (f" {event.time[:10]} {event.time[11:19]} ", "faint"),
            (f"{mark} {event.kind:<13}", role),
        ]
        available = max(width - length(prefix) - 1, 12)
        named = event.channel is None or event.channel in event.text  # most texts say it themselves
        text = event.text if named else f"{event.channel}: {event.text}"
        for k, part in enumerate(wrap(text, available)):
            lines.append([*(prefix if not k else [(" " * length(prefix), "text")]), (part, "text")])
    return [padded(line, width) for line in lines]


def sensors(state: ViewState, width: int, height: int = 0) -> list[Line]:
    """Return every device with status, elapsed time and grades."""
    lines: list[Line] = [[(" sensors ", "title"), (str(len(state.reports)), "muted")], []]
    for name, report in sorted(state.reports.items()):
        line = _sensor_line(state, name, report, width)
        lines.append(with_background(padded(line, width), "selected") if name == state.id else line)
        for sensor in INERTIAL:
            grade = report.grade.get(sensor, SensorGrade())
            role = f"grade-{grade.meets}" if grade.meets else "faint"
            lines.append([(f"{'':<{STATUS}}{sensor:<6}", "muted"), (grade_text(grade), role)])
    several = len(state.reports) > 1
    hint = "arrows select, enter opens" if several else "other sensors appear here when their daemons answer"
    lines += [[], [(f"   {hint}", "faint")]]
    return [padded(line, width) for line in lines]


def _sensor_line(state: ViewState, name: str, report: Report, width: int) -> Line:
    """Return one device: status, name, elapsed time, and how old its report is."""
    now = state.connection_status(name)
    age = "" if now.live else f"{approximate_duration(state.ages.get(name, 0.0))} ago"
    status: Line = [
        ("▌" if name == state.id else " ", "accent"),
        (f" {now.mark} {now.title:<14}", now.role),
    ]
    cells = 24 if width >= 66 else 17  # of the name
    return [
        *padded(status, STATUS),
        (f"{name:<{cells}}" if len(name) < cells else f"{name[: cells - 2]}… ", "strong"),
        (f"{duration(report.session.elapsed_s):<12}", "text"),
        (age, "warn"),
    ]


def drift(state: ViewState, width: int, height: int = 0) -> list[Line]:
    """Return the distribution, the slope of the mean, and the effect of the temperature."""
    channel, name = state.selected, state.channel
    factor, unit = state.notation.scale(name)
    lines = [_shape(channel, width), _slope(channel.drift, factor, unit, width)]
    degrees = state.report.channels.get(TEMPERATURE)
    if degrees is not None and degrees.last is not None:
        celsius = pretty("degC")
        now = f"now {degrees.last:.2f} {celsius}"
        heat: list[Line] = [[(_LABEL.format("temperature"), "muted"), (now, "text")]]
        if degrees.min is not None and degrees.max is not None:
            heat.append([(f" ({degrees.min:.2f} to {degrees.max:.2f})", "muted")])
        lines.append(fitted([*heat, *_effect(channel, factor, unit)], width))
    shape = channel.distribution
    if shape is not None and shape.recent_mean is not None and shape.recent_std is not None:
        mean, std = number(shape.recent_mean * factor, 4), number(shape.recent_std * factor, 3)
        text = f"mean {mean}   std {std} {unit}"
        lines.append([(_LABEL.format("last minute"), "muted"), (text, "text")])
    return [padded(line, width) for line in lines[:height]]


_LABEL = " {:<13}"


def _shape(channel: Channel, width: int) -> Line:
    """Return the shape of the distribution, with its third and fourth moment."""
    shape = channel.distribution
    verdict = shape.verdict if shape is not None and shape.verdict else "not known yet"
    parts: list[Line] = [[(_LABEL.format("shape"), "muted"), (verdict[: width - 15], "text")]]
    if channel.skewness is not None:
        parts.append([(f"   skewness {number(channel.skewness, 2)}", "muted")])
    if channel.excess_kurtosis is not None:
        parts.append([(f"   excess kurtosis {number(channel.excess_kurtosis, 2)}", "muted")])
    return fitted(parts, width)


def _slope(drift: Drift | None, factor: float, unit: str, width: int) -> Line:
    """Return the drift per hour with 95 % limits."""
    label = (_LABEL.format("drift"), "muted")
    if drift is None or drift.per_hour is None:
        return [label, ("not known yet", "faint")]
    hour = f"{number(drift.per_hour * factor, 3)} {unit} per hour"
    parts: list[Line] = [[label, (hour, "text" if drift.significant else "muted")]]
    if drifts_with_temperature(drift):
        parts.append([("   with the temperature", "muted")])
    if drift.significant is False:
        parts.append([("   no more than noise", "muted")])
    if drift.per_hour_low is not None and drift.per_hour_high is not None:
        low, high = number(drift.per_hour_low * factor, 2), number(drift.per_hour_high * factor, 2)
        parts.append([(f"   {low} to {high}", "muted")])
    return fitted(parts, width)


def _effect(channel: Channel, factor: float, unit: str) -> list[Line]:
    """Return the effect of a degree on the mean where it exceeds the noise, with the curve of the whole record."""
    drift, curve = channel.drift, channel.bias_curve
    if drift is None:
        return []
    if drifts_with_temperature(drift):
        return [[("   its effect: not separable from time", "muted")]]
    if drift.per_degC is None:
        return []
    if not follows_temperature(drift):
        return [[("   its effect: no more than noise", "muted")]]
    if curve is None or not curve.is_known:
        parts: list[Line] = [[(f"   {number(drift.per_degC * factor, 3)} {unit} per degree", "text")]]
        if drift.explained is not None:
            parts.append([(f", {100 * drift.explained:.0f} % of the drift", "muted")])
        return parts
    return [[(f"   {plus_minus(*curve.terms[1].limits(factor), 3)} {unit} per degree", "text")]]
