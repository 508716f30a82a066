"""Cures: options in advice, as the caller types them.

A cure that a user types must be one that the program takes. The names of the options are in one table, `OPTIONS`, from
which the parser adds them and from which messages print them; values are quoted as a shell needs it. A program that
calls `imumon.analyse` has arguments instead, and reads these (`python_caller`).

>>> option_text(columns={"gyro/x": "w x:deg/s"}, where={"sensor": "4"}, rate_hz=100.0)
"--map 'gyro/x=w x:deg/s' --where sensor=4 --rate 100"
>>> with python_caller():
...     option_text(columns={"gyro/x": "w x:deg/s"}, where={"sensor": "4"}, rate_hz=100.0)
'columns={"gyro/x": "w x:deg/s"}, where={"sensor": "4"}, rate_hz=100'
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

OPTIONS = {"kind": "--stream", "columns": "--map", "rate_hz": "--rate", "topic": "--topic", "sensor": "--sensor",
           "where": "--where", "definitions": "--msg", "filter": "--filter", "datasheet": "--datasheet",
           "accept": "--accept"}  # fmt: skip
"""Option of the command line by field of `ReadOptions`, or name: the parser takes these, and cures have them."""

ARGUMENTS = {"kind": "stream", "definitions": "msg"}
"""Arguments of `imumon.analyse` that have another name than the field."""

_in_python = ContextVar("in_python", default=False)


@contextmanager
def python_caller() -> Iterator[None]:
    """Let messages name the arguments of a call in place of the options of a command."""
    token = _in_python.set(True)
    try:
        yield
    finally:
        _in_python.reset(token)


def option(field: str) -> str:
    """Return the name of an option, such as ``--rate``, or of the argument, ``rate_hz=``."""
    if field == "accept" and _in_python.get():
        return "accept=True"
    return f"{ARGUMENTS.get(field, field)}=" if _in_python.get() else OPTIONS.get(field, field)


def option_text(**fields: Any) -> str:
    """Return options with their values, by the names in `OPTIONS`."""
    if _in_python.get():
        return ", ".join(f"{option(field)}{_python_value(value)}" for field, value in fields.items())
    return " ".join(f"{option(field)} {shlex.quote(_shell_value(value))}" for field, value in fields.items())


def _shell_value(value: Any) -> str:
    if isinstance(value, Mapping):
        return ",".join(f"{name}={text}" if text else name for name, text in value.items())
    return f"{value:g}" if isinstance(value, float) else str(value)


def _python_value(value: Any) -> str:
    if isinstance(value, Mapping):
        parts = (f'"{name}": "{text}"' if text else name for name, text in value.items())
        return f"{{{', '.join(parts)}}}"
    return f"{value:g}" if isinstance(value, float) else f'"{value}"'
