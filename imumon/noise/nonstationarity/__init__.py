"""Change of the statistics during a record: warm-up, drift, steps."""

from imumon.noise.nonstationarity.hourly_statistics import HOUR_S, Hour, HourlyStatistics

__all__ = ["HOUR_S", "Hour", "HourlyStatistics"]
