"""Pipeline: from sample blocks to a report."""

from imumon.pipeline.monitor import Monitor, RecordMismatch
from imumon.pipeline.record import MonitorOptions

__all__ = ["Monitor", "MonitorOptions", "RecordMismatch"]
