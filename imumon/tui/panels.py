"""Pages: status line, headline grades, the chosen channel in full, and what to do when nobody answers."""

from __future__ import annotations

from imumon.messages import caveat_lines, caveats, within
from imumon.report import COEFFICIENTS, Channel, Coefficient, Report, SensorGrade
from imumon.samples import sensor_of
from imumon.tui.block_letters import headline
from imumon.tui.channel_table import GRADED
from imumon.tui.formatting import (
    Line,
    Notation,
    about,
    clock,
    fitted,
    length,
    on,
    padded,
    remaining,
    signed,
    wrap,
)
from imumon.tui.view_state import MOVING, WARMING, Situation, ViewState
from imumon.units import counted, number

# ---------------------------------------------------------------------------- status line


def status(scene: ViewState, width: int, height: int = 1) -> list[Line]:
    """State, sensor, port, rate, elapsed, gaps, errors, temperature, as far as there is room."""
    now = scene.situation()
    ground = "status" if now.live else "alarm" if now.role == "bad" else "status"
    line: Line = [(f" {now.mark} {now.word} ", f"{now.role}-strong")]
    right: Line = []
    if scene.frozen:
        right = [(" frozen: f goes on ", "chip"), (" ", "text")]
    room = width - length(right)
    last = now.kind in ("warming", "moving")  # what they mean gives way to the facts
    first = now.text if not last and (not now.live or now.kind in ("starting", "finished")) else ""
    if first:
        line.append((f" {first}", "text"))
    report = scene.report
    if report is not None:
        parts = [*_facts(report, scene), *([[(now.text, "text")]] if last else [])]
        for k, part in enumerate(parts):
            piece: Line = [(" · " if k or first else "  ", "faint"), *part]
            if length(line) + length(piece) > room - 1:
                continue
            line += piece
    line = padded(line, room) + right
    return [on(line, ground)]


def _facts(report: Report, scene: ViewState) -> list[Line]:
    """What the status line tells, the most important first."""
    device, session = report.device, report.session
    facts: list[Line] = [[(device.id, "strong")]]
    if not session.samples:
        return facts + ([[(device.port, "muted")]] if device.port is not None else [])
    if device.sample_rate_hz is not None:
        facts.append([(f"{device.sample_rate_hz:.4g} Hz", "text")])
    facts.append([(clock(session.elapsed_s), "text")])
    for count, what in ((session.gaps, "gap"), (session.bad_checksums, "error")):
        facts.append([(counted(count, what), "warn" if count else "text")])
    degrees = report.channels.get("temperature")
    if degrees is not None and degrees.last is not None:
        facts.append([(f"{degrees.last:.1f} {scene.notation.unit('degC')}", "text")])
    if device.port is not None:
        facts.append([(device.port, "muted")])
    if device.stream is not None:
        facts.append([(device.stream, "muted")])
    if device.model is not None:
        facts.append([(device.model, "muted")])
    if report.speed != 1.0:
        facts.insert(3, [(f"time-lapse ×{report.speed:g}", "bound")])
    names = list(scene.reports)
    if scene.id is not None and len(names) > 1:
        facts.insert(1, [(f"{names.index(scene.id) + 1} of {len(names)}", "bound")])
    return facts


# ---------------------------------------------------------------------------- headline grades


def plates(scene: ViewState, width: int, height: int) -> list[Line]:
    """Headline grade of gyro and accelerometer: large where there is room, else one line."""
    report = scene.report
    if report is None:
        return []
    if height >= 6 and width >= 78:
        return _large(report, scene.notation, width)
    lines = [_one_line(scene, report, width)]
    return lines + _caveats(scene, width, height - 1) if height > 1 else lines


def _one_line(scene: ViewState, report: Report, width: int) -> Line:
    """Headline grades, and at the end the caveats by name, or their number where they do not fit.

    That there are caveats is worth more than what decides the grades. The one that the status line tells is
    not told twice.
    """
    told_above = {"warming": WARMING, "moving": MOVING}.get(scene.situation().kind, frozenset())
    found = [caveat.replace("_", " ") for caveat in caveats(report) if caveat not in told_above]
    line: Line = []
    for why in (True, False):
        line = []
        for sensor in GRADED:
            line += [("   " if line else " ", "text"), *_small(sensor, report.grade.get(sensor), why)]
        for text in (f"! {', '.join(found)} ", f"! {counted(len(found), 'caveat')} "):
            if found and length(line) + len(text) + 2 <= width:
                return [*padded(line, width - len(text)), (text, "warn")]
        if not found:
            break
    short = f"!{len(found)} "
    if found and length(line) + len(short) < width:
        return [*padded(line, width - len(short)), (short, "warn")]
    return padded(line, width)


def _small(sensor: str, grade: SensorGrade | None, why: bool) -> Line:
    """Headline grade in a few words, if wanted with what decides it."""
    if grade is None or grade.nearest is None:
        return [(f"{sensor} ", "muted"), ("no grade yet", "faint")]
    decided = grade.decided_by
    by = f" by {decided.coefficient} of {decided.axis[-1:]}" if decided and why else ""
    tail = " for now" if grade.provisional else ""
    return [
        (f"{sensor} ", "muted"),
        (grade.nearest.upper(), f"grade-{grade.nearest}-strong"),
        (by + tail, "muted"),
    ]


def _large(report: Report, notation: Notation, width: int) -> list[Line]:
    """Two plates side by side: sensor, grade in letters, what decides it."""
    half = width // 2
    lines: list[Line] = [[] for _ in range(6)]
    for sensor in GRADED:
        for line, part in zip(lines, _plate(sensor, report, notation, half), strict=True):
            line += padded(part, half)
    return [padded(line, width) for line in lines]


def _plate(sensor: str, report: Report, notation: Notation, width: int) -> list[Line]:
    """Six lines of one sensor's headline."""
    title = {"gyro": "gyroscope", "accel": "accelerometer"}[sensor]
    head: Line = [("  ", "text"), (title, "title")]
    grade = report.grade.get(sensor)
    if grade is None or grade.nearest is None:
        reason = (grade.reason if grade is not None else None) or "no coefficient is known well enough"
        text = [f"  {line}" for line in wrap(reason, width - 4)[:2]]
        return [
            head,
            [],
            [("  no grade yet", "muted")],
            *([(line, "faint")] for line in [*text, ""][:2]),
            [],
        ]
    head += [("  nearest grade", "faint"), (", for now" if grade.provisional else "", "warn")]
    role = f"grade-{grade.nearest}"
    rows = ["", grade.nearest.upper(), ""] if notation.ascii else headline(grade.nearest)
    return [
        head,
        *([("  ", "text"), (row, role)] for row in rows),
        _decided(sensor, grade, report, notation, width),
        [(f"  {within(grade.meets)}", "muted")],
    ]


def _decided(sensor: str, grade: SensorGrade, report: Report, notation: Notation, width: int) -> Line:
    """The figure that decides a grade, and the limit of that grade.

    The limit is worth more than the unit, which heads the column of the table too.
    """
    if grade.decided_by is None or grade.nearest is None:
        return []
    axis, name = grade.decided_by.axis[-1:], grade.decided_by.coefficient
    by: Line = [("  by ", "faint"), (f"{name} of {axis}", "text")]
    channel = report.channels.get(f"{sensor}/{axis}")
    figure: Coefficient | None = getattr(channel, name, None)
    limit = report.limits.get(sensor, {}).get(name, {}).get(grade.nearest)
    if figure is None:
        return by
    value, _, high = notation.limits(figure)
    size: Line = []
    if value is not None or high is not None:
        size = [(f", {number(value, 3) if value is not None else f'< {number(high or 0.0, 2)}'}", "text")]
    unit: Line = [(f" {notation.coefficient_unit(sensor, name)}", "text")] if size else []
    most: Line = [(f", limit {notation.limit(sensor, name, limit)}", "faint")] if limit is not None else []
    whole = [*by, *size, *unit, *most]
    return whole if length(whole) <= width else fitted([[*by, *size], most], width)


# ---------------------------------------------------------------------------- the chosen channel


def detail(scene: ViewState, width: int, height: int) -> list[Line]:
    """The chosen channel in full: coefficients with limits, quality of the fit, caveats."""
    channel, name = scene.chosen, scene.channel
    if channel is None or name is None or height < 1:
        return []
    notation = scene.notation
    factor, unit = notation.scale(name)
    lines: list[Line] = [
        fitted([[(f" {name.replace('/', ' ')}", "title")], *_mean(channel, notation, factor, unit)], width)
    ]
    for part in COEFFICIENTS:
        found = getattr(channel, part)
        if found is not None:
            lines.append(_limits(notation, sensor_of(name), part, found, channel))
    if channel.allan is not None:
        lines.append(_quality(channel, notation))
    shape = channel.distribution
    if shape is not None and shape.verdict:
        lines.append([("   shape ", "muted"), (shape.verdict, "text")])
    caveats = _caveats(scene, width, max(height - len(lines) - 1, 0))
    if caveats:
        lines += [[], *caveats]
    return [padded(line, width) for line in lines[:height]]


def _mean(channel: Channel, notation: Notation, factor: float, unit: str) -> list[Line]:
    """Mean with what it is worth, the last value, and the range."""
    if channel.mean is None:
        return [[("   no value yet", "faint")]]
    shape = channel.distribution
    mean: Line = [("   mean ", "muted"), (signed(channel.mean * factor, 5), "text")]
    parts: list[Line] = [mean]
    if shape is not None and shape.bias_low is not None and shape.bias_high is not None:
        half = 0.5 * (shape.bias_high - shape.bias_low) * factor
        about = (f" {notation.about} {number(half, 2)}", "text")
        if shape.bias is not None and shape.bias != channel.mean:  # of a sensor whose rest is not zero
            parts.append([("   bias ", "muted"), (signed(shape.bias * factor, 3), "text"), about])
        else:
            mean.append(about)
    elif shape is not None and shape.bias_reason:
        parts.append([("   bias ", "muted"), (shape.bias_reason, "faint")])
    mean.append((f" {unit}", "muted"))
    if channel.last is not None:
        parts.append([("   now ", "muted"), (signed(channel.last * factor, 5), "text")])
    if channel.min is not None and channel.max is not None:
        span = f"{signed(channel.min * factor)} to {signed(channel.max * factor)}"
        parts.append([("   range ", "muted"), (span, "text")])
    return parts


def _limits(notation: Notation, sensor: str, name: str, part: Coefficient, channel: Channel) -> Line:
    """A coefficient with its unit, limits, the classical reading and how long still."""
    value, low, high = notation.limits(part)
    unit = notation.coefficient_unit(sensor, name)
    line: Line = [(f"   {name} ", f"{name}-strong")]
    seconds = remaining(channel.time_to, name)
    precision = {"N": 1, "B": 20, "K": 50}[name]
    if part.status == "measured" and value is not None:
        line.append((f"{number(value, 4):>9} {unit:<12}", "text"))
        if low is not None and high is not None:
            line += [("95 % ", "faint"), (f"{number(low, 3)} to {number(high, 3)}", "muted")]
    elif part.status == "upper_bound" and high is not None:
        line += [(f"{'< ' + number(high, 2):>9} {unit:<12}", "bound"), ("95 % bound; not seen yet", "muted")]
    else:
        line += [(f"{'–':>9} {unit:<12}", "faint"), (part.reason or "too short to say anything", "muted")]
    if seconds:
        line = [*padded(line, 56), (f"{notation.about}{precision}% in {about(seconds)}", "muted")]
    return line


def _quality(channel: Channel, notation: Notation) -> Line:
    """How well the model fits, and how many octaves stand behind it."""
    line: Line = [("   fit ", "muted")]
    if channel.fit is None or channel.fit.chi2 is None or not channel.fit.dof:
        line.append(("not yet", "faint"))
    else:
        line += [(f"{notation.chi2} {channel.fit.chi2 / channel.fit.dof:.2f}", "text")]
        if channel.fit.p_value is not None:
            line.append((f"  p {channel.fit.p_value:.2g}", "muted"))
    allan = channel.allan
    if allan is not None and allan.tau_s:
        line.append(
            (
                f"   {sum(allan.used)} of {len(allan.tau_s)} octaves   longest {clock(allan.tau_s[-1])}",
                "muted",
            )
        )
    return line


def _caveats(scene: ViewState, width: int, height: int) -> list[Line]:
    """What one must know before believing the numbers, each with the channels it holds for."""
    report = scene.report
    if report is None or height < 1:
        return []
    lines: list[Line] = []
    for caveat in caveat_lines(report):
        for k, text in enumerate(wrap(caveat, max(width - 6, 10))):
            lines.append([("   ! " if not k else "     ", "warn"), (text, "muted")])
    return [padded(line, width) for line in lines[:height]]


# ---------------------------------------------------------------------------- nothing to show


def welcome(scene: ViewState, width: int, height: int) -> list[Line]:
    """What to type while there is no report."""
    now: Situation = scene.situation()
    where = scene.endpoint or "tcp/127.0.0.1:7448 to 7463"
    lines: list[Line] = []
    if scene.report is None and scene.ended:
        lines = [
            [("The daemon has ended. Its last word:", "strong")],
            *([(line, "text")] for line in wrap(scene.ended, max(width - 2, 1))),
            [],
            [("q leaves; what stands in the way says", "muted")],
            [("    imumon doctor", "accent")],
        ]
    elif now.kind == "nobody" and scene.starting:
        lines = [[(scene.starting, "strong")], [("A few seconds.", "muted")]]
    elif now.kind == "nobody":
        lines = [
            [("No daemon answers yet.", "strong")],
            [(f"Tried {where}; still trying.", "muted")],
            [],
            [("A VN-100 on this machine", "muted")],
            [("    imumon run", "accent")],
            [],
            [("No sensor at hand: a simulated one", "muted")],
            [("    imumon demo", "accent")],
            [],
            [("A daemon on another machine", "muted")],
            [("    imumon tui --connect tcp/HOST:7448", "accent")],
            [],
            [("Nothing works?", "muted")],
            [("    imumon doctor", "accent")],
        ]
    elif scene.report is None:
        wanted = f" of {scene.wanted}" if scene.wanted else ""
        lines = [
            [("A daemon is there.", "strong")],
            [(f"Waiting for the first report{wanted}.", "muted")],
        ]
    else:
        lines = [
            [(f"{scene.report.device.id}: {now.word}.", "strong")],
            [(f"{now.text}.".capitalize(), "muted")],
            [],
            [("What stands in the way?", "muted")],
            [("    imumon doctor", "accent")],
        ]
    inner = max(length(line) for line in lines)
    left = max((width - inner) // 2, 0)
    top = max((height - len(lines)) // 2, 0)
    return [padded([], width) for _ in range(top)] + [
        padded([(" " * left, "text"), *line], width) for line in lines
    ]
