"""Text fields: numbers with names in lines of text, and records of them.

Programs print a sample for people or for other programs, and the names are beside the numbers::

    t: 0, ax: 0.117, ay: -0.190, az: 9.799
    Acceleration X: 0.117, Y: -0.190, Z: 9.799 m/s^2
    10:23:45.123 -> Gyro: 0.0050, 0.0005, 0.0020
    {"ts": 0, "gyro": [0.0050, 0.0005, 0.0020], "acc": {"x": 0.117}}
    >gx:1627551892437:0.0050§rad/s                               (Teleplot)
    imu,host=a gx=0.0050,gy=0.0005 1700000000000000000           (line protocol of InfluxDB: the stamp is last)

`fields_of` returns the names and values of a line. A record may have several lines: it ends where a name comes again
(`RecordAssembler`). Files and live lines share both; what a name means is for `column_names`.

>>> fields_of("Rotation X: 0.0050, Y: 0.0005, Z: 0.0020 rad/s")
{'Rotation X [rad/s]': '0.0050', 'Rotation Y [rad/s]': '0.0005', 'Rotation Z [rad/s]': '0.0020'}
>>> fields_of('{"gyro": [1, 2, 3], "acc": {"x": 0.5}, "id": "A"}')
{'gyro[0]': '1', 'gyro[1]': '2', 'gyro[2]': '3', 'acc.x': '0.5', 'id': 'A'}
>>> fields_of("2024-3-19 9:44:16:689 0.01 0.02 0.03")
{}
>>> fields_of("gx:0.1 gy:0.2"), fields_of("ready"), fields_of("Gyro: 1, 2, 3")
({'gx': '0.1', 'gy': '0.2'}, {}, {'Gyro x': '1', 'Gyro y': '2', 'Gyro z': '3'})
>>> fields_of(">gx:1627551892437:0.5§rad/s"), fields_of("imu,host=a gx=0.5,gy=1 1700000000000000000")
({'time': '1627551892437', 'gx [rad/s]': '0.5'}, {'gx': '0.5', 'gy': '1', 'time': '1700000000000000000'})
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from imumon.model.samples import AXES
from imumon.sources.column_names import UNITS, split_unit, unit_of

MOST_FIELDS = 256
"""Fields of a record: a longer one is no sample."""

LONGEST_LIST = 9
"""Numbers of a list in JSON whose elements are fields: three axes, or a matrix of them."""

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_VALUE = re.compile(rf"[:=]\s*(?P<number>{_NUMBER})(?![\w.]|:\d)")
_TWO_MORE = re.compile(rf"[\s,;]+({_NUMBER})[\s,;]+({_NUMBER})(?![\w.:=])")
_FIVE_MORE = re.compile(rf"[\s,;]+({_NUMBER})" * 5 + r"(?![\w.:=])")
"""Numbers of two sensors behind a label such as ``a/g:``."""
_TIME_OF_DAY = re.compile(r"\s*\[?(\d{1,2}:\d\d:\d\d[.,]\d+)\]?\s*(?:->|\||,|:|-)?\s*")
"""Time that a terminal program writes before each line."""
_SEPARATORS = re.compile(r"[,;|\t]")
_TELEPLOT = re.compile(rf">([^:|§]+):(?:(\d+(?:\.\d*)?):)?({_NUMBER})(?:§([^|]*))?(?:\|.*)?")
_LAST_STAMP = re.compile(r"\s(\d{10,19})$")
"""Whole seconds since 1970 or a finer unit of them, behind the last value of a line."""


def fields_of(text: str) -> dict[str, str]:
    """Return the values of a line by their names, as text; empty: it has none."""
    text = text.strip()
    if text.startswith("{"):
        try:
            return json_fields(json.loads(text))
        except (ValueError, RecursionError):
            return {}
    if (plotted := _TELEPLOT.fullmatch(text)) is not None:
        name, stamp, number, unit = plotted.groups()
        value = {_plain(f"{name} [{unit}]" if unit else name): number}
        return {"time": stamp} | value if stamp else value
    fields: dict[str, str] = {}
    if clock := _TIME_OF_DAY.match(text):
        fields["time"] = clock[1].replace(",", ".")
        text = text[clock.end() :]
    named = _labelled(text)
    if named and not fields and (last := _LAST_STAMP.search(text)) is not None and "time" not in named:
        fields["time"] = last[1]
        return named | fields
    return fields | named if named else {}


def json_fields(value: Any) -> dict[str, str]:
    """Return the numbers and texts of a JSON object by their paths."""
    return dict(_flat("", value)) if isinstance(value, dict) else {}


def _flat(path: str, value: Any) -> Iterator[tuple[str, str]]:
    if isinstance(value, dict):
        for name, inner in list(value.items())[:MOST_FIELDS]:
            yield from _flat(f"{path}.{name}" if path else str(name), inner)
    elif isinstance(value, list):
        if len(value) <= LONGEST_LIST:
            for k, inner in enumerate(value):
                yield from _flat(f"{path}[{k}]", inner)
    elif isinstance(value, str | int | float) and not isinstance(value, bool):
        yield _plain(path), str(value)


@dataclass(slots=True)
class _LabelledNumber:
    """Number of a line, as text; `prefix` is what the labels of all axes of its sensor begin with."""

    text: str
    label: str
    prefix: str
    unit: str = ""


def _labelled(text: str) -> dict[str, str]:
    """Return the numbers behind labels in a line."""
    numbers: list[_LabelledNumber] = []
    end, prefix = 0, ""
    for match in _VALUE.finditer(text):
        if match.start() < end:
            continue
        unit, label = _unit_and_label(text[end : match.start()], first=not numbers)
        if numbers and unit:
            numbers[-1].unit = unit
        # the minutes of a time of day have no label: the line is a row of a table
        if not any(map(str.isalpha, label.rpartition(" ")[2])) or len(numbers) >= MOST_FIELDS:
            return {}
        label, prefix = _with_prefix(label, prefix)
        end = match.end()
        of_axes, end = _behind_one_label(label, match["number"], text, end)
        numbers += of_axes or [_LabelledNumber(match["number"], label, prefix)]
    if numbers:
        numbers[-1].unit = _known_unit(text[end:].strip(" ,;|")) or numbers[-1].unit
    _share_units(numbers)
    return {_plain(f"{n.label} [{n.unit}]" if n.unit else n.label): n.text for n in numbers}


def _behind_one_label(label: str, first: str, text: str, end: int) -> tuple[list[_LabelledNumber], int]:
    """Return the axes of one or two sensors whose numbers follow one label, and where they end; none: one number."""
    both = [part.strip() for part in label.split("/")]
    if len(both) == 2 and all(both) and (more := _FIVE_MORE.match(text, end)):  # a/g: 1 2 3 4 5 6
        texts = (first, *more.groups())
        return [*_numbers_of_axes(both[0], texts[:3]), *_numbers_of_axes(both[1], texts[3:])], more.end()
    if more := _TWO_MORE.match(text, end):  # Gyro: 0.1, 0.2, 0.3
        return list(_numbers_of_axes(label, (first, *more.groups()))), more.end()
    return [], end


def _with_prefix(label: str, prefix: str) -> tuple[str, str]:
    """Return a label with the prefix of the labels before it if it is an axis alone, and the prefix from here on."""
    if label.lower() in AXES and prefix:  # Acceleration X: 0.1, Y: 0.2
        return f"{prefix} {label}", prefix
    if split_unit(label)[0][-1:].lower() in AXES:
        return label, split_unit(label)[0][:-1].rstrip(" _.")
    return label, prefix


def _numbers_of_axes(label: str, texts: Sequence[str]) -> Iterator[_LabelledNumber]:
    """Yield the three numbers behind one label, with an axis and the unit of the label each."""
    bare, unit = split_unit(label)
    for axis, text in zip(AXES, texts, strict=True):
        yield _LabelledNumber(text, f"{bare} {axis}", bare, unit or "")


def _share_units(numbers: Sequence[_LabelledNumber]) -> None:
    """Give numbers without a unit that of the number behind them: at the end of a line, it is that of all axes."""
    for k in range(len(numbers) - 2, -1, -1):
        number, behind = numbers[k], numbers[k + 1]
        if not number.unit and behind.unit and number.prefix and number.prefix == behind.prefix:
            number.unit = behind.unit


def _unit_and_label(between: str, *, first: bool) -> tuple[str, str]:
    """Return the unit of the number before some text, and the label of the number behind it."""
    parts = [part.strip() for part in _SEPARATORS.split(between) if part.strip()]
    if not parts:
        return "", ""
    # host=a gx: a word is the value of a name before the label
    label = " ".join(re.sub(r"[:=]", " ", re.sub(r".*=\S+\s+", "", parts[-1])).split())
    if first:
        return "", label
    if len(parts) > 1:
        return _known_unit(parts[0]), label
    head, _, rest = label.partition(" ")
    return (head, rest) if rest and _known_unit(head) else ("", label)


def _known_unit(text: str) -> str:
    """Return a unit that follows a number; empty: it is none."""
    return text if any(unit_of(text, quantity) for quantity in UNITS) else ""


def _plain(name: str) -> str:
    """Return a name without what separates cells."""
    return " ".join(re.sub(r'[,;|\t"\r\n]', " ", name).split())


class RecordAssembler:
    """Joins the fields of lines to records: `add` for each line, then `finish`.

    >>> records = RecordAssembler()
    >>> [records.add({"x": "1"}), records.add({"y": "2"}), records.add({"x": "3"}), records.finish()]
    [None, None, {'x': '1', 'y': '2'}, {'x': '3'}]
    """

    def __init__(self) -> None:
        self._fields: dict[str, str] = {}

    def add(self, fields: Mapping[str, str]) -> dict[str, str] | None:
        """Return the record that ends before the fields of a line; None: it continues."""
        ended = None
        again = self._fields.keys() & fields.keys()
        # each value of a sample may have the stamp of the sample
        if again == {"time"} and self._fields["time"] == fields["time"]:
            again = set()
        if again or len(self._fields) > MOST_FIELDS:
            ended, self._fields = self._fields, {}
        self._fields.update(fields)
        return ended

    def finish(self) -> dict[str, str] | None:
        """Return the last record; None: there is none."""
        ended, self._fields = self._fields, {}
        return ended or None
