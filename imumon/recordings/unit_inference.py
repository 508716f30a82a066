"""Plausibility: of which units the numbers of a table can be.

Names may say no unit, or a wrong one, and a wrong one makes every figure wrong. A sensor at rest feels one g,
turns slowly, and no inertial sensor is slower than about 1 Hz or faster than some kHz: where that decides,
nothing is asked. Where two units are as plausible, it is an error that names both and how to say which.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np

from imumon.errors import SourceError
from imumon.recordings.column_names import UNITS, Column
from imumon.recordings.columns import SENSORS, ColumnLayout
from imumon.samples import Floats
from imumon.timebase.timestamps import typical_step

USUAL_HZ = (0.7, 1400.0)
"""Rates among which the unit of a time is looked for. They span more than the 1000 between two units: near
1 Hz and 1 kHz both fit."""

POSSIBLE_HZ = (1e-3, 2e4)
"""Rates that are believed where the unit is said."""

SINCE_1970_S = (1e9, 4.1e9)
"""Sizes of a time that counts from 1970: the years 2001 to 2099."""

SIZES = {"accel": (400.0, "m/s2", "mg"), "gyro": (70.0, "rad/s", "deg/s")}
"""More than a sensor at rest shows in SI, and the unit that is likely then."""

NEAR = (0.8, 1.25)
"""Share of one g within which a size must be one g."""

ENDINGS = {"deg/s": "dps", "rad/s": "rads"}
"""Units as the name of an array ends with them, where they are spelled otherwise."""


def cure(what: str, columns: Sequence[Column], unit: str) -> str:
    """How to say the unit of some columns.

    Parameters
    ----------
    what : the table is, ``csv``, ``npz`` or ``bag``.
    """
    if what == "bag":
        return "its driver must send SI units"
    told = []
    for column in columns:
        sensor = SENSORS.get(column.quantity or "", column.quantity)
        channel = f"{sensor}/{column.axis}" if column.axis else sensor
        told.append(f"{channel}={_bare(column.name)}:{unit}")
    by_hand = f"--map {','.join(told)}"
    if columns[0].name.isdigit():  # there is no header
        return by_hand
    if what == "npz":
        return f"let the name of the array end with _{ENDINGS.get(unit, unit)}, or {by_hand}"
    return f"write [{unit}] behind the name in the header, or {by_hand}"


def assumed(what: str, columns: Sequence[Column]) -> list[str]:
    """Remarks on columns whose unit nothing tells, not even their size: angles and rates."""
    remarks = []
    for quantity, si, other in (("gyro", "rad/s", "deg/s"), ("angle", "rad", "deg")):
        bare = [c for c in columns if c.quantity == quantity and c.unit is None]
        if bare:
            named = ", ".join(column.name for column in bare)
            remarks.append(
                f"{named} without a unit: taken as {si}; if {other} is meant, {cure(what, bare, other)}"
            )
    return remarks


def check_sizes(path: str, what: str, found: ColumnLayout, rows: Floats) -> None:
    """Refuse numbers that cannot be of their units.

    Parameters
    ----------
    rows : (n, k) with a column for each of the layout's first; not finite is missing.

    Raises
    ------
    SourceError : they cannot, or no row has all axes of a sensor.
    """
    for sensor, (most, si, likely) in SIZES.items():
        picked = [k for k, column in enumerate(found.columns) if column.quantity == sensor]
        if not picked:
            continue
        columns = [found.columns[k] for k in picked]
        names = ", ".join(column.name for column in columns)
        seen = rows[np.isfinite(rows[:, picked]).all(axis=1)][:, picked]
        if not len(seen):
            raise SourceError(f"{path}: no row has numbers for all of {names}")
        # a few spoilt numbers say nothing of the unit
        size = float(np.median(np.linalg.norm(seen * [column.factor for column in columns], axis=1)))
        bare = [column for column in columns if column.unit is None]
        fits = [u for u in ("g", "mg") if sensor == "accel" and _near(size / (1.0 if u == "g" else 1000.0))]
        if size <= most and not (bare and fits):
            continue
        unit = (fits or [likely])[0]
        blamed = bare or columns
        said = f"says {blamed[0].unit}" if not bare else f"says no unit, which means {si}"
        if sensor == "accel" and not fits:
            advice = (
                "that is one g in none of m/s2, g, mg: if these are raw counts, divide them by "
                f"the counts per g of the data sheet, then {cure(what, blamed, 'g')}"
            )
        else:
            advice = f"if it is {unit}, {cure(what, blamed, unit)}"
            advice += "; if these are raw counts, scale them first" if sensor == "gyro" else ""
        raise SourceError(f"{path}: {blamed[0].name} {said}, but its size is {size:.3g}: {advice}")


def time_unit(
    path: str, what: str, column: Column, times: Floats, rate_hz: float | None
) -> tuple[str, str | None]:
    """Unit of a column of time, and what to remark on it.

    Parameters
    ----------
    times : (n,) as the table has them, not all the same.
    rate_hz : told by the user, None otherwise.

    Raises
    ------
    SourceError : the unit that is said is not possible, or two are as plausible.
    """
    step = typical_step(times)
    rates = {unit: 1e9 / (step * ns) for unit, ns in UNITS["t"].items()}
    usual = [unit for unit, rate in rates.items() if _within(rate, USUAL_HZ)]
    if column.unit is not None:
        if _within(rates[column.unit], POSSIBLE_HZ):
            return column.unit, None
        raise SourceError(
            f"{path}: {column.name} says {column.unit}, but its steps of {step:.3g} would then be "
            f"{rates[column.unit]:.3g} Hz: " + _either(what, column, usual, rates)
        )
    if rate_hz is not None:
        return min(rates, key=lambda unit: abs(math.log(rates[unit] / rate_hz))), None
    dated = [u for u in rates if _within(abs(float(times[0])) * UNITS["t"][u] * 1e-9, SINCE_1970_S)]
    likely = [unit for unit in usual if unit in dated] or usual
    likely = likely or [unit for unit in ("s", "ns") if _within(rates[unit], POSSIBLE_HZ)]
    if len(likely) != 1:
        raise SourceError(
            f"{path}: {column.name} says no unit, and its steps are {step:.3g}: "
            + _either(what, column, likely, rates)
        )
    unit = likely[0]
    if unit == "s" or unit in dated:
        return unit, None
    return unit, (
        f"{column.name} without a unit: taken as {unit}, which is {rates[unit]:.4g} Hz; "
        f"if it is not, {cure(what, [column], 's')}"
    )


def _either(what: str, column: Column, units: Sequence[str], rates: dict[str, float]) -> str:
    """What a time may be, and how to say it."""
    if not units:
        return "no unit makes that the rate of a sensor; name another column with --map t=COLUMN:UNIT"
    readings = " or ".join(f"{rates[unit]:.4g} Hz if that is {unit}" for unit in units)
    return f"{readings}; {cure(what, [column], units[0])}" + (" (or --rate)" if column.unit is None else "")


def _within(value: float, limits: tuple[float, float]) -> bool:
    return limits[0] <= value <= limits[1]


def _near(size: float) -> bool:
    return _within(size, NEAR)


def _bare(name: str) -> str:
    """Name without its unit in brackets."""
    return re.sub(r"\s*[\[(][^\])]*[\])]\s*$", "", name)
