"""Header of a raw capture: one line of JSON in front of the bytes, read defensively.

Any program may have written it: a field that does not have the form that `CaptureWriter` gives it is ignored.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any

from imumon.report import MOST_CHARACTERS, plain, stamp


def read_header(line: bytes) -> dict[str, Any] | None:
    """Return the fields of a header from its JSON; None if it is no JSON object.

    >>> read_header(b'{"serial": "7", "rate_hz": Infinity, "caveats": [{}], "part": 0}')
    {'serial': '7', 'part': 0}
    """
    try:
        fields = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(fields, dict):
        return None
    checked = {name: check(fields[name]) for name, check in _FIELDS.items() if name in fields}
    return {name: value for name, value in checked.items() if value is not None}


def _text(value: Any) -> str | None:
    return plain(value)[:MOST_CHARACTERS] if isinstance(value, str) else None


def _name(value: Any) -> str | None:
    """Return the name of a file; a path would lead out of the directory of the recording."""
    return value if isinstance(value, str) and not re.search(r"[\0/]", value) else None


def _count(value: Any) -> int | None:
    return value if type(value) is int and 0 <= value < 1e9 else None


def _number(low: float, high: float) -> Callable[[Any], float | None]:
    return lambda v: float(v) if type(v) in (int, float) and low <= v <= high else None


def _time(value: Any) -> str | None:
    try:
        time = datetime.fromisoformat(value)
        return stamp(time if time.tzinfo else time.replace(tzinfo=UTC))
    except (TypeError, ValueError, OverflowError):
        return None


def _texts(value: Any) -> list[str] | None:
    texts = [_text(item) for item in value] if isinstance(value, list) else [None]
    return None if None in texts else [text for text in texts if text is not None]


def _text_by_name(value: Any) -> dict[str, str] | None:
    texts = _texts([*value.keys(), *value.values()]) if isinstance(value, dict) else None
    return None if texts is None else dict(zip(texts[: len(value)], texts[len(value) :], strict=True))


_FIELDS: Mapping[str, Callable[[Any], Any]] = {
    **dict.fromkeys(("driver", "id", "model", "serial", "firmware", "stream", "record"), _text),
    "time": _time,
    "rate_hz": _number(1e-4, 1e5),
    "alias_factor": _number(1e-3, 1e3),
    "caveats": _texts,
    "settings": _text_by_name,
    "away_s": _number(0.0, 1e10),
    "run": _text,
    "part": _count,
    "base": _name,
}
"""Check of each field that is read: the value, or None if it does not have the right form."""
