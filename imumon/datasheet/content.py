"""Content of a datasheet, element by element, the same for every form.

Order: grades, caveats, coefficients, curves, data sheet, uncertainty, the record, settings to paste, traceability.
Every number comes from the report; an unknown one is given with its reason.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Sequence
from functools import partial

from imumon.coefficients import COEFFICIENTS, GRADED, GRADES, INDISTINCT_WORD, NOISE
from imumon.datasheet.convergence_figure import convergence_svg, convergence_table, convergences
from imumon.datasheet.elements import (
    Caution,
    DataTable,
    Document,
    Element,
    Figure,
    GradeSummary,
    Heading,
    Listing,
    Paragraph,
)
from imumon.datasheet.evidence import (
    budget_elements,
    conformity_elements,
    exact_elements,
    traceability_elements,
)
from imumon.datasheet.figures import legend_text, svg
from imumon.datasheet.filter_figure import QUANTITIES, filter_svg, filter_table, shown_axis
from imumon.datasheet.history_figure import HistoryRows, history_svg, history_table, series
from imumon.datasheet.program_settings import settings_document
from imumon.datasheet.record_elements import record_elements, value_elements
from imumon.datasheet.tables import (
    SENSOR_TITLES,
    axis_grades,
    coefficient_text,
    driver_advice,
    filter_warning,
    readable_curves,
    record_line,
    record_title,
    sensor_axes,
    sensor_title,
    shown_letters,
    with_limits,
    without_aliasing,
)
from imumon.datasheet.temperature_figure import temperature_elements
from imumon.filter_report import FIX_WORDS, FilterReport
from imumon.messages import (
    FILTER_NOT_KNOWN,
    GRADE_WORDS,
    advice,
    caveats,
    grade_text,
    has_indistinct,
)
from imumon.readiness import letters_for, ready_text
from imumon.report import Allan, Channel, Report, SensorGrade
from imumon.report_json import to_json
from imumon.samples import INERTIAL, sensor_of
from imumon.units import figures, pretty

DOCUMENT_DIGITS = 12
"""Hexadecimal digits of the number of a document: none of a million documents have the same one."""
MARKED = ("aliased", "compensated", "not_at_rest", "warming_up")
"""Caveats that are repeated below the table of coefficients."""


MIXED = {"vibration", "oscillation"}
"""Caveats of channels whose classical readings hold what is no noise."""


def datasheet_content(report: Report, filters: FilterReport, history: HistoryRows = ()) -> Document:
    """Return the datasheet of the sensor of a report.

    Parameters
    ----------
    history : rows of its history; empty: none is known.
    """
    subtitle = f"Noise datasheet · {record_title(report)} · {report.time}"
    elements = (*_elements(report, filters, history), *_signatures(report))
    return Document(sensor_title(report), subtitle, elements, _running(report))


def short_content(report: Report, filters: FilterReport, program: str) -> Document:
    """Return the datasheet on two pages: whether it is ready, table, figures, and the settings of a program."""
    return Document(
        sensor_title(report),
        f"Noise, short form · {record_title(report)} · {report.time}",
        tuple(_short_elements(report, filters, program)),
        _running(report),
    )


def _short_elements(report: Report, filters: FilterReport, program: str) -> Iterator[Element]:
    sensors = [sensor for sensor in INERTIAL if any(_axes(report, sensor))]
    if ready := ready_text(report, program, letters_for(program)):
        yield Paragraph(f"{ready[0].upper()}{ready[1:]}.")
    yield from _grade_summaries(report)
    if names := [caveat.replace("_", " ") for caveat in caveats(report)]:
        yield Caution(", ".join(names), "imumon explain says what each means; the long form has what to do.")
    for sensor in sensors:
        yield _coefficient_table(report, sensor)
    yield from _curve_figures(report, sensors)
    if sensors:
        yield Heading(f"For {program}")
        # comments of every axis fill a page of their own
        lines = settings_document(program, report, filters).splitlines()
        yield Listing("yaml", "\n".join(line for line in lines if not line.startswith("#   ")))


def _convergence(report: Report, sensors: Sequence[str]) -> Iterator[Element]:
    """Yield what was stated of the inertial sensors when the record was shorter."""
    known = [sensor for sensor in sensors if sensor in INERTIAL and convergences(report, sensor)]
    if known:
        yield Heading("Convergence")
    for sensor in known:
        first = sensor == known[0]
        rest = (
            "what was stated when the record was shorter: values with their 95 % limits of statistics; ▼ and <: 95 % "
            "upper bounds."
        )
        yield Figure(
            f"{SENSOR_TITLES[sensor]}{f', {rest}' if first else '; marks as above.'}",
            convergence_table(report, sensor),
            partial(convergence_svg, report, sensor),
        )


def _running(report: Report) -> str:
    """Return the number of a document, which follows from all its numbers, and the revision of what wrote it."""
    number = hashlib.sha256(to_json(report).encode()).hexdigest()[:DOCUMENT_DIGITS]
    provenance = report.evaluation.provenance if report.evaluation is not None else None
    parts = [f"document {number}"]
    if provenance is not None:
        parts.append(
            provenance.written_by or f"{provenance.software}, revision {provenance.commit or 'unknown'}"
        )
    return re.sub(r"([0-9a-f]{12})[0-9a-f]{28}", r"\1", " · ".join(parts))


def _signatures(report: Report) -> Iterator[Element]:
    """Yield a table to sign in."""
    operator = report.item.operator if report.item is not None else None
    rows = [
        (role, name or "", "", "")
        for role, name in (("Measured", operator), ("Checked", ""), ("Approved", ""))
    ]
    yield Heading("Signatures", joined=True)  # a page with signatures alone could be signed for anything
    yield DataTable(("", "name", "date", "signature"), tuple(rows), tall=True)


def _elements(report: Report, filters: FilterReport, history: HistoryRows) -> Iterator[Element]:
    """Yield all elements but the signatures, in the order of the document."""
    yield from _item(report)
    yield from _grade_summaries(report)
    yield from _cautions(report)
    sensors = [sensor for sensor in SENSOR_TITLES if any(_axes(report, sensor))]
    yield Heading("Noise")
    if not sensors:
        yield Paragraph("Nothing is known yet: the record is too short.")
    for sensor in sensors:
        yield _coefficient_table(report, sensor)
    yield from _notes(report)
    yield from _grade_limits(report)
    if sensors:
        yield Heading("Allan deviation")
        yield from _curve_figures(report, sensors)
        yield from _convergence(report, sensors)
        yield from exact_elements(report)
        yield from conformity_elements(report)
        yield from budget_elements(report)
    yield from _history(history)
    yield from record_elements(report)
    yield from value_elements(report)
    yield from temperature_elements(report)
    if sensors:
        yield from _fit(report, sensors)
        yield from _filters(filters)
        yield Heading("For Kalibr")
        yield Paragraph(
            "Other formats: imumon report --format filter, ros, px4, ardupilot, gtsam, openvins, vins, fastlio, "
            "liosam, orbslam3, robot_localization or kfgins."
        )
        yield Listing("yaml", settings_document("kalibr", report, filters).rstrip("\n"))
    yield from traceability_elements(report)


def _notes(report: Report) -> Iterator[Element]:
    """Yield what the numbers of the tables mean."""
    if report.channels:
        yield Paragraph(
            "Each value with its 95 % limits, those of the uncertainty budget. < is a 95 % upper bound of what "
            "this record does not show; a longer record may measure it."
        )
    if has_indistinct(report):
        yield Paragraph(
            f"{INDISTINCT_WORD} after a bound: the record shows correlated noise, and does not show whether it is B, "
            "K or M. Each of them is then at most its bound; a longer record may decide."
        )
    if report.grade:
        yield Paragraph(GRADE_WORDS)


def _item(report: Report) -> Iterator[Element]:
    """Yield what was measured, by whom, where and how, if the user states any of it."""
    if (item := report.item) is None:
        return
    device = report.device
    rows = [
        ("Model", item.model or device.model),
        ("Serial number", item.serial or device.serial),
        ("Firmware", device.firmware),
        ("Operator", item.operator),
        ("Place", item.place),
        ("Ambient conditions", item.ambient),
        ("Procedure", item.procedure),
        ("Note", item.note),
    ]
    yield Heading("Item and measurement")
    yield DataTable(("", ""), tuple((name, text or "not stated") for name, text in rows))


# ---------------------------------------------------------------- grades and caveats


def _grade_summaries(report: Report) -> Iterator[Element]:
    for sensor, grade in report.grade.items():
        yield GradeSummary(SENSOR_TITLES.get(sensor, sensor), grade_text(grade), _grade_reason(sensor, grade))


def _grade_reason(sensor: str, grade: SensorGrade) -> str:
    parts = [grade.reason] if grade.reason else []
    if grade.decided_by is not None:
        letter = grade.decided_by.coefficient
        parts.insert(0, f"decided by {_title(sensor, letter)} of axis {grade.decided_by.axis}")
    return "; ".join(parts or ["nothing is known yet"]) + "."


def _title(sensor: str, letter: str) -> str:
    """Return the name of a coefficient with its letter."""
    unit = COEFFICIENTS[letter].units.get(sensor)
    return letter if unit is None else f"{unit.name} {letter}"


def _cautions(report: Report) -> Iterator[Element]:
    """Yield the caveats, each with its meaning and what helps."""
    for caveat, channels in caveats(report).items():
        text = advice(report, caveat)
        if caveat == "aliased":
            text = f"{text} {driver_advice(report, caveat)}".strip()
            if report.device.alias_factor:
                text = f"By a factor of {report.device.alias_factor:.2f}, nominally. {text}"
        where = f" ({', '.join(channels)})" if channels else ""
        yield Caution(f"{caveat.replace('_', ' ')}{where}", text)
    if (warning := filter_warning(report)) is not None:
        yield Caution(FILTER_NOT_KNOWN, warning)


# ---------------------------------------------------------------- coefficients and curves


def _axes(report: Report, sensor: str) -> Iterator[tuple[str, Channel]]:
    """Yield the axes of a sensor that have coefficients."""
    return ((axis, channel) for axis, channel in sensor_axes(report, sensor) if channel.estimates)


def _coefficient_table(report: Report, sensor: str) -> DataTable:
    """Return the coefficients of a sensor with their limits, and the grades of its axes."""
    graded, factor = sensor in report.grade, report.device.alias_factor
    rows = []
    letters = shown_letters(channel for _, channel in _axes(report, sensor))
    corrects = False
    for axis, channel in _axes(report, sensor):
        cells = [coefficient_text(channel.estimates.get(letter)) or "–" for letter in letters]
        if (n := without_aliasing(report, f"{sensor}/{axis}", channel.estimates.get("N"))) is not None:
            corrects = True
            cells.insert(1, coefficient_text(n) or "–")
        rows.append((axis, *cells, *((grade or "–" for grade in axis_grades(channel)) if graded else ())))
    names = [f"{_title(sensor, letter)}, {_unit(sensor, letter)}" for letter in letters]
    if corrects:
        names.insert(1, f"N without aliasing (read N / {factor:.2f}, nominal), {_unit(sensor, 'N')}")
    head = (SENSOR_TITLES[sensor], *names, *(["grade", "nearest"] if graded else []))
    return DataTable(head, tuple(rows), _marks(report, sensor))


def _marks(report: Report, sensor: str) -> str:
    """Return the caveats that are repeated below the table of coefficients."""
    # only the gyroscope is compensated
    marks = [c for c in MARKED if c in report.caveats and (c != "compensated" or sensor == "gyro")]
    axes = [axis for axis, channel in _axes(report, sensor) if "misfit" in channel.caveats]
    marks += [f"misfit ({', '.join(axes)})"] if axes else []
    return f"Caution: {', '.join(marks).replace('_', ' ')}; see above." if marks else ""


def _unit(sensor: str, letter: str) -> str:
    return pretty(COEFFICIENTS[letter].units[sensor].unit)


def _curve_figures(report: Report, sensors: Sequence[str]) -> Iterator[Element]:
    """Yield the figures of the Allan deviation; the first one says what the marks of all mean."""
    for sensor in sensors:
        drawn, caption = (
            partial(svg, report, sensor),
            f"{SENSOR_TITLES[sensor]}, Allan deviation in {_unit(sensor, 'B')}",
        )
        first = sensor == sensors[0]
        caption += f"; {record_line(report)}." if first else "; marks as above."
        legend = f"{legend_text(report, sensors)}." if first else ""
        yield Figure(caption, _curve_table(report, sensor), drawn, legend)


def _curve_table(report: Report, sensor: str) -> DataTable:
    """Return the Allan deviation of the axes at every octave, with its limits."""
    curves = readable_curves(report, sensor)
    longest = max(curves.values(), key=lambda curve: len(curve.tau_s), default=Allan())
    rows = tuple(
        (f"{tau:.4g}", *(_point_text(curve, j) for curve in curves.values()))
        for j, tau in enumerate(longest.tau_s)
    )
    unit = _unit(sensor, "B")
    return DataTable((f"{SENSOR_TITLES[sensor]}: τ, s", *(f"{axis}, {unit}" for axis in curves)), rows)


def _point_text(curve: Allan, octave: int) -> str:
    """Return the deviation at an averaging time with its 95 % limits."""
    if octave >= len(curve.sigma):
        return "–"
    return with_limits(curve.sigma[octave], curve.low[octave], curve.high[octave])


# ---------------------------------------------------------------- limits of the grades


def _grade_limits(report: Report) -> Iterator[Element]:
    """Yield the limits of the grades, with those of this sensor emphasised."""
    if not report.limits:
        return
    columns = [(s, c) for s in INERTIAL for c in GRADED if c in report.limits.get(s, {})]
    rows = tuple((name, *(_limit_text(report, s, c, name) for s, c in columns)) for name in GRADES)
    units = (f"{SENSOR_TITLES[s].lower()} {c}, {_unit(s, c)}" for s, c in columns)
    reached = {grade.nearest for grade in report.grade.values()}
    yield Heading("Limits of the grades")
    strong = frozenset(i for i, name in enumerate(GRADES) if name in reached)
    yield DataTable(("at most", *units), rows, strong=strong)
    yield Paragraph(
        "Limits of classes of sensors, not of a device: VectorNav Technologies, Inertial Navigation Primer, table 3.1. "
        "The grade of a sensor is the worst over N and B and over the axes."
    )


def _limit_text(report: Report, sensor: str, letter: str, grade: str) -> str:
    limit = report.limits[sensor][letter].get(grade)
    return "–" if limit is None else figures(limit * COEFFICIENTS[letter].units[sensor].factor, 2)


# ---------------------------------------------------------------- filters


def _history(rows: HistoryRows) -> Iterator[Element]:
    """Yield N of each sensor over days."""
    known = {sensor: axes for sensor in SENSOR_TITLES if (axes := series(rows, sensor))}
    if known:
        yield Heading("History")
    for sensor, axes in known.items():
        caption = f"{SENSOR_TITLES[sensor]}: N of each period alone, with its 95 % limits. imumon history has all rows."
        yield Figure(caption, history_table(sensor, axes), partial(history_svg, sensor, axes))


def _filters(filters: FilterReport) -> Iterator[Element]:
    """Yield the numbers for a filter, and the predicted error of filters with and without them."""
    if not filters.channels:
        return
    yield Heading("For a Kalman filter")
    rows, correlated = [], any(channel.markov is not None for channel in filters.channels.values())
    for name, parameters in filters.channels.items():
        factor = (
            figures(parameters.walk_factor, 2) if parameters.walk_factor is not None else "K is only bounded"
        )
        nees = (max(parameters.nees.n_and_k), max(parameters.nees.white_walk))
        white, walk = (pretty(COEFFICIENTS[letter].units[sensor_of(name)].si) for letter in "NK")
        values = [f"{parameters.white:.3e} {white}", f"{parameters.walk:.3e} {walk}"]
        if correlated:
            markov = parameters.markov
            text = (
                None
                if markov is None
                else f"{markov.sigma:.3e} {parameters.unit}, {figures(markov.time_constant_s)} s"
            )
            values.append(text or "–")
        rows.append((name, *values, factor, *(figures(value, 3) for value in nees)))
    head = (
        "",
        "white noise",
        "walk",
        *(["correlated noise: σ, time constant"] if correlated else []),
        "walk over K",
        "NEES of N and K alone",
        "NEES of white and walk",
    )
    yield DataTable(head, tuple(rows))
    yield Paragraph(
        f"For at most {filters.horizon_s:g} s without a fix (--horizon). {FIX_WORDS} The table has the worst NEES "
        "within that time. Gauss–Markov terms, which are better still: imumon report --format filter."
    )
    lines = ", root mean square: solid or first, what a filter has; dashed or second, what it states."
    for sensor in QUANTITIES:
        if (shown := shown_axis(filters, sensor)) is not None:
            axis, parameters = shown
            error = f"predicted error of the {QUANTITIES[sensor][0]} since the last fix"
            caption, lines = f"{SENSOR_TITLES[sensor]} {axis}, {error}{lines}", "; lines as above."
            yield Figure(
                caption, filter_table(sensor, axis, parameters), partial(filter_svg, sensor, parameters)
            )


def _fit_row(sensor: str, axis: str, channel: Channel) -> tuple[str, ...]:
    """Return the quality of the fit of an axis, what is read off its curve, and its caveats."""
    fit, quality = channel.fit, "–"
    if fit is not None and fit.chi2 is not None and fit.dof:
        quality = f"χ² {fit.chi2:.1f} for {fit.dof}"
        quality += f", p {fit.p_value:.2g}" if fit.p_value is not None else ""
    # the likelihood leaves lines and oscillations out; a reading off the curve cannot
    lines = channel.model.lines_hz if channel.model is not None else ()
    mark = "*" if lines or MIXED & set(channel.caveats) else ""
    cells = []
    for letter in NOISE:
        value = (channel.readings or {}).get(letter)
        factor, unit = COEFFICIENTS[letter].units[sensor].factor, _unit(sensor, letter)
        cells.append("none" if value is None else f"{figures(value * factor)} {unit}{mark}")
    texts = ", ".join(channel.caveats).replace("_", " ") or "–"
    return (f"{sensor}/{axis}", quality, *cells, texts)


def _fit(report: Report, sensors: Sequence[str]) -> Iterator[Element]:
    """Yield how well the model fits each axis, and the classical readings off the curve beside it."""
    rows = [_fit_row(sensor, axis, channel) for sensor in sensors for axis, channel in _axes(report, sensor)]
    yield Heading("The fit")
    read = (f"{letter} read" for letter in NOISE)
    correlated = any(channel.M is not None for channel in report.channels.values())
    markov = " + (2 M² T/τ) (1 − (T/2τ) (3 − 4 exp(−τ/T) + exp(−2τ/T)))" if correlated else ""
    yield DataTable(("", "fit", *read, "caveats"), tuple(rows))
    yield Paragraph(
        "N, B and K above come from one likelihood of the spectrum and of the block means of the record, without "
        "drift, temperature, lines and oscillations. The model of the figure is σ²(τ) = N²/τ + (2 ln 2/π) B² + "
        f"K² τ/3{markov} and what these add. The classical readings off the curve (σ at "
        "τ = 1 s on the −½ slope, floor / 0.664, σ at τ = 3 s on the +½ slope) are for comparison: they have no "
        "limits. *: the reading has a line, a vibration or an oscillation in it, as if that were noise."
    )
