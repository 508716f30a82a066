"""Repeatability of N, B and K: how much the days of the history scatter, from the published rows.

The rows are those of a running daemon or of the file, so what they contain is checked: a row that is none, or that
belongs to a day that does not count, is left out. The days that count are those of `day_changes`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from datetime import datetime
from typing import Any

import numpy as np

from imumon.coefficients import LIMIT_95
from imumon.history_report import LEAST_DAYS, DayScatter
from imumon.report import COEFFICIENTS, MAX_NUMBER
from imumon.units import DAY, HOUR


def day_scatter(rows: Iterable[Mapping[str, Any]]) -> dict[str, dict[str, DayScatter]]:
    """Return the scatter of the days, by channel and letter; empty without rows.

    Parameters
    ----------
    rows : of the history, of any step; only days count.
    """
    known: dict[str, dict[str, list[tuple[float, float]]]] = {}
    for row in rows:
        name = row.get("channel")
        if not isinstance(name, str):
            continue
        letters = known.setdefault(name, {letter: [] for letter in COEFFICIENTS})
        for letter in COEFFICIENTS if _counts(row) else ():
            if (measured := _measured(row.get(letter))) is not None:
                letters[letter].append(measured)
    return {
        name: {letter: _scatter(values) for letter, values in letters.items()}
        for name, letters in known.items()
    }


def _scatter(measured: list[tuple[float, float]]) -> DayScatter:
    if len(measured) < LEAST_DAYS:
        return DayScatter(days=len(measured), needed=LEAST_DAYS, std=None, statistics=None)
    values, errors = np.array(measured).T
    return DayScatter(
        days=len(measured),
        needed=LEAST_DAYS,
        std=float(np.std(values, ddof=1)),
        statistics=float(np.sqrt(np.mean(errors**2))),
    )


def _counts(row: Mapping[str, Any]) -> bool:
    """Return whether a row is a day that is over, without the warm-up, with enough samples."""
    if row.get("step") != "1d" or row.get("complete") is not True or row.get("warming_up") is not False:
        return False
    samples, missing = row.get("samples"), row.get("missing")
    if not isinstance(samples, int) or not isinstance(missing, int) or samples < 1 or missing < 0:
        return False
    try:
        length = datetime.fromisoformat(str(row.get("end"))) - datetime.fromisoformat(str(row.get("time")))
    except (ValueError, TypeError):
        return False
    return min(length.total_seconds(), DAY) * samples / (samples + missing) >= HOUR


def _measured(part: Any) -> tuple[float, float] | None:
    """Return a measured value and its standard error; None if it is bounded, pending or no coefficient."""
    if not isinstance(part, Mapping) or part.get("status") != "measured":
        return None
    numbers: list[Any] = [part.get(key) for key in ("value", "low", "high")]
    if not all(type(each) in (int, float) and 0.0 <= each < MAX_NUMBER for each in numbers):
        return None
    value, low, high = numbers
    fits = value > 0.0 and low <= value <= high
    return (float(value), (high - low) / (2.0 * LIMIT_95)) if fits else None
