"""One record: from sample blocks to a report.

record          the spine: clock, guard, sums and fits of the samples of one stream
stream_choice   which of several streams is characterised
gap_fill        steps of the sample clock to dense blocks, long gaps and breaks
counts          what became of the ticks of the grid
fits            coefficients, spectra and shapes, recomputed when the record has grown
convergence     what was stated when the record was shorter
changes         changes of a sensor as fields of a report
assessment      what the results mean: caveats, changes, grades
report_builder  results as parts of the report
combined_limits  limits of its coefficients with all that is known of their uncertainty
record_combination  the reports of several records as one
filter_report_builder  a report as parameters for filters
events          what happened, each thing once
periods         hours and days, for the history
loss            the share of samples that the link loses
"""

from imumon.record.record import Record, RecordMismatch, RecordOptions

__all__ = ["Record", "RecordMismatch", "RecordOptions"]
