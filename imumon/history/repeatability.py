"""Repeatability of N, B and K: how much the days of the history scatter, from the published rows.

The days that count are those of `day_changes`.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from imumon.model.coefficients import COEFFICIENTS, LIMIT_95, Estimate
from imumon.model.history_report import LEAST_DAYS, DayScatter, HistoryRow
from imumon.model.units import DAY, HOUR


def day_scatter(rows: Iterable[HistoryRow]) -> dict[str, dict[str, DayScatter]]:
    """Return the scatter of the days, by channel and letter, where there are enough days.

    Parameters
    ----------
    rows : of the history, of any step; only days count.
    """
    known: dict[str, dict[str, list[tuple[float, float]]]] = {}
    for row in rows:
        letters = known.setdefault(row.channel, {letter: [] for letter in COEFFICIENTS})
        for letter in COEFFICIENTS if _counts(row) else ():
            if (measured := _measured(row.coefficients.get(letter))) is not None:
                letters[letter].append(measured)
    return {
        name: {letter: _scatter(values) for letter, values in letters.items() if len(values) >= LEAST_DAYS}
        for name, letters in known.items()
    }


def _scatter(measured: list[tuple[float, float]]) -> DayScatter:
    values, errors = np.array(measured).T
    return DayScatter(
        days=len(measured),
        std=float(np.std(values, ddof=1)),
        statistics=float(np.sqrt(np.mean(errors**2))),
    )


def _counts(row: HistoryRow) -> bool:
    """Return whether a row is a day that is over, without the warm-up, with enough samples."""
    if row.step != "1d" or not row.complete or row.warming_up or not row.samples:
        return False
    return min(row.length_s, DAY) * row.samples / (row.samples + row.missing) >= HOUR


def _measured(part: Estimate | None) -> tuple[float, float] | None:
    """Return a measured value and its standard error; None if it is bounded, pending or no coefficient."""
    if part is None or part.status != "measured" or not part.value or part.low is None or part.high is None:
        return None
    return part.value, (part.high - part.low) / (2.0 * LIMIT_95)
