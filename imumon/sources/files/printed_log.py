"""Printed log: a text is what a loop printed, and its format string is recovered from it.

Each line is numbers in a fixed text. What divides them decides how the text is read:

1. *Cells.* Most lines have as many cells, apart by the same character: CSV in its dialects. Names are in the last
   line of as many cells above the first row, units in a line of units below it, or in brackets.
2. *Template.* Otherwise the text between the numbers is the template of a line. Lines whose templates repeat with a
   period are records: labels, YAML, JSON, dicts of Python, text of protobuf. Without a period, each template that comes
   often is a table of its own, and the lines between are text.
3. *Code.* A column of few values that alternate, and by which the numbers differ, says of which sensor a row is: each
   of its values is a table of its own.

A number is named by the header above it, else by the text before it; a bare axis, and an element of a list, also by the
words before that. A date is a number, in seconds. What the names mean is for `columns`.

`tables` finds the tables in the head of a text. `RecordReader` then reads blocks of lines by one of them in bulk: what
fits the form becomes rows, every other line is counted (`imumon.ledger`).

>>> table = tables("t: 0, ax: 0.1, ay: 0.2\\nt: 10, ax: 0.3, ay: 0.1\\nt: 20, ax: 0.2, ay: 0.3\\n" * 4)[0]
>>> table.names
('t', 'ax', 'ay')
>>> tables("Gyro: 1, 2, 3\\n" * 12)[0].names
('Gyro[0]', 'Gyro[1]', 'Gyro[2]')
"""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from imumon.model.samples import AXES, Floats
from imumon.sources.files.column_header import are_names, described_names, elements, header_of, listed_names
from imumon.sources.files.column_names import named_channel, names_sensor, words_of
from imumon.sources.files.columns import check_width
from imumon.sources.files.date_reader import DateReader
from imumon.sources.files.number_labels import AXIS, PrintedLine, Samples, number_labels
from imumon.sources.files.sizes_at_rest import same_sensor
from imumon.sources.files.text_cells import are_dates, has_value, number_of, numbers_of, split
from imumon.sources.files.unit_grammar import StatedRate, stated_rate

LONGEST_PERIOD = 64
"""Lines of a record at most: a message of a topic with its covariances has about forty."""

REGULAR = 0.9
"""Share of the lines that must have one form. Without text between them, all but some have it."""

FREQUENT_LINES, FREQUENT = 8, 0.03
"""Lines, and share of the lines, from which a template is a table of its own: one sensor may be 30 times as fast."""

MOST_DESCRIPTIONS = 4
"""Rows above the numbers that say one thing of all columns: more of them are samples with equal numbers."""

MOST_CODES = 12
"""Values of a column that divides the rows: a table has no more sensors."""

FAR = 6.0
"""Standard deviations by which numbers differ that are not of one sensor."""

TOO_LONG_BYTES = b"\xed\xbf\xbf"
"""Line in place of one that is too long: no text in UTF-8 has these bytes."""


_N = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+|[dD][-+]\d+)?"  # one way to match: a row has many
_VOID = r"[-+]?(?:nan|NaN|NAN|null|None|inf|Infinity)"
_STAMP = (
    r"(?:\d{4}[-/.]\d{1,2}[-/.]\d{1,2}[T ]+|\d{1,2}[-/.](?:\d{1,2}|[A-Za-z]{3})[-/.]\d{4}[T ,]+)?"
    r"\d{1,2}:\d{2}:\d{2}(?:(?:[.,:]|::)\d{1,9})?(?:Z|[+-]\d{2}:\d{2}(?!\S*:))?(?:\s*[AaPp]M)?"
    r"|\d{1,2}:\d{2}\.\d{1,9}"
    r"|\d{4}-\d{1,2}-\d{1,2}T\d{2}\.\d{2}\.\d{2}(?:\.\d{1,9})?"
)
_NO_INDEX = r"(?!(?<=\[)\d{1,2}\]\s*[:=]?\s*[-+.\d])"  # [0] 27 mg
TOKEN = re.compile(
    rf"(?<![\w.])(?P<stamp>{_STAMP})(?!:?\w)|(?:(?<![\w.^])|(?<=[A-Za-z_])(?=[-+])){_NO_INDEX}(?P<number>{_N})(?![.]?\w*\d)"
    rf"|(?<![\w.])(?P<void>{_VOID})(?!\w)"
)
"""A date or time of day, a number, or a word for none. Letters behind a number are its unit, unless
digits follow."""

_CODE = re.compile(
    r"\*[0-9A-Fa-f]{2,8}(?=\s*\"?\s*$)|(?<=[:=,\[(\s])(?:true|false|True|False)(?!\w)|\b0x[0-9A-Fa-f]+\b"
)
"""Checks, switches and bit fields: they differ from line to line and are no numbers."""

_BYTES = re.compile(r"(?:\b[0-9A-F]{2}[ \t]+){3,}[0-9A-F]{2}\b")
"""Bytes of a message, in hexadecimal."""

_ADDRESS = re.compile(r"(?:[0-9A-Fa-f]{2}:){5}[0-9A-Fa-f]{2}")
"""Address of a device: its bytes are no numbers of a sensor."""


def line_count(data: bytes) -> int:
    """Return the ends of lines in some bytes; numpy compares them eight times as fast as `bytes.count` searches."""
    return int(np.count_nonzero(np.frombuffer(data, np.uint8) == ord("\n")))


@dataclass(frozen=True, slots=True)
class PrintedTable:
    """One table of a text, and how its records are printed.

    Attributes
    ----------
    names, units : of each number of a record; an empty unit is none. A unit may also be a part of the name.
    rows : (n, k) numbers of the records in the head; not finite is missing.
    begin : lines before the first record.
    source : what it may be a table of: the values of codes, then the text before the table, a line each.
    rate : that this text states; None: it states none.
    dates : columns whose cells are dates or times of day; their numbers are seconds.
    separator : of cells; None with `pattern`: the text between the numbers divides them; None without: blanks do.
    decimal : the decimal sign is a comma.
    codes : values of the rows of this table, by column.
    header : line that names the columns; empty: there is none.
    pattern : of a record of one or more lines; empty: its parts are cells.
    lines : of a record.
    tail : lines of a record behind its last number, which the end of a text may lack.
    samples : places, in a record, of the numbers of each sample in it; empty: a record is a sample.
    between : patterns of lines with numbers that come now and then between the records.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    rows: Floats
    begin: int
    source: str = ""
    rate: StatedRate | None = None
    dates: tuple[int, ...] = ()
    separator: str | None = None
    decimal: bool = False
    codes: tuple[tuple[int, str], ...] = ()
    header: str = ""
    pattern: str = ""
    lines: int = 1
    tail: str = ""
    samples: tuple[tuple[int, ...], ...] = ()
    between: tuple[str, ...] = ()


def tables(head: str) -> list[PrintedTable]:
    """Return the tables in the beginning of a text; none: it has no records.

    Raises
    ------
    RecordingError : a record has more numbers than any sensor.
    """
    lines = head.split("\n")
    lines = lines[:-1] if len(lines) > 2 else lines  # the last line may end elsewhere
    body = [line for line in lines[len(lines) // 4 :] if line.strip()]
    if not body:
        return []
    form = _cell_form(body)
    return (_cell_tables(lines, *form) if form is not None else []) or list(_template_tables(lines))


# ---------------------------------------------------------------- cells


def _cell_form(body: Sequence[str]) -> tuple[str | None, bool] | None:
    """Return what separates the cells of most lines, and whether the decimal sign is a comma; None: no cells."""
    # objects, of many numbers each
    if sum(line.lstrip().startswith("{") for line in body) >= REGULAR * len(body):
        return None
    unquoted = [re.sub('"[^"]*"', "", line) for line in body]
    for separator in (";", "\t", ",", "|", None):
        if separator is not None and sum(separator in line for line in unquoted) < REGULAR * len(body):
            continue
        cells = _sample_cells(body[:200], separator)
        if cells is None:
            continue
        # a comma between cells is a decimal sign only in quotes, and then in all numbers
        decimal = any("," in c and number_of(c, decimal=True) is not None for c in cells) and not (
            separator == "," and any("." in c and number_of(c) is not None for c in cells)
        )
        if _are_mostly_values(cells, separator, decimal):
            return separator, decimal
    return None


def _sample_cells(lines: Sequence[str], separator: str | None) -> list[str] | None:
    """Return the cells of lines of which most have as many, or begin with one of few words; None: they do not."""
    sample = [split(line, separator) for line in lines]
    width, count = Counter(map(len, sample)).most_common(1)[0]
    tagged = len({cells[0] for cells in sample}) <= MOST_CODES
    if (width < 2 and separator is not None) or not (count >= REGULAR * len(sample) or tagged):
        return None
    return [c for row in sample if len(row) == width or tagged for c in row]


def _are_mostly_values(cells: Sequence[str], separator: str | None, decimal: bool) -> bool:
    """Return whether most cells hold one number or date, and few a name with it."""
    values = sum(has_value(c, decimal) for c in cells)
    several = sum(not has_value(c, decimal) and _has_labelled_number(c) for c in cells)
    # words between blanks are labels, unless they are in few cells
    fewest = 0.5 if separator is not None else REGULAR
    return values >= fewest * len(cells) and several < 0.1 * len(cells)


def _has_labelled_number(cell: str) -> bool:
    """Return whether a cell has a name before its number, a unit behind it, or several numbers."""
    cell = _ADDRESS.sub("", cell)
    numbers = sum(match["void"] is None for match in TOKEN.finditer(cell))
    if re.fullmatch(r"\d{1,4}([-/.])\d{1,2}\1\d{1,4}", cell):  # a day
        return False
    labelled = re.search(rf"[A-Za-z\"'][:= ]\s*[\[({{]?[-+.\d]|^{_N} [A-Za-z°]", cell)
    return numbers > 1 or (numbers == 1 and labelled is not None)


def _cell_tables(lines: Sequence[str], separator: str | None, decimal: bool) -> list[PrintedTable]:
    """Return the tables of lines that are cells; none: they are no rows of numbers."""
    cells = [split(line, separator) if line.strip() else [] for line in lines]
    rows = _rows_by_form(cells, decimal)
    total, most = sum(map(len, rows.values())), max(map(len, rows.values()), default=0)
    fewest = max(min(FREQUENT_LINES, total // 2), FREQUENT * total)
    tables_of_rows: list[PrintedTable] = []
    for (width, has_word), of in rows.items():
        # rows of another width are of another sensor if a word says so, else they are damaged
        if len(of) < (fewest if has_word else most):
            continue
        check_width(width)
        first = _first_row(cells, of)
        texts = [cells[k] for k in of if k >= first]
        tables_of_rows += _by_code(
            _cell_table(lines[:first], texts, separator, decimal), texts, lines[:first]
        )
    return tables_of_rows


def _rows_by_form(cells: Sequence[Sequence[str]], decimal: bool) -> dict[tuple[int, bool], list[int]]:
    """Return the lines of which half of the cells have values, by their width and whether they begin with a word."""
    rows: dict[tuple[int, bool], list[int]] = {}
    for k, row in enumerate(cells):
        values = [has_value(cell, decimal) for cell in row]
        numbers = any(number_of(c, decimal=decimal) is not None and c for c in row)
        if numbers and sum(values) >= max(1, len(row) // 2):
            rows.setdefault((len(row), not values[0]), []).append(k)
    return rows


def _first_row(cells: Sequence[Sequence[str]], places: Sequence[int]) -> int:
    """Return the line of the first row of a table: the first of three in succession that describes no columns."""
    first = next((k for k, later in zip(places, places[2:], strict=False) if later - k == 2), places[0])
    below = next((k for k in range(first, len(cells)) if not _is_description(cells[k])), first)
    return below if below - first <= MOST_DESCRIPTIONS and below + 1 in places else first


def _is_description(row: Sequence[str]) -> bool:
    """Return whether a row above the numbers says one thing of all columns: when they begin, their rate or count."""
    filled = {cell for cell in row if cell}
    return (
        len(filled) == 1 and sum(map(bool, row)) >= len(AXES) and number_of(filled.pop()) not in (0.0, None)
    )


def _cell_table(
    above: Sequence[str], texts: Sequence[Sequence[str]], separator: str | None, decimal: bool
) -> PrintedTable:
    """Return the table of rows of cells below some lines."""
    width = len(texts[0])
    filled = width - (not any(row[-1] for row in texts))  # rows may end with a separator
    names, units, header = header_of(above, filled, separator)
    if not any(map(names_sensor, names)) and (listed := listed_names(above, filled)):
        names = (*names[: filled - len(listed)], *listed)
    names, units = (*names, *[""] * (width - filled)), (*units, *[""] * (width - filled))
    dates = tuple(k for k in range(width) if are_dates([row[k] for row in texts]))
    return PrintedTable(
        names,
        units,
        _numbers(texts, dates, decimal),
        len(above),
        " ".join(above[-30:]),
        stated_rate("\n".join(above)),
        dates,
        separator,
        decimal,
        (),
        header,
    )


def _numbers(texts: Sequence[Sequence[str]], dates: Sequence[int], decimal: bool) -> Floats:
    """Return (n, k) numbers of cells; NaN where a cell has none."""
    columns = [
        numbers_of(column, DateReader() if k in dates else None, decimal)
        for k, column in enumerate(zip(*texts, strict=True))
    ]
    return np.array(columns).T.reshape(len(texts), -1)


def _by_code(table: PrintedTable, texts: Sequence[Sequence[str]], above: Sequence[str]) -> list[PrintedTable]:
    """Return a table, or one for each value of a column by which the numbers differ; a first word always divides."""
    code = next((k for k in range(len(table.names)) if _divides(table, k, [row[k] for row in texts])), None)
    if code is None:
        return [_with_named_sensor(table, texts)]
    tables_of_values: list[PrintedTable] = []
    for value in dict.fromkeys(row[code] for row in texts if row[code]):
        part = replace(
            table,
            names=described_names(above, table.names, table.separator, value),
            rows=table.rows[[row[code] == value for row in texts]],
            codes=(*table.codes, (code, value)),
            source=f"{value}\n{table.source}",
        )
        # the rows of a value may be of several sensors, too
        tables_of_values += _by_code(part, [row for row in texts if row[code] == value], ())
    return tables_of_values


def _divides(table: PrintedTable, column: int, cells: Sequence[str]) -> bool:
    """Return whether the cells of a column say of which sensor each row of a table is."""
    name, counts = table.names[column], Counter(filter(None, cells))
    if column in table.dates or not _may_be_code(name, counts, len(cells)):
        return False
    is_word = column == 0 and all(number_of(value) is None for value in counts)
    groups = [np.array([cell == value for cell in cells]) for value in counts]
    return is_word or _in_turn(name, cells) or _differ(table.rows, column, groups)


def _with_named_sensor(table: PrintedTable, texts: Sequence[Sequence[str]]) -> PrintedTable:
    """Return a table with the sensor that a column of it names: all rows so far are of that sensor."""
    columns = enumerate(zip(*texts, strict=True))
    constant = tuple(
        (k, cells[0]) for k, cells in columns if _name_one_sensor(cells) and (k, cells[0]) not in table.codes
    )
    source = "\n".join([*(word for _, word in constant), table.source])
    return replace(table, codes=(*table.codes, *constant), source=source)


def _name_one_sensor(cells: Sequence[str]) -> bool:
    """Return whether all cells hold the same name of a sensor."""
    names = {cell for cell in cells if cell}
    return len(names) == 1 and re.search("acc|gyr", cells[0], re.IGNORECASE) is not None


_DEVICE = re.compile(
    r"(?:^| )(?:sensor|id|dev|device|type|name|imu|topic|source|addr|address|node|instance|kind|channel|event|stream"
    r"|label|i)(?: |$)"
)
"""Words of columns that name a sensor or a device."""


def _may_be_code(name: str, counts: Mapping[str, int], rows: int) -> bool:
    """Return whether a column may say of which sensor a row is: by few words, or whole numbers below such a name."""
    if not 1 < len(counts) <= MOST_CODES or min(counts.values()) < max(3, FREQUENT * rows):
        return False
    if named_channel(name)[0]:  # coarse numbers have few values, too
        return False
    if any(number_of(value) is None for value in counts):
        return True
    return all(re.fullmatch(r"\d+", v) for v in counts) and (not name or bool(_DEVICE.search(words_of(name))))


def _in_turn(name: str, cells: Sequence[str]) -> bool:
    """Return whether a column names devices whose rows take turns."""
    changes = sum(cell != after for cell, after in pairwise(cells))
    return _DEVICE.search(words_of(name)) is not None and changes >= REGULAR * (len(cells) - 1)


def _differ(rows: Floats, code: int, groups: Sequence[Any]) -> bool:
    """Return whether a column of (n, k) numbers differs far between groups of the rows; a clock does between any."""
    moves = np.array([bool((np.diff(column[np.isfinite(column)]) < 0.0).any()) for column in rows.T])
    moves[code] = False
    if not moves.any():
        return False  # nothing but clocks
    with warnings.catch_warnings(action="ignore"):  # a column without numbers in a group
        sizes = [np.nanquantile(rows[group][:, moves], (0.16, 0.5, 0.84), axis=0) for group in groups]
    low, middle, high = np.stack(sizes, axis=1)
    spread = (high - low) / 2.0
    apart = np.abs(middle[:, None] - middle) > FAR * np.hypot(spread[:, None], spread)
    return bool((apart & (middle[:, None] != middle)).any())


# ---------------------------------------------------------------- templates


def _lexed(line: str, *, loose: bool) -> PrintedLine:
    """Return the parts of a line; `loose`: texts in quotes and words that are values are not distinguished."""
    line = _CODE.sub("\1", line)
    if loose:
        line = re.sub(r"([:=]\s*)(?:\"[^\"]*\"|'[^']*')", "\\1\1", line)
    literals, values, dates, end = [], [], [], 0
    for match in TOKEN.finditer(line):
        literals.append(line[end : match.start()])
        values.append(match[0])
        dates.append(match["stamp"] is not None)
        end = match.end()
    literals.append(line[end:])
    return PrintedLine(tuple(re.sub(r"\s+", " ", text) for text in literals), tuple(values), tuple(dates))


def _template_tables(lines: Sequence[str]) -> Iterator[PrintedTable]:
    """Yield the tables of lines that are numbers in a fixed text."""
    lines = _without_bytes(lines)
    for loose in (False, True):
        parsed = [_lexed(line, loose=loose) for line in lines]
        ids = [line.literals for line in parsed]
        if (period := _period(ids) or _period(_without_rare(ids))) is not None:
            begin = _record_begin(lines, ids, period)
            yield from _template_table(lines, parsed, [begin], period)
            return
        frequent = _frequent_templates(ids)
        for template in frequent:
            places = [k for k, x in enumerate(ids) if x == template]
            yield from _template_table(lines, parsed, places, 1)
        if frequent:
            return


def _without_bytes(lines: Sequence[str]) -> Sequence[str]:
    """Return lines with a mark in place of bytes in hexadecimal, if a letter shows that some are."""
    if any(re.search("[A-F]", bytes_of) for line in lines[:200] for bytes_of in _BYTES.findall(line)):
        return [_BYTES.sub("\1", line) for line in lines]
    return lines


def _frequent_templates(ids: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Return the templates with numbers that come often; none, if they are less than half of all such lines."""
    counts = Counter(x for x in ids if len(x) > 1)
    fewest = max(FREQUENT_LINES, FREQUENT * len(ids))
    frequent = [x for x, n in counts.most_common(MOST_CODES) if n >= fewest]
    return frequent if sum(counts[x] for x in frequent) >= 0.5 * sum(counts.values()) else []


def _without_rare(ids: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Return the templates of lines without those between records, which come less than half as often as most."""
    counts = Counter(ids)
    fewest = 0.5 * float(np.median([n for n in counts.values() if n >= FREQUENT_LINES] or [0]))
    return [x for x in ids if counts[x] >= fewest]


def _between(parsed: Sequence[PrintedLine], record: Sequence[PrintedLine]) -> tuple[str, ...]:
    """Return the patterns of lines that come several times and begin as no line of a record: that would be damaged."""
    begins = {line.literals[0] for line in record}
    lines = {line.literals: line for line in parsed}
    counts = Counter(x for x in (line.literals for line in parsed if line.values) if x[0] not in begins)
    return tuple(_pattern([lines[x]], {}) for x, count in counts.most_common(MOST_CODES) if count > 2)


def _period(ids: Sequence[tuple[str, ...]]) -> int | None:
    """Return the number of lines after which templates come again; None: they do not."""
    count = len(ids)
    late = range(count // 3, count)
    for period in range(1, min(LONGEST_PERIOD, count // 4) + 1):
        repeated = sum(ids[k] == ids[k - period] for k in late) >= REGULAR * len(late)
        if repeated and any(len(ids[k]) > 1 for k in late[:period]):
            return period
    return None


def _record_begin(lines: Sequence[str], ids: Sequence[tuple[str, ...]], period: int) -> int:
    """Return the first line of the first record: behind a blank line or a mark, or where a line has no indent."""
    whole = range(len(ids) - 2 * period + 1)
    start = next((k for k in whole if ids[k : k + period] == ids[k + period : k + 2 * period]), 0)

    def rank(k: int) -> tuple[bool, bool, int]:
        before = lines[start + k - 1 + (period if not k else 0)].strip()
        return (
            bool(re.search(r"\w", before)),
            lines[start + k][:1].isspace() or not lines[start + k].strip(),
            k,
        )

    return start + (min(range(period), key=rank) if period > 1 else 0)


def _template_table(
    lines: Sequence[str], parsed: Sequence[PrintedLine], places: Sequence[int], period: int
) -> list[PrintedTable]:
    """Return the tables of the records that begin at a place, or of one line at each of several places."""
    begin = places[0]
    record = parsed[begin : begin + period]
    names, units, samples = number_labels(record)
    check_width(len(names))
    if not names:
        return []  # lines that come again, but have no number
    numbered = max(k for k, line in enumerate(record) if line.values)
    tail = "".join(f"{line.literals[0].strip()}\n" for line in record[numbered + 1 :])
    are_dates = [is_date for line in record for is_date in line.dates]
    dates = tuple(np.flatnonzero(are_dates).tolist())
    pattern = _pattern(record, {})
    matches = re.compile(pattern, re.MULTILINE).findall("\n".join([*lines[begin:], tail]))
    texts = [(match,) if isinstance(match, str) else match for match in matches]
    if set(names) <= {"", "time"}:
        names = _list_header(lines[:begin], lines[begin], names)
    above = lines[max(0, begin - 30) : begin]
    describing = record[0].literals[0] if len(places) > 1 else " ".join(above)
    table = PrintedTable(
        names,
        units,
        _numbers(texts, dates, False),
        begin,
        describing,
        stated_rate("\n".join(above)),
        dates,
        lines=period,
        tail=tail,
        between=_between(parsed, record),
    )
    if samples and _are_of_one_sensor(table.rows, samples):
        return [replace(_by_samples(table, samples), pattern=pattern)]
    return [replace(each, pattern=_pattern(record, dict(each.codes))) for each in _by_code(table, texts, ())]


def _by_samples(table: PrintedTable, samples: Samples) -> PrintedTable:
    """Return a table of records with a row for each sample in a record."""
    of_samples = tuple(tuple(sample.values()) for sample in samples)
    first = of_samples[0]
    return replace(
        table,
        names=tuple(samples[0]),
        units=tuple(table.units[k] for k in first),
        rows=table.rows[:, of_samples].reshape(-1, len(first)),
        dates=tuple(j for j, k in enumerate(first) if k in table.dates),
        samples=of_samples,
    )


def _are_of_one_sensor(rows: Floats, samples: Samples) -> bool:
    """Return whether the axes of each sample of (n, k) records may be of one sensor."""
    stems = {name: match[1] for name in samples[0] if (match := AXIS.fullmatch(name)) is not None}
    axes = [name for name, stem in stems.items() if [*stems.values()].count(stem) == len(AXES)]
    first, *others = (rows[:, [sample[name] for name in axes]] for sample in samples)
    return all(same_sensor(first, other) for other in others)


def _pattern(record: Sequence[PrintedLine], codes: Mapping[int, str]) -> str:
    """Return the pattern of a record, with a group for each number, or for what some have as a code."""
    parts = []
    place = -1
    for line in record:
        text = "^[ \\t]*"
        for k, literal in enumerate(line.literals):
            fixed = literal.strip(" ") if k in (0, len(line.values)) else literal
            escaped = re.escape(fixed).replace("\\ ", "[ \\t]*").replace("\1", "[^\\n]*?")
            text += ("[ \\t]*" if k == len(line.values) and k else "") + escaped
            if k < len(line.values):
                place += 1
                number = codes.get(place) or (_STAMP if line.dates[k] else f"{_N}|{_VOID}")
                text += ("[ \\t]*" if not k else "") + f"({number})"
        parts.append(f"{text}[ \\t\\r]*\\n")
    return "".join(parts)


def _list_header(above: Sequence[str], line: str, names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of numbers by a header with a cell for each: they are in lists in quotes, or behind a date."""
    for separator in (",", ";", "\t", *([None] if any(names) else ())):
        cells = [TOKEN.finditer(_CODE.sub("\1", cell)) for cell in split(line, separator)]
        counts = [sum(match["stamp"] is None for match in of_cell) for of_cell in cells]
        for text in reversed(above):
            header = [
                re.sub(r"^\W+", "", TOKEN.sub("", cell)) for cell in split(text.lstrip("#% "), separator)
            ]
            if 1 < len(header) == len(counts) and are_names(header) and sum(counts) == names.count(""):
                named = iter(
                    elements([name for name, n in zip(header, counts, strict=True) for _ in range(n)])
                )
                return tuple(name or next(named) for name in names)
    return names
