"""Sheet: what a datasheet says, block by block, before it has a form.

Whoever reads it wants, in this order: is the sensor good, may I believe it, the numbers, the curves, what
the manufacturer says, how the record was made, and the settings to paste. Every number comes from the
report; what is not known is said with its reason.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from imumon.datasheet.blocks import (
    Block,
    Curves,
    Document,
    Heading,
    Snippet,
    Table,
    Text,
    Verdict,
    Warned,
)
from imumon.datasheet.config_snippets import kalibr, who
from imumon.datasheet.reference_values import LABORATORY, LABORATORY_GRADE, MANUFACTURER
from imumon.datasheet.svg_figure import curves
from imumon.datasheet.text_table import coefficient, spoilt
from imumon.messages import CAVEATS, CLOCKS, FILTER_NOT_KNOWN, caveats, exclusions, filter_not_known, within
from imumon.report import COEFFICIENTS, Allan, Channel, Coefficient, Report, SensorGrade
from imumon.samples import AXES
from imumon.units import READABLE, counted, duration, figures, pretty

SENSORS = {"gyro": "Gyroscope", "accel": "Accelerometer", "mag": "Magnetometer"}
COEFFICIENT_NAMES = {
    "gyro": {"N": "angle random walk N", "B": "bias instability B", "K": "rate random walk K"},
    "accel": {"N": "velocity random walk N", "B": "bias instability B", "K": "acceleration random walk K"},
    "mag": {"N": "white noise N", "B": "bias instability B", "K": "random walk K"},
}

MAG_HZ = 250.0
"""Readings of the magnetometer in a second."""

LINES = 4
"""Spectral lines shown of a channel."""


def sheet(made: Report) -> Document:
    """Datasheet of the sensor that a report is of."""
    device, session = made.device, made.session
    rate = f" at {device.sample_rate_hz:g} Hz" if device.sample_rate_hz else ""
    subtitle = (
        f"Noise datasheet · {duration(session.elapsed_s)} of {device.stream or 'samples'}{rate} · {made.time}"
    )
    return Document(who(made), subtitle, tuple(_blocks(made)))


def _blocks(made: Report) -> Iterator[Block]:
    yield from _verdicts(made)
    yield from _warnings(made)
    there = [sensor for sensor in SENSORS if any(_parts(made, sensor))]
    yield Heading("Noise")
    if not there:
        yield Text("Nothing is known yet: the record is too short.")
    for sensor in there:
        yield _noise(made, sensor)
    if made.channels:
        yield Text(
            "Each value with its 95 % limits. < is a 95 % upper bound of what this record does not show: the "
            "true value is smaller, how much so only a longer record tells."
        )
    if there:
        yield Heading("Allan deviation")
        for sensor in there:
            yield Curves(sensor, _caption(sensor), _numbers(made, sensor))
        yield from _beside(made, there)
    yield from _grades(made)
    yield from _record(made)
    yield from _values(made)
    if there:
        yield from _fit(made, there)
        yield Heading("For Kalibr")
        yield Text("Other forms: imumon report --format ros, px4, ardupilot, gtsam or openvins.")
        yield Snippet("yaml", kalibr(made).rstrip("\n"))


# ---------------------------------------------------------------- verdict and warnings


def _verdicts(made: Report) -> Iterator[Block]:
    for sensor, grade in made.grade.items():
        yield Verdict(SENSORS.get(sensor, sensor), grade.nearest or "no grade", _why(sensor, grade))


def _why(sensor: str, grade: SensorGrade) -> str:
    if grade.nearest is None:
        return f"{grade.reason or 'nothing is known yet'}."
    said = []
    if grade.decided_by is not None:
        name = COEFFICIENT_NAMES[sensor][grade.decided_by.coefficient]
        axis = grade.decided_by.axis.rpartition("/")[2]
        said.append(f"decided by {name} of axis {axis}")
    said.append(within(grade.meets))
    if grade.provisional:
        said.append(f"provisional{f': {grade.reason}' if grade.reason else ''}")
    return "; ".join(said) + "."


def _warnings(made: Report) -> Iterator[Block]:
    for word, channels in caveats(made).items():
        text = CAVEATS[word].advice if word in CAVEATS else ""
        if word == "aliased" and made.device.alias_factor:
            text = f"By a factor of {made.device.alias_factor:.2f}, nominally. {text}"
        where = f" ({', '.join(channels)})" if channels else ""
        yield Warned(f"{word.replace('_', ' ')}{where}", text)
    if (warning := filter_not_known(made)) is not None:
        yield Warned(FILTER_NOT_KNOWN, warning)


# ---------------------------------------------------------------- the numbers


def _parts(made: Report, sensor: str) -> Iterator[tuple[str, Channel]]:
    """Axes of a sensor that have coefficients."""
    for axis in AXES:
        channel = made.channels.get(f"{sensor}/{axis}")
        if channel is not None and channel.N is not None:
            yield axis, channel


def _noise(made: Report, sensor: str) -> Table:
    rows = []
    for axis, channel in _parts(made, sensor):
        cells = [coefficient(getattr(channel, letter)) for letter in COEFFICIENTS]
        grade = channel.grade.nearest if channel.grade else None
        rows.append((axis, *cells, *([grade or "–"] if sensor in made.grade else [])))
    units = [pretty(READABLE[sensor, letter].unit) for letter in COEFFICIENTS]
    names = [f"{COEFFICIENT_NAMES[sensor][c]}, {u}" for c, u in zip(COEFFICIENTS, units, strict=True)]
    head = (SENSORS[sensor], *names, *(["grade"] if sensor in made.grade else []))
    marks = [w for w in ("aliased", "compensated", "not_at_rest", "warming_up") if w in made.caveats]
    if sensor != "gyro" and "compensated" in marks:
        marks.remove("compensated")  # it is the gyroscope whose bias is taken out
    caption = f"Beware: {', '.join(marks).replace('_', ' ')}; see above." if marks else ""
    return Table(head, tuple(rows), caption)


def _caption(sensor: str) -> str:
    unit = pretty(READABLE[sensor, "B"].unit)
    return (
        f"{SENSORS[sensor]}, overlapping Allan deviation in {unit} with 95 % limits; lines: fitted model; "
        "hollow: left out of the fit"
    )


def _numbers(made: Report, sensor: str) -> Table:
    """Allan deviation of the axes at every octave."""
    found = curves(made, sensor)
    longest = max(found.values(), key=lambda curve: len(curve.tau_s), default=Allan())
    rows = tuple(
        (f"{tau:.4g}", *(figures(c.sigma[j]) if j < len(c.sigma) else "–" for c in found.values()))
        for j, tau in enumerate(longest.tau_s)
    )
    return Table((f"{SENSORS[sensor]}: τ, s", *found), rows)


def _worst(made: Report, sensor: str, letter: str) -> Coefficient | None:
    """The largest of the axes, a bound standing in for itself."""
    found: list[Coefficient] = [
        part for _, channel in _parts(made, sensor) if (part := getattr(channel, letter)) is not None
    ]
    sized = [(_size(part), part) for part in found]
    known = [(size, part) for size, part in sized if size is not None]
    return max(known, key=lambda pair: pair[0])[1] if known else None


def _size(part: Coefficient) -> float | None:
    return part.readable.value if part.status == "measured" else part.readable.high


def _beside(made: Report, there: Sequence[str]) -> Iterator[Block]:
    yield Heading("Beside other figures")
    rows = []
    for sensor in there:
        for letter in ("N", "B"):
            theirs, lab = MANUFACTURER.get((sensor, letter)), LABORATORY.get((sensor, letter))
            if theirs is None and lab is None:
                continue
            mine, scale = _worst(made, sensor, letter), READABLE[sensor, letter]
            rows.append(
                (
                    f"{SENSORS[sensor]} {letter}, {pretty(scale.unit)}",
                    coefficient(mine) if mine else "not known yet",
                    theirs.text if theirs else "–",
                    _compared(mine, theirs.value) if theirs else "–",
                    " / ".join(figures(v * scale.factor) for v in lab) if lab else "–",
                )
            )
    head = ("", "this sensor, worst axis", "VN-100, manufacturer", "", "laboratory report, x / y / z")
    yield Table(head, tuple(rows))
    yield Text(
        "The laboratory report is from five hours of $VNYMR at 40 Hz and concludes "
        f"{LABORATORY_GRADE} for both sensors. That stream is aliased and compensated: its N is about √5 = "
        f"2.24 times too high, and its gyroscope B is that of the sensor's filter. The manufacturer's bias "
        f"stability is the floor of the curve, 0.664 B.{_of_magnetometer(made)}"
    )


def _of_magnetometer(made: Report) -> str:
    """It has nothing like a delta angle: its samples are points, and fold whatever is faster."""
    rate, model = made.device.sample_rate_hz, made.device.model or ""
    if rate is None or rate >= MAG_HZ or "mag/x" not in made.channels or not model.startswith("VN-100"):
        return ""
    return (
        f" A VN-100 reads its magnetometer {MAG_HZ:g} times a second, unfiltered: at {rate:g} Hz its N is "
        f"{(MAG_HZ / rate) ** 0.5:.2f} times too high."
    )


def _compared(mine: Coefficient | None, theirs: float) -> str:
    """The own figure against another, judged by its limits."""
    if mine is None:
        return "–"
    low, high = mine.readable.low, mine.readable.high
    if high is not None and high <= theirs:
        return "within"
    if mine.status != "measured" or mine.readable.value is None:
        return "not decided"
    if low is not None and low > theirs:
        return f"{mine.readable.value / theirs:.2f} times as large"
    return "equal within its limits"


def _grades(made: Report) -> Iterator[Block]:
    if not made.limits:
        return
    order = ("navigation", "tactical", "industrial", "consumer")
    columns = [(s, c) for s in ("gyro", "accel") for c in ("N", "B") if c in made.limits.get(s, {})]
    rows = tuple(
        (name, *(figures(made.limits[s][c][name] * READABLE[s, c].factor, 2) for s, c in columns))
        for name in order
    )
    head = ("at most", *(f"{SENSORS[s].lower()} {c}, {pretty(READABLE[s, c].unit)}" for s, c in columns))
    own = {grade.nearest for grade in made.grade.values()}
    yield Heading("The grades")
    yield Table(head, rows, strong=frozenset(i for i, name in enumerate(order) if name in own))
    yield Text(
        "Table 3.1 of the VectorNav inertial navigation primer. The grade given is the nearest on a "
        "logarithmic scale, the worst over N and B and over the axes; beside it stands the best "
        "grade whose limits no figure exceeds."
    )


# ---------------------------------------------------------------- the record


def _record(made: Report) -> Iterator[Block]:
    device, session = made.device, made.session
    left_out = exclusions(made, _seconds)
    share = session.missing / (session.samples + session.missing) if session.samples else 0.0
    rows = [
        ("Stream", " ".join(part for part in (device.stream, device.source) if part) or "not known"),
        ("Rate", f"{device.sample_rate_hz:.6g} Hz" if device.sample_rate_hz else "not known"),
        ("Time from", CLOCKS.get(device.clock or "", "not known")),
        ("Alias factor of N", f"{device.alias_factor:.3g}" if device.alias_factor else "not known"),
        ("Began", session.started or "not known"),
        (
            "Length",
            f"{duration(session.elapsed_s)} ({session.elapsed_s:,.0f} s), "
            f"{counted(session.samples, 'sample')}",
        ),
        (
            "Missing",
            f"{counted(session.missing, 'sample')} in {counted(session.gaps, 'gap')}, {100 * share:.2g} %"
            if session.missing
            else "nothing",
        ),
        (
            "Left out as disturbed",
            f"{', '.join(left_out)}; in {counted(session.disturbances, 'piece')}" if left_out else "nothing",
        ),
        ("Left out as warm-up", _seconds(session.warmup_s)),
        (
            "Line",
            f"{counted(session.bad_checksums, spoilt(device))}, "
            f"{counted(session.discarded_bytes, 'byte')} of no message",
        ),
        ("Restarts", f"{session.restarts:,}"),
    ]
    rows += [
        (label, value)
        for label, value in (
            ("Model", device.model),
            ("Serial number", device.serial),
            ("Firmware", device.firmware),
        )
        if value
    ]
    rows += [(f"Register {name}", text) for name, text in device.settings.items()]
    yield Heading("The record")
    yield Table(("", ""), tuple(rows))


def _seconds(seconds: float) -> str:
    if seconds <= 0.0:
        return "nothing"
    return duration(seconds) if seconds >= 60.0 else f"{seconds:.1f} s"


def _values(made: Report) -> Iterator[Block]:
    rows = []
    for name, channel in made.channels.items():
        shape, drift = channel.distribution, channel.drift
        slope = "–"
        if drift is not None and drift.per_hour is not None:
            slope = f"{drift.per_hour:.1e}"
            if drift.per_hour_low is not None and drift.per_hour_high is not None:
                slope += f" ± {(drift.per_hour_high - drift.per_hour_low) / 2.0:.1e}"
        verdict = (shape.verdict if shape else None) or "–"
        unit = pretty(channel.unit)
        rows.append(
            (
                f"{name}, {unit}",
                *(_e(v) for v in (channel.mean, channel.std, channel.min, channel.max)),
                slope,
                verdict,
            )
        )
    if rows:
        yield Heading("The values")
        yield Table(
            ("", "mean", "deviation", "least", "greatest", "drift per hour", "distribution"), tuple(rows)
        )
        yield from _lines(made)


def _lines(made: Report) -> Iterator[Block]:
    """Spectral lines, the strongest few of each channel."""
    rows = []
    for name, channel in made.channels.items():
        if channel.spectrum is not None and channel.spectrum.lines:
            strongest = sorted(channel.spectrum.lines, key=lambda line: -line.amplitude)[:LINES]
            told = [
                f"{line.frequency_hz:.4g} Hz of {line.amplitude:.1e}"
                + (f" ({line.name})" if line.name else "")
                for line in strongest
            ]
            rows.append((f"{name}, {pretty(channel.unit)}", ", ".join(told)))
    if rows:
        yield Table(("", "strongest spectral lines, frequency and amplitude"), tuple(rows))


def _e(value: float | None) -> str:
    return "–" if value is None else f"{value:.4g}"


def _fit(made: Report, there: Sequence[str]) -> Iterator[Block]:
    rows = []
    for sensor in there:
        for axis, channel in _parts(made, sensor):
            fit, read = channel.fit, channel.readings
            quality = "–"
            if fit is not None and fit.chi2 is not None and fit.dof:
                quality = f"χ² {fit.chi2:.1f} for {fit.dof}"
                quality += f", p {fit.p_value:.2g}" if fit.p_value is not None else ""
            cells = []
            for letter in COEFFICIENTS:
                value = getattr(read, letter) if read is not None else None
                cells.append(
                    figures(value * READABLE[sensor, letter].factor) if value is not None else "none"
                )
            rows.append(
                (f"{sensor}/{axis}", quality, *cells, ", ".join(channel.caveats).replace("_", " ") or "–")
            )
    yield Heading("The fit")
    yield Table(("", "fit", "N read", "B read", "K read", "caveats"), tuple(rows))
    yield Text(
        "N, B and K above come from a generalised least-squares fit of σ²(τ) = N²/τ + (2 ln 2/π) B² + K² "
        "τ/3 to all octaves, with the covariance between them. The classical readings off the curve (σ at "
        "τ = 1 s on the −½ slope, floor / 0.664, σ at τ = 3 s on the +½ slope; units as above) stand "
        "beside it for comparison."
    )
