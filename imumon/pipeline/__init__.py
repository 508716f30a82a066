"""Pipeline: from sample blocks to a report."""

from imumon.pipeline.monitor import (
    PATIENCE,
    PATIENCE_S,
    RANK,
    SAME_RATE,
    Monitor,
    MonitorOptions,
    RateRequired,
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
