"""Pipeline: from sample blocks to a report."""

from imumon.pipeline.monitor import (
    PATIENCE,
    PATIENCE_S,
    RANK,
    SAME_RATE,
    Monitor,
    OtherRun,
    RateNeeded,
    Wanted,
)

__all__ = [
    "PATIENCE",
    "PATIENCE_S",
    "RANK",
    "SAME_RATE",
    "Monitor",
    "OtherRun",
    "RateNeeded",
    "Wanted",
]
