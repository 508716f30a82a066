"""Tables: recordings of others as blocks of samples. CSV of any dialect, and NumPy archives.

A table has a column for each channel (`columns`) and mostly one of time. The time of its first rows tells
the sampling interval; a table without one needs the rate. Rows that lack a number are lost samples; a
row that is no row is an error that names its line. CSV is read in pieces: memory does not
grow with its length.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np

from imumon.samples import Clock, Floats, Ints, Kind, SampleBlock, Stream
from imumon.sources.columns import UNITS, Column, Layout, layout
from imumon.sources.errors import SourceError
from imumon.sources.recording import Recording

ROWS = 1 << 15
"""Rows handed over at once."""

PREAMBLE = 30
"""Lines before which the header must come."""

BATCHED = 0.1
"""Share of steps of no length from which times are those of arrival, which tell nothing of the sensor."""

ZERO_CELSIUS = 273.15
GRAVITY = 9.80665
MISSING = {"", "nan", "na", "n/a", "null", "none", "-"}


@dataclass(frozen=True, slots=True)
class Wanted:
    """How to read a table.

    Attributes
    ----------
    kind : which stream, where there are several; None: the best.
    given : channel to ``COLUMN:UNIT``; empty: by the names.
    rate_hz : told by the user, None otherwise.
    topic : of a bag.
    """

    kind: Kind | None = None
    given: Mapping[str, str] | None = None
    rate_hz: float | None = None
    topic: str | None = None


class Rows:
    """Numbers of a table as blocks of samples.

    Parameters
    ----------
    path : for messages.
    found : which columns.
    what : what the table is, ``csv`` and the like.

    Attributes
    ----------
    lost : rows that lacked a number.
    """

    def __init__(self, path: str, found: Layout, what: str, rate_hz: float | None) -> None:
        self._path, self._layout, self._what, self._rate = path, found, what, rate_hz
        self._stream: Stream | None = None
        self._origin: Floats | None = None
        self._scales: list[float] = []  # ns in a unit of each column of time
        self._owed = 0
        self._picked: list[int] = []
        self.lost = 0

    @property
    def columns(self) -> list[int]:
        """Which columns of the table are wanted, in the order `blocks` takes them."""
        found = self._layout
        interval = [found.interval] if found.interval is not None else []
        return [column.index for column in (*found.columns, *found.times, *interval)]

    def blocks(self, rows: Floats) -> Iterator[SampleBlock]:
        """Blocks of some rows, (n, k) with the wanted columns; not finite is missing.

        Raises
        ------
        SourceError : the numbers cannot be of the unit that is said.
        """
        if self._stream is None:
            if not len(rows):
                return
            rows = self._begin(rows)
        layout_, width = self._layout, len(self._layout.columns)
        good = np.isfinite(rows).all(axis=1)
        lost = np.zeros(len(rows), dtype=np.int64)
        if not good.all():
            places = np.flatnonzero(good)
            before = np.diff(np.concatenate([[-1], places])) - 1
            lost, bad = before, int(len(rows) - len(places))
            self.lost += bad
            rows = rows[places]
            tail = bad - int(before.sum())
            if len(places):
                lost[0] += self._owed
                self._owed = 0
            self._owed += tail
        elif self._owed and len(rows):
            lost[0], self._owed = self._owed, 0
        if not len(rows):
            return
        assert self._stream is not None
        values = np.empty((len(rows), width))
        for k, column in enumerate(layout_.columns):
            values[:, k] = rows[:, k] * column.factor
            if column.unit == "k":
                values[:, k] -= ZERO_CELSIUS
        if layout_.kind == "deltas":
            values = self._over_interval(values, rows)
        yield SampleBlock(self._stream, values, self._times(rows), lost)

    # ------------------------------------------------------------ what the first rows tell

    def _begin(self, rows: Floats) -> Floats:
        """Settle columns, clock and interval; the rows again, without columns that were given up."""
        rows = self._drop(rows)
        found = self._layout
        self._check(rows)
        seen = rows[np.isfinite(rows).all(axis=1)]
        width = len(found.columns)
        times = seen[:, width : width + len(found.times)]
        interval, clock = None if self._rate is None else 1.0 / self._rate, "none"
        if found.times and len(times):
            self._origin = times[0].copy()
            self._scales = [_scale(c, times[:, k], self._rate) for k, c in enumerate(found.times)]
            clock, measured = self._clock(times)
            interval = interval or measured
        elif found.interval is not None:
            clock = "dt"
        known: Clock = "startup" if clock == "startup" else "dt" if clock == "dt" else "none"
        first = found.columns[0].name.partition(" [")[0]
        self._stream = Stream(found.kind, found.channels, f"{self._what} {first}", known, interval)
        return rows

    def _drop(self, rows: Floats) -> Floats:
        """Leave out columns that are not filled: an empty clock, a slower magnetometer."""
        found = self._layout
        count = len(found.columns)
        full = np.isfinite(rows).mean(axis=0) if len(rows) else np.zeros(rows.shape[1])
        keep = [k for k, name in enumerate(found.channels) if name[:4] in ("gyro", "acce") or full[k] > 0.9]
        times = [k for k in range(len(found.times)) if full[count + k] > 0.9]
        times = times if found.apart else times[:1]
        interval = [count + len(found.times)] if found.interval is not None else []
        if interval and full[interval[0]] <= 0.9:
            interval = []
        self._layout = Layout(
            found.kind,
            tuple(found.channels[k] for k in keep),
            tuple(found.columns[k] for k in keep),
            tuple(found.times[k] for k in times),
            found.interval if interval else None,
        )
        self._picked = [*keep, *(count + k for k in times), *interval]
        return rows[:, self._picked]

    def pick(self, rows: Floats) -> Floats:
        """Later rows without the columns that were left out."""
        return rows if self._stream is None else rows[:, self._picked]

    def _check(self, rows: Floats) -> None:
        """A sensor at rest feels about one g: anything else is another unit than is said."""
        for sensor, least, most in (("accel", 0.0, 400.0), ("gyro", 0.0, 70.0)):
            picked = [k for k, name in enumerate(self._layout.channels) if name.startswith(sensor)]
            if len(picked) != 3 or self._layout.kind == "deltas":
                continue
            columns = [self._layout.columns[k] for k in picked]
            size = float(np.sqrt(np.nansum((rows[:, picked] * columns[0].factor) ** 2, axis=1)).mean())
            if sensor == "accel" and columns[0].unit is None and 0.8 < size < 1.25:
                raise SourceError(_unit(self._path, columns, size, "g"))
            if sensor == "accel" and columns[0].unit is None and 800.0 < size < 1250.0:
                raise SourceError(_unit(self._path, columns, size, "mg"))
            if not least <= size <= most:
                likely = "deg/s" if sensor == "gyro" else "mg"
                raise SourceError(_unit(self._path, columns, size, likely))

    def _clock(self, times: Floats) -> tuple[str, float | None]:
        """Clock and interval, s, from the times of the first rows."""
        t = self._nanoseconds(times).astype(np.float64)
        steps = np.diff(t)
        ahead = steps[steps > 0.0]
        if not len(ahead):
            raise SourceError(f"{self._path}: the time in {self._layout.times[0].name} stands still")
        typical = float(np.median(ahead))
        short = ahead[ahead < 1.5 * typical]
        near = float(short.mean())
        ticks = np.rint(ahead / near)
        if (np.rint(steps / near) == 0.0).mean() > BATCHED:
            return "none", float(ahead.sum()) / len(steps) * 1e-9
        plain = ticks < 100.0
        return "startup", float(ahead[plain].sum() / ticks[plain].sum()) * 1e-9

    # ------------------------------------------------------------ every block

    def _over_interval(self, values: Floats, rows: Floats) -> Floats:
        """Angles and velocities to rates: over each sample's own interval, else over the common one."""
        found = self._layout
        assert self._stream is not None
        over: Any = self._stream.interval_s
        if found.interval is not None:
            over = (rows[:, -1] * found.interval.factor)[:, None]
        elif over is None:
            raise SourceError(f"{self._path} has deltas and no interval: a column dt, of time, or --rate")
        moved = [k for k, name in enumerate(found.channels) if name[:4] in ("gyro", "acce")]
        values[:, moved] /= over
        return values

    def _times(self, rows: Floats) -> Ints | None:
        assert self._stream is not None
        width = len(self._layout.columns)
        if self._stream.clock == "startup":
            return self._nanoseconds(rows[:, width : width + len(self._layout.times)])
        if self._stream.clock == "dt" and self._layout.interval is not None:
            return np.rint(rows[:, -1] * self._layout.interval.factor * 1e9).astype(np.int64)
        return None

    def _nanoseconds(self, times: Floats) -> Ints:
        """(n, 1 or 2) as the table has it, to (n,) ns since the first row."""
        assert self._origin is not None
        total = np.zeros(len(times))
        for k, scale in enumerate(self._scales):
            total += (times[:, k] - self._origin[k]) * scale
        return np.rint(total).astype(np.int64)


def _unit(path: str, columns: Sequence[Column], size: float, likely: str) -> str:
    said = columns[0].unit or "no unit, which means SI"
    sensor = columns[0].quantity or "gyro"
    return (
        f"{path}: {columns[0].name} says {said}, but its size is {size:.3g}: if it is {likely}, write "
        f"[{likely}] into the header or --map {sensor}/x={columns[0].name}:{likely},..."
    )


def _scale(column: Column, times: Floats, rate_hz: float | None) -> float:
    """ns in a unit of a column of time that does not say its own: by its size and its steps."""
    if column.unit is not None:
        return UNITS["t"][column.unit]
    steps = np.diff(times)
    ahead = steps[steps > 0.0]
    step = float(np.median(ahead)) if len(ahead) else 1.0
    if rate_hz is not None:
        return min(UNITS["t"].values(), key=lambda ns: abs(np.log(step * ns * 1e-9 * rate_hz)))
    size = abs(float(times[0]))
    for least, unit in ((1e17, "ns"), (1e14, "us"), (1e11, "ms"), (1e8, "s")):
        if size >= least and unit != "s":  # since 1970
            return UNITS["t"][unit]
    whole = bool(np.all(times[:100] == np.rint(times[:100])))
    if not whole or step < 1.0:
        return UNITS["t"]["s"]
    return UNITS["t"]["ms" if step < 1e3 else "us" if step < 1e6 else "ns"]


# -------------------------------------------------------------------- CSV


class Csv:
    """A CSV file, gzip or not, as blocks of samples.

    Attributes
    ----------
    header : None: such a file tells nothing of the sensor.
    bad_checksums, discarded, fed : rows that lacked a number, 0, and bytes read.

    Raises
    ------
    SourceError : it cannot be read, or its columns are not those of an inertial sensor.
    """

    header: Mapping[str, Any] | None = None
    discarded = 0

    def __init__(self, recording: Recording, wanted: Wanted) -> None:
        self._recording, self._wanted = recording, wanted
        self.path = recording.path
        self.fed = 0
        self.bad_checksums = 0

    @property
    def progress(self) -> float | None:
        return self._recording.progress

    def __iter__(self) -> Iterator[list[SampleBlock]]:
        lines = self._lines()
        separator, rows, first, number = self._head(lines)
        reader = _Reader(self.path, separator, rows.columns)
        gathered: list[str] = []
        before = number - len(first)
        for line in chain(first, chain.from_iterable(lines)):
            gathered.append(line)
            if len(gathered) >= ROWS:
                yield self._hand(rows, reader, gathered, before)
                before += len(gathered)
                gathered = []
        if gathered:
            yield self._hand(rows, reader, gathered, before, last=True)

    def _hand(
        self, rows: Rows, reader: _Reader, lines: list[str], before: int, *, last: bool = False
    ) -> list[SampleBlock]:
        found = list(rows.blocks(rows.pick(reader.numbers(lines, before, last=last))))
        self.bad_checksums = rows.lost
        return found

    def _lines(self) -> Iterator[list[str]]:
        """Whole lines, as many at once as a piece of the file has."""
        rest = b""
        for chunk in self._recording:
            self.fed += len(chunk)
            *whole, rest = (rest + chunk).split(b"\n")
            yield [line.decode("utf-8-sig", "replace").rstrip("\r") for line in whole]
        if rest.strip():
            yield [rest.decode("utf-8-sig", "replace").rstrip("\r")]

    def _head(self, lines: Iterator[list[str]]) -> tuple[str | None, Rows, list[str], int]:
        """Separator, columns, the rows read along with the header, and lines read so far."""
        seen: list[str] = []
        for piece in lines:
            seen += piece
            if len(seen) > PREAMBLE:
                break
        names_at = header_line(seen)
        if names_at is None:
            return self._headless(seen)
        separator = separator_of(seen[names_at])
        names = split(seen[names_at], separator)
        try:
            found = layout(names, self._wanted.kind, self._wanted.given)
        except SourceError as error:
            raise SourceError(f"{self.path}: {error}") from None
        rows = Rows(self.path, found, "csv", self._wanted.rate_hz)
        return separator, rows, seen[names_at + 1 :], len(seen)

    def _headless(self, seen: list[str]) -> tuple[str | None, Rows, list[str], int]:
        """Numbers from the first line on: columns by their number, if the user names them."""
        start = next(
            (k for k, line in enumerate(seen) if line.strip() and line.lstrip()[0] not in "#%"), None
        )
        if start is None:
            raise SourceError(f"{self.path} holds no rows")
        separator = separator_of(seen[start])
        names = [str(k + 1) for k in range(len(split(seen[start], separator)))]
        if not self._wanted.given:
            raise SourceError(
                f"{self.path} has no line that names its {len(names)} columns: add one, "
                "or --map gyro/x=2:rad/s,... by number"
            )
        try:
            found = layout(names, self._wanted.kind, self._wanted.given)
        except SourceError as error:
            raise SourceError(f"{self.path}: {error}") from None
        return separator, Rows(self.path, found, "csv", self._wanted.rate_hz), seen[start:], len(seen)

    def verdict(self) -> str:
        return f"{self.path} has a header and no row of numbers behind it"


def header_line(lines: Sequence[str]) -> int | None:
    """Which of the first lines names the columns: the one most of whose cells are no numbers."""
    for k, line in enumerate(lines[:PREAMBLE]):
        cells = split(line, separator_of(line))
        if len(cells) > 1 and sum(not _is_number(cell) for cell in cells if cell) > len(cells) / 2:
            following = next((each for each in lines[k + 1 :] if each.strip()), None)
            if following is None or len(split(following, separator_of(line))) >= len(cells) - 1:
                return k
    return None


def separator_of(line: str) -> str | None:
    """Sign between the cells; None is blanks."""
    found = max((";", ",", "\t"), key=line.count)
    return found if line.count(found) else None


def split(line: str, separator: str | None) -> list[str]:
    return [cell.strip().strip('"').strip() for cell in line.split(separator)]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


class _Reader:
    """Lines to numbers."""

    def __init__(self, path: str, separator: str | None, columns: Sequence[int]) -> None:
        self._path, self._separator, self._columns = path, separator, list(columns)

    def numbers(self, lines: list[str], before: int, *, last: bool) -> Floats:
        """(n, k) of the wanted columns.

        Raises
        ------
        SourceError : a cell is no number; it names the line.
        """
        try:
            found = np.loadtxt(
                lines, delimiter=self._separator, usecols=self._columns, ndmin=2, comments=None, quotechar='"'
            )
            return np.asarray(found, dtype=np.float64)
        except (ValueError, IndexError):
            end = len(lines) - 1 if last else -1
            rows = [self._row(line, before + k + 1, k == end) for k, line in enumerate(lines) if line.strip()]
            return np.array([row for row in rows if row]).reshape(-1, len(self._columns))

    def _row(self, line: str, number: int, last: bool) -> list[float]:
        """Numbers of a line that is not quite regular; nothing for a last line that is cut off."""
        cells = split(line, self._separator)
        out = []
        for column in self._columns:
            if column >= len(cells):
                if last:
                    return []
                raise SourceError(
                    f"{self._path} line {number} has {len(cells)} columns, column {column + 1} is wanted"
                )
            text = cells[column]
            if self._separator == ";":
                text = text.replace(",", ".")
            try:
                out.append(float(text))
            except ValueError:
                if text.lower() not in MISSING:
                    raise SourceError(
                        f"{self._path} line {number} column {column + 1}: {text[:30]!r} is no number"
                    ) from None
                out.append(float("nan"))
        return out


# -------------------------------------------------------------------- NumPy


class Archive:
    """A NumPy archive (``.npz``) of arrays with names like those of columns: (n,) or (n, 3).

    Raises
    ------
    SourceError : it cannot be read, or holds no inertial sensor.
    """

    header: Mapping[str, Any] | None = None
    discarded = 0
    progress: float | None = None

    def __init__(self, path: str, wanted: Wanted) -> None:
        self.path = path
        self.fed = 0
        self.bad_checksums = 0
        try:
            with np.load(path, allow_pickle=False) as archive:
                names, arrays = _flattened({name: archive[name] for name in archive.files})
        except (OSError, ValueError, EOFError, zipfile.BadZipFile):
            raise SourceError(f"{path} is no NumPy archive of plain arrays") from None
        try:
            found = layout(names, wanted.kind, wanted.given)
        except SourceError as error:
            raise SourceError(f"{path}: {error}") from None
        self._rows = Rows(path, found, "npz", wanted.rate_hz)
        picked = [arrays[k] for k in self._rows.columns]
        if len({len(column) for column in picked}) != 1:
            raise SourceError(
                f"{path}: its arrays have {sorted({len(c) for c in picked})} samples, not one number"
            )
        self._columns = picked

    def __iter__(self) -> Iterator[list[SampleBlock]]:
        count = len(self._columns[0])
        for start in range(0, count, ROWS):
            piece = np.column_stack([column[start : start + ROWS] for column in self._columns])
            self.fed += piece.nbytes
            yield list(self._rows.blocks(self._rows.pick(piece)))
            self.bad_checksums, self.progress = self._rows.lost, min(1.0, (start + ROWS) / count)

    def verdict(self) -> str:
        return f"{self.path} holds arrays without a sample"


def _flattened(arrays: Mapping[str, Any]) -> tuple[list[str], list[Floats]]:
    """Names and columns; of an array with three columns one for each axis."""
    names: list[str] = []
    columns: list[Floats] = []
    for name, array in arrays.items():
        if array.dtype.kind not in "iuf":
            continue
        words = name.rsplit("_", 1)
        unit = f" [{words[1]}]" if len(words) == 2 and words[1] in _ARRAY_UNITS else ""
        bare = words[0] if unit else name
        if array.ndim == 1:
            names.append(f"{bare}{unit}")
            columns.append(array.astype(np.float64))
        elif array.ndim == 2 and array.shape[1] == 3:
            for k, axis in enumerate("xyz"):
                names.append(f"{bare}_{axis}{unit}")
                columns.append(array[:, k].astype(np.float64))
    return names, columns


_ARRAY_UNITS = {"gauss", "C", "kPa", "dps", "g", "mg", "rads", "uT", "nT", "ns", "us", "ms", "s"}
"""Units that the last word of an array's name may be."""
