"""Header of a table: names and units of its columns, by the lines above its first row.

The names are in the last line of as many cells, the units in a line of units beside it, or each in brackets. A line may
also describe each channel in pairs of a word and a name, and the lines may list one name each. A name may span several
columns, and a comment may say which columns the rows of a word have.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import groupby, pairwise

from imumon.sources.files.text_cells import has_value, split
from imumon.sources.files.unit_grammar import known_unit


def header_of(
    above: Sequence[str], width: int, separator: str | None
) -> tuple[tuple[str, ...], tuple[str, ...], str]:
    """Return the names and units of columns by the lines above the first row, and the line of the names."""
    empty = ("",) * width
    lines = [(k, row) for k, line in enumerate(above) if (row := _header_cells(line, width, separator))]
    if (paired := _header_of_pairs(lines)) is not None:
        k, names, units = paired
        return tuple(names), tuple(units or empty), above[k]
    place, units = _named_line([cells for _, cells in lines])
    if place < 0:
        return empty, empty, ""
    k, names = lines[place]
    # a name may span the columns of its axes, which are empty or have a number
    spanned = ["" if re.fullmatch(r"\d", name) else name for name in names]
    names = elements(_spread(spanned)) if "" in spanned[1:-1] else names
    return tuple(names), tuple(units or empty), above[k]


def _header_of_pairs(
    lines: Sequence[tuple[int, Sequence[str]]],
) -> tuple[int, Sequence[str], Sequence[str]] | None:
    """Return the place of the line that names channels in pairs, their names and units; None: there is no such line.

    The rows have a time and a number for each channel. Above these are a word, and what it says of the channel.
    """
    described = {row[0].lower(): (k, row) for k, row in lines[::-1] if _are_pairs(row)}
    key = next((key for key in described if re.search("name|channel|signal", key)), None)
    if key is None:
        return None
    place, row = described[key]
    _, units_of = described.get("unit", described.get("units", (0, ())))
    names = ["time" if k % 2 == 0 else cell for k, cell in enumerate(row)]
    return place, names, ["" if k % 2 == 0 else cell for k, cell in enumerate(units_of)]


_LISTED = re.compile(r"(?:col[a-z]*|ch[a-z]*|field)?\s*\d+\s*[:.)=-]+\s*([^\W\d].*)", re.IGNORECASE)
"""A line of a list, with a name behind a number."""


def listed_names(above: Sequence[str], width: int) -> list[str]:
    """Return names of which each has a line: behind a number, or before a line with a unit.

    All columns are listed, or all but the first one, which is the time.
    """
    lines = [line.strip("#% \t") for line in above]
    numbered = [match[1] for match in map(_LISTED.match, lines) if match is not None]
    before_units = [
        f"{name} [{unit}]" for name, unit in pairwise(lines) if known_unit(unit) and not known_unit(name)
    ]
    return next((names for names in (numbered, before_units) if len(names) in (width, width - 1)), [])


def _are_pairs(cells: Sequence[str]) -> bool:
    """Return whether every second cell has one word, so that those between are what it says of a channel each."""
    return len(cells) > 2 and len(set(cells[::2])) == 1


def _named_line(lines: Sequence[Sequence[str]]) -> tuple[int, Sequence[str]]:
    """Return the place of the line of names, -1 if there is none, and the units of a line of units."""
    named = [k for k, cells in enumerate(lines) if are_names(cells)]
    last = max(named, default=-1)
    for k in range(len(lines) - 1, -1, -1):
        if _are_units(lines[k]) and k - 1 in named:  # whatever is below them
            return k - 1, lines[k]
        if _are_units(lines[k]) and k < last:  # above the names, where the first cell may name the line
            first, *others = lines[k]
            return last, [first if known_unit(first) is not None else "", *others]
    return last, ()


def described_names(
    above: Sequence[str], names: tuple[str, ...], separator: str | None, word: str
) -> tuple[str, ...]:
    """Return the names in a comment on the rows of a word, such as # UncalGyro,utcTimeMillis; else those above all."""
    pattern = rf"(?<![\w]){re.escape(word)}\s*{re.escape(separator or ' ')}(.*)"
    for match in filter(None, (re.search(pattern, line) for line in above)):
        cells = [word, *split(match[1].strip("'\" "), separator), ""]
        if len(cells) > len(names):
            return tuple(cells[: len(names)])
    return names


def _are_units(cells: Sequence[str]) -> bool:
    """Return whether two cells or more, and half of those with a text, are units."""
    return sum(known_unit(c) is not None for c in cells) >= max(2, sum(map(bool, cells)) // 2)


def _header_cells(line: str, width: int, separator: str | None) -> list[str] | None:
    """Return the cells of a line if they are as many as those of a row; other separators count, too."""
    text = re.sub(r"^\s*(?:#+|%+|//)\s*", "", line)
    for other in dict.fromkeys((separator, ",", ";", "\t", None)):
        cells = split(text, other)
        while len(cells) > width and not cells[-1]:
            cells.pop()
        # rows end with a separator, or have no comment
        if separator is not None and abs(len(cells) - width) == 1:
            cells = [*cells, ""][:width]
        if len(cells) == width:
            return cells
    return None


def are_names(cells: Sequence[str]) -> bool:
    """Return whether cells can be names: most hold a letter and no number or date; axes may have the names 1 and 2."""
    texts = [cell for cell in cells if cell]
    words = [cell for cell in texts if re.search(r"[^\W\d]", cell) and not has_value(cell, False)]
    return len(words) >= max(1.0, 0.5 * len(texts), 0.25 * len(cells)) and all(
        len(cell) < 4 for cell in texts if cell not in words
    )


def _spread(cells: Sequence[str]) -> list[str]:
    """Return cells of which an empty one has the name before it."""
    result: list[str] = []
    for cell in cells:
        result.append(cell or (result[-1] if result else ""))
    return result


def elements(names: Sequence[str]) -> list[str]:
    """Return names of which those that occur several times one behind the other have a number, or the axis.

    >>> elements(["t", "a", "a", "gyro (z,x,y)", "gyro (z,x,y)"])
    ['t', 'a[0]', 'a[1]', 'gyro z', 'gyro x']
    """
    result = []
    for name, of in groupby(names):
        count, order = len(list(of)), re.search(r"\(([xyz]),\s*([xyz]),\s*([xyz])\)", name)
        for k in range(count):
            axis = (
                f"{name[: order.start()]}{order[k % 3 + 1]}{name[order.end() :]}" if order else f"{name}[{k}]"
            )
            result.append(axis if count > 1 and name else name)
    return result
