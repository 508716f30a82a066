"""Pipeline: from sample blocks to a report."""

from imumon.pipeline.monitor import Monitor, MonitorOptions, RecordMismatch

__all__ = ["Monitor", "MonitorOptions", "RecordMismatch"]
