"""Status line, headline grades, the selected channel in full, and the page while there is no report."""

from __future__ import annotations

from imumon.messages import caveat_lines, caveats, within
from imumon.report import COEFFICIENTS, Channel, Coefficient, Report, SensorGrade
from imumon.samples import sensor_of
from imumon.tui.channel_table import GRADED
from imumon.tui.formatting import (
    Line,
    Notation,
    approximate_duration,
    fitted,
    length,
    padded,
    remaining,
    with_background,
    wrap,
)
from imumon.tui.view_state import MOTION_CAVEATS, WARMUP_CAVEATS, ConnectionStatus, ViewState
from imumon.units import counted, duration, number

# ---------------------------------------------------------------------------- status line


def status(state: ViewState, width: int, height: int = 1) -> list[Line]:
    """Return status, sensor, rate, elapsed time, gaps, errors, temperature ..., as far as they fit."""
    now = state.connection_status()
    background = "alarm" if not now.live and now.role == "bad" else "status"
    line: Line = [(f" {now.mark} {now.title} ", f"{now.role}-strong")]
    right: Line = [(" frozen: f continues ", "chip"), (" ", "text")] if state.frozen else []
    available = width - length(right)
    explained_last = now.kind in ("warming_up", "moving")  # the facts matter more
    explained_first = (
        now.text and not explained_last and (not now.live or now.kind in ("starting", "finished"))
    )
    if explained_first:
        line.append((f" {now.text}", "text"))
    report = state.report
    if report is not None:
        parts = [*_facts(report, state), *([[(now.text, "text")]] if explained_last else [])]
        for k, part in enumerate(parts):
            addition: Line = [(" · " if k or explained_first else "  ", "faint"), *part]
            if length(line) + length(addition) < available:
                line += addition
    return [with_background(padded(line, available) + right, background)]


def _facts(report: Report, state: ViewState) -> list[Line]:
    """Return the parts of the status line, the most important first."""
    device, session = report.device, report.session
    facts: list[Line] = [[(device.id, "strong")]]
    if not session.samples:
        return facts + ([[(device.port, "muted")]] if device.port is not None else [])
    if device.sample_rate_hz is not None:
        facts.append([(f"{device.sample_rate_hz:.4g} Hz", "text")])
    facts.append([(duration(session.elapsed_s), "text")])
    for count, what in ((session.gaps, "gap"), (session.bad_checksums, "error")):
        facts.append([(counted(count, what), "warn" if count else "text")])
    degrees = report.channels.get("temperature")
    if degrees is not None and degrees.last is not None:
        facts.append([(f"{degrees.last:.1f} {state.notation.unit('degC')}", "text")])
    if device.port is not None:
        facts.append([(device.port, "muted")])
    if device.stream is not None:
        facts.append([(device.stream, "muted")])
    if device.model is not None:
        facts.append([(device.model, "muted")])
    if report.speed != 1.0:
        facts.insert(3, [(f"time-lapse ×{report.speed:g}", "bound")])
    names = list(state.reports)
    if state.id is not None and len(names) > 1:
        facts.insert(1, [(f"{names.index(state.id) + 1} of {len(names)}", "bound")])
    return facts


# ---------------------------------------------------------------------------- headline grades


def headlines(state: ViewState, width: int, height: int) -> list[Line]:
    """Return the headline grades of gyroscope and accelerometer: in large letters, or in one line."""
    report = state.report
    if report is None:
        return []
    if height >= 6 and width >= 78:
        return _large(report, state.notation, width)
    lines = [_one_line(state, report, width)]
    return lines + _caveats(state, width, height - 1) if height > 1 else lines


def _one_line(state: ViewState, report: Report, width: int) -> Line:
    """Return the grades, and at the end the caveats by name, or their number where the names do not fit.

    The existence of caveats matters more than what decides the grades. A caveat that the status line shows is
    not repeated.
    """
    repeated = {"warming_up": WARMUP_CAVEATS, "moving": MOTION_CAVEATS}
    shown_above = repeated.get(state.connection_status().kind, frozenset())
    names = [caveat.replace("_", " ") for caveat in caveats(report) if caveat not in shown_above]
    line: Line = []
    for why in (True, False):
        line = []
        for sensor in GRADED:
            line += [("   " if line else " ", "text"), *_small(sensor, report.grade.get(sensor), why)]
        for text in (f"! {', '.join(names)} ", f"! {counted(len(names), 'caveat')} "):
            if names and length(line) + len(text) + 2 <= width:
                return [*padded(line, width - len(text)), (text, "warn")]
        if not names:
            break
    shortest = f"!{len(names)} "
    if names and length(line) + len(shortest) < width:
        return [*padded(line, width - len(shortest)), (shortest, "warn")]
    return padded(line, width)


def _small(sensor: str, grade: SensorGrade | None, why: bool) -> Line:
    """Return a headline grade in a few words, with what decides it if `why`."""
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
    """Return two panels side by side: sensor, grade in large letters, what decides it."""
    half = width // 2
    lines: list[Line] = [[] for _ in range(6)]
    for sensor in GRADED:
        for line, part in zip(lines, _headline(sensor, report, notation, half), strict=True):
            line += padded(part, half)
    return [padded(line, width) for line in lines]


def _headline(sensor: str, report: Report, notation: Notation, width: int) -> list[Line]:
    """Return the six lines of one sensor."""
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
    rows = ["", grade.nearest.upper(), ""] if notation.ascii else block_letters(grade.nearest)
    return [
        head,
        *([("  ", "text"), (row, role)] for row in rows),
        _decided(sensor, grade, report, notation, width),
        [(f"  {within(grade.meets)}", "muted")],
    ]


def _decided(sensor: str, grade: SensorGrade, report: Report, notation: Notation, width: int) -> Line:
    """Return the value that decides a grade, and the limit of that grade.

    The limit matters more than the unit, which the table also shows.
    """
    if grade.decided_by is None or grade.nearest is None:
        return []
    axis, name = grade.decided_by.axis[-1:], grade.decided_by.coefficient
    by: Line = [("  by ", "faint"), (f"{name} of {axis}", "text")]
    channel = report.channels.get(f"{sensor}/{axis}")
    deciding: Coefficient | None = getattr(channel, name, None)
    limit = report.limits.get(sensor, {}).get(name, {}).get(grade.nearest)
    if deciding is None:
        return by
    value, _, high = notation.limits(deciding)
    size: Line = []
    if value is not None or high is not None:
        size = [(f", {number(value, 3) if value is not None else f'< {number(high or 0.0, 2)}'}", "text")]
    unit: Line = [(f" {notation.coefficient_unit(sensor, name)}", "text")] if size else []
    maximum: Line = [(f", limit {notation.limit(sensor, name, limit)}", "faint")] if limit is not None else []
    whole = [*by, *size, *unit, *maximum]
    return whole if length(whole) <= width else fitted([[*by, *size], maximum], width)


# ---------------------------------------------------------------------------- the selected channel


def detail(state: ViewState, width: int, height: int) -> list[Line]:
    """Return the selected channel in full: coefficients with limits, quality of the fit, caveats."""
    channel, name = state.selected, state.channel
    if channel is None or name is None or height < 1:
        return []
    notation = state.notation
    factor, unit = notation.scale(name)
    lines: list[Line] = [
        fitted([[(f" {name.replace('/', ' ')}", "title")], *_mean(channel, notation, factor, unit)], width)
    ]
    for letter in COEFFICIENTS:
        part = getattr(channel, letter)
        if part is not None:
            lines.append(_limits(notation, sensor_of(name), letter, part, channel))
    if channel.allan is not None:
        lines.append(_quality(channel, notation))
    shape = channel.distribution
    if shape is not None and shape.verdict:
        lines.append([("   shape ", "muted"), (shape.verdict, "text")])
    if cautions := _caveats(state, width, max(height - len(lines) - 1, 0)):
        lines += [[], *cautions]
    return [padded(line, width) for line in lines[:height]]


def _mean(channel: Channel, notation: Notation, factor: float, unit: str) -> list[Line]:
    """Return the mean with its uncertainty, the last value, and the range."""
    if channel.mean is None:
        return [[("   no value yet", "faint")]]
    shape = channel.distribution
    mean: Line = [("   mean ", "muted"), (number(channel.mean * factor, 5), "text")]
    parts: list[Line] = [mean]
    if shape is not None and shape.bias_low is not None and shape.bias_high is not None:
        half = 0.5 * (shape.bias_high - shape.bias_low) * factor
        uncertainty = (f" {notation.plus_minus} {number(half, 2)}", "text")
        if shape.bias is not None and shape.bias != channel.mean:  # a sensor that does not read zero at rest
            parts.append([("   bias ", "muted"), (number(shape.bias * factor, 3), "text"), uncertainty])
        else:
            mean.append(uncertainty)
    elif shape is not None and shape.bias_reason:
        parts.append([("   bias ", "muted"), (shape.bias_reason, "faint")])
    mean.append((f" {unit}", "muted"))
    if channel.last is not None:
        parts.append([("   now ", "muted"), (number(channel.last * factor, 5), "text")])
    if channel.min is not None and channel.max is not None:
        span = f"{number(channel.min * factor, 4)} to {number(channel.max * factor, 4)}"
        parts.append([("   range ", "muted"), (span, "text")])
    return parts


def _limits(notation: Notation, sensor: str, name: str, part: Coefficient, channel: Channel) -> Line:
    """Return a coefficient with its unit, limits, and the time until the configured precision."""
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
        line = [
            *padded(line, 56),
            (f"{notation.plus_minus}{precision}% in {approximate_duration(seconds)}", "muted"),
        ]
    return line


def _quality(channel: Channel, notation: Notation) -> Line:
    """Return how well the model fits, and how many octaves it uses."""
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
                f"   {sum(allan.used)} of {len(allan.tau_s)} octaves   longest {duration(allan.tau_s[-1])}",
                "muted",
            )
        )
    return line


def _caveats(state: ViewState, width: int, height: int) -> list[Line]:
    """Return what restricts the numbers, each with the channels it holds for."""
    report = state.report
    if report is None or height < 1:
        return []
    lines: list[Line] = []
    for caveat in caveat_lines(report):
        for k, text in enumerate(wrap(caveat, max(width - 6, 10))):
            lines.append([("   ! " if not k else "     ", "warn"), (text, "muted")])
    return [padded(line, width) for line in lines[:height]]


# ---------------------------------------------------------------------------- nothing to show


DEFAULT_ENDPOINTS = "tcp/127.0.0.1:7448 to 7463"


def welcome(state: ViewState, width: int, height: int) -> list[Line]:
    """Return what to type while there is no report."""
    lines = _welcome_text(state, width)
    left = max((width - max(map(length, lines))) // 2, 0)
    top = max((height - len(lines)) // 2, 0)
    empty: list[Line] = [[] for _ in range(top)]
    return [padded(line, width) for line in [*empty, *([(" " * left, "text"), *line] for line in lines)]]


def _welcome_text(state: ViewState, width: int) -> list[Line]:
    now: ConnectionStatus = state.connection_status()
    if state.report is None and state.ended:
        return [
            [("The daemon has ended. Its last message:", "strong")],
            *([(line, "text")] for line in wrap(state.ended, max(width - 2, 1))),
            [],
            [("q quits; this command finds the cause:", "muted")],
            [("    imumon doctor", "accent")],
        ]
    if now.kind == "no_daemon" and state.starting:
        return [[(state.starting, "strong")], [("A few seconds.", "muted")]]
    if now.kind == "no_daemon":
        return [
            [("No daemon answers yet.", "strong")],
            [(f"Tried {state.endpoint or DEFAULT_ENDPOINTS}; still trying.", "muted")],
            [],
            [("A sensor on this machine", "muted")],
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
    if state.report is None:
        whose = f" of {state.requested_id}" if state.requested_id else ""
        return [
            [("A daemon is running.", "strong")],
            [(f"Waiting for the first report{whose}.", "muted")],
        ]
    return [
        [(f"{state.report.device.id}: {now.title}.", "strong")],
        [(f"{now.text}.".capitalize(), "muted")],
        [],
        [("This command finds the cause:", "muted")],
        [("    imumon doctor", "accent")],
    ]


# ---------------------------------------------------------------------------- large letters

_SHAPES = {
    "A": (".#.", "#.#", "###", "#.#", "#.#"),
    "C": ("###", "#..", "#..", "#..", "###"),
    "D": ("##.", "#.#", "#.#", "#.#", "##."),
    "E": ("###", "#..", "##.", "#..", "###"),
    "G": ("###", "#..", "#.#", "#.#", "###"),
    "I": ("#", "#", "#", "#", "#"),
    "L": ("#..", "#..", "#..", "#..", "###"),
    "M": ("#...#", "##.##", "#.#.#", "#...#", "#...#"),
    "N": ("#..#", "##.#", "#.##", "#..#", "#..#"),
    "O": ("###", "#.#", "#.#", "#.#", "###"),
    "R": ("##.", "#.#", "##.", "#.#", "#.#"),
    "S": ("###", "#..", "###", "..#", "###"),
    "T": ("###", ".#.", ".#.", ".#.", ".#."),
    "U": ("#.#", "#.#", "#.#", "#.#", "###"),
    "V": ("#.#", "#.#", "#.#", "#.#", ".#."),
}
"""Letters that occur in names of grades, five dots high."""

_BLOCK = {"..": " ", "#.": "▀", ".#": "▄", "##": "█"}


def block_letters(word: str) -> list[str]:
    """Return three rows of cells that spell a word in half blocks; plain text if a letter has no shape.

    >>> block_letters("it"), block_letters("x")
    (['█ ▀█▀', '█  █ ', '▀  ▀ '], ['', 'X', ''])
    """
    if not set(word.upper()) <= set(_SHAPES):
        return ["", word.upper(), ""]
    shapes = [_SHAPES[letter] for letter in word.upper()]
    dots = [".".join(shape[row] for shape in shapes) for row in range(5)]
    dots.append("." * len(dots[0]))
    return ["".join(_BLOCK[a + b] for a, b in zip(dots[r], dots[r + 1], strict=True)) for r in (0, 2, 4)]
