"""Tables: rows of numbers as blocks of samples, whatever file they come from.

A table has a column for each channel (`columns`) and mostly one of time. The time of its first rows tells
the sampling interval and whether the stamps are a sensor's or a host's (`stamps`); a table without one needs
the rate. Stamps of a sensor are its clock, whatever rate is told; those of a host give way to it. Rows that
lack a number are lost samples. Nothing is lost or assumed without a remark.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from imumon.errors import RateUnknown, SourceError
from imumon.recordings.column_names import UNITS
from imumon.recordings.columns import INERTIAL, ColumnLayout
from imumon.recordings.unit_inference import assumed, check_sizes, time_unit
from imumon.samples import Clock, Floats, Ints, Kind, SampleBlock, Stream, sensor_of
from imumon.timebase.timestamps import Late, interval_of, why_no_rate

ROWS = 1 << 15
"""Rows handed over at once."""

ABSURD = 1e100
"""Size of a number that no instrument writes, and whose square is none: as good as missing."""

FAR_OFF = 0.02
"""Share by which a rate that was told may miss that of the stamps before it is a remark."""

FULL = 0.9
"""Share of the first rows that a column which is not an inertial sensor's must fill."""

LONGEST_NS = 4e18
"""Spans between two times that still are one; beyond, a stamp is garbage."""

PLACES = {"csv": "line", "npz": "sample", "bag": "message"}
"""What the rows of a table are numbered by, for people."""

ZERO_CELSIUS = 273.15


@dataclass(frozen=True, slots=True)
class ReadOptions:
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


class TableRows:
    """Numbers of a table as blocks of samples.

    Parameters
    ----------
    path : for messages.
    found : which columns.
    what : what the table is: ``csv``, ``npz``, ``bag``.
    names : of all columns of the table.

    Attributes
    ----------
    lost : rows that lacked a number.
    """

    def __init__(
        self, path: str, found: ColumnLayout, what: str, rate_hz: float | None, names: Sequence[str] = ()
    ) -> None:
        self._path, self._layout, self._what, self._rate = path, found, what, rate_hz
        self._stream: Stream | None = None
        self._origin: Floats | None = None
        self._scales: list[float] = []  # ns in a unit of each column of time
        self._owed = 0
        self._picked: list[int] = []
        self._late: Late | None = None  # stamps of a host: rows wait until it has placed them
        self._waiting: list[Floats] = []
        self._names = names
        self._said = list(found.remarks)
        self._open, self._first_open = 0, ""  # rows that lacked a number, and where the first is
        self._back, self._first_back = 0, ""  # steps of a clock that go back, and where the first is
        self._last: Ints | None = None  # ns, the last two times
        self.lost = 0

    @property
    def remarks(self) -> list[str]:
        """What a reader should know: columns and rows that are not used, units and stamps."""
        said = list(self._said)
        if self._open:
            rows = "1 row lacks" if self._open == 1 else f"{self._open:,} rows lack"
            said.append(f"{rows} a number and count as lost; first {self._first_open}")
        if self._back:
            times = "once" if self._back == 1 else f"{self._back:,} times"
            said.append(f"the time in {self._layout.times[0].name} steps back {times}; {self._first_back}")
        if self._late is not None and self._late.back_s:
            said.append(
                f"its clock steps back by {self._late.back_s:.6g} s: a gap of unknown length, counted as none"
            )
        return said

    @property
    def columns(self) -> list[int]:
        """Which columns of the table are wanted, in the order `blocks` takes them."""
        found = self._layout
        interval = [found.interval] if found.interval is not None else []
        return [column.index for column in (*found.columns, *found.times, *interval)]

    def blocks(self, rows: Floats, places: Sequence[int]) -> Iterator[SampleBlock]:
        """Blocks of some rows, (n, k) with the wanted columns; not finite is missing.

        Parameters
        ----------
        places : (n,) number of each row in its file, for people; 0 for one of which they know already.

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
            kept = np.flatnonzero(good)
            before = np.diff(np.concatenate([[-1], kept])) - 1
            lost, bad = before, int(len(rows) - len(kept))
            self.lost += bad
            self._note_open(rows, np.flatnonzero(~good), places)
            rows, places = rows[kept], [places[k] for k in kept.tolist()]
            tail = bad - int(before.sum())
            if len(kept):
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
            times = self._times(rows)
            if times is not None and self._stream.clock == "startup":
                self._note_back(times, places)
            yield SampleBlock(self._stream, values, times, lost)
            return
        self._waiting.append(values)
        stamps = rows[:, width : width + len(layout_.times)]
        yield from self._placed(self._late.place(self._nanoseconds(stamps).astype(np.float64)))

    def _note_open(self, rows: Floats, bad: Ints, places: Sequence[int]) -> None:
        """Count rows that lack a number, and keep where the first is."""
        found = self._layout
        told = [k for k in bad.tolist() if places[k]]
        if told and not self._open:
            columns = (*found.columns, *found.times, *([found.interval] if found.interval else []))
            lacking = [c.name for c, x in zip(columns, rows[told[0]], strict=True) if not abs(x) < ABSURD]
            self._first_open = f"{PLACES[self._what]} {places[told[0]]}: {', '.join(lacking)}"
        self._open += len(told)

    def _note_back(self, times: Ints, places: Sequence[int]) -> None:
        """Count the steps back of a sensor's clock, and keep where the first is and how long.

        One wrong stamp is none: two on either side must agree.
        """
        seen = np.concatenate([times[[0, 0]] if self._last is None else self._last, times])
        now = seen[2:]
        back = np.maximum(now, np.append(now[1:], now[-1])) < np.minimum(seen[1:-1], seen[:-2])
        if back.any() and not self._back:
            at = int(np.argmax(back))
            by_s = (seen[at + 1] - now[at]) * 1e-9
            where = f"{PLACES[self._what]} {places[at]}"
            self._first_back = f"first by {by_s:.6g} s at {where}: a gap of unknown length"
        self._back += int(back.sum())
        self._last = seen[-2:]

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
        check_sizes(self._path, self._what, found, np.where(np.abs(rows) < ABSURD, rows, np.nan))
        self._said += assumed(self._what, found.columns)
        seen = rows[(np.abs(rows) < ABSURD).all(axis=1)]
        if not len(seen):
            raise SourceError(
                f"{self._path}: no row has numbers in all of {', '.join(c.name for c in found.columns)}: "
                "if its sensors take turns, put the rows of each into a file of its own"
            )
        width = len(found.columns)
        interval: float | None = None if self._rate is None else 1.0 / self._rate
        clock: Clock = "none"
        if found.times:
            clock, interval = self._clock(seen[:, width : width + len(found.times)])
        elif found.interval is not None:
            clock, interval = "dt", None
            self._compare(float(np.median(seen[:, -1])) * found.interval.factor, own=True)
        elif interval is None:
            raise RateUnknown(self._clockless())
        sensors = ", ".join(dict.fromkeys(sensor_of(channel) for channel in found.channels))
        self._stream = Stream(found.kind, found.channels, f"{self._what} ({sensors})", clock, interval)
        return rows

    def _clockless(self) -> str:
        used = {column.index for column in self._layout.columns}
        others = [name.strip() for k, name in enumerate(self._names) if k not in used]
        there = f" (left over: {', '.join(others[:8])})" if others else ""
        return (
            f"{self._path} has no clock: no filled column is a time by its name{there}; "
            "say which with --map t=COLUMN:UNIT, or give the sample rate with --rate"
        )

    def _compare(self, interval_s: float, *, own: bool) -> None:
        """Remark where the rate that was told is not that of the stamps, and say which is used."""
        if self._rate is None or abs(self._rate * interval_s - 1.0) <= FAR_OFF:
            return
        told = f"its stamps tell {1.0 / interval_s:.6g} Hz"
        self._said.append(
            f"{told} and are the sensor's clock: --rate {self._rate:g} is not used"
            if own
            else f"{told}, but are a host's: --rate {self._rate:g} is used"
        )

    def _drop(self, rows: Floats) -> Floats:
        """Leave out columns that are not filled: an empty clock, a slower magnetometer."""
        found = self._layout
        count = len(found.columns)
        full = np.isfinite(rows).mean(axis=0) if len(rows) else np.zeros(rows.shape[1])
        void = self._void(full)
        keep = [
            k
            for k, name in enumerate(found.channels)
            if (sensor_of(name) not in void if sensor_of(name) in INERTIAL else full[k] > FULL)
        ]
        times = [k for k in range(len(found.times)) if full[count + k] > FULL]
        times = times if found.apart else times[:1]
        interval = [count + len(found.times)] if found.interval is not None else []
        if interval and full[interval[0]] <= FULL:
            interval = []
        self._picked = [*keep, *(count + k for k in times), *interval]
        self._tell_sparse(full)
        self._layout = replace(
            found,
            channels=tuple(found.channels[k] for k in keep),
            columns=tuple(found.columns[k] for k in keep),
            times=tuple(found.times[k] for k in times),
            interval=found.interval if interval else None,
        )
        return rows[:, self._picked]

    def _tell_sparse(self, full: Floats) -> None:
        """Remark on columns that are left out because hardly a row has them."""
        found = self._layout
        wanted = (*found.columns, *found.times, *([found.interval] if found.interval else []))
        left = [c.name for k, c in enumerate(wanted) if k not in self._picked and 0 < full[k] <= FULL]
        if left:
            self._said.append(f"{', '.join(left)} not used: too many rows lack it")

    def _void(self, full: Floats) -> set[str]:
        """Inertial sensors that lack an axis wholly, and are left out; none where there would be no other."""
        named = self._layout.channels
        empty = {sensor_of(name): k for k, name in enumerate(named) if not full[k]}
        void = {sensor for sensor in empty if sensor in INERTIAL}
        if void == {sensor_of(name) for name in named} & INERTIAL:
            return set()
        for sensor in void:
            column = self._layout.columns[empty[sensor]].name
            self._said.append(f"{column} holds no numbers: {sensor} is left out")
        return void

    def pick(self, rows: Floats) -> Floats:
        """Later rows, (n, k) with the wanted columns, without those that were left out."""
        return rows if self._stream is None else rows[:, self._picked]

    def _clock(self, times: Floats) -> tuple[Clock, float]:
        """Clock and interval, s, from the times of the first rows."""
        found = self._layout.times
        self._origin = times[0].copy()
        self._scales = [UNITS["t"][column.unit or "ns"] for column in found]
        raw = times[:, 0] if len(found) == 1 else self._nanoseconds(times).astype(np.float64)
        why = why_no_rate(raw)
        if why is not None:
            why = f"the time in {found[0].name} {why}"
            if self._rate is None:
                raise SourceError(f"{self._path}: {why}; or give --rate to do without it")
            self._said.append(f"{why}: --rate {self._rate:g} is used, lost samples do not show")
            return "none", 1.0 / self._rate
        if len(found) == 1:
            unit, remark = time_unit(self._path, self._what, found[0], raw, self._rate)
            self._scales = [UNITS["t"][unit]]
            self._said += [remark] if remark else []
        t = self._nanoseconds(times).astype(np.float64)
        tick, steady = interval_of(t)
        self._compare(tick * 1e-9, own=steady)
        if steady:
            return "startup", tick * 1e-9
        self._late = Late(t, tick)
        told = "its stamps come late or in batches, as a host's do: "
        told += "only their mean rate is used" if self._rate is None else "they only show what was lost"
        if self._late.rough:
            told += ", and single lost samples cannot be told"
        self._said.append(told)
        return "none", tick * 1e-9 if self._rate is None else 1.0 / self._rate

    # ------------------------------------------------------------ every block

    def _over_interval(self, values: Floats, rows: Floats) -> Floats:
        """Angles and velocities to rates: over each sample's own interval, else over the common one."""
        found = self._layout
        assert self._stream is not None
        over: Any = self._stream.interval_s
        if found.interval is not None:
            over = (rows[:, -1] * found.interval.factor)[:, None]
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
        return np.rint(np.clip(total, -LONGEST_NS, LONGEST_NS)).astype(np.int64)
