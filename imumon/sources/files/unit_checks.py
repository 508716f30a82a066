"""Unit checks: whether the numbers of a table can have the units that its names show, and which else they have.

The first rows decide (`rest_sizes`). A unit that the name has, or that the user gives, is checked as one that is
assumed. What cannot be is an error that names all columns and the unit that fits; what is only unlikely is a remark,
because a sensor may vibrate.

time
    A step d in a unit of u ns is a rate of 1e9 / (d u). Units differ by 1000, and sensors sample at 1 Hz to 1 kHz, so
    that mostly one unit fits:

    ====  =======  =======  =======
    step  s        ms       us
    ====  =======  =======  =======
    0.01  100 Hz   100 kHz  -
    10    0.1 Hz   100 Hz   100 kHz
    1     1 Hz     1 kHz    1 MHz
    ====  =======  =======  =======

    A step of 1 fits two. Then a time since 1970 decides, whose size is one of 1.7e9 s, 1.7e12 ms, ..., or a configured
    rate; else it is an error.

Example: times without a unit.

>>> source = RowSource("run.csv", "csv")
>>> time_unit(source, Column(0, "t", "t"), 10.0 * np.arange(100), None)[0]
'ms'
>>> time_unit(source, Column(0, "t", "t"), 1.7e9 + np.arange(100), None)[0]
's'
>>> try:
...     time_unit(source, Column(0, "t", "t"), 1.0 * np.arange(100), None)
... except RecordingError as error:
...     print(error.cure.partition(";")[0])
1 Hz if that is s or 1000 Hz if that is ms
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imumon.grid.stamp_kinds import typical_step
from imumon.model.cures import option, option_text
from imumon.model.samples import AXES, Floats, sensor_of
from imumon.sources.column_names import UNITS, Column
from imumon.sources.files.base import RecordingError, RowSource
from imumon.sources.files.columns import ColumnLayout, channel_of, reference, without_unit
from imumon.sources.rest_sizes import are_counts, is_one_g, median_size, sample_noise, too_noisy

USUAL_HZ = (0.7, 1400.0)
"""Hz, rates at which the unit of a time is inferred. They span more than the 1000 between two units, so near
1 Hz and 1 kHz both fit."""

INFERRED = ("s", "ms", "us", "ns")
"""Units of a time that its steps may show."""

POSSIBLE_HZ = (1e-3, 2e4)
"""Hz, rates that are possible if the unit is given."""

FINE_UNIT, SLOWEST_FINE_HZ = "100us", 2.0
"""Unit of SampleTimeFine of an Xsens MTi, and rate below which it is that of a Movella DOT, which counts us and has at
most 120 Hz: 1.2 Hz if its numbers were multiples of 100 us."""

SINCE_1970_S = (1e9, 4.1e9)
"""s, times that count from 1970: the years 2001 to 2099."""

MAX_AT_REST = {"accel": (400.0, "m/s2"), "gyro": (70.0, "rad/s")}
"""By sensor: SI, more than a sensor at rest measures, and its unit. 70 rad/s is 4000 deg/s, the end of the widest range
of a gyroscope."""

GRAVITY_UNITS = {"accel": ("g", "mg", "m/s2", "mm/s2", "cm/s2"), "velocity": ("g*s", "m/s")}
"""Units in which one g is looked for, by quantity."""

ARRAY_SUFFIXES = {"deg/s": "dps", "rad/s": "rads"}
"""Units as suffixes of the name of an array, where they differ."""

WHOLE_SIZE = 0.1
"""Share by which whole numbers may differ from one g in a unit, chosen: 800 counts per g are 18 % from one g in cm/s2,
and are no unit."""

WHOLE_POWER = 0.03
"""Share by which one g in counts may differ from a power of two and be meant to be it: ranges of digital
accelerometers are 2, 4, 8 or 16 g over 2^15 counts."""


@dataclass(frozen=True, slots=True)
class _WrongUnit:
    """Columns of a sensor whose numbers cannot have their unit.

    Attributes
    ----------
    code : of the error.
    fault : what contradicts the unit, for people.
    unit : that fits; empty: none is known.
    scale : of the counts, as ``--map`` writes it; empty: the numbers have the unit.
    """

    code: str
    columns: tuple[Column, ...]
    fault: str
    unit: str
    scale: str = ""


def unit_cure(source: RowSource, columns: Sequence[Column], unit: str) -> str:
    """Return how to give the unit of some columns of a table."""
    option = _option(source, _assignments(source, columns, unit, ""))
    if source.form not in ("csv", "npz") or columns[0].name.isdigit():  # there is no header
        return option
    if source.form == "npz":
        return f"let the name of the array end with _{ARRAY_SUFFIXES.get(unit, unit)}, or {option}"
    return f"write [{unit}] behind the name in the header, or {option}"


def _option(source: RowSource, columns: Mapping[str, str]) -> str:
    """Return how to give the units of some columns, by channel as for ``--map``."""
    if source.form != "arrays":
        return option_text(columns=columns)
    # of a program: there is no command line, and each sensor has one unit
    units = {
        "time" if name == "t" else sensor_of(name): text.rpartition(":")[2] for name, text in columns.items()
    }
    listed = ", ".join(f'"{name}": "{unit}"' for name, unit in units.items())
    return f"units={{{listed}}}"


def _assignments(source: RowSource, columns: Sequence[Column], unit: str, scale: str) -> dict[str, str]:
    return {channel_of(column): f"{column_text(source, column)}{scale}:{unit}" for column in columns}


def column_text(source: RowSource, column: Column) -> str:
    """Return how ``--map`` names a column."""
    return reference(column.index, source.column_names) if source.column_names else without_unit(column.name)


def unit_remarks(source: RowSource, columns: Sequence[Column]) -> list[str]:
    """Return remarks on columns whose unit is assumed: angles and rates, whose size does not show it, and a single
    axis of an accelerometer, which may be horizontal."""
    remarks = []
    for quantity, si, other in (("gyro", "rad/s", "deg/s"), ("angle", "rad", "deg"), ("accel", "m/s2", "g")):
        of_quantity = [c for c in columns if c.quantity == quantity]
        bare = [c for c in of_quantity if c.unit is None]
        if bare and (quantity != "accel" or len(of_quantity) == 1):
            names = ", ".join(column.name for column in bare)
            text = f"{names} without a unit: {si} is assumed; if it is {other}"
            remarks.append(f"{text}, {unit_cure(source, bare, other)}")
    doubts = dict.fromkeys(column.doubt for column in columns if column.doubt)
    for doubt in doubts:
        of_doubt = [column for column in columns if column.doubt == doubt]
        remarks.append(f"{', '.join(column.name for column in of_doubt)}: {doubt}")
    return remarks


def check_magnitudes(
    source: RowSource, stream_layout: ColumnLayout, rows: Floats, interval_s: float | None = None
) -> list[str]:
    """Check that the numbers can have their units; return remarks on those that hardly can.

    Parameters
    ----------
    rows : (n, k) with the columns of the layout first; not finite is missing.
    interval_s : s, over which increments are divided: they are checked. None: only the others are.

    Raises
    ------
    RecordingError : they cannot, or no row has all axes of a sensor.
    """
    wrong: list[_WrongUnit] = []
    remarks: list[str] = []
    increments = interval_s is not None
    quantities = ("velocity",) if increments else ("gyro", "accel")
    for quantity in quantities:
        indices = [k for k, column in enumerate(stream_layout.columns) if column.quantity == quantity]
        if not indices:
            continue
        columns = tuple(stream_layout.columns[k] for k in indices)
        valid = rows[np.isfinite(rows[:, indices]).all(axis=1)][:, indices]
        if not len(valid):
            names = ", ".join(column.name for column in columns)
            text = f"{source.name}: no row has numbers for all of {names}"
            raise RecordingError("no_complete_row", text, "check that it is complete")
        found = (
            _wrong_rate(columns, valid)
            if quantity == "gyro"
            else _wrong_acceleration(columns, valid, interval_s or 1.0)
        )
        if isinstance(found, _WrongUnit):
            wrong.append(found)
        elif found is not None:
            remarks.append(
                f"{found}; if it is deg/s, {unit_cure(source, columns, 'deg/s')}"
                if quantity == "gyro"
                else found
            )
    if wrong:
        raise _impossible(source, stream_layout, wrong)
    return remarks


def _wrong_rate(columns: tuple[Column, ...], values: Floats) -> _WrongUnit | str | None:
    """Return why the rates of a gyroscope cannot have their unit, or a remark why they hardly can."""
    rates = values * [column.factor for column in columns]
    bare = _without_unit(columns)
    subject = _subject(bare or columns)
    size = median_size(rates) or 0.0
    number = size / columns[0].factor
    if bare and are_counts(values):
        fault = f"{subject}, but its numbers are whole: they are counts"
        return _WrongUnit("raw_counts", bare, fault, "deg/s", "/COUNTS")
    if size > MAX_AT_REST["gyro"][0]:
        return _WrongUnit("wrong_unit", bare or columns, f"{subject}, but its size is {number:.3g}", "deg/s")
    if not too_noisy(rates):
        return None
    noise = sample_noise(rates)
    fault = f"{subject}, but its noise of {math.degrees(noise):.2g} deg/s is more than that of a gyroscope at rest"
    if bare:
        return _WrongUnit("wrong_unit", bare, fault, "deg/s")
    # a unit that is written may be right: propellers shake a sensor as much
    return f"{fault}: its unit may be wrong" if columns[0].unit == "rad/s" else None


def _wrong_acceleration(
    columns: tuple[Column, ...], values: Floats, interval_s: float
) -> _WrongUnit | str | None:
    """Return why the numbers of an accelerometer cannot have their unit, or a remark that they are one g in none."""
    factors = np.array([column.factor for column in columns]) / interval_s
    size = median_size(values * factors) or 0.0
    bare = _without_unit(columns)
    complete = len(columns) == len(AXES)
    # axes that are not all there may be horizontal: then any size is possible
    if is_one_g(size) or not (complete or bare):
        return None
    quantity = columns[0].quantity or ""
    number = size * interval_s / columns[0].factor  # as in the table
    doubtful = bare or columns
    subject = f"{_subject(doubtful)}, but its size is {number:.3g}"
    whole = are_counts(values)
    unit = _unit_of_gravity(quantity, number, interval_s, whole)
    scaled = any(column.scale != 1.0 for column in columns)
    if unit is not None and not scaled:
        return _WrongUnit("wrong_unit", doubtful, subject, unit)
    if size > MAX_AT_REST["accel"][0] or (bare and whole):
        return _raw_counts(doubtful, quantity, subject, number)
    if complete:
        return f"{subject}, which is one g in no unit: its unit may be wrong, or gravity has been removed"
    return None


def _without_unit(columns: tuple[Column, ...]) -> tuple[Column, ...]:
    """Return the columns whose unit is not written."""
    return tuple(column for column in columns if column.unit is None)


def _raw_counts(columns: tuple[Column, ...], quantity: str, subject: str, number: float) -> _WrongUnit:
    """Return that the numbers of an accelerometer, of this size, are counts; the subject names them."""
    fault = (
        f"{subject}: that is one g in none of {', '.join(GRAVITY_UNITS[quantity])}, so these are raw counts"
    )
    unit = "g" if quantity == "accel" else "g*s"
    return _WrongUnit("raw_counts", columns, fault, unit, f"/{_counts_per_g(number):g}")


def _unit_of_gravity(quantity: str, number: float, interval_s: float, whole: bool) -> str | None:
    """Return the unit in which a size, as in the table, is one g; None: it is in none.

    Whole numbers may be counts, so that they must be closer to one g.
    """
    for unit in GRAVITY_UNITS[quantity]:
        size = number * UNITS[quantity][unit] / interval_s
        if is_one_g(size) and not (whole and abs(size / UNITS["accel"]["g"] - 1.0) > WHOLE_SIZE):
            return unit
    return None


def _counts_per_g(size: float) -> float:
    """Return the counts per g that a size of one g shows: the power of two that is near, else four digits."""
    power = 2.0 ** round(math.log2(size))
    return power if abs(size / power - 1.0) < WHOLE_POWER else float(f"{size:.4g}")


def _subject(columns: Sequence[Column]) -> str:
    """Return the first column and what its unit is taken for."""
    quantity = columns[0].quantity or ""
    si = next(unit for unit, factor in UNITS[quantity].items() if factor == 1.0)
    unit = columns[0].unit
    return (
        f"{columns[0].name} has no unit, which means {si}"
        if unit is None
        else f"{columns[0].name} is in {unit}"
    )


def _impossible(
    source: RowSource, stream_layout: ColumnLayout, wrong: Sequence[_WrongUnit]
) -> RecordingError:
    """Return the error for numbers that cannot have their units; its cure gives all of them."""
    text = f"{source.name}: {'; '.join(each.fault for each in wrong)}"
    # what the user has given already stays in the option
    given = {
        channel_of(c): f"{column_text(source, c)}{_scale_text(c)}:{c.unit}" for c in _given(stream_layout)
    }
    cured: dict[str, str] = {}
    for each in wrong:
        cured |= _assignments(source, each.columns, each.unit, each.scale)
    units = " and ".join(dict.fromkeys(each.unit for each in wrong))
    single = len(wrong) == 1 and not given and not wrong[0].scale
    option = unit_cure(source, wrong[0].columns, units) if single else _option(source, given | cured)
    counts = [each for each in wrong if each.scale]
    notes = _note_on_scales([each.scale for each in counts])
    if source.form == "arrays" and counts:
        option, notes = f"divide the counts by those of a unit, then {option}", ""
    code = wrong[0].code if len({each.code for each in wrong}) == 1 else "wrong_unit"
    return RecordingError(code, text, f"if it is {units}, {option}{notes}")


def _note_on_scales(scales: Sequence[str]) -> str:
    """Return where the counts of a unit in a cure come from, to follow it; empty: it has none."""
    if any("COUNTS" in scale for scale in scales):
        return "; COUNTS of a unit are in the data sheet"
    if scales:
        return f"; {scales[0][1:]} is the size that was measured, the data sheet has the exact counts per g"
    return ""


def _scale_text(column: Column) -> str:
    return "" if column.scale == 1.0 else f"*{column.scale:.12g}"


def _given(stream_layout: ColumnLayout) -> Iterator[Column]:
    """Yield the columns of sensors that the user has assigned with a unit."""
    for column in (*stream_layout.columns, *stream_layout.times):
        if column.rank < 0 and column.unit is not None:
            yield column


def time_unit(
    source: RowSource, column: Column, times: Floats, rate_hz: float | None
) -> tuple[str, str | None]:
    """Return the unit of a column of time, and a remark on it.

    Parameters
    ----------
    times : (n,) as in the table, not all the same.
    rate_hz : Hz, configured sample rate; None: not configured.

    Raises
    ------
    RecordingError : the given unit is not possible, or two are equally plausible.
    """
    step = column.scale * typical_step(times)
    # ticks of 100 us are no unit that is inferred: only the name of a column shows them
    rates = {u: 1e9 / (step * ns) for u, ns in UNITS["t"].items() if u in INFERRED or u == column.unit}
    usual = [unit for unit, rate in rates.items() if _within(rate, USUAL_HZ)]
    if column.unit == FINE_UNIT and column.rank >= 0 and rates[FINE_UNIT] < SLOWEST_FINE_HZ:
        return _fine_unit(column, rates, rate_hz)
    if column.unit is not None:
        return column.unit, _doubt_of_unit(source, column, column.unit, rates, usual)
    if rate_hz is not None:
        return min(rates, key=lambda unit: abs(math.log(rates[unit] / rate_hz))), None
    dated = [u for u in rates if _within(abs(float(times[0])) * UNITS["t"][u] * 1e-9, SINCE_1970_S)]
    likely = _likely_units(rates, usual, dated)
    if len(likely) != 1:
        text = f"{source.name}: {column.name} has no unit, and its steps are {step:.3g}"
        raise RecordingError("ambiguous_time_unit", text, _choices(source, column, likely, rates))
    unit = likely[0]
    if unit == "s" or unit in dated:  # SI, or certain: no remark
        return unit, None
    text = f"{column.name} without a unit: {unit} is assumed, which is {rates[unit]:.4g} Hz"
    return unit, f"{text}; if it is another, {unit_cure(source, [column], 's')}"


def _likely_units(rates: Mapping[str, float], usual: Sequence[str], dated: Sequence[str]) -> list[str]:
    """Return the units that a time without one may have: those with a date first, of those with a usual rate."""
    likely = [unit for unit in usual if unit in dated] or list(usual)
    # beyond the usual rates only the units that people write without naming them
    return likely or [unit for unit in ("s", "ns") if _within(rates[unit], POSSIBLE_HZ)]


def _fine_unit(column: Column, rates: Mapping[str, float], rate_hz: float | None) -> tuple[str, str | None]:
    """Return the unit of a counter whose name shows ticks of 100 us, at which it would be slow, and a remark."""
    if rate_hz is not None and abs(math.log(rates[FINE_UNIT] / rate_hz)) < math.log(10.0):
        return FINE_UNIT, None
    text = f"{column.name} counts us, {rates['us']:.4g} Hz: 100 us would be {rates[FINE_UNIT]:.4g} Hz"
    return "us", f"{text}; if it counts these, {option_text(columns={'t': f'{column.name}:{FINE_UNIT}'})}"


def _doubt_of_unit(
    source: RowSource, column: Column, unit: str, rates: dict[str, float], usual: Sequence[str]
) -> str | None:
    """Return a remark on the unit that a header gives; raise an error if no sensor has that rate."""
    if not _within(rates[unit], POSSIBLE_HZ):
        # loggers write "ms" above seconds: a rate that no sensor has refutes the header
        text = f"{source.name}: {column.name} is in {unit}, but its steps would then be {rates[unit]:.3g} Hz"
        raise RecordingError("wrong_time_unit", text, _choices(source, column, usual, rates))
    # a slower sensor than any, whose rate is usual in another unit: the header may be wrong
    if rates[unit] < USUAL_HZ[0] and usual and column.rank >= 0:
        text = f"{column.name} is in {unit}, which is {rates[unit]:.3g} Hz"
        other = unit_cure(source, [column], usual[0])
        return f"{text}; if it is {usual[0]}, {rates[usual[0]]:.4g} Hz, {other}"
    return None


def _choices(source: RowSource, column: Column, units: Sequence[str], rates: dict[str, float]) -> str:
    """Return which units a time can have, and how to give one."""
    if not units:
        another = option_text(columns={"t": "COLUMN:UNIT"})
        return f"no unit makes that the rate of a sensor; name another column with {another}"
    readings = " or ".join(f"{rates[unit]:.4g} Hz if that is {unit}" for unit in units)
    rate = f" (or {option('rate_hz')})" if column.unit is None else ""
    return f"{readings}; {unit_cure(source, [column], units[0])}{rate}"


def _within(value: float, limits: tuple[float, float]) -> bool:
    return limits[0] <= value <= limits[1]
