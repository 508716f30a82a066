"""Lists: the device, the events, the sensors and the help as lines of text."""

from __future__ import annotations

from collections.abc import Sequence

from imumon.devices.vn100.register_text import describe_setting
from imumon.messages import CLOCKS, caveat_lines, excluded_by, follows_temperature
from imumon.report import Channel, Drift, Event, Report
from imumon.tui.channel_table import GRADED
from imumon.tui.compare import comparison
from imumon.tui.formatting import Line, about, clock, fitted, length, padded, wrap
from imumon.tui.view_state import ViewState
from imumon.units import number


def _pair(name: str, value: object, note: str = "", role: str = "text") -> Line:
    """One line of a card: a name, its value, and a remark."""
    text = "–" if value is None else str(value)
    return [
        (f"  {name:<20}", "muted"),
        (text, "faint" if value is None else role),
        (f"   {note}" if note else "", "faint"),
    ]


def _title(text: str) -> Line:
    return [(f" {text}", "title")]


def device(scene: ViewState, width: int, height: int = 0) -> list[Line]:
    """Who the sensor is, what its numbers describe, and how the line does."""
    report = scene.report
    if report is None:
        return []
    wide = width >= 110
    half = width // 2 if wide else width
    first = [_identity(report), _stream(report), _notes(report, half)]
    second = [_link(report), _left_out(report)]
    settings = _settings(report, width)
    if not wide:
        cards = [*first, settings, *second]
        return [padded(line, width) for card in cards if card for line in [*card, []]]
    left, right = ([line for card in cards if card for line in [*card, []]] for cards in (first, second))
    count = max(len(left), len(right))
    left += [[]] * (count - len(left))
    right += [[]] * (count - len(right))
    both = [padded(a, half) + padded(b, width - half) for a, b in zip(left, right, strict=True)]
    return both + [padded(line, width) for line in settings]


def _identity(report: Report) -> list[Line]:
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
    d = report.device
    meaning = {
        "deltas": "true averages over each interval",
        "uncompensated": "samples before the bias filter",
        "compensated": "samples after the bias filter",
    }
    alias, note, role = None, "unknown: the filter register was not read", "text"
    if d.alias_factor is not None:
        alias = f"{d.alias_factor:.2f}"
        note = "N is not inflated" if d.alias_factor == 1.0 else "N is too high by this factor, nominally"
        role = "text" if d.alias_factor == 1.0 else "warn"
    rate = None if d.sample_rate_hz is None else f"{d.sample_rate_hz:.6g} Hz"
    return [
        _title("What the numbers describe"),
        _pair("stream", d.stream, meaning.get(d.stream or "", ""), "strong"),
        _pair("message", d.source),
        _pair("sample rate", rate),
        _pair("time from", CLOCKS.get(d.clock or "", d.clock)),
        _pair("alias factor", alias, note, role),
    ]


def _settings(report: Report, width: int) -> list[Line]:
    """Registers by name, what each does, and behind that its value as it is."""
    settings = report.device.settings
    lines = [_title("Settings that change the data")]
    if not settings:
        return [*lines, [("  not read from the sensor", "faint")]]
    wide = min(max(map(len, settings)), max(width // 2 - 6, 1))
    for name, value in settings.items():
        said = describe_setting(name, value)
        line: Line = [(f"  {name[:wide]:<{wide}}   ", "muted"), (said or value, "text")]
        raw: Line = [(f"   {value}", "faint")] if said else []
        lines.append(fitted([line, raw], width))
    return lines


def _link(report: Report) -> list[Line]:
    s = report.session
    expected = s.samples + s.missing
    share = f"{100 * s.missing / expected:.2g} %" if s.missing and expected else ""
    return [
        _title("Line"),
        _pair("since", None if s.started is None else s.started[:19].replace("T", " ") + " UTC"),
        _pair("elapsed", clock(s.elapsed_s)),
        _pair("samples", f"{s.samples:,}"),
        _pair("missing", f"{s.missing:,}", share, "warn" if s.missing else "text"),
        _pair("gaps", f"{s.gaps:,}", role="warn" if s.gaps else "text"),
        _pair("failed checksums", f"{s.bad_checksums:,}", role="warn" if s.bad_checksums else "text"),
        _pair(
            "discarded bytes",
            f"{s.discarded_bytes:,}",
            f"of {s.received_bytes:,}" if s.received_bytes else "",
        ),
        _pair("overruns", f"{s.overruns:,}", role="warn" if s.overruns else "text"),
        _pair("duplicates", f"{s.duplicates:,}"),
        _pair("restarts", f"{s.restarts:,}"),
    ]


def _left_out(report: Report) -> list[Line]:
    s = report.session
    by, alone = excluded_by(report)
    return [
        _title("Cut out"),
        _pair("disturbances", f"{s.disturbances:,}"),
        _pair("excluded", clock(s.excluded_s)),
        *(_pair(f"  by {reason}", clock(seconds)) for reason, seconds in by.items()),
        *([_pair("magnetometer alone", clock(alone))] if alone else []),
        _pair("warm-up", clock(s.warmup_s)),
    ]


def _notes(report: Report, width: int) -> list[Line]:
    """Caveats of the numbers, and what is not known of the sensor or not as it should be."""
    lines: list[Line] = []
    for caveat in (*caveat_lines(report), *report.device.remarks):
        for k, text in enumerate(wrap(caveat, max(width - 5, 10))):
            lines.append([("  ! " if not k else "    ", "warn"), (text, "text")])
    return [_title("Caveats"), *lines] if lines else []


_KINDS = {
    "disconnect": "bad",
    "gap": "warn",
    "disturbance": "warn",
    "connect": "good",
    "restart": "warn",
    "grade": "accent",
}


def chosen_events(events: Sequence[Event], needle: str) -> list[Event]:
    """Events whose kind, channel or text hold every word asked for."""
    wanted = needle.casefold().split()
    return [e for e in events if all(w in f"{e.kind} {e.channel or ''} {e.text}".casefold() for w in wanted)]


def events(scene: ViewState, width: int, height: int = 0) -> list[Line]:
    """The log, newest first."""
    found = chosen_events(scene.events, scene.needle)
    kept = f"{len(found)} of {len(scene.events)}" if scene.needle else f"{len(found)}"
    head: Line = [(" events ", "title"), (kept, "muted")]
    if scene.needle:
        head += [(f"   with '{scene.needle}'", "bound"), ("   esc", "key"), (" shows all again", "muted")]
    else:
        head += [("   /", "key"), (" filters", "muted")]
    lines: list[Line] = [padded(head, width), []]
    if not found:
        lines.append([(" nothing has happened" if not scene.events else " none of them matches", "faint")])
    for event in reversed(found):
        role = next((r for kind, r in _KINDS.items() if kind in event.kind), "text")
        stem: Line = [(f" {event.time[:10]} {event.time[11:19]} ", "faint"), (f"{event.kind:<14}", role)]
        room = max(width - length(stem) - 1, 12)
        text = (
            event.text
            if event.channel is None or event.channel in event.text
            else f"{event.channel}: {event.text}"
        )
        for k, part in enumerate(wrap(text, room)):
            lines.append([*(stem if not k else [(" " * length(stem), "text")]), (part, "text")])
    return [padded(line, width) for line in lines]


def sensors(scene: ViewState, width: int, height: int = 0) -> list[Line]:
    """Every device: state, grades, elapsed; and two of them side by side."""
    lines: list[Line] = [padded([(" sensors ", "title"), (str(len(scene.reports)), "muted")], width), []]
    head = f"   {'state':<16}{'name':<24}{'gyro':<12}{'accel':<12}{'elapsed':<12}"
    lines.append([(head, "muted")])
    for name, report in sorted(scene.reports.items()):
        now = scene.situation(name)
        line: Line = [
            ("▌" if name == scene.id else " ", "accent"),
            (f" {now.mark} {now.word:<14}"[:18], now.role),
        ]
        line = padded(line, 19)
        line.append((f"{name:<24}" if len(name) < 24 else f"{name[:22]}… ", "strong"))
        for sensor in GRADED:
            grade = report.grade.get(sensor)
            nearest = grade.nearest if grade is not None else None
            line.append((f"{nearest or '–':<12}", f"grade-{nearest}" if nearest else "faint"))
        line.append((f"{clock(report.session.elapsed_s):<12}", "text"))
        tail = (
            "compared"
            if name == scene.other
            else about(scene.ages.get(name, 0.0)) + " ago"
            if not now.live
            else ""
        )
        line.append((tail, "bound" if name == scene.other else "warn"))
        line = padded(line, width)
        lines.append([(t, f"{r.partition('/')[0]}/chosen") for t, r in line] if name == scene.id else line)
    if len(scene.reports) < 2:
        lines += [[], [("   another sensor stands here as soon as its daemon answers", "faint")]]
    else:
        lines += [
            [],
            [
                ("   arrows choose", "faint"),
                (" · ", "faint"),
                (
                    "c compares the chosen one with the next"
                    if scene.other is None
                    else "c goes on to the next, then to none",
                    "faint",
                ),
            ],
        ]
    return [padded(line, width) for line in [*lines, [], *comparison(scene)]]


def drift(scene: ViewState, width: int, height: int = 0) -> list[Line]:
    """Shape of the values, slope of the mean, and what the temperature has to do with it."""
    channel, name = scene.chosen, scene.channel
    if channel is None or name is None:
        return []
    factor, unit = scene.notation.scale(name)
    notation = scene.notation
    lines = [_shape(channel, width), _slope(channel.drift, factor, unit, width)]
    degrees = scene.report.channels.get("temperature") if scene.report is not None else None
    if degrees is not None and degrees.last is not None:
        celsius = notation.unit("degC")
        heat: list[Line] = [
            [(_LABEL.format("temperature"), "muted"), (f"now {degrees.last:.2f} {celsius}", "text")]
        ]
        if degrees.min is not None and degrees.max is not None:
            heat.append([(f" ({degrees.min:.2f} to {degrees.max:.2f})", "muted")])
        lines.append(fitted([*heat, *_effect(channel.drift, factor, unit)], width))
    shape = channel.distribution
    if shape is not None and shape.recent_mean is not None and shape.recent_std is not None:
        mean, std = number(shape.recent_mean * factor, 4), number(shape.recent_std * factor, 3)
        text = f"mean {mean}   std {std} {unit}"
        lines.append([(_LABEL.format("last minute"), "muted"), (text, "text")])
    return [padded(line, width) for line in lines[:height]]


_LABEL = " {:<13}"


def _shape(channel: Channel, width: int) -> Line:
    """Verdict on the distribution, with its third and fourth moment."""
    shape = channel.distribution
    verdict = shape.verdict if shape is not None and shape.verdict else "not judged yet"
    parts: list[Line] = [[(_LABEL.format("shape"), "muted"), (verdict[: width - 15], "text")]]
    if channel.skewness is not None:
        parts.append([(f"   skewness {channel.skewness:.2g}", "muted")])
    if channel.excess_kurtosis is not None:
        parts.append([(f"   excess kurtosis {channel.excess_kurtosis:.2g}", "muted")])
    return fitted(parts, width)


def _slope(found: Drift | None, factor: float, unit: str, width: int) -> Line:
    """Drift over an hour, with 95 % limits."""
    label = (_LABEL.format("drift"), "muted")
    if found is None or found.per_hour is None:
        return [label, ("not known yet", "faint")]
    hour = f"{number(found.per_hour * factor, 3)} {unit} an hour"
    parts: list[Line] = [[label, (hour, "text" if found.significant else "muted")]]
    if found.significant is False:
        parts.append([("   no more than noise", "muted")])
    if found.per_hour_low is not None and found.per_hour_high is not None:
        low, high = number(found.per_hour_low * factor, 2), number(found.per_hour_high * factor, 2)
        parts.append([(f"   {low} to {high}", "muted")])
    return fitted(parts, width)


def _effect(found: Drift | None, factor: float, unit: str) -> list[Line]:
    """What a degree does to the mean, where it does more than the noise."""
    if found is None or found.per_degC is None:
        return []
    if not follows_temperature(found):
        return [[("   its effect: no more than noise", "muted")]]
    parts: list[Line] = [[(f"   {number(found.per_degC * factor, 3)} {unit} a degree", "text")]]
    if found.explained is not None:
        parts.append([(f", {100 * found.explained:.0f} % of the drift", "muted")])
    return parts
