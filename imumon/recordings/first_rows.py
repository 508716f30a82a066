"""First rows of a table: what they decide about all of its rows.

They show which columns have numbers, whether the stamps are those of a sample clock or of a host (`timestamps`), the
sampling interval, and whether rows are copies. The stamps of a sample clock are used whatever rate is configured;
those of a host give way to it. A remark reports what is left out or assumed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np

from imumon.column_names import UNITS, Column
from imumon.errors import RateRequired
from imumon.noise.validity_groups import LARGEST
from imumon.recordings.base import RecordingError
from imumon.recordings.columns import INERTIAL, LISTED, ColumnLayout
from imumon.recordings.row_selection import COPIED, HeldNumbers, are_doubled, copies
from imumon.recordings.unit_inference import SINCE_1970_S, check_magnitudes, time_unit, unit_remarks
from imumon.report import stamp
from imumon.samples import LONGEST_NS, Bools, Clock, Floats, Ints, Stream, sensor_of
from imumon.timebase.interval import RATE_TOLERANCE
from imumon.timebase.late_stamps import LateStamps
from imumon.timebase.timestamps import HostStamps, RateObstacle, rate_obstacle, stamp_interval
from imumon.units import share_text

FILLED = 0.9
"""Share of the first rows in which a column of time or of a magnetometer must have a number."""

SLOW = {"temperature", "pressure"}
"""Sensors that may be slower than the rows, and are held between their numbers."""

HELD_STEPS = 2.0
"""Mean steps between the numbers of a slow sensor for which one is held: its steps are not quite even."""


RATE_CURE = "give the sample rate with --rate"

OBSTACLES: dict[RateObstacle, tuple[str, str]] = {
    "single_row": ("has one row, and a rate needs two", "check that the file is complete, or record longer"),
    "time_descending": ("runs backwards", f"sort the rows by it, or {RATE_CURE}"),
    "time_constant": ("does not change", f"write it with more digits, or {RATE_CURE}"),
    "time_too_coarse": ("changes in hardly any row", f"write it with more digits, or {RATE_CURE}"),
}
"""Message and cure for a time that shows no rate."""


@dataclass(frozen=True, slots=True)
class TableTimes:
    """Times of a table that has a clock.

    Attributes
    ----------
    origin : (1 or 2,) the times of the first row, as in the table.
    scales : ns in a unit of each column of time.
    stamps : places the rows, by stamps of a host or by those of a sample clock.
    """

    origin: Floats
    scales: tuple[float, ...]
    stamps: HostStamps | LateStamps | None = None

    @property
    def started(self) -> str | None:
        """Date of the first row; None if its time is none since 1970."""
        unix_s = float(self.origin @ np.array(self.scales)) * 1e-9
        return (
            stamp(datetime.fromtimestamp(unix_s, UTC))
            if SINCE_1970_S[0] <= unix_s < SINCE_1970_S[1]
            else None
        )

    def nanoseconds(self, times: Floats) -> Ints:
        """Return (n,) ns since the first row of (n, 1 or 2) times as in the table."""
        total: Floats = (times - self.origin) @ np.array(self.scales)
        nanoseconds: Ints = np.rint(np.clip(total, -LONGEST_NS, LONGEST_NS)).astype(np.int64)
        return nanoseconds


@dataclass(frozen=True, slots=True)
class TableStart:
    """What the first rows show.

    Attributes
    ----------
    times : None: the table has no time that is used.
    doubled : rows may be copies of the row before.
    assumed_unit : see `Recording`.
    """

    stream: Stream
    times: TableTimes | None
    doubled: bool
    assumed_unit: str


class FirstRows:
    """Decides about a table by its first rows: `choose_columns` first, then `start`.

    Parameters
    ----------
    path, what, layout, rate_hz, names, source : see `Table`.

    Attributes
    ----------
    layout : columns of the stream; `choose_columns` leaves some out.
    needed : places of the columns that a sample cannot lack, of those that are used.
    held : by place, numbers of those that some rows lack.
    remarks : what is left out or assumed.
    """

    def __init__(
        self,
        path: str,
        layout: ColumnLayout,
        what: str,
        rate_hz: float | None,
        names: Sequence[str],
        source: str,
    ) -> None:
        self.layout, self.remarks = layout, list(layout.remarks)
        self.needed: list[int] = []
        self.held: dict[int, HeldNumbers] = {}
        self._path, self._what, self._rate, self._names, self._source = path, what, rate_hz, names, source

    @property
    def columns(self) -> tuple[Column, ...]:
        """Columns in the order of the rows: channels, times, interval."""
        found = self.layout
        return (*found.columns, *found.times, *([found.interval] if found.interval is not None else []))

    def choose_columns(self, rows: Floats) -> list[int]:
        """Leave out columns with few numbers: an empty time, a slower magnetometer; return the places of the others."""
        found = self.layout
        count = len(found.columns)
        full = np.isfinite(rows).mean(axis=0)
        empty = self._empty_sensors(full)
        sensors = [sensor_of(name) for name in found.channels]
        used = [k for k in range(count) if _is_used(sensors[k], float(full[k]), empty)]
        times = [k for k in range(count, count + len(found.times)) if full[k] > FILLED]
        used += times if found.split_time else times[:1]
        used += [k for k in range(count + len(found.times), len(full)) if full[k] > FILLED]
        self.remarks += _sparse(self.columns, sensors, full, used)
        self.needed = [at for at, k in enumerate(used) if k >= count or sensors[k] in INERTIAL]
        slow = [(at, full[k]) for at, k in enumerate(used) if k < count and sensors[k] in SLOW]
        self.held = {at: HeldNumbers(math.ceil(HELD_STEPS / share)) for at, share in slow if share < 1.0}
        self.layout = replace(
            found,
            channels=tuple(found.channels[k] for k in used if k < count),
            columns=tuple(found.columns[k] for k in used if k < count),
            times=tuple(found.times[k - count] for k in used if count <= k < count + len(found.times)),
            interval=found.interval if used[-1] >= count + len(found.times) else None,
        )
        return used

    def complete(self, rows: Floats) -> Bools:
        """Return which rows have the numbers that a sample needs: those of a temperature may be unknown."""
        return np.asarray(present(rows[:, self.needed]).all(axis=1))

    def _empty_sensors(self, full: Floats) -> set[str]:
        """Return inertial sensors with an axis without numbers; none if no other would be left."""
        channels = self.layout.channels
        axis = {sensor_of(name): k for k, name in enumerate(channels) if not full[k]}
        empty = {sensor for sensor in axis if sensor in INERTIAL}
        if empty == {sensor_of(name) for name in channels} & INERTIAL:
            return set()
        for sensor in empty:
            column = self.layout.columns[axis[sensor]].name
            self.remarks.append(f"{column} holds no numbers: {sensor} is left out")
        return empty

    def start(self, rows: Floats) -> TableStart:
        """Return clock, interval and stream that the first rows in order show."""
        found = self.layout
        width = len(found.columns)
        check_magnitudes(self._path, self._what, found, np.where(present(rows), rows, np.nan))
        assumed = unit_remarks(self._what, found.columns)
        self.remarks += assumed
        doubled = bool(found.times) and are_doubled(rows, slice(width, width + len(found.times)))
        whole = rows[self.complete(rows)]
        if doubled:
            whole = whole[~np.append(False, copies(whole))]
        if not len(whole):
            text = f"{self._path}: no row has numbers in all of {', '.join(c.name for c in found.columns)}"
            raise RecordingError("no_complete_row", text, "check that it is complete")
        interval: float | None = None if self._rate is None else 1.0 / self._rate
        clock: Clock = "none"
        times = None
        if found.times:
            clock, interval, times = self._clock(whole[:, width : width + len(found.times)])
        elif found.interval is not None:
            clock, interval = "dt", None
            self._compare(float(np.median(whole[:, -1])) * found.interval.factor, own=True)
        elif interval is None:
            raise self._rate_required()
        self.remarks += list(_repeating(found, whole))
        sensors = ", ".join(dict.fromkeys(sensor_of(channel) for channel in found.channels))
        stream = Stream(found.kind, found.channels, f"{self._source} ({sensors})", clock, interval)
        return TableStart(stream, times, doubled, (assumed or [""])[0])

    def _rate_required(self) -> RateRequired:
        """Return the error that lists the columns that may be a time."""
        used = {column.index for column in self.layout.columns}
        others = [name.strip() for k, name in enumerate(self._names) if k not in used]
        hint = f" (other columns: {', '.join(others[:LISTED])})" if others else ""
        text = f"{self._path} has no clock: no column with numbers has the name of a time{hint}"
        cure = f"name one with --map t=COLUMN:UNIT, or {RATE_CURE}" if others else RATE_CURE
        return RateRequired("rate_required", text, cure)

    def _compare(self, interval_s: float, *, own: bool) -> None:
        """Note if the configured rate differs from that of the stamps, and which is used."""
        if self._rate is None or abs(self._rate * interval_s - 1.0) <= RATE_TOLERANCE:
            return
        clock = " and are those of a sample clock" if own else ", but are those of a host"
        used = f"--rate {self._rate:g} is {'not used' if own else 'used'}"
        self.remarks.append(f"its time stamps show {1.0 / interval_s:.6g} Hz{clock}: {used}")

    def _clock(self, times: Floats) -> tuple[Clock, float, TableTimes | None]:
        """Return clock, interval, s, and the times that are used, from the times of the first rows."""
        found = self.layout.times
        used = TableTimes(times[0].copy(), tuple(UNITS["t"][column.unit or "ns"] for column in found))
        raw = times[:, 0] if len(found) == 1 else used.nanoseconds(times).astype(np.float64)
        obstacle = rate_obstacle(raw)
        if obstacle is not None:
            what, cure = OBSTACLES[obstacle]
            text = f"the time in {found[0].name} {what}"
            if self._rate is None:
                raise RecordingError(obstacle, f"{self._path}: {text}", cure)
            self.remarks.append(f"{text}: --rate {self._rate:g} is used, lost samples cannot be detected")
            return "none", 1.0 / self._rate, None
        if len(found) == 1:
            unit, remark = time_unit(self._path, self._what, found[0], raw, self._rate)
            used = replace(used, scales=(UNITS["t"][unit],))
            self.remarks += [remark] if remark else []
        t = used.nanoseconds(times).astype(np.float64)
        interval, steady = stamp_interval(t)
        self._compare(interval * 1e-9, own=steady)
        if steady:
            return "startup", interval * 1e-9, replace(used, stamps=LateStamps(interval))
        host = HostStamps(t, interval)
        text = "its time stamps are late or in batches, as those of a host: "
        text += "only their mean rate is used" if self._rate is None else "they only show what was lost"
        if host.rough:
            text += ", and single lost samples cannot be detected"
        self.remarks.append(text)
        interval_s = interval * 1e-9 if self._rate is None else 1.0 / self._rate
        return "none", interval_s, replace(used, stamps=host)


def present(rows: Floats) -> Bools:
    """Return which of some numbers are there: finite, and no larger than an instrument writes."""
    return np.abs(rows) < LARGEST


def _repeating(found: ColumnLayout, rows: Floats) -> Iterator[str]:
    """Yield a remark on each inertial sensor that is slower than its rows and holds its values between."""
    from imumon.noise.statistics.differences import REPEATED

    for sensor in sorted(INERTIAL & set(map(sensor_of, found.channels)), reverse=True):
        own = [k for k, name in enumerate(found.channels) if sensor_of(name) == sensor]
        share = float(copies(rows[:, own]).mean()) if len(rows) > 1 else 0.0
        if REPEATED < share < COPIED:
            yield f"{sensor} repeats its values in {share_text(share)} of the rows: it is slower than they are"


def _is_used(sensor: str, share: float, empty: set[str]) -> bool:
    """Return whether a channel is used of which a share of the first rows has a number."""
    if sensor in INERTIAL:
        return sensor not in empty
    return share > (0.0 if sensor in SLOW else FILLED)


def _sparse(
    columns: Sequence[Column], sensors: Sequence[str], full: Floats, used: Sequence[int]
) -> Iterator[str]:
    """Yield a remark on the columns that rows lack, by the share of the rows and by what is done."""
    sparse: dict[str, list[str]] = {}
    for k, column in enumerate(columns):
        if full[k] <= FILLED and (k >= len(sensors) or sensors[k] not in INERTIAL):
            lack = f"{share_text(1.0 - full[k])} of the rows lack" if full[k] else "no row has a number in"
            use = "the one before is held" if k in used else "not used"
            sparse.setdefault(f"{lack} {{}}: {use}", []).append(column.name)
    yield from (text.format(", ".join(names)) for text, names in sparse.items())
