"""Labels of numbers: the name and the unit of each number of a record, by the text between the numbers.

A number is named by the text before it. A bare axis, and an element of a list, has the words before that, too. A unit
is in brackets before a number, or behind it. Where the axes of a sensor come again, the record holds several samples.

>>> line = PrintedLine(("Gyro x: ", " dps, y: ", " dps"), ("1", "2"), (False, False))
>>> number_labels([line])
(('Gyro x', 'Gyro y'), ('dps', 'dps'), ())
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

from imumon.model.samples import AXES
from imumon.sources.files.column_names import names_time
from imumon.sources.files.unit_grammar import known_unit


@dataclass(frozen=True, slots=True)
class PrintedLine:
    """The literal text between the numbers of a line, and its numbers and dates as text."""

    literals: tuple[str, ...]
    values: tuple[str, ...]
    dates: tuple[bool, ...]


Samples: TypeAlias = tuple[Mapping[str, int], ...]
"""Places of the numbers of each sample of a record, by their names; none: the record is one sample."""


def number_labels(record: Sequence[PrintedLine]) -> tuple[tuple[str, ...], tuple[str, ...], Samples]:
    """Return a name and a unit for each number of a record, by the text between the numbers, and its samples."""
    labels = _Labels(any(_unit_behind(line.literals[-1]) for line in record))
    tail = ""  # text behind the last number of the lines before
    texts: list[str] = []  # of each line with numbers, with the lines without any before it
    for line in record:
        if line.values:
            texts.append("\n".join([tail, *line.literals]))
        for k, literal in enumerate(line.literals):
            text = literal if k else f"{tail}\n{literal}"
            if k == len(line.values):
                tail = text
                continue
            tail = ""
            labels.add(text, is_date=line.dates[k])
    if labels.names:
        labels.state_unit_behind(_unit_behind(tail))
    counts = [len(line.values) for line in record if line.values]
    return tuple(_distinct(labels.names, counts, texts)), tuple(labels.units), samples_of(labels.names)


@dataclass(slots=True)
class _Labels:
    """The labels of the numbers of a record so far, and what the next one may depend on.

    Attributes
    ----------
    names, units, sections : of each number so far.
    section : words before a bare axis.
    base, index : name of a list, and place of its last element.
    unit_before : unit before the last number, which the next elements of its list have, too.
    was_assigned : an equals sign is before the last number.
    has_units_behind : a unit is behind the last number of a line, so that words between numbers may be units, too.
    """

    has_units_behind: bool
    names: list[str] = field(default_factory=list)
    units: list[str] = field(default_factory=list)
    sections: list[str] = field(default_factory=list)
    section: str = ""
    base: str = ""
    index: int = 0
    unit_before: str = ""
    was_assigned: bool = False

    def add(self, text: str, *, is_date: bool) -> None:
        """Add the label of the number behind a text."""
        text = self._without_unit_behind(text)
        unit, label, container, assigned = _between(text)
        self.section = container or self.section
        # behind a number, a bracket begins a list of its own
        begins_list = bool(self.base) and not label and re.search(r"[\[({]\s*$", text) is not None
        if re.fullmatch(r"[xyzw]|[xyzw]-?axis|roll|pitch|yaw", label, re.IGNORECASE):
            name = f"{self.section} {label}".strip()
            self.base, self.index = name, 0
        elif label:
            name = self._begin_list(label, assigned=assigned)
        elif is_date:
            name = "time"
        elif begins_list:
            name, self.index = f"{self.base}[0]", 0
        elif self.was_assigned and not text.strip():  # a=1,b=2 3: no element of b
            name, self.base = "", ""
        else:
            name = self._next_element()
        self.was_assigned = text.rstrip().endswith("=")
        continues = bool(self.units) and not (label or begins_list) and self.sections[-1] == self.section
        self.names.append(name)
        self.unit_before = unit or (self.unit_before if continues else "")
        self.units.append(self.unit_before)
        self.sections.append(self.section)

    def _without_unit_behind(self, text: str) -> str:
        """Return a text without the unit of the number before it, which is stated now; one before that number is it."""
        behind = _unit_behind(text) if self.names and not self.units[-1] else ""
        end = text.find(behind) + len(behind)
        if text[:1].isspace() and not text[end:].strip() and not self.has_units_behind:
            return text  # the label of the number behind it
        self.state_unit_behind(behind)
        return text[end:]

    def state_unit_behind(self, unit: str) -> None:
        """Give the last numbers of a section, which have no unit yet, the one behind them; empty: none."""
        for j in range(len(self.names) - 1, -1, -1):
            if self.units[j] or self.sections[j] != self.sections[-1]:
                break
            self.units[j] = unit

    def _begin_list(self, label: str, *, assigned: bool) -> str:
        """Return the name of a number with a label, which may be the first element of a list."""
        words = label.split()
        name = " ".join(words[-2:] if len(words[-1]) == 1 else words[-1:]) if assigned else label
        self.index, self.base = 0, name
        stem = re.sub(r"[\s_.-]*\b[xyz]$", "", name, flags=re.IGNORECASE).strip()
        self.section = "" if names_time(stem) else stem or self.section
        return name

    def _next_element(self) -> str:
        """Return the name of a number without a label: an element of the list that has begun."""
        self.index += 1
        if not self.base:
            return ""
        if self.index == 1 and self.names[-1] == self.base:
            self.names[-1] = f"{self.base}[0]"
        return f"{self.base}[{self.index}]"


def _distinct(names: Sequence[str], counts: Sequence[int], texts: Sequence[str]) -> list[str]:
    """Return names of which those that come again have the words that only their line has, or the last one with such.

    Parameters
    ----------
    counts : of the names of each line.
    texts : of each line.
    """
    often = Counter(names)
    words = [list(dict.fromkeys(re.findall(r"[^\W\d_]{2,}", text))) for text in texts]
    common = Counter(word for of_line in words for word in of_line)
    result: list[str] = []
    describing = ""
    for count, of_line in zip(counts, words, strict=True):
        # the words of the only line are of all its numbers
        describing = " ".join(word for word in of_line if common[word] == 1 < len(texts)) or describing
        of_names = names[len(result) : len(result) + count]
        result += [f"{describing} {name}".strip() if often[name] > 1 else name for name in of_names]
    return result


AXIS = re.compile(r"(.*?)(?:[\s_.]{0,3}([xyz])|\[([012])\])", re.IGNORECASE)
"""A name with an axis, or with the place of one in a list."""


def samples_of(names: Sequence[str]) -> Samples:
    """Return the samples of a record in which the axes of a sensor come again.

    A number that is not repeated, and a time that is so more often, belongs to the samples behind it.

    >>> samples_of(["t", "a[0]", "a[1]", "a[2]", "a[0]", "a[1]", "a[2]"])[1]
    {'t': 0, 'a[0]': 4, 'a[1]': 5, 'a[2]': 6}
    >>> samples_of(["t", "x[0]", "x[1]", "y[0]", "y[1]", "z[0]", "z[1]"])[1]
    {'t': 0, 'x': 2, 'y': 4, 'z': 6}
    """
    names = _lists_by_axis(names)
    places: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        places.setdefault(name, []).append(k)
    repeats = _repeats(places)
    count = max(repeats.values(), default=1)
    if count == 1:
        return ()
    repeated = [name for name in places if repeats.get(_stem(name)) == count]
    others = [name for name in places if _stem(name) not in repeats]
    samples = []
    for j in range(count):
        first = min(places[name][j] for name in repeated)
        before = {
            name: max([k for k in places[name] if k < first], default=places[name][0]) for name in others
        }
        samples.append(before | {name: places[name][j] for name in repeated})
    return tuple(samples)


def _stem(name: str) -> str | None:
    """Return what the name of an axis has in common with those of the other axes; None: it is of no axis."""
    match = AXIS.fullmatch(name)
    return None if match is None else match[1].lower()


def _lists_by_axis(names: Sequence[str]) -> list[str]:
    """Return the names, where each axis of a sensor has a list of its own by the axis alone."""
    lists = Counter(name.rpartition("[")[0] for name in names if name.endswith("]"))
    of_axes = {
        stem
        for stem, count in lists.items()
        if all(lists[f"{stem[:-1]}{axis}"] == count > 1 for axis in AXES)
    }
    return [stem if (stem := name.rpartition("[")[0]) in of_axes else name for name in names]


def _repeats(places: Mapping[str, Sequence[int]]) -> dict[str | None, int]:
    """Return how often the axes of each sensor come, by stem, where all three come as often."""
    counts: dict[str, list[int]] = {}
    for name, numbers in places.items():
        if (stem := _stem(name)) is not None:
            counts.setdefault(stem, []).append(len(numbers))
    return {stem: of[0] for stem, of in counts.items() if len(of) == len(AXES) and len(set(of)) == 1}


def _unit_behind(text: str) -> str:
    """Return the unit at the begin of the text behind a number, also in brackets of its line; empty: none is."""
    word = re.match(
        r"(?:[\s\"'§\])}]*|[ \t\"'\])}]*[\[(] *)([A-Za-z°µ%][^\s,;|)\]}\"'\n]*(?: (?:per|p) \w+)?)", text
    )
    unit = "" if word is None else word[1].rstrip(".")
    return unit if known_unit(unit) is not None else ""


def _between(text: str) -> tuple[str, str, str, bool]:
    """Return the text before a number.

    Returns
    -------
    unit in brackets, label, words of the section around it, and whether an equals sign is before the number.
    """
    unit = ""
    for match in re.finditer(r"[\[(]\s*([^\[\]()\d][^\[\]()]*)\s*[\])]", text):
        if known_unit(match[1]) is not None:
            unit = match[1]
            text = text.replace(match[0], " ", 1)
    assigned = text.rstrip("\"' [({").endswith("=")
    segments = [
        " ".join(re.findall(r"[^\W]+(?:[/.\-^][^\W]+)*", part))
        for part in re.split(r"[,;|{}()\[\]\n>]|[:=]", text)
    ]
    segments = [segment for segment in segments if re.search(r"[^\W\d_]", segment)]
    label = segments[-1] if segments else ""
    return unit, label, segments[-2] if len(segments) > 1 else "", assigned
