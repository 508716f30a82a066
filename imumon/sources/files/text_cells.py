"""Cells: the texts between the separators of a line, and the number or date in each."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Sequence

from imumon.sources.files.date_reader import DateReader

MISSING = {"", "nan", "na", "n/a", "null", "none", "-"}
"""Contents of a cell without a number."""


def decoded(data: bytes) -> str:
    """Return text in UTF-8, else in Latin-1: older spreadsheets write the degree sign as one byte."""
    try:
        return data.decode("utf-8-sig")  # spreadsheets begin a file with a mark of the byte order
    except UnicodeDecodeError:
        return data.decode("latin-1")


_BEFORE_BRACKET = re.compile(r"(?<![ \t])[ \t]+(?=[\[(][^\d\s\])]*[A-Za-z°][^\[\](]*[\])])")


def split(line: str, separator: str | None) -> list[str]:
    """Return the cells of a line, without quotes and blanks around them.

    >>> split('"a, b", 2,', ","), split("A_X [mg]  B", None), split("1;2,5", ";")
    (['a, b', '2', ''], ['A_X [mg]', 'B'], ['1', '2,5'])
    """
    if separator is None:
        return [cell.replace("\0", " ").strip("\"'") for cell in _BEFORE_BRACKET.sub("\0", line).split()]
    cells = next(csv.reader([line], delimiter=separator), []) if '"' in line else line.split(separator)
    return [cell.strip().strip("\"'").strip() for cell in cells]


_FORTRAN = re.compile(r"^([-+]?\d*\.\d*)[dD](?=[-+]\d+$)")
"""A number with the exponent that Fortran prints."""

_CHECK = re.compile(r"\*.{2,}|;$")
"""Check behind a number, 12.3*4F, or the end of a line."""


def number_of(cell: str, *, decimal: bool = False) -> float | None:
    """Return the number in a cell; NaN where it says that there is none, None where it holds something else."""
    text = cell.replace(",", ".") if decimal else cell
    try:
        return float(text)
    except ValueError:
        number = _FORTRAN.sub(r"\1e", _CHECK.sub("", text))
    if number != text:
        return number_of(number)
    return math.nan if text.lower() in MISSING else None


def is_date(cell: str) -> bool:
    try:
        DateReader().seconds(cell)
    except ValueError:
        return False
    return True


def has_value(cell: str, decimal: bool) -> bool:
    """Return whether a cell holds a number or a date, or is empty."""
    return number_of(cell, decimal=decimal) is not None or is_date(cell)


def are_dates(cells: Sequence[str]) -> bool:
    texts = [cell for cell in cells if cell.lower() not in MISSING][:20]
    return (
        bool(texts)
        and not any(number_of(text) is not None for text in texts)
        and all(map(is_date, texts[-5:]))
    )


def numbers_of(
    cells: Sequence[str] | Sequence[bytes], reader: DateReader | None = None, decimal: bool = False
) -> list[float]:
    """Return the numbers of a column of cells; NaN where a cell has none.

    Parameters
    ----------
    reader : of a column of dates.
    """
    try:
        if reader is None:
            return [*map(float, cells)]
    except ValueError:
        pass
    texts = (decoded(cell).strip() if isinstance(cell, bytes) else cell for cell in cells)
    return [_cell_number(text, reader, decimal) for text in texts]


def _cell_number(cell: str, reader: DateReader | None, decimal: bool) -> float:
    try:
        number = (
            number_of(cell, decimal=decimal)
            if reader is None or cell.lower() in MISSING
            else reader.seconds(cell)
        )
    except ValueError:
        number = None
    return math.nan if number is None else number
