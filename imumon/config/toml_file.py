"""Settings file: its text, the line of each setting, its faults, and the TOML text of values."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date, time
from pathlib import Path
from typing import Any

from imumon.files import SMALL_BYTES, read_at_most
from imumon.model.errors import ImumonError
from imumon.model.report_json import plain
from imumon.model.system_errors import cure_of_reading


@dataclass(frozen=True, slots=True)
class ConfigFault:
    """One fault of a file or of the command line.

    Attributes
    ----------
    code : ``file_unreadable``, ``not_utf8``, ``not_toml``, ``unknown_section``, ``unknown_setting``,
        ``not_a_section``, ``invalid_value`` or ``contradiction``.
    place : ``config.toml:12``, ``config.toml`` or ``command line``.
    setting : dotted name, empty for a fault of the whole file.
    message, cure : what is wrong, and what to do.
    """

    code: str
    place: str
    setting: str
    message: str
    cure: str

    def __str__(self) -> str:
        text = ": ".join(filter(None, (self.place, self.setting, self.message)))
        return plain(f"{text}; {self.cure}")


class ConfigError(ImumonError):
    """The settings have faults.

    Attributes
    ----------
    faults : all of them, in the order of the file.
    """

    def __init__(self, *faults: ConfigFault) -> None:
        super().__init__("invalid_settings", "\n".join(map(str, faults)))
        self.faults = faults


def read_text(path: Path) -> str:
    """Return the text of a file or a pipe; raise `ConfigError` if it cannot be read."""
    try:
        with path.open("rb") as file:
            return read_at_most(file, SMALL_BYTES).decode("utf-8-sig").replace("\r\n", "\n")
    except OSError as error:
        cure = cure_of_reading(error)
        fault = ConfigFault(
            "file_unreadable", str(path), "", f"cannot be read: {error.strerror or error}", cure
        )
    except UnicodeDecodeError as error:
        message = f"is not UTF-8 text (byte {error.start})"
        fault = ConfigFault("not_utf8", str(path), "", message, "save it as UTF-8")
    raise ConfigError(fault)


def parse(text: str, file: str) -> dict[str, Any]:
    """Return the values of a TOML text; raise `ConfigError` if it is not TOML."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # the text has the line
        cure = 'write name = value on each line, with text in "quotes"'
        raise ConfigError(ConfigFault("not_toml", file, "", f"not TOML: {error}", cure)) from None


def tables(path: Path) -> set[str]:
    """Return the top-level tables of a file, also of one that is not TOML; raise OSError if it cannot be read.

    Only the first `SMALL_BYTES` count: the file may belong to another program, and be anything.
    """
    with path.open("rb") as file:
        text = file.read(SMALL_BYTES).decode("utf-8-sig", "replace").replace("\r\n", "\n")
    try:
        return {name for name, value in parse(text, str(path)).items() if isinstance(value, dict)}
    except ConfigError:
        headers = re.findall(r"^[ \t]*\[([^\[\]\n]{1,99})\]", text, re.MULTILINE)
        return {_unquoted(header).partition(".")[0] for header in headers}


def line_numbers(text: str) -> dict[str, int]:
    """Return the line of each section and setting by its dotted name, as far as single lines show it."""
    lines: dict[str, int] = {}
    table = ""
    name = r"(?:[\w-]+|\"[^\"]*\"|'[^']*')"
    for number, line in enumerate(text.splitlines(), 1):
        if header := re.match(r"\s*\[([^\[\]]+)\]", line):
            table = _unquoted(header[1])
            full = table
        elif key := re.match(rf"\s*({name}(?:\s*\.\s*{name})*)\s*=", line):
            full = f"{table}.{_unquoted(key[1])}".lstrip(".")
        else:
            continue
        while full:
            lines.setdefault(full, number)
            full = full.rpartition(".")[0]
    return lines


def _unquoted(key: str) -> str:
    return ".".join(part.strip().strip("\"'") for part in key.split("."))


@dataclass
class Places:
    """Place of each setting: a line of the file, or the command line."""

    file: str
    known: dict[str, str]

    def of(self, name: str) -> str:
        """Return the place of a setting, or of the nearest thing around it that has one."""
        while name and name not in self.known:
            name = name.rpartition(".")[0]
        return self.known.get(name, self.file)

    def order(self, fault: ConfigFault) -> tuple[bool, int, str]:
        """Return the sort key of a fault: by line of the file, then the command line."""
        head, _, line = fault.place.rpartition(":")
        in_file = head == self.file and line.isdigit()
        return (not in_file, int(line) if in_file else 0, str(fault))


def toml_text(value: Any) -> str:
    """Return the TOML text of a value.

    >>> toml_text(("a", True, 0.5)), toml_text({"x/y": 1})
    ('["a", true, 0.5]', '{ "x/y" = 1 }')
    """
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return '"' + re.sub(r"[\x00-\x1f\x7f]", lambda m: f"\\u{ord(m[0]):04x}", escaped) + '"'
    if isinstance(value, Mapping):
        inner = ", ".join(f"{toml_text(str(key))} = {toml_text(item)}" for key, item in value.items())
        return f"{{ {inner} }}" if inner else "{}"
    if isinstance(value, tuple | list):
        return "[" + ", ".join(toml_text(item) for item in value) + "]"
    return value.isoformat() if isinstance(value, date | time) else repr(value)
