"""First rows of a table: what they decide about all of its rows.

The names of the columns say what the numbers are meant to be (`columns`); the rows of the first block show what they
are. `FirstRows` takes each of these decisions once, before the first sample:

- Which columns have numbers. A time without numbers gives way to the next one, a sensor without numbers is left out.
  A magnetometer that most rows lack is left out, too; a temperature may be slow and is held between its numbers.
- Whether the stamps are those of a sample clock, or of a host (`timebase.stamp_kinds`), and the sampling interval. The
  stamps of a sample clock are used whatever rate is configured; those of a host give way to it.
- Whether rows are copies of the row before (`row_selection`).

What is left out or assumed is a remark. Where the numbers allow two readings that differ in the result, there is an
error that names both and how to choose.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np

from imumon.grid.counter_wraps import CounterWraps
from imumon.grid.interval import RATE_TOLERANCE
from imumon.grid.stamp_kinds import StampCandidate, decide, typical_step
from imumon.grid.stamp_placement import StampPlacer
from imumon.model.cures import option, option_text
from imumon.model.errors import RateRequired
from imumon.model.report import stamp
from imumon.model.samples import AXES, INERTIAL, LONGEST_NS, Bools, Clock, Floats, Ints, Stream
from imumon.model.units import share_text
from imumon.noise.validity_groups import LARGEST
from imumon.sources.files.base import RecordingError, RowSource
from imumon.sources.files.columns import SINCE_1970_S, Column, ColumnLayout
from imumon.sources.files.row_selection import (
    COPIED,
    FEWEST_HELD,
    HeldNumbers,
    alternate,
    are_doubled,
    copies,
    repeats_by_chance,
)

FILLED = 0.9
"""Share of the first rows in which a column of time or of a magnetometer must have a number."""

SLOW = {"temperature", "pressure"}
"""Sensors that may be slower than the rows, and are held between their numbers."""

HELD_STEPS = 2.0
"""Mean steps between the numbers of a slow sensor for which one is held: its steps are not quite even."""

HELD_SHARE = 0.01
"""Share of the rows that repeat all axes of a sensor, above which they are held: fewer move N by less than 0.5 %."""

HELD_EXCESS = 3.0
"""Ratio of this share to that of three axes that repeat by chance, each for itself, above which they are held."""

WRAPPING_NS = (1e6, 1e3)
"""ns in a unit of counters that wrap: ms and us, as for lines."""

UNSET_ROWS, UNSET_STEPS = 2, 1e6
"""Rows with a time of 0 that are those of a clock that was not set, and steps by which its other times are beyond."""

STATED_TOLERANCE = 0.02
"""Share by which the rate of a time may differ from one that a comment states: those are nominal."""


def read_alone() -> str:
    """Return the cure for sensors of different rates."""
    return f"read each alone, {option_text(sensor='gyro')} and {option_text(sensor='accel')}"


def rate_cure() -> str:
    """Return the cure for samples without a rate."""
    return f"give the sample rate with {option('rate_hz')}"


NO_RATE: dict[str, tuple[str, str]] = {
    "single_row": ("has one row, and a rate needs two", "check that the file is complete, record longer"),
    "time_descending": ("runs backwards", "sort the rows by it"),
    "time_constant": ("does not change", "write it with more digits"),
    "time_too_coarse": ("changes in hardly any row", "write it with more digits"),
    "time_rate_impossible": ("shows no rate that a sensor has", "check its unit"),
}
"""Message and cure for a time that shows no rate, by the name of its kind of stamps."""


@dataclass(frozen=True, slots=True)
class TableTimes:
    """Times of a table that has a clock.

    Attributes
    ----------
    origin : (1 or 2,) the times of the first row, as in the table.
    scales : ns in a unit of each column of time.
    placer : places the rows.
    wraps : of a counter.
    """

    origin: Floats
    scales: tuple[float, ...]
    placer: StampPlacer
    wraps: CounterWraps

    @property
    def origin_ns(self) -> float:
        """ns, time of the first row."""
        return float(self.origin @ np.array(self.scales))

    @property
    def started(self) -> str | None:
        """Date of the first row; None if its time is none since 1970."""
        unix_s = self.origin_ns * 1e-9
        return (
            stamp(datetime.fromtimestamp(unix_s, UTC))
            if SINCE_1970_S[0] <= unix_s < SINCE_1970_S[1]
            else None
        )

    def nanoseconds(self, times: Floats) -> Ints:
        """Return (n,) ns since the first row of (n, 1 or 2) times as in the table."""
        return _continued(_nanoseconds(times, self.origin, self.scales), self.wraps, self.origin_ns)


def _nanoseconds(times: Floats, origin: Floats, scales: tuple[float, ...]) -> Ints:
    """Return (n,) ns since the origin of (n, k) times, of which each column has a scale, ns."""
    # first the difference, column by column, then the sum: a float of ns since 1970 has steps of 256 ns
    total: Floats = (times - origin) @ np.array(scales)
    # a wrong stamp of 1e300 must not become any integer, but a step that the clock refuses
    nanoseconds: Ints = np.rint(np.clip(total, -LONGEST_NS, LONGEST_NS)).astype(np.int64)
    return nanoseconds


def _continued(nanoseconds: Ints, wraps: CounterWraps, origin_ns: float) -> Ints:
    """Return (n,) ns since the first row with the wraps of a counter undone, which counts from its own zero."""
    # ns of a float since 1970 are rounded, but those of a counter of 32 bits are not
    zero = round(origin_ns) if abs(origin_ns) < LONGEST_NS else 0
    return wraps.continued(nanoseconds + zero) - zero


@dataclass(frozen=True, slots=True)
class TableStart:
    """What the first rows show.

    Attributes
    ----------
    times : None: the table has no time that is used.
    doubled : rows may be copies of the row before.
    """

    stream: Stream
    times: TableTimes | None
    doubled: bool


class FirstRows:
    """Decides about a table by its first rows: `choose_columns` first, then `start`.

    Parameters
    ----------
    source : of the rows.
    table_layout : columns of the stream, by their names.
    rate_hz : Hz, configured sample rate; None: not configured.

    Attributes
    ----------
    layout : columns of the stream; `choose_columns` leaves some out.
    needed : indices of the columns that a sample cannot lack, of those that are used.
    repeated : indices of the axes that are held in rows which are no samples of them; empty: all rows are samples.
    held : by such an index, numbers of those that some rows lack.
    remarks : what is left out or assumed.
    unused : why a column is not used, by its place in the table.
    caveats : what limits the meaning of the numbers, as in `Recording`.
    no_time : why the time of the layout is not used; empty: it is, or there is none.
    """

    def __init__(self, source: RowSource, table_layout: ColumnLayout, rate_hz: float | None) -> None:
        self.layout, self.remarks = table_layout, list(table_layout.remarks)
        self.needed: list[int] = []
        self.held: dict[int, HeldNumbers] = {}
        self.no_time = ""
        self.unused: dict[int, str] = dict(table_layout.unused)
        self.repeated: list[int] = []
        self.caveats = list(table_layout.caveats)
        self._source, self._rate = source, rate_hz if rate_hz is not None else table_layout.rate_hz

    @property
    def columns(self) -> tuple[Column, ...]:
        """Columns in the order of the rows: channels, times, interval."""
        interval = self.layout.interval
        return (*self.layout.columns, *self.layout.times, *([] if interval is None else [interval]))

    def choose_columns(self, rows: Floats) -> list[int]:
        """Return the indices of the columns that are used: without an empty time, or a slower magnetometer."""
        stream_layout = self.layout
        end_of_channels = len(stream_layout.columns)
        end_of_times = end_of_channels + len(stream_layout.times)
        filled = np.isfinite(rows).mean(axis=0)
        empty = self._empty_sensors(filled)
        held = self._held_sensors(rows, empty)
        inertial = set(INERTIAL) & {name.sensor for name in stream_layout.channels} - empty
        if len(held) < len(inertial):  # the sensor that has a sample in each row is used
            empty |= held
        sensors = [name.sensor for name in stream_layout.channels]
        channels = [k for k in range(end_of_channels) if _is_used(sensors[k], float(filled[k]), empty)]
        times = [k for k in range(end_of_channels, end_of_times) if filled[k] > FILLED]
        if len(times) < len(stream_layout.times):
            times = []
        interval = [k for k in range(end_of_times, len(filled)) if filled[k] > FILLED]
        used = [*channels, *times, *interval]
        self.remarks += _sparse(self.columns, sensors, filled, used)
        self._note_unused(filled, used, held)
        self.needed = [i for i, k in enumerate(used) if k >= end_of_channels or sensors[k] in INERTIAL]
        repeated = held - empty
        self.repeated = [i for i, k in enumerate(used) if k < end_of_channels and sensors[k] in repeated]
        slow = {i: filled[k] for i, k in enumerate(channels) if sensors[k] in SLOW and filled[k] < 1.0}
        self.held = {i: HeldNumbers(math.ceil(HELD_STEPS / share)) for i, share in slow.items()}
        self.layout = _layout_of(
            stream_layout, channels, [k - end_of_channels for k in times], bool(interval)
        )
        return used

    def _note_unused(self, filled: Floats, used: Sequence[int], held: set[str]) -> None:
        """Note why each column is not used that is not among the `used` ones."""
        columns, count = self.columns, len(self.layout.columns)
        time = next((columns[k].name for k in used if count <= k < count + len(self.layout.times)), None)
        for k, column in enumerate(columns):
            if k in used:
                continue
            sensor = self.layout.channels[k].sensor if k < count else None
            if not filled[k]:
                reason = "no row has a number in it"
            elif sensor in held:
                reason = f"{sensor} is slower than the rows, and repeats its values"
            elif sensor in INERTIAL:
                reason = f"an axis of {sensor} has no numbers"
            elif filled[k] <= FILLED:
                reason = f"{share_text(1.0 - filled[k])} of the rows lack it"
            else:
                reason = f"the time is {time}"
            self.unused[column.index] = reason

    def _held_sensors(self, rows: Floats, empty: set[str]) -> set[str]:
        """Return the inertial sensors whose numbers are held in some rows, because rows come faster than samples.

        A program that writes a row whenever any sensor has a sample repeats the numbers of the others. Such rows are no
        samples: their noise is smaller. Coarse numbers repeat by chance, each axis for itself.

        Raises
        ------
        RecordingError : two sensors have other rates than the rows, and each another one.
        """
        layout = self.layout
        held: dict[str, Bools] = {}
        if not layout.times:
            return set()
        # a row with the stamp of the row before is a copy of it, which is another matter
        time = rows[:, len(layout.columns)]
        rows = rows[np.append(True, time[1:] != time[:-1])]
        inertial = sorted(set(INERTIAL) & {name.sensor for name in layout.channels} - empty)
        for sensor in inertial:
            axes = [k for k, name in enumerate(layout.channels) if name.sensor == sensor]
            whole = rows[present(rows[:, axes]).all(axis=1)][:, axes]
            if len(axes) < len(AXES) or len(whole) < FEWEST_HELD:
                continue
            equal = whole[1:] == whole[:-1]
            repeats = equal.all(axis=1)
            # a sensor that is stuck repeats its values, too, but for long: those are counted once
            begins = repeats & ~np.append(False, repeats[:-1])
            share = float(repeats.mean())
            by_chance = repeats_by_chance(float(equal.mean()), share)
            if float(begins.mean()) > HELD_SHARE and share < COPIED and share > HELD_EXCESS * by_chance:
                held[sensor] = repeats
        shares = [f"{sensor} in {share_text(float(repeats.mean()))}" for sensor, repeats in held.items()]
        if len(held) == len(INERTIAL):
            one, other = held.values()
            if len(one) != len(other) or float((one != other).mean()) > HELD_SHARE:
                text = f"{self._source.name}: the rows repeat {' and '.join(shares)} of them: both have other rates"
                raise RecordingError("different_rates", text, read_alone())
        elif held and len(inertial) > 1:
            sensor = next(iter(held))
            text = f"the rows repeat {shares[0]} of them: it is slower than they are, and left out"
            self.remarks.append(f"{text}; {option_text(sensor=sensor)} reads it")
        return set(held)

    def note_unset_times(self, rows: Floats) -> bool:
        """Return whether the time is 0 in rows for which the clock was not set, and note it.

        Parameters
        ----------
        rows : the first ones, with the columns that are used.
        """
        if len(self.layout.times) != 1:
            return False
        times = rows[:, len(self.layout.columns)]
        unset = times == 0.0
        steps = np.diff(times[~unset & present(times)])
        if unset.sum() < UNSET_ROWS or not (steps > 0.0).any():
            return False
        # a time that counts from zero is 0 once, and near it then
        if float(np.abs(times[~unset & present(times)]).min()) < UNSET_STEPS * float(
            np.median(steps[steps > 0.0])
        ):
            return False
        name = self.layout.times[0].name
        self.remarks.append(f"the time in {name} is 0 in rows before its clock was set: they count as lost")
        return True

    def complete(self, rows: Floats) -> Bools:
        """Return which rows have the numbers that a sample needs: those of a temperature may be unknown."""
        return np.asarray(present(rows[:, self.needed]).all(axis=1))

    def _empty_sensors(self, filled: Floats) -> set[str]:
        """Return inertial sensors with an axis without numbers; none if no other would be left."""
        channels = self.layout.channels
        empty_axis = {name.sensor: k for k, name in enumerate(channels) if not filled[k]}
        empty = {sensor for sensor in empty_axis if sensor in INERTIAL}
        # then the rows themselves are the problem: `start` raises the error that no row is complete
        if empty == {name.sensor for name in channels} & set(INERTIAL):
            return set()
        for sensor in empty:
            column = self.layout.columns[empty_axis[sensor]].name
            self.remarks.append(f"{column} holds no numbers: {sensor} is left out")
        return empty

    def start(self, rows: Floats) -> TableStart:
        """Return clock, interval and stream that the first rows in order show.

        Raises
        ------
        RecordingError : the numbers cannot have their unit, the time shows no rate, or no row is complete.
        RateRequired : there is no time, and no rate is configured.
        """
        stream_layout, source = self.layout, self._source
        width = len(stream_layout.columns)
        doubled = bool(stream_layout.times) and are_doubled(
            rows, slice(width, width + len(stream_layout.times))
        )
        # stamps and repeats are judged on rows that become samples
        whole = rows[self.complete(rows)]
        if doubled:
            whole = whole[~np.append(False, copies(whole))]
        if self.repeated:
            whole = whole[~np.append(False, copies(whole[:, self.repeated]))]
        if not len(whole):
            names = ", ".join(column.name for column in stream_layout.columns)
            text = f"{source.name}: no row has numbers in all of {names}"
            raise RecordingError("no_complete_row", text, "check that it is complete")
        clock, interval, times = self._clock_of_stream(whole)
        self.remarks += list(_repeating(stream_layout, whole))
        self._note_alternating(whole)
        sensors = ", ".join(dict.fromkeys(channel.sensor for channel in stream_layout.channels))
        title = f"{source.title or source.form} ({sensors})"
        stream = Stream(
            stream_layout.kind,
            stream_layout.channels,
            title,
            clock,
            interval,
            stream_layout.gyro,
            stream_layout.accel,
        )
        return TableStart(stream, times, doubled)

    def _note_alternating(self, whole: Floats) -> None:
        """Note whether every second row is of another sensor, and no column says it."""
        channels = self.layout.channels
        for sensor in sorted(set(INERTIAL) & {name.sensor for name in channels}):
            axes = [k for k, name in enumerate(channels) if name.sensor == sensor]
            if alternate(whole[:, axes]):
                text = (
                    f"every second row of {sensor} differs from those between: the rows may be of two sensors"
                )
                self.remarks.append(f"{text}; write a file for each")
                self.caveats.append("mixed_rows")
                return

    def _clock_of_stream(self, whole: Floats) -> tuple[Clock, float | None, TableTimes | None]:
        """Return clock, interval, s, and the times that are used, of (n, k) complete rows; errors as `start`."""
        interval: float | None = None if self._rate is None else 1.0 / self._rate
        # a time shows what was lost; intervals of samples do not, and a rate least of all
        if self.layout.times:
            width = len(self.layout.columns)
            return self._clock(whole[:, width : width + len(self.layout.times)])
        if (column := self.layout.interval) is not None:
            self._compare(float(np.median(whole[:, -1])) * column.factor, keeps_stamps=True)
            return "dt", None, None
        if interval is None:
            raise RateRequired("rate_required", f"{self._source.name} has no clock", rate_cure())
        return "none", interval, None

    def _compare(self, interval_s: float, *, keeps_stamps: bool) -> None:
        """Note if the configured rate differs from that of the stamps, and which is used."""
        if self._rate is None or abs(self._rate * interval_s - 1.0) <= RATE_TOLERANCE:
            return
        clock = " and are those of a sample clock" if keeps_stamps else ", but are those of a host"
        used = f"{option_text(rate_hz=self._rate)} is {'not used' if keeps_stamps else 'used'}"
        self.remarks.append(f"its time stamps show {1.0 / interval_s:.6g} Hz{clock}: {used}")

    def _clock(self, times: Floats) -> tuple[Clock, float, TableTimes | None]:
        """Return clock, interval, s, and the times that are used, from the times of the first rows."""
        scales = tuple(column.factor for column in self.layout.times)
        origin = times[0].copy()
        nanoseconds = _nanoseconds(times, origin, scales)
        unit_ns = int(scales[0]) if len(scales) == 1 and scales[0] in WRAPPING_NS else 0
        origin_ns, wraps = float(origin @ np.array(scales)), CounterWraps(unit_ns)
        nanoseconds = _continued(nanoseconds, wraps, origin_ns)
        if wraps.count:
            name = self.layout.times[0].name
            self.remarks.append(f"the counter {name} wraps: its time is continued")
        decision = decide([StampCandidate(nanoseconds)])
        if self.repeated and decision.interval is not None:
            return "none", self._mean_interval(nanoseconds), None
        if decision.interval is None:
            return "none", self._rate_instead(decision.kind.name), None
        placer, interval_s = decision.placer(nanoseconds), decision.interval * 1e-9
        stated_hz = self._source.stated_hz
        if stated_hz is not None and abs(stated_hz * interval_s - 1.0) > STATED_TOLERANCE:
            name = self.layout.times[0].name
            text = (
                f"a comment states {stated_hz:g} Hz, and the time in {name} shows {1.0 / interval_s:.6g} Hz"
            )
            self.remarks.append(f"{text}: check its unit")
            self.caveats.append("doubtful_rate")
        self._compare(interval_s, keeps_stamps=decision.kind.keeps_stamps)
        used = TableTimes(origin, scales, placer, CounterWraps(unit_ns))
        if decision.kind.keeps_stamps:
            return "startup", interval_s, used
        # a stream without a clock: the placer turns the stamps of the host into lost samples
        use = "only their mean rate is used" if self._rate is None else "they only show what was lost"
        hidden = ", and single lost samples cannot be detected" if placer.hides_losses else ""
        self.remarks.append(f"{decision.kind.remark}: {use}{hidden}")
        return "none", interval_s if self._rate is None else 1.0 / self._rate, used

    def _mean_interval(self, nanoseconds: Ints) -> float:
        """Return the interval, s, of samples that are held: their stamps are those of rows, late by up to one."""
        if self._rate is not None:
            return 1.0 / self._rate
        self.remarks.append(
            "its rate is the mean of the rows with new values: lost samples cannot be detected"
        )
        typical = typical_step(nanoseconds.astype(np.float64))
        mean = float(nanoseconds[-1] - nanoseconds[0]) / (len(nanoseconds) - 1)
        # the mean is more precise, unless a gap is in it
        return (mean if abs(mean / typical - 1.0) < HELD_SHARE else typical) * 1e-9

    def _rate_instead(self, code: str) -> float:
        """Return the configured interval, s, for times that show none; raise `RecordingError` if there is none."""
        fault, cure = NO_RATE[code]
        text = f"the time in {self.layout.times[0].name} {fault}"
        if self._rate is None:
            raise RecordingError(code, f"{self._source.name}: {text}", f"{cure}, or {rate_cure()}")
        self.no_time = f"it {fault}"
        self.remarks.append(
            f"{text}: {option_text(rate_hz=self._rate)} is used, lost samples cannot be detected"
        )
        return 1.0 / self._rate


def present(rows: Floats) -> Bools:
    """Return which of some numbers are there: finite, and no larger than an instrument writes."""
    return np.abs(rows) < LARGEST


def _repeating(stream_layout: ColumnLayout, rows: Floats) -> Iterator[str]:
    """Yield a remark on each inertial sensor that is slower than its rows and holds its values between."""
    from imumon.noise.statistics.differences import REPEATED

    for sensor in sorted(set(INERTIAL) & {name.sensor for name in stream_layout.channels}, reverse=True):
        axes = [k for k, name in enumerate(stream_layout.channels) if name.sensor == sensor]
        share = float(copies(rows[:, axes]).mean()) if len(rows) > 1 else 0.0
        # nearly all: the sensor is stuck, or constant, which the guard finds
        if REPEATED < share < COPIED:
            yield f"{sensor} repeats its values in {share_text(share)} of the rows: it is slower than they are"


def _is_used(sensor: str, share: float, empty: set[str]) -> bool:
    """Return whether a channel is used of which a share of the first rows has a number."""
    if sensor in INERTIAL:
        return sensor not in empty
    return share > (0.0 if sensor in SLOW else FILLED)


def _layout_of(
    stream_layout: ColumnLayout, channels: Sequence[int], times: Sequence[int], has_interval: bool
) -> ColumnLayout:
    """Return a layout with some of its channels and times, by their indices there, and with or without its interval."""
    return replace(
        stream_layout,
        channels=tuple(stream_layout.channels[k] for k in channels),
        columns=tuple(stream_layout.columns[k] for k in channels),
        times=tuple(stream_layout.times[k] for k in times),
        interval=stream_layout.interval if has_interval else None,
    )


def _sparse(
    columns: Sequence[Column], sensors: Sequence[str], filled: Floats, used: Sequence[int]
) -> Iterator[str]:
    """Yield a remark on the columns that rows lack, by the share of the rows and by what is done."""
    sparse: dict[str, list[str]] = {}
    for k, column in enumerate(columns):
        if filled[k] <= FILLED and (k >= len(sensors) or sensors[k] not in INERTIAL):
            lack = (
                f"{share_text(1.0 - filled[k])} of the rows lack" if filled[k] else "no row has a number in"
            )
            use = "the one before is held" if k in used else "not used"
            sparse.setdefault(f"{lack} {{}}: {use}", []).append(column.name)
    yield from (text.format(", ".join(names)) for text, names in sparse.items())
