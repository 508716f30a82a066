"""Meaning of columns that the user states: units by sensor, and what a sample is.

Names of columns say most of it (`columns`). Where they do not, a caller of `imumon.analyse` gives the unit
of a sensor, and says whether a number is

point       the output at an instant, behind whatever filter the sensor has. N is raised by aliasing.
average     the mean over the interval of a sample: a rate or an acceleration that the sensor has integrated.
increment   the integral over that interval: an angle or a velocity, as delta angles are.

The last two are true averages (`SampleBlock` of the kind ``deltas``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import get_args

from imumon.model.samples import Kind
from imumon.sources.column_names import UNITS, Column, unit_of
from imumon.sources.files.base import OptionError, OptionNotApplicable, ReadOptions, Samples
from imumon.sources.files.columns import INERTIAL, SENSORS, ColumnLayout

INTEGRALS = {"gyro": "angle", "accel": "velocity"}
"""Quantity of an increment, by that of its rate."""

UNIT_KEYS = {
    **{sensor: sensor for sensor in ("gyro", "accel", "mag", "temperature", "pressure")},
    "time": "t",
}
"""Names for which a unit may be given, and their quantities."""


def check_meaning(units: Mapping[str, str], samples: str | None) -> None:
    """Check what a user states before anything is read; raise `OptionError` if it has no meaning."""
    if samples is not None and samples not in get_args(Samples):
        cure = f"use one of {', '.join(get_args(Samples))}, or leave it out"
        raise OptionError("kind_unknown", f"kind={samples!r} is no kind of sample", cure)
    for name, unit in units.items():
        if name not in UNIT_KEYS:
            cure = f"the names are {', '.join(UNIT_KEYS)}"
            raise OptionError("units_of_unknown", f"units has {name!r}, which is no sensor", cure)
        quantity = UNIT_KEYS[name]
        _unit(str(unit), INTEGRALS.get(quantity, quantity) if samples == "increment" else quantity)


def check_nothing_stated(path: str, options: ReadOptions) -> None:
    """Raise `OptionNotApplicable` if units or samples are stated of messages, whose device defines both."""
    if options.units or options.samples is not None:
        text = f"units and kind are for tables, and {path} has messages of a sensor, which say both"
        raise OptionNotApplicable("units_not_applicable", text, "leave them out")


def with_meaning(
    table_layout: ColumnLayout, units: Mapping[str, str], samples: Samples | None
) -> ColumnLayout:
    """Return the columns of a stream with the units and the meaning of samples that a user states.

    Raises
    ------
    OptionError : a unit is unknown, or the columns are increments and are to be point samples or rates.
    """
    columns = table_layout.columns
    if samples is not None:
        columns = tuple(_as_samples(column, samples) for column in columns)
        table_layout = replace(table_layout, kind=_kind(table_layout, samples), gyro=None, accel=None)
    columns = tuple(_with_unit(column, units) for column in columns)
    times = table_layout.times
    if "time" in units:
        times = tuple(replace(column, unit=_unit(units["time"], "t"), rank=-1) for column in times)
    return replace(table_layout, columns=columns, times=times)


def _kind(table_layout: ColumnLayout, samples: Samples) -> Kind:
    if samples != "point":
        return "deltas"
    return "unknown" if table_layout.kind == "deltas" else table_layout.kind


def _as_samples(column: Column, samples: Samples) -> Column:
    """Return a column whose numbers are those samples."""
    if column.quantity in INTEGRALS.values() and samples != "increment":
        text = f"the column {column.name} has increments, and kind={samples!r} is for rates"
        raise OptionError("kind_contradicts", text, "use kind='increment', or leave it out")
    if column.quantity not in INERTIAL or samples != "increment":
        return column
    quantity = INTEGRALS[column.quantity]
    # a rate in the name of the column is the unit of the sensor, and says nothing of its integral
    unit = None if column.unit is None else unit_of(column.unit, quantity)
    return replace(column, quantity=quantity, unit=unit)


def _with_unit(column: Column, units: Mapping[str, str]) -> Column:
    """Return a column in the unit that is given for its sensor."""
    sensor = SENSORS.get(column.quantity or "", column.quantity or "")
    if column.quantity is None or sensor not in units:
        return column
    # rank: a unit that the user gives needs no proof by the size of the numbers
    return replace(column, unit=_unit(units[sensor], column.quantity), rank=-1, unknown_unit=None)


def _unit(text: str, quantity: str) -> str:
    """Return a unit of a quantity; raise `OptionError` if it is none."""
    unit = unit_of(text, quantity)
    if unit is None:
        nouns = {"t": "time", "gyro": "rate", "accel": "acceleration"}
        message = f"{text!r} is no unit of {nouns.get(quantity, quantity)}"
        raise OptionError("unknown_unit", message, f"use one of {', '.join(UNITS[quantity])}")
    return unit
