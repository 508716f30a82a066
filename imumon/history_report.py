"""Period of the history: what a record showed in 10 minutes, an hour or a day, as a message between packages.

The pipeline makes it, the daemon gives it the time of the host clock, the history stores it. A row of the published
history is one channel of one period.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from imumon.report import Estimate, GradeName

STEPS = {"10m": 600, "1h": 3600, "1d": 86400}
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
    needed: int  # days from which the scatter is known
    std: float | None  # SI, standard deviation between the days, with n - 1; null: too few days
    statistics: float | None  # SI, root mean square of the standard errors of the days


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
    grades: Mapping[str, GradeName | None] = field(default_factory=dict)  # nearest, of the record at its end
    channels: Mapping[str, PeriodChannel] = field(default_factory=dict)  # by name
