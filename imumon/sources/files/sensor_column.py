"""Sensor column: the column of a table that says which sensor a row is of, and the rows that are read.

A logger of events writes a row whenever a sensor has a sample, and one column names the sensor::

    sensor,timestamp,x,y,z
    1,1230000,0.1166,-0.1896,9.7987
    4,2500000,0.0050,0.0005,0.0020

Read as one sensor, such rows give a noise that none has. A column divides the rows if it has few values that alternate,
and if the numbers of three columns differ by them: by far, or significantly if the name of the column is that of a
sensor or of a device. A flag or a coarse number alternates, too, and nothing differs by it. Which rows are read is the
choice of the user, ``--where COLUMN=VALUE``. Without a choice, the rows of the only sensor in the first rows are read
(`sensor_rows`).

Where rows begin with a word and comments name the columns of each word (`table_header.tagged_headers`), the words are
the values of such a column (`chosen_tag`). At last, the name of a file may be that of its sensor (`sensor_of_file`).
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from imumon.model.cures import option, option_text
from imumon.model.samples import AXES, INERTIAL, Floats
from imumon.sources.column_names import NO_SENSOR, UNITS, parse_names, triples, words_of
from imumon.sources.files.base import OptionError, RecordingError
from imumon.sources.files.columns import SENSORS, reference
from imumon.sources.files.table_header import TAG, is_number
from imumon.sources.rest_sizes import is_one_g, median_size, too_noisy

MOST_VALUES = 12
"""Values of a column that divides the rows: a table has no more sensors."""

FEWEST_ROWS = 20
"""Rows that show whether a column divides them."""

ALTERNATING = 0.04
"""Share of the rows in which the value must change: one sensor may be 50 times as fast as another."""

FAR = 6.0
"""Standard deviations by which numbers differ that are not of one sensor."""

DEVICE_WORDS = {"sensor", "sensors", "id", "device", "type", "name", "imu", "topic", "source", "addr", "address",
                "node", "instance", "kind", "channel", "event", "stream", "unit", "label", "sensorid", "i"}  # fmt: skip
"""Words of columns that name a sensor or a device."""


@dataclass(frozen=True, slots=True)
class RowChoice:
    """Rows that are read: those in which a column, by its place in the table, has a value."""

    column: int
    value: str

    def holds(self, cells: Sequence[str]) -> bool:
        """Return whether a row has the value, as text or as a number."""
        return self.column < len(cells) and same_value(cells[self.column], self.value)


def same_value(one: str, other: str) -> bool:
    """Return whether two cells are the same text or number.

    >>> same_value("4.0", "4"), same_value("Gyro", "gyro"), same_value("a", "4")
    (True, True, False)
    """
    if one.strip().lower() == other.strip().lower():
        return True
    try:
        return float(one) == float(other)
    except ValueError:
        return False


def parse_where(text: str) -> dict[str, str]:
    """Return ``sensor=4,device=A`` as a dict; raise `OptionError` if it has another form."""
    values = {}
    for part in text.split(","):
        column, equals, value = part.partition("=")
        if not equals or not column.strip():
            message = f"{option('where')} {part.strip()!r} names no column"
            raise OptionError("where_syntax", message, "write COLUMN=VALUE, such as sensor=4")
        values[column.strip()] = value.strip()
    return values


def row_choices(
    names: Sequence[str], where: Mapping[str, str], rows: Sequence[Sequence[str]]
) -> list[RowChoice]:
    """Return the rows that ``--where`` chooses; raise `RecordingError` if no row of the first has the value."""
    choices = []
    whole = [name.strip().lower() for name in names]
    for column, value in where.items():
        if column.lower() in whole:
            place = whole.index(column.lower())
        elif column.isdigit() and 1 <= int(column) <= len(names):
            place = int(column) - 1
        else:
            listed = ", ".join(name.strip() for name in names[:MOST_VALUES])
            text = f"no column {column!r} for {option('where')}"
            raise RecordingError("unknown_column", text, f"there are {listed}")
        choice = RowChoice(place, value)
        if not any(map(choice.holds, rows)):
            values = list(dict.fromkeys(row[place] for row in rows if place < len(row)))[:MOST_VALUES]
            text = f"no row of the first {len(rows):,} has {column}={value}"
            raise RecordingError("no_such_rows", text, f"there are {', '.join(values)}")
        choices.append(choice)
    return choices


def chosen_tag(tags: Mapping[str, Sequence[str]], where: Mapping[str, str]) -> str:
    """Return the word of the rows that are read, by the names of the columns of each.

    Raises
    ------
    RecordingError : several of them are of an inertial sensor and none is chosen, or the chosen one is none of them.
    """
    given = next(iter(where.values()), None)
    if given is not None:
        chosen = next((tag for tag in tags if same_value(tag, given)), None)
        if chosen is None:
            raise RecordingError(
                "no_such_rows",
                f"no comment names the columns of rows {given}",
                f"there are {', '.join(tags)}",
            )
        return chosen
    inertial = [tag for tag, names in tags.items() if any(c.quantity in INERTIAL for c in parse_names(names))]
    if len(inertial) == 1:
        return inertial[0]
    if not inertial:
        text = f"the comments name the columns of {', '.join(tags)}: none is a gyroscope or accelerometer"
        raise RecordingError("no_sensor", text, "check that it has one")
    choices = " or ".join(option_text(where={TAG: tag}) for tag in inertial)
    text = f"the rows are of several sensors, by their first cell: {', '.join(inertial)}"
    raise RecordingError("several_sensors", text, f"choose one: {choices}")


def sensor_rows(names: Sequence[str], rows: Sequence[Sequence[str]]) -> list[RowChoice]:
    """Return the rows of the only sensor that a column of words names in the first rows; empty: none does.

    The names of the other columns must not show a sensor: then such a word may be anything.
    """
    if any(column.quantity in INERTIAL and column.axis for column in parse_names(names)):
        return []
    for k in range(len(names)):
        values = {row[k] for row in rows if k < len(row)}
        if len(values) == 1 and (value := values.pop()) and sensor_of_value(value) and not is_number(value):
            return [RowChoice(k, value)]
    return []


def sensor_of_file(path: str) -> str | None:
    """Return the inertial sensor that the name of a file is that of; None: of none, or of several.

    >>> sensor_of_file("a/Gyroscope.csv"), sensor_of_file("accel_gyro.csv"), sensor_of_file("accel_bias.csv")
    ('gyro', None, None)
    """
    stem = os.path.basename(path).lower().split(".")[0]
    named = [sensor for sensor in INERTIAL if sensor in stem]
    return named[0] if len(named) == 1 and not set(words_of(stem)) & NO_SENSOR else None


def check_one_sensor(names: Sequence[str], rows: Sequence[Sequence[str]], numbers: Floats) -> None:
    """Raise `RecordingError`, with the choice, if a column divides the first rows by sensors.

    Parameters
    ----------
    rows : their cells.
    numbers : (n, k) of the same rows; NaN where a cell has none.
    """
    if len(rows) < FEWEST_ROWS:
        return
    columns = parse_names(names)
    threes = [triple.indices for triple in triples(names)]
    in_triples = {k for three in threes for k in three}
    meaningful = {column.index for column in columns if column.quantity is not None}
    for k in range(len(names)):
        if k in in_triples or k in meaningful:
            continue
        member = _rows_by_value([row[k] if k < len(row) else "" for row in rows])
        if len(member) < 2:
            continue
        named = bool(set(words_of(names[k])) & DEVICE_WORDS)
        divided = [three for three in threes if _differ(numbers[:, three], list(member.values()), named)]
        if divided:
            raise _several_sensors(names, k, divided[0], numbers, member, columns[divided[0][0]].quantity)


def _rows_by_value(values: Sequence[str]) -> dict[str, np.ndarray]:
    """Return which rows have each value of a column, without rare and empty ones; empty: no few values alternate."""
    distinct = list(dict.fromkeys(values))
    changes = sum(one != other for one, other in pairwise(values))
    # rows of sensors that have names may also be in sections, one behind the other
    in_sections = all(map(sensor_of_value, distinct))
    if not 2 <= len(distinct) <= MOST_VALUES or not (in_sections or changes >= ALTERNATING * len(values)):
        return {}
    member = {value: np.array([v == value for v in values]) for value in distinct}
    return {value: rows_of for value, rows_of in member.items() if rows_of.sum() >= 3 and value}


def _differ(numbers: Floats, members: Sequence[np.ndarray], named: bool) -> bool:
    """Return whether (n, 3) numbers are those of several sensors, by their rows."""
    groups = [numbers[rows][np.isfinite(numbers[rows]).all(axis=1)] for rows in members]
    groups = [group for group in groups if len(group) >= 3]
    for k, one in enumerate(groups):
        for other in groups[k + 1 :]:
            apart = np.abs(np.median(one, axis=0) - np.median(other, axis=0))
            spread = np.hypot(_spread(one), _spread(other))
            # of a column that names a sensor, a significant difference is enough
            few = min(len(one), len(other))
            if (apart > FAR * spread / (few**0.5 if named else 1.0)).any() and (apart > 0.0).any():
                return True
    return False


def _spread(values: Floats) -> Floats:
    return np.asarray(np.quantile(values, 0.84, axis=0) - np.quantile(values, 0.16, axis=0)) / 2.0


def _several_sensors(
    names: Sequence[str],
    column: int,
    three: tuple[int, ...],
    numbers: Floats,
    member: Mapping[str, np.ndarray],
    quantity: str | None,
) -> RecordingError:
    """Return the error that lists the sensors of the rows, with the option that reads each."""
    name = names[column].strip()
    counts = ", ".join(f"{value} ({int(rows.sum()):,} of {len(rows):,})" for value, rows in member.items())
    text = f"the rows are of several sensors, by the column {name}: {counts}"
    options = []
    for value, rows in member.items():
        fields: dict[str, object] = {"where": {name: value}}
        size = median_size(numbers[rows][:, three]) or 0.0
        named = SENSORS.get(quantity or "") or sensor_of_value(value)
        if named is None and not any(is_one_g(size * UNITS["accel"][unit]) for unit in ("m/s2", "g", "mg")):
            unit = "deg/s" if too_noisy(numbers[rows][:, three]) else "rad/s"
            fields["columns"] = {
                f"gyro/{axis}": f"{reference(k, names)}:{unit}" for axis, k in zip(AXES, three, strict=True)
            }
        options.append(option_text(**fields))
    return RecordingError("several_sensors", text, f"choose one: {' or '.join(options)}")


def sensor_of_value(value: str) -> str | None:
    """Return the sensor that a value names; None: it names none.

    >>> sensor_of_value("Gyroscope"), sensor_of_value("android.sensor.accelerometer"), sensor_of_value("4")
    ('gyro', 'accel', None)
    """
    return next((s for s in ("gyro", "accel", "mag") if s in value.lower()), None)
