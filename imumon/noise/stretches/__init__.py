"""Parts of a record: what each of them says, by the same fit."""

from imumon.noise.stretches.record_statistics import RecordStatistics

__all__ = ["RecordStatistics"]
