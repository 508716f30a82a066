"""Table choice: which of the tables of a text is read, and what its columns are.

A text may hold the rows of several sensors. The table with the most of them is proposed, and a question names the
others. What is known of a format (`formats`) counts as if the table stated it. A file and a device go this way.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace

from imumon.model.cures import option_text
from imumon.model.samples import INERTIAL
from imumon.sources.files.base import ReadOptions, RecordingError
from imumon.sources.files.column_reader import read_columns
from imumon.sources.files.columns import Reading, Use, parse_map
from imumon.sources.files.formats import known_format
from imumon.sources.files.printed_log import PrintedTable
from imumon.sources.files.text_cells import number_of
from imumon.sources.files.unit_grammar import Unit


def chosen_table(
    printed: Sequence[PrintedTable], text: str, options: ReadOptions, path: str = ""
) -> tuple[PrintedTable, Reading]:
    """Return the table that is read, and what its columns are.

    Parameters
    ----------
    printed : the tables of the text, at least one.
    path : of the text, whose name may say of which sensor the rows are.

    Raises
    ------
    RecordingError : no table is the one that the options choose, or none has a sensor.
    """
    wanted = options.where or {}
    readings = _readings(_chosen(printed, wanted), text, options, path)
    sensors = {k: [use.key for use in each.uses if use.key in INERTIAL] for k, each in readings.items()}
    best = min(readings, key=lambda k: (len(sensors[k]) < len(INERTIAL), "gyro" not in sensors[k], k))
    if len(readings) == 1 or wanted:
        return printed[best], readings[best]
    choices = {k: _choice(k, printed, [*readings]) for k in readings}
    texts = {k: f"{option_text(where=choice)} ({'+'.join(sensors[k])})" for k, choice in choices.items()}
    others = ", ".join(text for k, text in texts.items() if k != best)
    reason = f"the rows are of several sensors: {option_text(where=choices[best])} is proposed; others are "
    known = Unit("rows", 1.0)
    question = Use("rows", known=known, reason=reason + others, assumptions=("assumed_columns",))
    where = tuple(choices[best].items())
    return printed[best], replace(readings[best], uses=(*readings[best].uses, question), where=where)


def _chosen(printed: Sequence[PrintedTable], wanted: Mapping[str, str]) -> dict[int, PrintedTable]:
    """Return the tables that the user chooses, by their places; raise `RecordingError` if none is such."""
    chosen = {k: each for k, each in enumerate(printed) if _are_chosen(_labels(k, each), wanted)}
    if not chosen:
        listed = ", ".join(code for each in printed for _, code in each.codes)
        message = f"no row of the first has {option_text(where=wanted)}"
        raise RecordingError("no_such_rows", message, f"there are {listed or 'no such columns'}")
    return chosen


def _readings(
    wanted: Mapping[int, PrintedTable], text: str, options: ReadOptions, path: str
) -> dict[int, Reading]:
    """Return what the columns of tables are, of those that have a sensor; raise `RecordingError` if none has."""
    readings: dict[int, Reading] = {}
    faults: list[RecordingError] = []
    for k, table in wanted.items():
        try:
            readings[k] = _reading(table, text, options, path)
        except RecordingError as error:
            faults.append(error)
    if not readings:
        raise max(faults, key=lambda error: error.code != "no_sensor")
    return readings


def _reading(table: PrintedTable, text: str, options: ReadOptions, path: str) -> Reading:
    """Return what the columns of a table are, with what is known of its format."""
    names = table.names
    top = "\n".join(text.split("\n", table.begin + 3)[: table.begin + 3])
    known = known_format(top, names)
    if known is not None and (not known.columns or len(names) >= len(known.columns)):
        if known.columns:
            kept = len(names) - len(known.columns)
            names = (*(name or f"column {k + 1}" for k, name in enumerate(names[:kept])), *known.columns)
        stated = parse_map(known.filled_map(top)) if known.map else {}
        options = replace(
            options, columns=stated | dict(options.columns or {}), units={**known.units, **options.units}
        )
    source = f"{table.source} {os.path.basename(path).partition('.')[0]}"
    return read_columns(
        names, table.units, table.rows, options, source=source, rate=table.rate, dates=table.dates
    )


def _labels(place: int, table: PrintedTable) -> dict[str, str]:
    """Return by which column and value the rows of a table are chosen, the best last."""
    labels = {"table": str(place + 1)}
    for k, code in table.codes[::-1]:
        labels |= {str(k + 1): code, table.names[k].strip() or str(k + 1): code}
    return labels


def _choice(place: int, printed: Sequence[PrintedTable], places: Sequence[int]) -> dict[str, str]:
    """Return by which columns and values one of some tables is chosen."""
    codes = {
        printed[place].names[k].strip() or str(k + 1): code
        for k, code in printed[place].codes
        if any((k, code) not in printed[other].codes for other in places)
    }
    return codes or {"table": str(place + 1)}


def _are_chosen(labels: Mapping[str, str], wanted: Mapping[str, str]) -> bool:
    return all(_same(labels.get(column), value) for column, value in wanted.items())


def _same(value: str | None, other: str) -> bool:
    """Return whether two values of a code are the same text or number."""
    if value is None or value.lower() == other.lower():
        return value is not None
    number = number_of(value)
    return number is not None and number == number_of(other)
