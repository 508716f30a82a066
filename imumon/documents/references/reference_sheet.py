"""Reference sheet: the limits of one sensor in a TOML file, with their source.

The file holds what a data sheet prints, in its units. Quantities: N, B, K; `floor`, the lowest Allan deviation
(in-run bias stability), which is sqrt(2 ln 2 / pi) = 0.664 times B; `density`, the one-sided noise density, which
is sqrt(2) times N for makers that define it by the noise in a bandwidth. A limit holds for a sensor (all its
axes) or for single channels. docs/REPORTS.md describes the format.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from imumon.files import SMALL_BYTES, open_regular
from imumon.model.coefficients import COEFFICIENTS, MG
from imumon.model.cures import option_text
from imumon.model.errors import ImumonError, why
from imumon.model.report_json import check, plain
from imumon.model.samples import AXES, sensor_of
from imumon.model.system_errors import cure_of_reading
from imumon.model.units import DEG, FLICKER, HOUR

SENSORS = ("gyro", "accel", "mag")
BASES = ("maximum", "typical")
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
    channels : channels that it holds for, such as gyro/x.
    quantity : one of `QUANTITIES`.
    at_most : in `unit`.
    basis : ``maximum``, or ``typical``: about half of the devices exceed a typical value.
    sampled_hz : Hz, rate at which the device reads this quantity, unfiltered: slower streams alias; None: unknown.
    """

    channels: tuple[str, ...]
    quantity: str
    at_most: float
    unit: str
    basis: str
    sampled_hz: float | None = None


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
        if len(data) > SMALL_BYTES:
            raise ValueError(f"more than {SMALL_BYTES} bytes")
        return _sheet(tomllib.loads(data.decode()))
    except (ValueError, TypeError, KeyError) as error:  # TOMLDecodeError and UnicodeDecodeError too
        text = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else plain(f"{error}")
        raise SheetError("datasheet_invalid", f"{path} is no reference sheet: {text}", cure) from None


def _sheet(fields: Mapping[str, Any]) -> ReferenceSheet:
    """Return the sheet of the fields of a file; raise `ValueError` if they are not those of one."""
    known = {"title", "document", "edition", "source", "note", "models", "limit"}
    unknown = set(fields) - known
    check(not unknown, f"unknown field {_listed(unknown)}")
    title, document = (_text(fields, name, required=True) or "" for name in ("title", "document"))
    texts = {name: _text(fields, name) for name in ("edition", "source", "note")}
    models = fields.get("models", [])
    texts_only = isinstance(models, list) and all(isinstance(model, str) and model for model in models)
    check(texts_only, "models is not a list of texts")
    limits = fields.get("limit", [])
    check(isinstance(limits, list) and bool(limits), "it has no [[limit]]")
    return ReferenceSheet(
        title=title,
        document=document,
        models=tuple(models),
        limits=tuple(_limit(limit, k) for k, limit in enumerate(limits, 1)),
        **texts,
    )


def _text(fields: Mapping[str, Any], name: str, *, required: bool = False) -> str | None:
    value = fields[name] if required else fields.get(name)
    if value is not None and not isinstance(value, str):
        raise ValueError(f"{name} is not a text")
    return None if value is None else plain(" ".join(value.split()))


def _limit(fields: Any, number: int) -> Limit:
    """Return the limit of a table; `number` counts from 1, for the message of an error."""
    where = f"limit {number}"
    check(isinstance(fields, dict), f"{where} is not a table")
    unknown = set(fields) - {"channels", "quantity", "at_most", "unit", "basis", "sampled_hz"}
    check(not unknown, f"{where}: unknown field {_listed(unknown)}")
    channels, quantity, basis = fields["channels"], fields["quantity"], fields.get("basis", "maximum")
    check(isinstance(channels, list) and bool(channels), f"{where}: channels is not a list")
    names = [name for entry in channels for name in _channels(entry, where)]
    check(quantity in QUANTITIES, f"{where}: quantity is not one of {', '.join(QUANTITIES)}")
    value, sampled = fields["at_most"], fields.get("sampled_hz")
    check(_is_positive(value), f"{where}: at_most is not a positive number")
    check(sampled is None or _is_positive(sampled), f"{where}: sampled_hz is not a rate")
    check(basis in BASES, f"{where}: basis is not one of {', '.join(BASES)}")
    for sensor in {sensor_of(name) for name in names}:
        units = UNITS[sensor, QUANTITIES[quantity][0]]
        text = f"{where}: unit of {quantity} of {sensor} is not one of {', '.join(units)}"
        check(fields["unit"] in units, text)
    return Limit(
        channels=tuple(dict.fromkeys(names)),
        quantity=quantity,
        at_most=float(value),
        unit=fields["unit"],
        basis=basis,
        sampled_hz=sampled,
    )


def _listed(names: Iterable[Any]) -> str:
    return ", ".join(sorted(map(repr, names)))


def _is_positive(value: Any) -> bool:
    return type(value) in (int, float) and 0.0 < value < 1e12


def _channels(name: Any, where: str) -> list[str]:
    """Return the channels of a name: all axes of a sensor, or one."""
    sensor, slash, axis = name.partition("/") if isinstance(name, str) else ("", "", "")
    if sensor not in SENSORS or (slash and axis not in AXES):
        raise ValueError(f"{where}: {name!r} is no channel; write gyro, accel, mag, or gyro/x")
    return [name] if slash else [f"{sensor}/{axis}" for axis in AXES]
