"""Recordings: files as sources of samples.

recording         files of any format, decoded raw captures
base              contract of recordings, options for reading, errors
raw_capture       raw bytes of a device, read back
capture_writer    raw bytes of a device, written to disk
text_file         printed logs and tables as text
printed_log       how they are printed: the tables in a text, and its rows in bulk
text_cells        cells of a line, and the number in each
column_header     names and units of columns, by the lines above
number_labels     names of numbers, by the text before them
record_reader     numbers of the records of a text, in bulk
table_choice      which table of a text is read, and what its columns are
columns           which number is which channel, in which unit, and how certain that is
column_names      quantity, axis and kind in the name of a column
unit_grammar      units: prefix, base, power, per
column_reader     sensors and units of columns, each use with its reason
column_clock      clock and interval of columns
sizes_at_rest     1 g, and noise at rest
formats           formats of single programs, from formats.toml
date_reader       dates and times of day
array_file        arrays of NumPy, MATLAB and Parquet
document_file     arrays in JSON and in text of Octave
array_table       named arrays, of a file or of a program
log_file          topics of bags and of logs of autopilots
log_process       program that reads them, with limits
table             rows of numbers as samples, from a file or from memory
table_clock       clock and interval by the first rows
row_selection     columns and rows that are samples, in the order of their time
"""

from imumon.sources.files.base import OptionNotApplicable, ReadOptions, Recording, RecordingError
from imumon.sources.files.capture_writer import CaptureWriter, check_place
from imumon.sources.files.raw_capture import RawCapture
from imumon.sources.files.recording import open_recording

__all__ = [
    "CaptureWriter",
    "OptionNotApplicable",
    "RawCapture",
    "ReadOptions",
    "Recording",
    "RecordingError",
    "check_place",
    "open_recording",
]
