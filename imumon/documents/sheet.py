"""Sheet: what a customer reads of a sensor on two pages, element by element, the same for every form.

First page: grades, caveats, each number with one 95 % interval beside the value of the sensor's data sheet, what the
intervals hold, and what was excluded. Second page: the Allan deviation, and the settings of one program. Every number
comes from the report; an unknown one is given with its reason. What supports it is in the `appendix`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

from imumon import __version__
from imumon.documents.appendix import appendix
from imumon.documents.elements import (
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
from imumon.documents.figures import curve_table, legend_text, svg
from imumon.documents.program_settings import PROGRAMS, number_lines, settings_document
from imumon.documents.report_texts import (
    SENSOR_TITLES,
    coefficient_text,
    counters_text,
    date_text,
    excluded_sentence,
    filter_warning,
    readable_curves,
    record_line,
    record_title,
    sensor_axes,
    sensor_title,
    shown_letters,
    without_aliasing,
)
from imumon.model.coefficients import COEFFICIENTS, INDISTINCT_WORD, unit_of
from imumon.model.filter_report import FilterReport
from imumon.model.messages import (
    FILTER_NOT_KNOWN,
    GRADE_WORDS,
    caveats,
    grade_text,
    has_indistinct,
    joined,
    line_with_size,
)
from imumon.model.report import Channel, Report, SensorGrade, SheetValue
from imumon.model.samples import INERTIAL, TEMPERATURE, ChannelName
from imumon.model.units import figures, pretty, sentence

QUANTITIES = {"floor": "in-run bias stability, 0.664 B", "density": "noise density, √2 N"}
"""Quantities of data sheets that are no coefficient."""


def datasheet(report: Report, filters: FilterReport, program: str) -> Document:
    """Return the datasheet of the sensor of a report, with the settings of a program."""
    return Document(
        sensor_title(report),
        f"Noise at rest · {record_title(report)} · {date_text(report)}",
        tuple(_sheet(report, filters, program)),
        tuple(appendix(report)),
        f"imumon {__version__}",
    )


def _sheet(report: Report, filters: FilterReport, program: str) -> Iterator[Element]:
    sensors = shown_sensors(report)
    for sensor, grade in report.grade.items():
        yield GradeSummary(SENSOR_TITLES.get(sensor, sensor), grade_text(grade), _grade_reason(sensor, grade))
    yield from _cautions(report)
    if not sensors:
        yield Paragraph("Nothing is known yet: the record is too short.")
    for sensor in sensors:
        yield coefficient_table(report, sensor)
    yield from _notes(report)
    yield Paragraph(f"{counters_text(report).rstrip('.')}. {excluded_sentence(report)}")
    if not (inertial := [sensor for sensor in INERTIAL if sensor in sensors]):
        return
    curves = [sensor for sensor in inertial if readable_curves(report, sensor)]  # none of a combination
    if curves:
        yield Heading("Allan deviation", new_page=True)
    for sensor in curves:
        first = sensor == curves[0]
        caption = f"{SENSOR_TITLES[sensor]}, Allan deviation in {pretty(unit_of(sensor, 'B').unit)}"
        caption += f"; {record_line(report)}." if first else "; marks as above."
        legend = f"{legend_text(report, curves)}." if first else ""
        yield Figure(caption, curve_table(report, sensor), partial(svg, report, sensor), legend)
    yield Heading(f"Settings: {PROGRAMS[program].text}")
    yield Listing("yaml", "\n".join(number_lines(settings_document(program, report, filters))))
    yield Paragraph(
        f"Random walks hold for at most {filters.horizon_s:g} s without a fix. imumon report --format {program} writes "
        "the whole file, with the unit, the origin and the axes of each number."
    )


def shown_sensors(report: Report) -> list[str]:
    """Return the sensors that have coefficients."""
    return [sensor for sensor in SENSOR_TITLES if any(_axes(report, sensor))]


def _axes(report: Report, sensor: str) -> Iterator[tuple[str, Channel]]:
    """Yield the axes of a sensor that have coefficients."""
    return ((axis, channel) for axis, channel in sensor_axes(report, sensor) if channel.estimates)


def _grade_reason(sensor: str, grade: SensorGrade) -> str:
    parts = [grade.reason] if grade.reason else []
    if grade.decided_by is not None:
        name = _name(sensor, grade.decided_by.coefficient)
        parts.insert(0, f"decided by {name} of axis {grade.decided_by.axis}")
    return "; ".join(parts or ["nothing is known yet"]) + "."


def _name(sensor: str, letter: str) -> str:
    """Return the name of a coefficient with its letter."""
    unit = COEFFICIENTS[letter].units.get(sensor)
    return letter if unit is None else f"{unit.name} {letter}"


def _cautions(report: Report) -> Iterator[Element]:
    """Yield the caveats, one line each; the appendix says what helps."""
    for caveat, channels in caveats(report).items():
        text = line_with_size(report, caveat)
        if caveat == "aliased" and report.device.alias_factor:
            text += f", by a factor of {report.device.alias_factor:.2f}, nominally"
        where = f" ({joined(channels)})" if channels else ""
        yield Caution(f"{caveat.replace('_', ' ')}{where}", f"{sentence(text)}.")
    if (warning := filter_warning(report)) is not None:
        yield Caution(FILTER_NOT_KNOWN, warning)


# ---------------------------------------------------------------- coefficients


def coefficient_table(report: Report, sensor: str) -> DataTable:
    """Return the coefficients of a sensor with their limits, beside the values of its data sheet."""
    axes = dict(_axes(report, sensor))
    sheet = report.data_sheet.values if report.data_sheet is not None else ()
    published = [value for value in sheet if value.channel.startswith(f"{sensor}/")]
    rows = []
    for letter in shown_letters(axes.values()):
        title = f"{sentence(_name(sensor, letter))}, {pretty(unit_of(sensor, letter).unit)}"
        cells = [coefficient_text(channel.estimates.get(letter)) or "–" for channel in axes.values()]
        values = [value for value in published if value.coefficient == letter]
        rows.append((title, *cells, *([_published_text(values, len(axes))] if published else [])))
        true = [
            without_aliasing(report, ChannelName(f"{sensor}/{axis}"), c.estimates.get(letter))
            for axis, c in axes.items()
        ]
        if letter == "N" and any(true):
            cells = [coefficient_text(part) or "–" for part in true]
            title = f"N without aliasing (over {report.device.alias_factor:.2f}, nominally)"
            rows.append((title, *cells, *([""] if published else [])))
    return DataTable(
        (SENSOR_TITLES[sensor], *axes, *(["data sheet"] if published else [])), tuple(rows), even=True
    )


def _published_text(values: Sequence[SheetValue], axes: int) -> str:
    """Return the values of the data sheet for a row, and which axes are above: ``0.210 typical; above: x, z``.

    Parameters
    ----------
    axes : number of axes in the row.
    """
    texts = []
    for size in dict.fromkeys((value.value, value.basis) for value in values):
        same = [value for value in values if (value.value, value.basis) == size]
        text = figures(size[0] * unit_of(same[0].channel.sensor, same[0].coefficient, same[0].unit).factor)
        text += " typical" if size[1] == "typical" else ""
        above = [value.channel.axis for value in same if value.above]
        if above:
            text += "; above" if len(above) == axes else f"; above: {', '.join(above)}"
        texts.append(text)
    return " or ".join(texts) or "–"


def _notes(report: Report) -> Iterator[Element]:
    """Yield what the numbers of the tables mean."""
    if report.channels:
        text = "Each value with its 95 % interval. < is a 95 % upper bound of what this record does not show."
        if has_indistinct(report):
            text += (
                f" {INDISTINCT_WORD}: the record shows correlated noise, and not whether it is B, K or M; each of them "
                "is at most its bound."
            )
        yield Paragraph(f"{text} {_contents(report)}")
    if report.data_sheet is not None and report.data_sheet.values:
        yield Paragraph(_sheet_text(report))
    if report.grade:
        yield Paragraph(GRADE_WORDS)


def _contents(report: Report) -> str:
    """Return what the intervals hold, and what they do not."""
    temperature = report.channels.get(TEMPERATURE)
    if temperature is None or temperature.min is None or temperature.max is None:
        outside = "the temperature, which is not in the record"
    else:
        outside = f"temperatures outside {temperature.min:.1f} °C to {temperature.max:.1f} °C"
    return (
        "An interval holds the statistics of the fit, the scatter between quarters of the record and between days of "
        "the history where they show it, the resolution of the values, and the clock. It does not hold "
        f"{outside}, the next power-up, the scale factor of the sensor, ageing, or another mounting; of a coefficient "
        "that moves away, it holds the mean over the record."
    )


def _sheet_text(report: Report) -> str:
    """Return where the values of the data sheet come from, and what its quantities mean."""
    sheet = report.data_sheet
    assert sheet is not None
    source = [
        sheet.document,
        f"edition: {sheet.edition or 'not named'}",
        sheet.source and f"source: {sheet.source}",
    ]
    printed: dict[str, list[str]] = {}
    for value in sheet.values:
        texts = printed.setdefault(value.quantity, [])
        if (text := f"{value.printed:g} {pretty(value.printed_unit)}") not in texts:
            texts.append(text)
    reasons: dict[str, dict[str, None]] = {}
    for value in sheet.values:
        if value.reason:
            reasons.setdefault(value.reason, {})[value.channel.sensor] = None
    parts = [
        f"Data sheet: {'; '.join(filter(None, source))}",
        *(
            f"It states the {name}: {', '.join(printed[key])}"
            for key, name in QUANTITIES.items()
            if key in printed
        ),
        "Above: the whole interval is above the value",
        *(f"N of {' and '.join(sensors)} may be above: {text}" for text, sensors in reasons.items()),
        (sheet.note or "").rstrip("."),
    ]
    return f"{'. '.join(filter(None, parts))}."
