"""Loading of the settings: a TOML file and the options of the command line become one checked tree.

All faults of a file are reported at once, each with its line, what is allowed and the nearest valid name, and
`Settings.origins` keeps where each value comes from.
"""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal, cast, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt, MaxLen
from pydantic import ValidationError

from imumon.config.settings import (
    NAMES,
    SECTIONS,
    DeviceSettings,
    Settings,
    ZenohSettings,
)
from imumon.config.toml_file import (
    ConfigError,
    ConfigFault,
    Places,
    line_numbers,
    parse,
    read_text,
    tables,
    toml_text,
)
from imumon.model.errors import QUOTED
from imumon.model.samples import FASTEST_HZ, SLOWEST_HZ


def search() -> tuple[Path | None, Path | None]:
    """Return the first settings file there is, and the ``./config.toml`` of another program that was ignored.

    The files are ./config.toml, $XDG_CONFIG_HOME/imumon/config.toml and /etc/imumon/config.toml. The first
    counts only if it has a section of imumon, for many programs use this name.
    """
    local, ignored = Path("config.toml"), None
    if local.is_file():
        try:
            if tables(local) & SECTIONS.keys():
                return local, None
            ignored = local
        except OSError:
            return local, None  # `load` reports why it is unreadable
    # expanduser, unlike Path.home(), accepts a user without a home directory, as a service may run as one
    home = Path(os.environ.get("XDG_CONFIG_HOME") or os.path.expanduser("~/.config"))
    others = (home / "imumon" / "config.toml", Path("/etc/imumon/config.toml"))
    return next((path for path in others if path.is_file()), None), ignored


def load(path: Path | str | None = None, overrides: Mapping[str, Any] | None = None) -> Settings:
    """Return the settings of a file with values of the command line on top, or raise all faults.

    Parameters
    ----------
    path : file to read; None: the one that `search` finds, if any.
    overrides : dotted name to value, such as ``{"device.baud": 115200}``; None values are ignored.
    """
    given = {name: value for name, value in (overrides or {}).items() if value is not None}
    file, ignored = search() if path is None else (Path(path), None)
    text = "" if file is None else read_text(file)
    values = parse(text, str(file))
    places = Places(str(file), {name: f"{file}:{line}" for name, line in line_numbers(text).items()})
    for name, value in given.items():
        section, _, setting = name.partition(".")
        if isinstance(table := values.setdefault(section, {}), dict):
            table[setting] = value
        places.known[name] = "command line"
    sections = _checked_sections(values, places)
    present = {f"{section}.{name}" for section, table in values.items() for name in table}
    origins = {name: places.of(name) if name in present else "default" for name in NAMES}
    return Settings(**cast(Any, sections), path=file, ignored=ignored, origins=origins)


def _checked_sections(values: Mapping[str, Any], places: Places) -> dict[str, Any]:
    """Return the sections of the settings, or raise all faults."""
    sections: dict[str, Any] = {}
    faults: list[ConfigFault] = []
    for section, table in values.items():
        try:
            sections[section] = _check_section(section, table, places)
        except ConfigError as error:
            faults += error.faults
    faults += _contradictions(sections, places)
    if faults:
        raise ConfigError(*sorted(faults, key=places.order))
    return sections


def origin_lines(settings: Settings) -> list[str]:
    """Return a line of TOML for each setting, with its origin as a comment; a password is not shown."""
    lines = []
    for full in NAMES:
        section, _, name = full.partition(".")
        value = getattr(getattr(settings, section), name)
        shown = "********" if value and name == "password" else value
        lines.append(f"{full} = {toml_text(shown)}  # {settings.origins.get(full, 'default')}")
    return lines


def _check_section(section: str, table: Any, places: Places) -> Any:
    """Return the checked section; raise `ConfigError` with all its faults."""
    if section not in SECTIONS:
        raise ConfigError(_unknown(section, isinstance(table, dict), places))
    if not isinstance(table, dict):
        message, cure = "is a section, not a value", f"write [{section}] on a line of its own"
        raise ConfigError(ConfigFault("not_a_section", places.of(section), section, message, cure))
    cls = SECTIONS[section]
    try:
        return cls(**table)
    except ValidationError as error:
        # a list has a fault for each of its items: the first is enough
        first = {str(detail["loc"][0]): detail for detail in reversed(error.errors())}
        faults = [_fault(section, name, detail, table, places) for name, detail in first.items()]
        raise ConfigError(*faults) from None


def _fault(section: str, name: str, detail: Any, table: Mapping[str, Any], places: Places) -> ConfigFault:
    """Return pydantic's error of a setting as a fault."""
    full = f"{section}.{name}"
    if detail["type"] == "unexpected_keyword_argument":
        return _unknown(full, False, places)
    value = toml_text(_value_at(table, detail["loc"]))
    shown = value if len(value) <= QUOTED else value[: QUOTED - 3] + "..."
    cure = f"give {_allowed(detail, SECTIONS[section].__pydantic_fields__[name])}"
    return ConfigFault("invalid_value", places.of(full), full, f"{shown} is not valid", cure)


_NAMES_CURE = "imumon config show prints all of them"


def _unknown(name: str, is_section: bool, places: Places) -> ConfigFault:
    """Return the fault of an unknown name, with the nearest valid one."""
    place = places.of(name)
    if is_section:
        near = difflib.get_close_matches(name, SECTIONS, n=1)
        cure = f"did you mean [{near[0]}]?" if near else _NAMES_CURE
        return ConfigFault("unknown_section", place, f"[{name}]", "no such section", cure)
    section, _, setting = name.rpartition(".")
    everywhere = {full.partition(".")[2]: full for full in reversed(NAMES)}
    here = {full.partition(".")[2]: full for full in NAMES if full.startswith(f"{section}.")}
    candidates = here or everywhere
    near = difflib.get_close_matches(setting, candidates, n=1)
    right = everywhere.get(setting) or (candidates[near[0]] if near else None)
    cure = f"did you mean {right}?" if right else _NAMES_CURE
    return ConfigFault("unknown_setting", place, name, "no such setting", cure)


def _value_at(table: Any, path: Iterable[Any]) -> Any:
    """Return the value at a path of a section, or the nearest one around it."""
    with suppress(KeyError, IndexError, TypeError):
        for step in path:
            table = table[step]
    return table


_TYPES = {
    "string_type": "text in quotes",
    "bool_type": "true or false",
    "tuple_type": 'a list, such as ["..."]',
    "mapping_type": "a table",
    "dict_type": "a table",
}


def _allowed(detail: Any, info: Any) -> str:
    """Return what a setting may be."""
    if get_origin(info.annotation) is Literal:
        return "one of " + ", ".join(map(toml_text, get_args(info.annotation)))
    limits = {type(limit): limit for limit in info.metadata}
    if Ge in limits:
        return f"a number from {limits[Ge].ge:.9g} to {limits[Le].le:.9g}"
    if Gt in limits:
        return f'a number between {limits[Gt].gt:g} and {limits[Lt].lt:g}, or a text in percent, such as "5%"'
    if detail["type"] == "string_pattern_mismatch":
        return "HOST:PORT, such as 127.0.0.1:9847"
    if detail["type"] == "string_too_long":
        return f"at most {limits[MaxLen].max_length} characters"
    return _TYPES.get(detail["type"]) or str(detail["msg"]).lower()


_TOGETHER = (("user", "password"), ("password", "user"), ("certificate", "key"), ("key", "certificate"))
"""Settings of ``[zenoh]`` of which the first needs the second."""


def _contradictions(sections: Mapping[str, Any], places: Places) -> Iterator[ConfigFault]:
    """Yield the faults of settings that are valid alone but not together."""

    def fault(name: str, message: str, cure: str, code: str = "contradiction") -> ConfigFault:
        return ConfigFault(code, places.of(name), name, message, cure)

    zenoh = sections.get("zenoh", ZenohSettings())
    for name, other in _TOGETHER:
        if getattr(zenoh, name) and not getattr(zenoh, other):
            yield fault(f"zenoh.{name}", f"zenoh.{other} is missing", "set both or neither")
    device = sections.get("device", DeviceSettings())
    for name in ("set_baud", "set_rate_hz") if device.listen_only else ():
        if getattr(device, name):
            yield fault(f"device.{name}", "is not possible with device.listen_only", "remove one of the two")
    for name in ("rate_hz", "set_rate_hz"):
        if 0.0 < (rate := getattr(device, name)) < SLOWEST_HZ:
            cure = f"give 0, or a number from {SLOWEST_HZ:g} to {FASTEST_HZ:g}"
            yield fault(f"device.{name}", f"{rate:g} is not valid", cure, "invalid_value")
    if device.id and not re.search(r"[a-z0-9_]", device.id.lower()):
        message = f"{toml_text(device.id)} is not valid"
        yield fault("device.id", message, "use letters and digits, such as imu-1", "invalid_value")
