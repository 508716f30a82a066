"""Change of the statistics during a record: warm-up, drift, steps."""

from imumon.noise.nonstationarity.hourly_statistics import (
    HOUR_S,
    History,
    Hour,
    Moved,
)

__all__ = [
    "HOUR_S",
    "History",
    "Hour",
    "Moved",
]
