"""Pipeline: from sample blocks to a report."""

from imumon.errors import RateRequired
from imumon.pipeline.monitor import (
    PATIENCE,
    PATIENCE_S,
    RANK,
    SAME_RATE,
    Monitor,
    MonitorOptions,
    RecordMismatch,
)

__all__ = [
    "PATIENCE",
    "PATIENCE_S",
    "RANK",
    "SAME_RATE",
    "Monitor",
    "MonitorOptions",
    "RateRequired",
    "RecordMismatch",
]
