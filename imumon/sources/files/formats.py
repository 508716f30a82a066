"""Formats: what is known of the tables of single programs that neither names nor physics show.

`formats.toml` has a few of them; a user adds others in ``formats.toml`` in the directory of the settings. What a format
states is certain, as if it stood in the table.
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from imumon.model.errors import why
from imumon.sources.files.base import OptionError

FILE = "formats.toml"


@dataclass(frozen=True, slots=True)
class Format:
    """One format; see the head of ``formats.toml``."""

    name: str
    text: str = ""
    names: str = ""
    type: str = ""
    columns: Sequence[str] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    map: str = ""

    def filled_map(self, text: str) -> str:
        """Return the map with the numbers that stand beside its words in a text."""

        def number(word: re.Match[str]) -> str:
            match = re.search(rf"^\W*{re.escape(word[1])}\W+([-+.\deE]+)", text, re.MULTILINE)
            return match[1] if match else word[1].upper()

        return re.sub(r"\{(\w+)\}", number, self.map)


def user_file() -> Path:
    """Return where a user has formats."""
    return Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config", "imumon", FILE)


@cache
def formats() -> tuple[Format, ...]:
    """Return all formats, those of the user first.

    Raises
    ------
    OptionError : the file of the user has none.
    """
    result: list[Format] = []
    for path in (user_file(), Path(__file__).with_name(FILE)):
        try:
            if path.exists():
                result += [Format(**entry) for entry in tomllib.loads(path.read_text("utf-8"))["format"]]
        except (OSError, ValueError, TypeError, KeyError) as error:
            cure = "write [[format]] with name, text, names, type, columns, units and map"
            raise OptionError("formats_invalid", f"{path}: {why(error)}", cure) from None
    return tuple(result)


def known_format(text: str = "", names: Sequence[str] = (), type_name: str = "") -> Format | None:
    """Return the format of a table by its text and names, or of messages by their type; None: it is not known."""
    joined = ",".join(name.strip() for name in names)
    for each in formats():
        given = ((each.text, text), (each.names, joined), (each.type, type_name))
        if all(re.search(pattern, where) for pattern, where in given if pattern):
            return each
    return None
