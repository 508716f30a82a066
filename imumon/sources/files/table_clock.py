"""Clock of a table: what the times of its first rows are, and the sampling interval.

The stamps are those of a sample clock, or of a host (`grid.stamp_kinds`). Those of a sample clock are used whatever
rate is configured; those of a host give way to it. A time that shows no rate needs one that is configured.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from imumon.grid.counter_wraps import CounterWraps
from imumon.grid.interval import RATE_TOLERANCE
from imumon.grid.stamp_kinds import StampCandidate, decide, typical_step
from imumon.grid.stamp_placement import StampPlacer
from imumon.model.cures import option, option_text
from imumon.model.errors import RateRequired
from imumon.model.report import stamp
from imumon.model.samples import LONGEST_NS, Clock, Floats, Ints
from imumon.sources.files.base import RecordingError, RowSource
from imumon.sources.files.columns import SINCE_1970_S, ColumnLayout

WRAPPING_NS = (1e6, 1e3)
"""ns in a unit of counters that wrap: those of Arduino and MicroPython in ms and us do. No board is known whose counter
of s or ns wraps."""

STATED_TOLERANCE = 0.02
"""Share by which the rate of a time may differ from one that a comment states: those are nominal."""

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
    scales : (1 or 2,) ns in a unit of each column of time.
    wraps : of a counter.
    placer : places the rows.
    """

    origin: Floats
    scales: Floats
    wraps: CounterWraps
    placer: StampPlacer

    @property
    def origin_ns(self) -> float:
        """ns, time of the first row."""
        return float(self.origin @ self.scales)

    @property
    def started(self) -> str | None:
        """Date of the first row; None if its time is none since 1970."""
        unix_s = self.origin_ns * 1e-9
        is_date = SINCE_1970_S[0] <= unix_s < SINCE_1970_S[1]
        return stamp(datetime.fromtimestamp(unix_s, UTC)) if is_date else None

    def nanoseconds(self, times: Floats) -> Ints:
        """Return (n,) ns since the first row of (n, 1 or 2) times as in the table."""
        return _nanoseconds(times, self.origin, self.scales, self.wraps)


@dataclass(frozen=True, slots=True)
class TableClock:
    """What the first rows show of the clock.

    Attributes
    ----------
    clock : of the stream.
    interval_s : s; None: each row has its own.
    times : None: the table has no time that is used.
    remarks : what is doubtful, or not used.
    unused : why the time is not used; empty: it is, or there is none.
    is_doubtful : the rate is not the one that a comment states.
    """

    clock: Clock
    interval_s: float | None
    times: TableTimes | None = None
    remarks: tuple[str, ...] = ()
    unused: str = ""
    is_doubtful: bool = False


def clock_of(
    rows: Floats, layout: ColumnLayout, source: RowSource, rate_hz: float | None, *, held: bool
) -> TableClock:
    """Return the clock that (n, k) complete rows show.

    Parameters
    ----------
    rows : with the columns of the layout: channels, times, interval.
    rate_hz : Hz, configured; None: the layout may state one.
    held : rows that repeat a sensor are left out: the stamps of others are late by up to one row.

    Raises
    ------
    RecordingError : the time shows no rate. RateRequired : there is no time, and no rate is configured.
    """
    rate = rate_hz if rate_hz is not None else layout.rate_hz
    # a time shows what was lost; intervals of samples do not, and a rate least of all
    if layout.times:
        return _of_times(
            rows[:, len(layout.columns) :][:, : len(layout.times)], layout, source, rate, held=held
        )
    if layout.interval is not None:
        interval_s = float(np.median(rows[:, -1])) * layout.interval.factor
        return TableClock("dt", None, remarks=tuple(_compared(rate, interval_s, keeps_stamps=True)))
    if rate is None:
        cure = f"give the sample rate with {option('rate_hz')}"
        raise RateRequired("rate_required", f"{source.name} has no clock", cure)
    return TableClock("none", 1.0 / rate)


def _of_times(
    times: Floats, layout: ColumnLayout, source: RowSource, rate: float | None, *, held: bool
) -> TableClock:
    """Return the clock that the (n, 1 or 2) times of complete rows show."""
    name, scales = layout.times[0].name, np.array([column.factor for column in layout.times])
    wraps = CounterWraps(counter_unit(layout))
    nanoseconds = _nanoseconds(times, times[0], scales, wraps)
    remarks = [f"the counter {name} wraps: its time is continued"] if wraps.count else []
    decision = decide([StampCandidate(nanoseconds)])
    if decision.interval is None:
        return _without_times(decision.kind.name, name, source, rate, remarks)
    if held:
        remarks.append("its rate is the mean of the rows with new values: lost samples cannot be detected")
        typical_s = typical_step(nanoseconds.astype(np.float64)) * 1e-9
        return TableClock("none", typical_s if rate is None else 1.0 / rate, remarks=tuple(remarks))
    placer, interval_s = decision.placer(nanoseconds), decision.interval * 1e-9
    stated_hz, shown_hz = source.stated_hz, 1.0 / interval_s
    is_doubtful = stated_hz is not None and abs(stated_hz / shown_hz - 1.0) > STATED_TOLERANCE
    if is_doubtful:
        text = f"a comment states {stated_hz:g} Hz, and the time in {name} shows {shown_hz:.6g} Hz"
        remarks.append(f"{text}: check its unit")
    remarks += _compared(rate, interval_s, keeps_stamps=decision.kind.keeps_stamps)
    used = TableTimes(times[0].copy(), scales, CounterWraps(counter_unit(layout)), placer)
    if decision.kind.keeps_stamps:
        return TableClock("startup", interval_s, used, tuple(remarks), "", is_doubtful)
    # a stream without a clock: the placer turns the stamps of the host into lost samples
    use = "only their mean rate is used" if rate is None else "they only show what was lost"
    hidden = ", and single lost samples cannot be detected" if placer.hides_losses else ""
    remarks.append(f"{decision.kind.remark}: {use}{hidden}")
    return TableClock(
        "none", interval_s if rate is None else 1.0 / rate, used, tuple(remarks), "", is_doubtful
    )


def _without_times(
    code: str, name: str, source: RowSource, rate: float | None, remarks: list[str]
) -> TableClock:
    """Return the clock of the configured rate, for times that show none; raise `RecordingError` if there is none."""
    fault, cure = NO_RATE[code]
    text = f"the time in {name} {fault}"
    if rate is None:
        cure = f"{cure}, or give the sample rate with {option('rate_hz')}"
        raise RecordingError(code, f"{source.name}: {text}", cure)
    remarks.append(f"{text}: {option_text(rate_hz=rate)} is used, lost samples cannot be detected")
    return TableClock("none", 1.0 / rate, remarks=tuple(remarks), unused=f"it {fault}")


def _compared(rate: float | None, interval_s: float, *, keeps_stamps: bool) -> Iterator[str]:
    """Yield a remark if the configured rate differs from that of the stamps, and which is used."""
    if rate is not None and abs(rate * interval_s - 1.0) > RATE_TOLERANCE:
        clock = " and are those of a sample clock" if keeps_stamps else ", but are those of a host"
        used = f"{option_text(rate_hz=rate)} is {'not used' if keeps_stamps else 'used'}"
        yield f"its time stamps show {1.0 / interval_s:.6g} Hz{clock}: {used}"


def counter_unit(layout: ColumnLayout) -> int:
    """Return the unit of a time, ns, if it is a counter that wraps; 0: it does not wrap, or there is no time."""
    unit_ns = layout.times[0].factor if len(layout.times) == 1 else 0.0
    return int(unit_ns) if unit_ns in WRAPPING_NS else 0


def _nanoseconds(times: Floats, origin: Floats, scales: Floats, wraps: CounterWraps) -> Ints:
    """Return (n,) ns since the origin of (n, k) times, with the wraps of a counter undone."""
    # first the difference, column by column, then the sum: a float of ns since 1970 has steps of 256 ns
    total: Floats = (times - origin) @ scales
    # a wrong stamp of 1e300 must not become any integer, but a step that the clock refuses
    nanoseconds: Ints = np.rint(np.clip(total, -LONGEST_NS, LONGEST_NS)).astype(np.int64)
    # a counter counts from its own zero; ns of a float since 1970 are rounded, those of a counter of 32 bits are not
    origin_ns = float(origin @ scales)
    zero = round(origin_ns) if abs(origin_ns) < LONGEST_NS else 0
    return wraps.continued(nanoseconds + zero) - zero
