"""Rows: the published form of the history, one object per channel and period, as JSON and CSV."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from typing import Any

from imumon.history.schema import ESTIMATE_COLUMNS
from imumon.history.selection import Selection
from imumon.history.store import TimedPeriod
from imumon.model.coefficients import Estimate
from imumon.model.history_report import STEPS
from imumon.model.report import stamp
from imumon.model.samples import UNITS

DIGITS = 7
"""Significant digits of a number in a row; the limits of N are wider."""

_STEP_NAMES = {seconds: name for name, seconds in STEPS.items()}
_LIMITS = ("value", "low", "high", "status")


def rows(timed: TimedPeriod, device: str, selected: Selection | None = None) -> Iterator[dict[str, Any]]:
    """Yield the rows of one period, of the channels of a selection."""
    period = timed.period
    common = {
        "samples": period.samples,
        "missing": period.missing,
        "excluded_s": _rounded(period.excluded_s),
        "temperature": _rounded(period.temperature),
        "warming_up": period.warming_up,
        "complete": period.complete,
    }
    for name, channel in period.channels.items():
        if selected is not None and not selected.wants(name):
            continue
        yield {
            "time": iso(timed.begin),
            "end": iso(timed.end),
            "device": device,
            "channel": str(name),
            "step": _STEP_NAMES[period.step_s],
            "unit": UNITS.get(name.sensor, ""),
            **{letter: _limits(channel.coefficients.get(letter)) for letter in ESTIMATE_COLUMNS},
            "mean": _rounded(channel.mean),
            "std": _rounded(channel.std),
            "grade": period.grades.get(name.sensor),
            **common,
        }


def json_pieces(objects: Iterable[dict[str, Any]]) -> Iterator[str]:
    """Yield a JSON array in pieces, one object per line; other threads may run between two of them."""
    separator = "["
    for row in objects:
        yield separator + json.dumps(row, separators=(",", ":"), allow_nan=False)
        separator = ",\n"
    yield "[]" if separator == "[" else "]"


def csv_pieces(objects: Iterable[dict[str, Any]]) -> Iterator[str]:
    """Yield CSV line by line, one column per number: ``N``, ``N_low``, ``N_high``, ``N_status`` and so on."""
    writer: csv.DictWriter[str] | None = None
    for row in objects:
        flat: dict[str, Any] = {}
        for name, value in row.items():
            if name in ESTIMATE_COLUMNS:
                parts = value or dict.fromkeys(_LIMITS)
                flat |= {name if part == "value" else f"{name}_{part}": parts[part] for part in _LIMITS}
            else:
                flat[name] = value
        out = io.StringIO()
        if writer is None:
            csv.DictWriter(out, flat, lineterminator="\n").writeheader()
        writer = csv.DictWriter(out, flat, lineterminator="\n")
        writer.writerow(flat)
        yield out.getvalue()


def iso(time: float) -> str:
    """Return a time, s since 1970, in ISO 8601.

    >>> iso(0.0)
    '1970-01-01T00:00:00.000Z'
    """
    return stamp(datetime.fromtimestamp(time, UTC))


def _limits(part: Estimate | None) -> dict[str, Any] | None:
    if part is None:
        return None
    return {
        "value": _rounded(part.value),
        "low": _rounded(part.low),
        "high": _rounded(part.high),
        "status": part.status,
    }


def _rounded(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.{DIGITS}g}")
