"""Reference sheet: the limits of one sensor in a TOML file, with their source.

The file holds what a data sheet prints, in its units. Quantities: N, B, K; `floor`, the lowest Allan deviation
(in-run bias stability), which is sqrt(2 ln 2 / pi) = 0.664 times B; `density`, the one-sided noise density, which
is sqrt(2) times N for makers that define it by the noise in a bandwidth. A limit holds for a sensor (all its
axes) or for single channels. docs/REPORTS.md describes the format.
"""

from __future__ import annotations

import itertools
import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Literal

from imumon.files import SMALL_BYTES, open_regular
from imumon.model.coefficients import COEFFICIENTS, MG
from imumon.model.cures import option_text
from imumon.model.errors import ImumonError, why
from imumon.model.report_json import JsonReader, check, plain
from imumon.model.samples import AXES, ChannelName
from imumon.model.system_errors import cure_of_reading
from imumon.model.units import DEG, FLICKER, HOUR

SENSORS = ("gyro", "accel", "mag")
QUANTITIES = {
    **{letter: (letter, 1.0) for letter in COEFFICIENTS},
    "density": ("N", math.sqrt(2.0)),
    "floor": ("B", FLICKER),
}
"""Coefficient of each quantity, and the factor from it."""

_OTHER_UNITS: Mapping[tuple[str, str], Mapping[str, float]] = {
    ("gyro", "N"): {"deg/s/sqrt(Hz)": DEG, "deg/h/sqrt(Hz)": DEG * HOUR},
    ("gyro", "B"): {"deg/s": DEG},
    ("accel", "N"): {"mg/sqrt(Hz)": MG, "ug/sqrt(Hz)": 1e3 * MG},
    ("accel", "B"): {"ug": 1e3 * MG},
    ("mag", "N"): {"uG/sqrt(Hz)": 1e6, "nT/sqrt(Hz)": 1e5},
    ("mag", "B"): {"nT": 1e5},
}
UNITS: Mapping[tuple[str, str], Mapping[str, float]] = {
    (sensor, letter): {unit.si: 1.0, unit.unit: unit.factor, **_OTHER_UNITS.get((sensor, letter), {})}
    for letter, row in COEFFICIENTS.items()
    for sensor, unit in row.units.items()
}
"""Factor from SI to each unit that a file may use, by sensor and coefficient."""


class SheetError(ImumonError):
    """The file is no reference sheet, or not of this device."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limit:
    """A limit of one quantity.

    Attributes
    ----------
    channels : that it holds for, such as gyro/x, or sensors.
    quantity : one of `QUANTITIES`.
    at_most : in `unit`.
    basis : ``maximum``, or ``typical``: about half of the devices exceed a typical value.
    sampled_hz : Hz, rate at which the device reads this quantity, unfiltered: slower streams alias; None: unknown.
    """

    channels: tuple[ChannelName, ...]
    quantity: str
    at_most: float
    unit: str
    basis: Literal["maximum", "typical"] = "maximum"
    sampled_hz: float | None = None

    @property
    def axes(self) -> list[ChannelName]:
        """Channels that it holds for; a sensor has all its axes."""
        names = [
            [name] if name.axis else [ChannelName(f"{name}/{axis}") for axis in AXES]
            for name in self.channels
        ]
        return list(dict.fromkeys(itertools.chain(*names)))


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceSheet:
    """Limits of a device, and where they come from.

    Attributes
    ----------
    models : beginnings of the model that a device reports; empty: of any device.
    """

    title: str
    document: str
    edition: str | None = None
    source: str | None = None
    note: str | None = None
    models: tuple[str, ...] = ()
    limits: tuple[Limit, ...] = ()

    def is_of(self, model: str) -> bool:
        """Return whether a model is of this device."""
        return any(model.startswith(begin) for begin in self.models)


def read_sheet(path: Path | str) -> ReferenceSheet:
    """Read a file, or one of those that are published with imumon, by its name.

    Raises
    ------
    SheetError : it cannot be read, or is no reference sheet.
    """
    sheet = published().get(str(path).lower()) if not Path(path).exists() else None
    if sheet is not None:
        return sheet
    try:
        with open(open_regular(path, follow=True), "rb") as file:
            data = file.read(SMALL_BYTES + 1)
    except OSError as error:
        cure = f"{cure_of_reading(error)}, or name one of {', '.join(published())}"
        raise SheetError(
            "datasheet_unreadable", f"{option_text(datasheet=path)}: {why(error)}", cure
        ) from None
    return _parsed(data, str(path))


@cache
def published() -> Mapping[str, ReferenceSheet]:
    """Return the sheets that are part of imumon, by name."""
    files = sorted(Path(__file__).parent.glob("*.toml"))
    return {file.stem: _parsed(file.read_bytes(), file.name) for file in files}


def sheet_of_model(model: str | None) -> ReferenceSheet | None:
    """Return the published sheet of a model; None if it is unknown or has none."""
    return next((sheet for sheet in published().values() if model and sheet.is_of(model)), None)


def _parsed(data: bytes, path: str) -> ReferenceSheet:
    """Return the sheet in the bytes of a file; raise `SheetError` if it is none."""
    cure = "docs/REPORTS.md shows the format"
    try:
        check(len(data) <= SMALL_BYTES, f"more than {SMALL_BYTES} bytes")
        table = tomllib.loads(data.decode())
        limits = table.get("limit", [])
        for part, names in ((table, NAMES), *((limit, NAMES_OF_LIMIT) for limit in limits)):
            check(part.keys() <= names, f"unknown field {', '.join(sorted(map(repr, part.keys() - names)))}")
        one_line = {name: " ".join(text.split()) for name, text in table.items() if isinstance(text, str)}
        return _READER.part(ReferenceSheet, {**table, **one_line, "limits": limits})
    except (ValueError, TypeError, AttributeError) as error:  # TOMLDecodeError and UnicodeDecodeError too
        text = plain(f"{path} is no reference sheet: {error}")
        raise SheetError("datasheet_invalid", text, cure) from None


def _check_limit(limit: Limit) -> None:
    """Raise TypeError if a limit is none of a sensor."""
    check(limit.quantity in QUANTITIES, f"quantity is not one of {', '.join(QUANTITIES)}")
    check(limit.at_most > 0.0 and (limit.sampled_hz or 1.0) > 0.0, "at_most or sampled_hz is not positive")
    for name in limit.channels:
        known = name.sensor in SENSORS and name.axis in ("", *AXES)
        check(known, f"{name!r} is no channel; write gyro, accel, mag, or gyro/x")
        units = UNITS[name.sensor, QUANTITIES[limit.quantity][0]]
        check(
            limit.unit in units, f"unit of {limit.quantity} of {name.sensor} is not one of {', '.join(units)}"
        )


NAMES = {field.name for field in fields(ReferenceSheet)} - {"limits"} | {"limit"}
NAMES_OF_LIMIT = {field.name for field in fields(Limit)}
_READER = JsonReader(
    {Limit: _check_limit, ReferenceSheet: lambda sheet: check(bool(sheet.limits), "it has no [[limit]]")}
)
