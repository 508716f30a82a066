"""Tables: rows of numbers as blocks of samples, whatever file they come from.

A table has a column for each channel (`columns`) and mostly one of time. The time of its first rows tells
the sampling interval and whether the stamps are a sensor's or a host's (`stamps`); a table without one needs
the rate. Rows that lack a number are lost samples.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from imumon.samples import Clock, Floats, Ints, Kind, SampleBlock, Stream, sensor_of
from imumon.sources.columns import Layout
from imumon.sources.errors import SourceError
from imumon.sources.names import UNITS, Column
from imumon.sources.stamps import Late, interval_of

ROWS = 1 << 15
"""Rows handed over at once."""

SINCE_1970 = 1e11
"""Size from which the unit of a time shows in the number itself."""

ABSURD = 1e100
"""Size of a number that no instrument writes, and whose square is none: as good as missing."""

FAR_OFF = 0.02
"""Share by which a rate that was told may miss that of the stamps before it is a remark."""

INERTIAL = {"gyro", "accel"}
ZERO_CELSIUS = 273.15
GRAVITY = 9.80665


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
    remarks : what a reader should know of its stamps.
    """

    def __init__(self, path: str, found: Layout, what: str, rate_hz: float | None) -> None:
        self._path, self._layout, self._what, self._rate = path, found, what, rate_hz
        self._stream: Stream | None = None
        self._origin: Floats | None = None
        self._scales: list[float] = []  # ns in a unit of each column of time
        self._owed = 0
        self._picked: list[int] = []
        self._late: Late | None = None  # stamps of a host: rows wait until it has placed them
        self._waiting: list[Floats] = []
        self.lost = 0
        self.remarks: list[str] = []

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
        good = (np.abs(rows) < ABSURD).all(axis=1)
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
        if self._late is None:
            yield SampleBlock(self._stream, values, self._times(rows), lost)
            return
        self._waiting.append(values)
        stamps = rows[:, width : width + len(layout_.times)]
        yield from self._placed(self._late.place(self._nanoseconds(stamps).astype(np.float64)))

    def finish(self) -> Iterator[SampleBlock]:
        """Rows that still wait, at the end of the table."""
        if self._late is not None:
            yield from self._placed(self._late.place(np.empty(0), final=True))

    def _placed(self, lost: Ints) -> Iterator[SampleBlock]:
        """The oldest rows that wait, for which it is known how many were lost before."""
        if not len(lost):
            return
        assert self._stream is not None
        values = np.concatenate(self._waiting)
        self._waiting = [values[len(lost) :]]
        yield SampleBlock(self._stream, values[: len(lost)], None, lost)

    # ------------------------------------------------------------ what the first rows tell

    def _begin(self, rows: Floats) -> Floats:
        """Settle columns, clock and interval; the rows again, without columns that were given up."""
        rows = self._drop(rows)
        found = self._layout
        self._check(rows)
        seen = rows[np.isfinite(rows).all(axis=1)]
        width = len(found.columns)
        times = seen[:, width : width + len(found.times)]
        interval: float | None = None if self._rate is None else 1.0 / self._rate
        clock: Clock = "none"
        if found.times and len(times):
            self._origin = times[0].copy()
            self._scales = [_scale(c, times[:, k], self._rate) for k, c in enumerate(found.times)]
            clock, measured = self._clock(times)
            guessed = (
                self._rate is None and found.times[0].unit is None and self._scales[0] != UNITS["t"]["s"]
            )
            if guessed and abs(times[0, 0]) < SINCE_1970:
                unit = next(name for name, ns in UNITS["t"].items() if ns == self._scales[0])
                self.remarks.append(
                    f"{self._path}: {found.times[0].name} says no unit, its numbers are taken for {unit}: "
                    f"{1.0 / measured:.6g} Hz; write [{unit}] or [s] behind it if you know"
                )
            interval = interval or measured
        elif found.interval is not None:
            clock = "dt"
        first = found.columns[0].name.partition(" [")[0]
        self._stream = Stream(found.kind, found.channels, f"{self._what} {first}", clock, interval)
        return rows

    def _drop(self, rows: Floats) -> Floats:
        """Leave out columns that are not filled: an empty clock, a slower magnetometer."""
        found = self._layout
        count = len(found.columns)
        full = np.isfinite(rows).mean(axis=0) if len(rows) else np.zeros(rows.shape[1])
        void = self._void(full)
        keep = [
            k
            for k, name in enumerate(found.channels)
            if (sensor_of(name) not in void if sensor_of(name) in INERTIAL else full[k] > 0.9)
        ]
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

    def _void(self, full: Floats) -> set[str]:
        """Inertial sensors that lack an axis wholly, and are left out; none where there would be no other."""
        named = self._layout.channels
        empty = {sensor_of(name): k for k, name in enumerate(named) if not full[k]}
        void = {sensor for sensor in empty if sensor in INERTIAL}
        if void == {sensor_of(name) for name in named} & INERTIAL:
            return set()
        for sensor in void:
            column = self._layout.columns[empty[sensor]].name
            self.remarks.append(f"{self._path}: {column} holds no numbers: {sensor} is left out")
        return void

    def pick(self, rows: Floats) -> Floats:
        """Later rows, (n, k) with the wanted columns, without those that were left out."""
        return rows if self._stream is None else rows[:, self._picked]

    def _check(self, rows: Floats) -> None:
        """A sensor at rest feels about one g: anything else is another unit than is said."""
        for sensor, least, most in (("accel", 0.0, 400.0), ("gyro", 0.0, 70.0)):
            picked = [k for k, name in enumerate(self._layout.channels) if name.startswith(sensor)]
            if len(picked) != 3 or self._layout.kind == "deltas":
                continue
            columns = [self._layout.columns[k] for k in picked]
            seen = rows[np.isfinite(rows[:, picked]).all(axis=1)][:, picked] * columns[0].factor
            if not len(seen):
                raise SourceError(f"{self._path}: no row has numbers for all of {_names(columns)}")
            # a few spoilt numbers say nothing of the unit
            size = float(np.median(np.hypot(np.hypot(seen[:, 0], seen[:, 1]), seen[:, 2])))
            if sensor == "accel" and columns[0].unit is None and 0.8 < size < 1.25:
                raise SourceError(_unit(self._path, columns, size, "g"))
            if sensor == "accel" and columns[0].unit is None and 800.0 < size < 1250.0:
                raise SourceError(_unit(self._path, columns, size, "mg"))
            if not least <= size <= most:
                likely = "deg/s" if sensor == "gyro" else "mg"
                raise SourceError(_unit(self._path, columns, size, likely))

    def _clock(self, times: Floats) -> tuple[Clock, float]:
        """Clock and interval, s, from the times of the first rows."""
        t = self._nanoseconds(times).astype(np.float64)
        if not (np.diff(t) > 0.0).any():
            name = self._layout.times[0].name
            if len(t) < 2:
                raise SourceError(f"{self._path}: one row tells no rate: two are needed")
            if (np.diff(t) < 0.0).any():
                raise SourceError(f"{self._path}: the time in {name} runs backwards: sort its rows by it")
            raise SourceError(f"{self._path}: the time in {name} stands still")
        tick, steady = interval_of(t)
        found = 1e9 / tick
        if self._rate is not None and abs(self._rate / found - 1.0) > FAR_OFF:
            self.remarks.append(f"{self._path}: its stamps tell {found:.6g} Hz, --rate says {self._rate:g}")
        if steady:
            return "startup", tick * 1e-9
        self._late = Late(t, tick)
        told = f"{self._path}: its stamps are a host's, not the sensor's: only their mean rate is used"
        if self._late.rough:
            told += ", and single lost samples cannot be told"
        self.remarks.append(told)
        return "none", tick * 1e-9

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


def _names(columns: Sequence[Column]) -> str:
    return ", ".join(column.name for column in columns)


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
    for least, unit in ((1e17, "ns"), (1e14, "us"), (SINCE_1970, "ms"), (1e8, "s")):
        if size >= least and unit != "s":  # since 1970
            return UNITS["t"][unit]
    whole = bool(np.all(times[:100] == np.rint(times[:100])))
    if not whole or step < 1.0:
        return UNITS["t"]["s"]
    return UNITS["t"]["ms" if step < 1e3 else "us" if step < 1e6 else "ns"]
