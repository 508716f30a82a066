"""Unit inference: possible units of the numbers of a table.

The name of a column may have no unit or a wrong one, and a wrong unit makes every result wrong. A sensor at
rest measures one g and turns slowly, and inertial sensors sample at 1 Hz to some kHz: where that decides, the
unit is inferred. Where two units are equally plausible, it is an error that names both and how to choose.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imumon.column_names import UNITS, Column
from imumon.recordings.base import RecordingError
from imumon.recordings.columns import ColumnLayout, channel_of, without_unit
from imumon.samples import AXES, Floats
from imumon.timebase.timestamps import typical_step

USUAL_HZ = (0.7, 1400.0)
"""Hz, rates at which the unit of a time is inferred. They span more than the 1000 between two units, so near
1 Hz and 1 kHz both fit."""

POSSIBLE_HZ = (1e-3, 2e4)
"""Hz, rates that are possible if the unit is given."""

SINCE_1970_S = (1e9, 4.1e9)
"""s, times that count from 1970: the years 2001 to 2099."""

MAX_AT_REST = {"accel": (400.0, "m/s2", "mg"), "gyro": (70.0, "rad/s", "deg/s")}
"""By sensor: SI, more than a sensor at rest measures, its unit, and the unit that is likely then."""

ONE_G = (0.8, 1.25)
"""Sizes of an acceleration that are one g, in g."""

ONE_G_SI = UNITS["accel"]["g"]
"""m/s2, one g."""

ARRAY_SUFFIXES = {"deg/s": "dps", "rad/s": "rads"}
"""Units as suffixes of the name of an array, where they differ."""


def unit_cure(what: str, columns: Sequence[Column], unit: str) -> str:
    """Return how to give the unit of some columns of a table."""
    assigned = (f"{channel_of(column)}={without_unit(column.name)}:{unit}" for column in columns)
    option = f"--map {','.join(assigned)}"
    if what not in ("csv", "npz") or columns[0].name.isdigit():  # there is no header
        return option
    if what == "npz":
        return f"let the name of the array end with _{ARRAY_SUFFIXES.get(unit, unit)}, or {option}"
    return f"write [{unit}] behind the name in the header, or {option}"


def unit_remarks(what: str, columns: Sequence[Column]) -> list[str]:
    """Return remarks on columns whose unit is assumed: angles and rates, whose size does not show it, and a single
    axis of an accelerometer, which may be horizontal."""
    remarks = []
    for quantity, si, other in (("gyro", "rad/s", "deg/s"), ("angle", "rad", "deg"), ("accel", "m/s2", "g")):
        present = [c for c in columns if c.quantity == quantity]
        bare = [c for c in present if c.unit is None]
        if bare and (quantity != "accel" or len(present) == 1):
            names = ", ".join(column.name for column in bare)
            text = f"{names} without a unit: {si} is assumed; if it is {other}"
            remarks.append(f"{text}, {unit_cure(what, bare, other)}")
    return remarks


def check_magnitudes(path: str, what: str, found: ColumnLayout, rows: Floats) -> None:
    """Check that the numbers can have their units.

    Parameters
    ----------
    rows : (n, k) with the columns of the layout first; not finite is missing.

    Raises
    ------
    RecordingError : they cannot, or no row has all axes of a sensor.
    """
    for sensor in MAX_AT_REST:
        indices = [k for k, column in enumerate(found.columns) if column.quantity == sensor]
        columns = [found.columns[k] for k in indices]
        valid = rows[np.isfinite(rows[:, indices]).all(axis=1)][:, indices]
        if columns and not len(valid):
            names = ", ".join(column.name for column in columns)
            text = f"{path}: no row has numbers for all of {names}"
            raise RecordingError("no_complete_row", text, "check that it is complete")
        if columns:
            # the median: a few wrong numbers say nothing of the unit
            size = float(np.median(np.linalg.norm(valid * [column.factor for column in columns], axis=1)))
            _check_size(path, what, sensor, columns, size)


def _check_size(path: str, what: str, sensor: str, columns: Sequence[Column], size: float) -> None:
    """Check that a sensor at rest can have this size, SI unit."""
    most, si, likely = MAX_AT_REST[sensor]
    bare = [column for column in columns if column.unit is None]
    named = [c for c in columns if c.rank < 0] or len(columns) < len(AXES)
    raw, fits = size / columns[0].factor, []
    if sensor == "accel" and not _within(size / ONE_G_SI, ONE_G) and (bare or not named):
        fits = [u for u in ("g", "mg", "m/s2") if _within(raw * UNITS["accel"][u] / ONE_G_SI, ONE_G)]
    if size <= most and not fits:
        return
    unit = (fits or [likely])[0]
    wrong = bare or columns
    given = f"is in {wrong[0].unit}" if not bare else f"has no unit, which means {si}"
    if sensor == "accel" and not fits:
        code = "raw_counts"
        cure = "that is one g in none of m/s2, g, mg: if these are raw counts, divide them by the counts "
        cure += f"per g of the data sheet, then {unit_cure(what, wrong, 'g')}"
    else:
        code, cure = "wrong_unit", f"if it is {unit}, {unit_cure(what, wrong, unit)}"
        cure += "; if these are raw counts, scale them first" if sensor == "gyro" else ""
    raise RecordingError(code, f"{path}: {wrong[0].name} {given}, but its size is {raw:.3g}", cure)


def time_unit(
    path: str, what: str, column: Column, times: Floats, rate_hz: float | None
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
    step = typical_step(times)
    rates = {unit: 1e9 / (step * ns) for unit, ns in UNITS["t"].items()}
    usual = [unit for unit, rate in rates.items() if _within(rate, USUAL_HZ)]
    if column.unit is not None:
        if _within(rates[column.unit], POSSIBLE_HZ):
            return column.unit, None
        text = f"{path}: {column.name} is in {column.unit}, but its steps of {step:.3g} would then be "
        text += f"{rates[column.unit]:.3g} Hz"
        raise RecordingError("wrong_time_unit", text, _choices(what, column, usual, rates))
    if rate_hz is not None:
        return min(rates, key=lambda unit: abs(math.log(rates[unit] / rate_hz))), None
    dated = [u for u in rates if _within(abs(float(times[0])) * UNITS["t"][u] * 1e-9, SINCE_1970_S)]
    likely = [unit for unit in usual if unit in dated] or usual
    likely = likely or [unit for unit in ("s", "ns") if _within(rates[unit], POSSIBLE_HZ)]
    if len(likely) != 1:
        text = f"{path}: {column.name} has no unit, and its steps are {step:.3g}"
        raise RecordingError("ambiguous_time_unit", text, _choices(what, column, likely, rates))
    unit = likely[0]
    if unit == "s" or unit in dated:
        return unit, None
    text = f"{column.name} without a unit: {unit} is assumed, which is {rates[unit]:.4g} Hz"
    return unit, f"{text}; if it is another, {unit_cure(what, [column], 's')}"


def _choices(what: str, column: Column, units: Sequence[str], rates: dict[str, float]) -> str:
    """Return which units a time can have, and how to give one."""
    if not units:
        return "no unit makes that the rate of a sensor; name another column with --map t=COLUMN:UNIT"
    readings = " or ".join(f"{rates[unit]:.4g} Hz if that is {unit}" for unit in units)
    rate = " (or --rate)" if column.unit is None else ""
    return f"{readings}; {unit_cure(what, [column], units[0])}{rate}"


def _within(value: float, limits: tuple[float, float]) -> bool:
    return limits[0] <= value <= limits[1]
