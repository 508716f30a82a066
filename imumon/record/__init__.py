"""Pipeline: from sample blocks to a report.

monitor         chooses the stream, keeps its record, makes the report
record          the samples of one stream, and everything that follows from them
gap_fill        steps of the sample clock to dense blocks, long gaps and breaks
accumulators    every accumulator of a record
analysis        fits, spectra and shapes, recomputed when the record has grown
assessment      what the results mean: caveats, changes, grades
report_builder  results as parts of the report
combined_limits  limits of its coefficients with all that is known of their uncertainty
filter_report_builder  a report as parameters for filters
events          what happened, each thing once
periods         hours and days, for the history
loss            the share of samples that the link loses
"""

from imumon.record.monitor import Monitor
from imumon.record.record import MonitorOptions, RecordMismatch

__all__ = ["Monitor", "MonitorOptions", "RecordMismatch"]
