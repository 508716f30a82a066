"""Header of a raw capture: one line of JSON in front of the bytes, read defensively.

Any program may have written it: a field that has not the form that `CaptureWriter` gives it is ignored.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any

from imumon.report import plain, stamp

MAX_CHARACTERS = 200
"""Characters of a text that are kept. Not critical."""


def read_header(line: bytes) -> dict[str, Any] | None:
    """Return the fields of a header from its JSON; None if it is no JSON object.

    >>> read_header(b'{"serial": "7", "rate_hz": Infinity, "caveats": [{}], "part": 0}')
    {'serial': '7', 'part': 0}
    """
    try:
        found = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(found, dict):
        return None
    read = {name: checked(found[name]) for name, checked in _FIELDS.items() if name in found}
    return {name: value for name, value in read.items() if value is not None}


def _text(value: Any) -> str | None:
    return plain(value)[:MAX_CHARACTERS] if isinstance(value, str) else None


def _path(value: Any) -> str | None:
    return value if isinstance(value, str) and "\0" not in value else None


def _count(value: Any) -> int | None:
    return value if type(value) is int and value >= 0 else None


def _number(low: float, high: float) -> Callable[[Any], float | None]:
    return lambda v: float(v) if type(v) in (int, float) and low <= v <= high else None


def _time(value: Any) -> str | None:
    try:
        time = datetime.fromisoformat(value)
        return stamp(time if time.tzinfo else time.replace(tzinfo=UTC))
    except (TypeError, ValueError, OverflowError):
        return None


def _texts(value: Any) -> list[str] | None:
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        return None
    return [plain(item)[:MAX_CHARACTERS] for item in value]


def _text_by_name(value: Any) -> dict[str, str] | None:
    if not isinstance(value, Mapping) or not all(isinstance(item, str) for item in value.values()):
        return None
    return {plain(key)[:MAX_CHARACTERS]: plain(item)[:MAX_CHARACTERS] for key, item in value.items()}


_FIELDS: Mapping[str, Callable[[Any], Any]] = {
    "time": _time,
    "driver": _text,
    "id": _text,
    "model": _text,
    "serial": _text,
    "firmware": _text,
    "stream": _text,
    "rate_hz": _number(1e-4, 1e5),
    "alias_factor": _number(1e-3, 1e3),
    "caveats": _texts,
    "settings": _text_by_name,
    "away_s": _number(0.0, 1e10),
    "run": _path,
    "record": _text,
    "part": _count,
    "base": _path,
}
"""Check of each field that is read: the value, or None if it has not the right form."""
