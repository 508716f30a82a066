"""Period of the history: what a record showed in an hour or a day, as a message between packages.

The pipeline makes it, the daemon gives it the time of the host clock, the history stores it. A row of the published
history is one channel of one period (docs/HISTORY.md). Any program may publish rows, so what is no row is left out.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

from imumon.model.coefficients import BIAS_SLOPE, COEFFICIENTS, Estimate, GradeName
from imumon.model.report_json import JsonReader, check, entries
from imumon.model.samples import ChannelName

STEPS = {"1h": 3600, "1d": 86400}
"""s, lengths of the periods by name."""
LEAST_DAYS = 3
"""Days from which their scatter is given: two show a standard deviation only within a factor of 30."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PeriodChannel:
    """One channel in one period; temperature and pressure have no coefficients."""

    coefficients: Mapping[str, Estimate] = field(default_factory=dict)  # by letter, SI, of this period alone
    mean: float | None = None  # channel unit
    std: float | None = None  # channel unit, with n - 1


@dataclass(frozen=True, slots=True, kw_only=True)
class DayScatter:
    """How much one coefficient scatters between the days of the history."""

    days: int  # days of which it is measured
    std: float  # SI, standard deviation between the days, with n - 1
    statistics: float  # SI, root mean square of the standard errors of the days


@dataclass(frozen=True, slots=True, kw_only=True)
class HistoryPeriod:
    """What a record showed in one period of the sample clock.

    The counts of all periods of one length add up to those of the record: a period also counts what was missing or
    excluded since the one before.
    """

    step_s: int  # s, full length of such a period
    number: int  # periods of this length since the beginning of the record
    begin_age_s: float  # s of the sample clock from its beginning to the newest sample of the record
    end_age_s: float  # s of the sample clock from its end to the newest sample of the record
    complete: bool  # False: in progress
    samples: int  # received, excluded ones included
    missing: int  # samples that the sample clock proves and that did not arrive valid
    excluded_s: float  # s of received samples that the guards excluded
    temperature: float | None  # degC, mean; None: unknown
    warming_up: bool  # whether the sensor still warmed up at its end
    grades: Mapping[str, GradeName | None] = field(default_factory=dict)  # of the record at its end
    channels: Mapping[ChannelName, PeriodChannel] = field(default_factory=dict)  # by name


@dataclass(frozen=True, slots=True, kw_only=True)
class HistoryRow:
    """A row of the published history: one channel of one period."""

    channel: ChannelName
    time: str  # ISO 8601, of its beginning
    end: str  # ISO 8601
    step: str = ""  # one of `STEPS`
    coefficients: Mapping[str, Estimate] = field(  # by letter, SI, of this period alone
        default_factory=dict, metadata=entries((*COEFFICIENTS, BIAS_SLOPE))
    )
    mean: float | None = None  # channel unit
    temperature: float | None = None  # degC
    samples: int = 0
    missing: int = 0
    excluded_s: float = 0.0
    complete: bool = False
    warming_up: bool = True

    @property
    def begin(self) -> datetime:
        """Beginning, UTC."""
        return datetime.fromisoformat(self.time).astimezone(UTC)

    @property
    def length_s(self) -> float:
        """Time from its beginning to its end, s."""
        return (datetime.fromisoformat(self.end).astimezone(UTC) - self.begin).total_seconds()


def _check_row(row: HistoryRow) -> None:
    check(
        row.length_s >= 0.0 <= min(row.samples, row.missing),
        "an end before the beginning, or a negative count",
    )
    for letter, part in row.coefficients.items():
        known = [size for size in (part.low, part.value, part.high) if size is not None]
        check(known == sorted(known), "a value outside of its limits")
        check(letter == BIAS_SLOPE or min(known, default=0.0) >= 0.0, "a negative size")


_READER = JsonReader({HistoryRow: _check_row})


def objects(reply: bytes) -> list[Any]:
    """Return the entries of an array of JSON; none if a reply is something else."""
    try:
        entries = json.loads(reply)
    except (ValueError, RecursionError):
        return []
    return entries if isinstance(entries, list) else []


def history_rows(objects: Iterable[Any]) -> Iterator[HistoryRow]:
    """Yield the rows among some data of JSON."""
    for entry in objects:
        with suppress(TypeError, AttributeError, KeyError, ValueError, OverflowError):
            yield _READER.part(HistoryRow, entry)
