"""Change of the statistics during a record: warm-up, drift, steps."""

from imumon.noise.nonstationarity.hourly_statistics import HourlyStatistics

__all__ = ["HourlyStatistics"]
