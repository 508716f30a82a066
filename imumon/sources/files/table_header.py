"""Table header: which line of a text names the columns, and what the lines around it say.

Programs write more than names before their rows::

    LOGGER 7                                a title
    # Update Rate: 100.0Hz                  a comment that states the rate (`stated_rate`)
    Samples;1200;1200;1200                  settings, some of them numbers
    ;Gyroscope [deg/s];;                    a cell that spans three columns (`spread_names`)
    t;x;y;z                                 the names
    s;;;                                    units (`with_units`)
    0.00;0.012;-0.003;0.001

1. *Rows* begin at the first line most of whose cells are numbers, if the two lines behind it are such lines, too.
2. *Names* are in the line before them that has the most similar number of cells, one more or less, and whose cells are
   mostly no numbers. A mark of a comment before it is no name.
3. *Two lines of names*: where the second one names no sensor and both together do, each column has both.
4. *Tags.* Rows of several kinds may begin with a word, and comments name the columns of each kind (`tagged_headers`)::

       # Acc,timeMillis,AccXMps2,AccYMps2,AccZMps2
       # Gyr,timeMillis,GyrXRadPerSec,GyrYRadPerSec,GyrZRadPerSec
       Acc,1700000000000,0.1,-0.2,9.8
       Gyr,1700000000003,0.01,0.02,0.03

5. *Scales.* A log of Gyroflow has counts, and their scales before the names (`preamble_scales`).

>>> names_of = lambda *lines: below_header(lines, header_line(lines))[0]
>>> names_of("t,gx", "0,1", "1,1", "2,1"), names_of("n 3 3", "# t gx", "0 1", "1 1", "2 2")
(['t', 'gx'], ['t', 'gx'])
>>> names_of(",Gyro [deg/s],,", "t,x,y,z", "0,1,1,1", "1,1,1,1", "2,1,1,1")
['t', 'Gyro x [deg/s]', 'Gyro y [deg/s]', 'Gyro z [deg/s]']
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Sequence

from imumon.model.report_json import plain
from imumon.model.samples import AXES, INERTIAL
from imumon.sources.column_names import UNITS, parse_name, parse_names, split_unit, unit_of
from imumon.sources.files.base import HEAD_LINES

SHOWING_ROWS = 3
"""Lines of numbers behind each other that are rows: one or two may be settings before the names."""

SENSORS_WITH_AXES = ("gyro", "accel", "mag")

# ---------------------------------------------------------------- lines and cells


def has_cells(line: str) -> bool:
    """Return whether a line is neither blank nor a comment."""
    return bool(line.strip()) and line.lstrip()[0] not in "#%"


def separator_of(line: str) -> str | None:
    """Return the character between the cells; None: blanks.

    >>> separator_of("t;x,y;z"), separator_of('t;"x,y,z"'), separator_of("1 2")
    (';', ';', None)
    """
    if '"' in line:
        # what is in quotes separates nothing, unless the whole line is
        bare = re.sub(r'"[^"]*"', '""', line)
        line = bare if set(bare) & set(";,\t|") else line
    # ask a header: a row of numbers may have more decimal commas than separators
    separator = max((";", ",", "\t", "|"), key=line.count)
    return separator if line.count(separator) else None


def split(line: str, separator: str | None) -> list[str]:
    """Return the cells of a line, without quotes.

    >>> split('cts,"Gyro (z,x,y)","1"', ","), split('"t,x"', ",")
    (['cts', 'Gyro (z,x,y)', '1'], ['t', 'x'])
    """
    if '"' in line and separator is not None:
        try:
            quoted = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
        except csv.Error:
            quoted = []
        if len(quoted) > 1:
            return [cell.strip().strip('"').strip() for cell in quoted]
    return [cell.strip().strip('"').strip() for cell in line.split(separator)]


def is_number(text: str, read: Callable[[str], float] = float) -> bool:
    try:
        read(text)
    except ValueError:
        return False
    return True


_THOUSANDS = re.compile(
    r"[-+]?\d{1,3}(?:(?:,\d{3})+\.\d*|(?:\.\d{3})+,\d*|(?:['’]\d{3})+(?:[.,]\d*)?|(?:,\d{3}){2,}|(?:\.\d{3}){2,})"
)


def has_thousands(text: str) -> bool:
    """Return whether a number has separators of thousands, beyond doubt.

    >>> [has_thousands(text) for text in ("12,000.5", "1.234,5", "12'000", "1,234,567", "1,234", "0.5")]
    [True, True, True, True, False, False]
    """
    return _THOUSANDS.fullmatch(text) is not None


# ---------------------------------------------------------------- the line of names


def header_line(lines: Sequence[str]) -> int | None:
    """Return which of the first lines names the columns; None: none does.

    A table of one column has its name before the first three numbers.

    >>> header_line(["t,gx", "0,1"]), header_line(["10", "gyro_z", "1", "2", "3"]), header_line(["1", "2"])
    (0, 1, None)
    >>> header_line(["Samples,3,3", "t,gx,gy", "0,1,2", "1,1,2", "2,3,4"])
    1
    """
    lines = lines[: HEAD_LINES + SHOWING_ROWS]
    # at first by rows of numbers behind each other; a file may have less of them
    for showing in (SHOWING_ROWS, 1):
        candidates: list[int] = []
        for k, line in enumerate(lines[:HEAD_LINES]):
            # three numbers: a single one in a line may be a setting in the preamble
            if (
                k
                and _names_one_column(lines[k - 1])
                and all(map(_is_one_number, lines[k : k + SHOWING_ROWS]))
            ):
                return k - 1
            cells = split(line, separator_of(line))
            if len(cells) > 1 and sum(not is_number(cell) for cell in cells if cell) > len(cells) / 2:
                candidates.append(k)
            elif _begin_rows(lines[k:], showing):
                return _nearest(lines, candidates, line)
    return candidates[0] if candidates else None


def _nearest(lines: Sequence[str], candidates: Sequence[int], row: str) -> int | None:
    """Return which line has the number of cells of a row, and at best names a sensor; None: none does."""
    excess = {place: _excess_cells(lines[place], row) for place in candidates}
    # one more or less: many programs end their rows, or their header, with a separator
    fitting = [place for place in candidates if excess[place] <= 1]
    names = {place: header_cells(lines[place], separator_of(lines[place])) for place in fitting}
    return min(fitting, key=lambda place: (not names_sensor(names[place]), excess[place]), default=None)


def _begin_rows(lines: Sequence[str], showing: int) -> bool:
    """Return whether some lines begin with rows of as many cells, most of them numbers."""
    rows = [split(line, separator_of(line)) for line in lines if has_cells(line)][:showing]
    return (
        has_cells(lines[0])
        and len(rows) == showing
        and all(len(row) == len(rows[0]) > 1 and _most_are_numbers(row) for row in rows)
    )


def _most_are_numbers(cells: Sequence[str]) -> bool:
    return sum(map(is_number, cells)) > len(cells) / 2


def _is_one_number(line: str) -> bool:
    return len(line.split()) == 1 and is_number(line)


def _names_one_column(line: str) -> bool:
    return bool(line.strip()) and not is_number(line)


def _excess_cells(names: str, row: str) -> int:
    """Return by how many cells a line of names and a row differ."""
    separator = separator_of(names)
    return abs(len(header_cells(names, separator)) - len(split(row, separator)))


def header_cells(line: str, separator: str | None) -> list[str]:
    """Return the names in a header; of names apart by blanks, a unit in brackets belongs to the name before it.

    >>> header_cells("# t [ms] A_X [m / s2] B", None)
    ['t [ms]', 'A_X [m / s2]', 'B']
    """
    if separator is not None:
        return split(line, separator)
    cells = re.findall(r"\S+(?:\s+[\[(][^\])]*[\])])?", re.sub(r"^\s*[#%]+\s*", "", line))
    return [cell.strip() for cell in cells]


def below_header(lines: Sequence[str], place: int) -> tuple[list[str], int, str | None]:
    """Return the names of columns with their units, the first line of rows, and the separator, by a header's place."""
    header, begin, separator = lines[place], place + 1, separator_of(lines[place])
    names = [plain(name) for name in header_cells(header, separator)]
    # a table of one column: blanks in its header, as in "gyro z", do not separate anything
    if _is_one_number("".join(lines[begin : begin + 1])):
        names, separator = [plain(header.strip())], None
    if begin < len(lines) and (both := _of_two_lines(header, lines[begin], separator)) is not None:
        names, begin = both, begin + 1
    elif place and (both := _of_two_lines(lines[place - 1], header, separator)) is not None:
        names = both
    if begin < len(lines) and (united := with_units(names, lines[begin], separator)) is not None:
        names, begin = united, begin + 1
    return spread_names(names), begin, separator


def _of_two_lines(first: str, second: str, separator: str | None) -> list[str] | None:
    """Return the names of two lines, of which the cells of the first span columns; None: these are not two such lines.

    >>> _of_two_lines(",Acc [g],,", "t,x,y,z", ",")
    ['t', 'Acc x [g]', 'Acc y [g]', 'Acc z [g]']
    """
    spans, names = ([plain(cell) for cell in header_cells(line, separator)] for line in (first, second))
    if len(spans) != len(names) or any(map(is_number, names)) or names_sensor(spans) or names_sensor(names):
        return None
    above, joined = "", []
    for span, name in zip(spans, names, strict=True):
        above = span or above
        base, unit = split_unit(above)
        joined.append(f"{base} {name}{f' [{unit}]' if unit and name else ''}".strip())
    return joined if names_sensor(joined) else None


def names_sensor(names: Sequence[str]) -> bool:
    return any(column.quantity in INERTIAL and column.axis for column in parse_names(names))


def spread_names(names: Sequence[str]) -> list[str]:
    """Return names in which a cell that spans three columns names each of them.

    >>> spread_names(["date", "Gyroscope (z,x,y) [rad/s]", "1", "2", "Acc", "", ""])
    ['date', 'Gyroscope z [rad/s]', 'Gyroscope x [rad/s]', 'Gyroscope y [rad/s]', 'Acc x', 'Acc y', 'Acc z']
    """
    spread = list(names)
    for k, name in enumerate(names[:-2]):
        if (names[k + 1].strip(), names[k + 2].strip()) not in (("", ""), ("1", "2"), ("2", "3")):
            continue
        base, unit = split_unit(name)
        order = re.search(r"\(\s*([xyz])\s*,\s*([xyz])\s*,\s*([xyz])\s*\)", base, re.IGNORECASE)
        base = base if order is None else base[: order.start()].strip()
        if parse_name(k, base).axis or parse_name(k, f"{base} x").quantity not in SENSORS_WITH_AXES:
            continue
        for place, axis in enumerate(AXES if order is None else order.groups(), start=k):
            spread[place] = f"{base} {axis.lower()}{f' [{unit}]' if unit else ''}"
    return spread


def with_units(names: Sequence[str], row: str, separator: str | None) -> list[str] | None:
    """Return the names with the units of a row below them; None if it is no row of units.

    >>> with_units(["t", "wx", "wy [deg/s]"], "s,rad/s,", ",")
    ['t [s]', 'wx [rad/s]', 'wy [deg/s]']
    >>> with_units(["t", "wx"], "0.0,n/a", ",") is None
    True
    """
    cells = [plain(_bare_unit(cell)) for cell in split(row, separator)]
    known = [any(unit_of(cell, quantity) for quantity in UNITS) for cell in cells if cell]
    # half: columns of other quantities have units that are not known here, such as V or %
    if 2 * sum(known) <= len(known):
        return None
    cells += [""] * (len(names) - len(cells))
    return [
        f"{name} [{cell}]" if cell and not name.rstrip().endswith(("]", ")")) else name
        for name, cell in zip(names, cells, strict=False)
    ]


def _bare_unit(cell: str) -> str:
    """Return a unit without brackets around it.

    >>> _bare_unit("[deg/s]"), _bare_unit("m/(s^2)")
    ('deg/s', 'm/(s^2)')
    """
    match = re.fullmatch(r"\[([^\]]*)\]|\(([^()]*)\)", cell)
    return cell if match is None else match[1] or match[2] or ""


# ---------------------------------------------------------------- other lines

ECHOED = (
    "sec", "nanosec", "frame_id", *("orientation",) * 13,
    *(f"angular_velocity.{axis} [rad/s]" for axis in AXES), *("covariance",) * 9,
    *(f"linear_acceleration.{axis}" for axis in AXES), *("covariance",) * 9,
)  # fmt: skip
"""Columns that ``ros2 topic echo --csv`` prints of `sensor_msgs/Imu`, without a header."""


def is_echoed(line: str) -> bool:
    """Return whether a line is a message that ``ros2 topic echo --csv`` prints of an IMU."""
    cells = split(line, ",")
    return len(cells) == len(ECHOED) and all(map(is_number, (*cells[:2], *cells[3:])))


_STATED_RATE = re.compile(
    r"(?:rate|frequency|odr)\b[^\d\n]{0,20}?(?P<number>\d+(?:\.\d+)?)\s*(?P<kilo>k?)hz\b", re.IGNORECASE
)
"""Sample rate in words before a table, such as ``// Update Rate: 100.0Hz``."""


def stated_rate(lines: Sequence[str]) -> float | None:
    """Return the only rate that the lines before a table state, Hz; None: none, or several.

    >>> stated_rate(["// Update Rate: 100.0Hz"]), stated_rate(["# gyro rate 1 kHz, accel rate 100 Hz"])
    (100.0, None)
    """
    rates = {
        float(match["number"]) * (1e3 if match["kilo"] else 1.0)
        for line in lines
        for match in _STATED_RATE.finditer(line)
    }
    return rates.pop() if len(rates) == 1 and min(rates) > 0.0 else None


TAG = "row"
"""Name of the column in which rows of several kinds have a word."""


def tagged_headers(lines: Sequence[str]) -> dict[str, list[str]]:
    """Return the names of the columns by the word that rows begin with, as comments state them; empty: they do not.

    >>> head = ["# Acc,t,AccX,AccY,AccZ", "% Gyr: 'Gyr,t,GyrX,GyrY,GyrZ'", "Acc,0,1,2,3", "Gyr,0,1,2,3"]
    >>> tagged_headers(head)["Gyr"], tagged_headers(["# t,x", "0,1"])
    (['row', 't', 'GyrX', 'GyrY', 'GyrZ'], {})
    """
    comments = [line for line in lines if line.strip() and not has_cells(line)]
    widths: dict[str, int] = {}
    for line in filter(has_cells, lines if comments else ()):
        cells = split(line, separator_of(line))
        if (
            len(cells) > len(AXES)
            and re.fullmatch(r"[A-Za-z]\w*", cells[0])
            and any(map(is_number, cells[1:]))
        ):
            widths[cells[0]] = len(cells)
    headers: dict[str, list[str]] = {}
    for comment in comments if widths else ():
        # the names may be behind words, in quotes
        for text in (comment.strip().strip("#% \t'\""), *re.findall(r"'([^']*)'", comment)):
            tag, *names = split(text, separator_of(text)) or [""]
            # one more or less: a row may end with a separator
            if names and abs(widths.get(tag, 0) - len(names) - 1) <= 1:
                headers.setdefault(tag, [TAG, *map(plain, names)])
    return headers


GYROFLOW = "GYROFLOW IMU LOG"


def preamble_scales(lines: Sequence[str], names: Sequence[str]) -> dict[str, str]:
    """Return the columns of a log of Gyroflow with its scales, as ``--map`` has them; empty: the text is none.

    The scales make the time seconds, the rates rad/s and the accelerations g (docs.gyroflow.xyz, GCSV).

    >>> preamble_scales(["GYROFLOW IMU LOG", "tscale,0.001", "gscale,0.02"], ["t", "gx"])
    {'t': 't*0.001:s', 'gyro/x': 'gx*0.02:rad/s'}
    """
    if not lines or lines[0].strip().upper() != GYROFLOW:
        return {}
    settings = dict(line.replace(":", ",").split(",")[:2] for line in lines[1:] if re.search("[,:]", line))
    channels = {"t": ("t", "tscale", "s")}
    channels |= {f"g{axis}": (f"gyro/{axis}", "gscale", "rad/s") for axis in AXES}
    channels |= {f"a{axis}": (f"accel/{axis}", "ascale", "g") for axis in AXES}
    mapped = {}
    for name, (channel, key, unit) in channels.items():
        scale = settings.get(key, "").strip()
        if name in names and is_number(scale):
            mapped[channel] = f"{name}*{scale}:{unit}"
    return mapped
