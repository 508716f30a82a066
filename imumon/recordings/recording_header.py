"""Header: what a recording says of itself, as far as it can be believed.

It is one line of JSON in front of the bytes, and anybody may have written it: what has not the form that
`imumon.recordings.raw_capture.CaptureWriter` gives it counts as not said.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any

from imumon.report import plain, stamp

LONGEST = 200
"""Characters of a text that are kept."""


def read_header(line: bytes) -> dict[str, Any] | None:
    """Header of its JSON; None when it is none.

    >>> read_header(b'{"serial": "7", "rate_hz": Infinity, "caveats": [{}], "part": 0}')
    {'serial': '7', 'part': 0}
    """
    try:
        found = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(found, dict):
        return None
    read = {name: take(found[name]) for name, take in _TAKEN.items() if name in found}
    return {name: value for name, value in read.items() if value is not None}


def _text(value: Any) -> str | None:
    return plain(value)[:LONGEST] if isinstance(value, str) else None


def _path(value: Any) -> str | None:
    return value if isinstance(value, str) and "\0" not in value else None


def _count(value: Any) -> int | None:
    return value if type(value) is int and value >= 0 else None


def _number(least: float, greatest: float) -> Callable[[Any], float | None]:
    return lambda v: float(v) if type(v) in (int, float) and least <= v <= greatest else None


def _moment(value: Any) -> str | None:
    try:
        moment = datetime.fromisoformat(value)
        return stamp(moment if moment.tzinfo else moment.replace(tzinfo=UTC))
    except (TypeError, ValueError, OverflowError):
        return None


def _texts(value: Any) -> list[str] | None:
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        return None
    return [plain(item)[:LONGEST] for item in value]


def _named(value: Any) -> dict[str, str] | None:
    if not isinstance(value, Mapping) or not all(isinstance(item, str) for item in value.values()):
        return None
    return {plain(key)[:LONGEST]: plain(item)[:LONGEST] for key, item in value.items()}


_TAKEN: Mapping[str, Callable[[Any], Any]] = {
    "time": _moment,
    "id": _text,
    "model": _text,
    "serial": _text,
    "firmware": _text,
    "stream": _text,
    "rate_hz": _number(1e-4, 1e5),
    "alias_factor": _number(1e-3, 1e3),
    "caveats": _texts,
    "settings": _named,
    "away_s": _number(0.0, 1e10),
    "run": _path,
    "record": _text,
    "part": _count,
    "base": _path,
}
