"""Status line, footer, headline grades, the selected channel in full, and the page while there is no report."""

from __future__ import annotations

from imumon.model.coefficients import INDISTINCT_WORD, SCALE, Estimate
from imumon.model.messages import GRADE_MEANING, NOT_APART, caveat_lines, caveats, grade_text, loss_label
from imumon.model.readiness import ready_text, seconds_left
from imumon.model.report import Channel, Report, SensorGrade
from imumon.model.samples import INERTIAL, TEMPERATURE, ChannelName
from imumon.model.units import counted, duration, number, pretty, sentence
from imumon.tui.formatting import (
    Line,
    Notation,
    Span,
    approximate_duration,
    fitted,
    length,
    marked,
    padded,
    with_background,
    wrap,
)
from imumon.tui.view_state import SHOWN_CAVEATS, VIEWS, ViewState

# ---------------------------------------------------------------------------- status line


def status(state: ViewState, width: int, height: int = 1) -> list[Line]:
    """Return status, sensor, rate, elapsed time, gaps, errors, temperature ..., as far as they fit."""
    now = state.connection_status()
    # an alarm is the loss of the sensor or of the daemon; what delays is a warning
    background = "alarm" if not now.live and now.role == "bad" else "status"
    line: Line = [(f" {now.mark} {now.title} ", f"{now.role}-strong")]
    right: Line = [(" frozen: f continues ", "chip"), (" ", "text")] if state.frozen else []
    available = width - length(right)
    explained_last = now.kind in ("warming_up", "moving")  # the facts matter more
    if now.text and not explained_last:
        line.append((f" {now.text}", "text"))
    if state.has_report:
        facts = _facts(state.report, state) + ([[(now.text, "text")]] if explained_last else [])
        for k, fact in enumerate(facts):  # a later, shorter one may fit where an earlier one does not
            addition: Line = [("  " if not k and len(line) == 1 else " · ", "faint"), *fact]
            if length(line) + length(addition) < available:
                line += addition
    return [with_background(padded(line, available) + right, background)]


def _facts(report: Report, state: ViewState) -> list[Line]:
    """Return the parts of the status line, the most important first."""
    device, session, names = report.device, report.session, list(state.reports)
    if not session.samples:  # counts and times would all be 0
        return [[(device.id, "strong")], *([[(device.port, "muted")]] if device.port is not None else [])]
    temperature = report.channels.get(TEMPERATURE)
    degrees = temperature.last if temperature is not None else None
    position = f"{names.index(state.id) + 1} of {len(names)}" if state.id and len(names) > 1 else None
    facts = (
        (device.id, "strong"),
        (position, "bound"),
        (None if device.sample_rate_hz is None else f"{device.sample_rate_hz:.4g} Hz", "text"),
        (duration(session.elapsed_s), "text"),
        (f"time-lapse ×{report.time_lapse:g}" if report.time_lapse is not None else None, "bound"),
        (loss_label(report) if session.recent_loss else None, "warn" if report.is_lossy else "text"),
        (counted(session.gaps, "gap"), "warn" if session.gaps else "text"),
        (counted(session.bad_checksums, "error"), "warn" if session.bad_checksums else "text"),
        (None if degrees is None else f"{degrees:.1f} {pretty('degC')}", "text"),
        *((text, "muted") for text in (device.port, device.stream, device.model)),
    )
    return [[(text, role)] for text, role in facts if text is not None]


# ---------------------------------------------------------------------------- footer


VIEW_KEYS = {
    "overview": (
        ("c", "copy"),
        ("z", "chart"),
        ("o", "axes"),
        ("g", "grades"),
        ("b", "keep"),
    ),
    "signal": (("w", "window"),),
    "events": (("/", "filter"),),
    "over time": (("+-", "span"),),
}
"""The keys of each view that a user has to know of."""


FIRST_KEYS = (("?", "help"), ("q", "quit"))
LAST_KEYS = (("s", "save"), ("u", "units"), ("f", "freeze"))
"""Keys that are everywhere: before those of the view, and behind them."""


def _footer_keys(state: ViewState) -> list[Line]:
    """Return the keys of the footer, the most important first."""
    keys = (*FIRST_KEYS, *VIEW_KEYS.get(state.view, ()), *LAST_KEYS)
    return [[(f" {key} ", "key"), (name, "muted")] for key, name in keys]


def tabs(state: ViewState, width: int) -> Line:
    """Return the views of the footer, the visible one highlighted; by name where the first keys have room beside them.

    The help lists every key; nothing else lists the views.
    """
    named = [f"{k} {name} " for k, name in enumerate(VIEWS, 1)]
    needed = sum(map(len, named)) + sum(map(length, _footer_keys(state)[: len(FIRST_KEYS)]))
    return [
        (text if needed < width or name == state.view else text[:2], "tab" if name == state.view else "muted")
        for name, text in zip(VIEWS, named, strict=True)
    ]


def footer(state: ViewState, width: int, height: int = 1) -> list[Line]:
    """Return the views and the most important keys, those of the view before those that are everywhere."""
    line, right = tabs(state, width), list[Span]()
    for item in _footer_keys(state):
        if length(line) + length(right) + length(item) < width:
            right += item
    return [
        with_background([*padded(line, max(width - length(right) - 1, 0)), *right, (" ", "text")], "footer")
    ]


# ---------------------------------------------------------------------------- headline


def headlines(state: ViewState, width: int, height: int) -> list[Line]:
    """Return whether the numbers are ready, and the grades with what decides them as far as there is room.

    The first line ends with the caveats by name, or with their number where the names do not fit: that they
    exist matters more than the grades. A caveat that the status line shows is not repeated.
    """
    report = state.report
    shown_above = SHOWN_CAVEATS.get(state.connection_status().kind)
    names = [caveat.replace("_", " ") for caveat in caveats(report) if caveat != shown_above]
    notes = [f"  ! {', '.join(names)} ", f"  ! {counted(len(names), 'caveat')} ", f" !{len(names)} "]
    ready: Line = [(f" {ready_text(report, state.program, approximate_duration)}", "strong")]
    fits = [text for text in notes if length(ready) + len(text) <= width] or notes[-1:]
    note = fits[0] if names else ""
    lines: list[Line] = [[*padded(ready, width - len(note)), (note, "warn")]]
    if not report.session.samples:  # why there is none matters more than grades that are not known
        texts = [text for remark in report.device.remarks for text in wrap(remark, max(width - 2, 10))]
        lines += [[(f" {text}", "warn")] for text in texts]
    if height > len(INERTIAL):
        lines += _grades(report, state.notation, width, spacious=height > 2 * len(INERTIAL))
    return [padded(line, width) for line in lines[:height]]


def _grades(report: Report, notation: Notation, width: int, *, spacious: bool) -> list[Line]:
    """Return the grade of each inertial sensor and what decides it, in one line or in two."""
    lines = []
    for sensor in INERTIAL:
        grade = report.grade.get(sensor, SensorGrade())
        role = f"grade-{grade.meets}-strong" if grade.meets else "muted"
        head: Line = [(f" {sensor:<6}", "title"), (grade_text(grade), role)]
        parts = _basis(sensor, grade, report, notation)
        if not spacious:
            lines.append(fitted([head, [("   ", "text")], *parts], width))
            continue
        meaning: Line = [(f": {GRADE_MEANING}", "faint")] if grade.meets else []
        lines += [fitted([head, meaning], width), fitted([[(" " * 7, "text")], *parts], width)]
    return lines


def _basis(sensor: str, grade: SensorGrade, report: Report, notation: Notation) -> list[Line]:
    """Return the value that decides the grade, and the limit of the next better one; without one, the reason."""
    if grade.decided_by is None or grade.meets is None:
        return [[(grade.reason or "no coefficient is known well enough", "faint")]]
    axis, name = grade.decided_by.axis[-1:], grade.decided_by.coefficient
    parts: list[Line] = [[("by ", "faint"), (f"{name} of {axis}", "text")]]
    channel = report.channels.get(ChannelName(f"{sensor}/{axis}"))
    part = channel.estimates.get(name) if channel is not None else None
    value, _, high = notation.limits(part) if part is not None else (None, None, None)
    if value is not None or high is not None:
        text = number(value, 3) if value is not None else f"< {number(high or 0.0, 2)}"
        parts.append([(f", {text} {notation.coefficient_scale(sensor, name)[1]}", "text")])
    # what it exceeds says more than what it meets
    better = SCALE[max(SCALE.index(grade.meets) - 1, 0)] if grade.meets in SCALE else grade.meets
    limit = report.limits.get(sensor, {}).get(name, {}).get(better)
    if limit is not None:
        parts.append([(f"; {better} allows {notation.limit(sensor, name, limit)}", "faint")])
    return parts


# ---------------------------------------------------------------------------- the selected channel


def detail(state: ViewState, width: int, height: int) -> list[Line]:
    """Return the selected channel in full: coefficients with limits, quality of the fit, caveats."""
    channel, name = state.selected, state.channel
    if height < 1:
        return []
    notation = state.notation
    factor, unit = notation.scale(name)
    title: Line = [(f" {name.replace('/', ' ')}", "title")]
    lines = [fitted([title, *_mean(channel, factor, unit)], width)]
    for letter, part in channel.estimates.items():
        line = _limits(notation, name.sensor, letter, part)
        if goal := precision_goal(state, letter):
            line = [*padded(line, 56), (goal, "muted")]  # below one another, behind the longest limits
        lines.append(line)
    if channel.allan is not None:
        lines.append(_quality(channel))
    if cautions := _caveats(state, width, height - len(lines) - 1):
        lines += [[], *cautions]
    return [padded(line, width) for line in lines[:height]]


def _mean(channel: Channel, factor: float, unit: str) -> list[Line]:
    """Return the mean with its uncertainty, the last value, and the range."""
    if channel.mean is None:
        return [[("   no value yet", "faint")]]
    shape = channel.distribution
    mean: Line = [("   mean ", "muted"), (number(channel.mean * factor, 5), "text")]
    parts: list[Line] = [mean]
    if shape is not None and shape.bias_low is not None and shape.bias_high is not None:
        half = 0.5 * (shape.bias_high - shape.bias_low) * factor
        uncertainty = (f" ± {number(half, 2)}", "text")
        # an accelerometer reads gravity at rest: there, the bias is not the mean
        if shape.bias is not None and shape.bias != channel.mean:
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


def precision_goal(state: ViewState, letter: str) -> str:
    """Return the time until a coefficient of the selected channel has its configured precision; empty: none."""
    report, channel = state.report, state.selected
    if report.state != "running" or letter not in report.precision:
        return ""
    seconds = seconds_left(channel, letter, report.precision)
    goal = state.notation.goal(report.precision[letter])
    return f"{goal} in {approximate_duration(seconds)}" if seconds else ""


def _limits(notation: Notation, sensor: str, name: str, part: Estimate) -> Line:
    """Return a coefficient with its unit and limits."""
    value, low, high = notation.limits(part)
    unit = notation.coefficient_scale(sensor, name)[1]
    line: Line = [(f"   {name} ", f"{name}-strong")]
    if part.status == "measured" and value is not None:
        line.append((f"{number(value, 4):>9} {unit:<12}", "text"))
        if low is not None and high is not None:
            line += [("95 % ", "faint"), (f"{number(low, 3)} to {number(high, 3)}", "muted")]
    elif part.is_bound and high is not None:
        text = f"{'< ' + number(high, 2):>9} {unit:<12}"
        why = (
            f"{INDISTINCT_WORD}: {NOT_APART}"
            if part.status == "indistinct"
            else part.reason or "not visible yet"
        )
        line += [(text, "bound"), (f"95 % upper bound; {why}", "muted")]
    else:
        line += [(f"{'–':>9} {unit:<12}", "faint"), (part.reason or "the record is too short", "muted")]
    return line


def _quality(channel: Channel) -> Line:
    """Return how well the model fits, and how many octaves it uses."""
    line: Line = [("   fit ", "muted")]
    fit, allan = channel.fit, channel.allan
    if fit is None or fit.chi2 is None or not fit.dof:
        line.append(("not yet", "faint"))
    else:
        line.append((f"χ²/dof {fit.chi2 / fit.dof:.2f}", "text"))
        line.append((f"  p {fit.p_value:.2g}" if fit.p_value is not None else "", "muted"))
    if allan is not None and allan.tau_s:
        octaves = f"{sum(allan.used)} of {len(allan.tau_s)} octaves"
        line.append((f"   {octaves}   longest {duration(allan.tau_s[-1])}", "muted"))
    return line


def _caveats(state: ViewState, width: int, height: int) -> list[Line]:
    """Return what restricts the numbers, each with the channels it holds for."""
    return marked(caveat_lines(state.report), width, "muted")[: max(height, 0)]


# ---------------------------------------------------------------------------- nothing to show


DEFAULT_ENDPOINTS = "tcp/127.0.0.1:7448 to 7463"


def welcome(state: ViewState, width: int, height: int) -> list[Line]:
    """Return what to type while there is no report."""
    lines = _welcome_text(state, width)
    left = max((width - max(map(length, lines))) // 2, 0)
    top = max((height - len(lines)) // 2, 0)
    empty: list[Line] = [[] for _ in range(top)]
    return [padded(line, width) for line in [*empty, *([(" " * left, "text"), *line] for line in lines)]]


def _advice(*pairs: tuple[str, str]) -> list[Line]:
    """Return situations, each with the command to type."""
    groups = ([[], [(text, "muted")], [(f"    {command}", "accent")]] for text, command in pairs)
    return [line for group in groups for line in group]


def _welcome_text(state: ViewState, width: int) -> list[Line]:
    """Return why nothing is shown, and what to type, by what is known of the daemon."""
    now = state.connection_status()
    if state.has_report:
        return [
            [(f"{state.report.device.id}: {now.title}.", "strong")],
            [(f"{sentence(now.text)}.", "muted")],
            *_advice(("This command finds the cause:", "imumon doctor")),
        ]
    if state.ended:
        return [
            [("The daemon has ended. Its last message:", "strong")],
            *([(line, "text")] for line in wrap(state.ended, width - 2)),
            *_advice(("q quits; this command finds the cause:", "imumon doctor")),
        ]
    if now.kind != "no_daemon":
        whose = f" of {state.requested_id}" if state.requested_id else ""
        return [[("A daemon is running.", "strong")], [(f"Waiting for the first report{whose}.", "muted")]]
    if state.starting:
        return [[(state.starting, "strong")], [("A few seconds.", "muted")]]
    return [
        [("No daemon answers yet.", "strong")],
        [(f"Tried {state.endpoint or DEFAULT_ENDPOINTS}; still trying.", "muted")],
        *_advice(
            ("A sensor on this machine", "imumon run"),
            ("No sensor at hand: a simulated one", "imumon demo"),
            ("A daemon on another machine", "imumon tui --connect tcp/HOST:7448"),
            ("Nothing works?", "imumon doctor"),
        ),
    ]
