"""Cures: options in advice, as the parser of options reads them.

A cure that a user types must be one that the program takes. The names of the options are in one table, `OPTIONS`, from
which the parser adds them and from which messages print them; values are quoted as a shell needs it.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from typing import Any

OPTIONS = {"kind": "--stream", "columns": "--map", "rate_hz": "--rate", "topic": "--topic", "sensor": "--sensor",
           "where": "--where", "definitions": "--msg"}  # fmt: skip
"""Option of the command line by field of `ReadOptions`: the parser takes these names, and cures have them."""


def option_text(**fields: Any) -> str:
    """Return options as they are typed in a shell; the fields are those of `ReadOptions`.

    >>> option_text(columns={"gyro/x": "w x:deg/s"}, where={"sensor": "4"}, rate_hz=100.0)
    "--map 'gyro/x=w x:deg/s' --where sensor=4 --rate 100"
    """
    return " ".join(f"{OPTIONS[name]} {shlex.quote(_value_text(value))}" for name, value in fields.items())


def _value_text(value: Any) -> str:
    if isinstance(value, Mapping):
        return ",".join(f"{name}={text}" for name, text in value.items())
    return f"{value:g}" if isinstance(value, float) else str(value)
