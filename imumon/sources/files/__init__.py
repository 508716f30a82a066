"""Recordings: files as sources of samples.

recording         files of any format, decoded raw captures
base              contract of recordings, options for reading, errors
raw_capture       raw bytes of a device, read back
capture_writer    raw bytes of a device, written to disk
csv               tables as text
table_header      the line that names their columns, and what the lines around it say
text_records      text with names beside the numbers, as a table
date_reader       dates and times of day in them
array_file        arrays of NumPy, MATLAB and Parquet
memory_table      arrays in memory
array_table       named arrays, of a file or in memory
sentence_table    tables of raw sentences of a device
log_file          topics of bags and of logs of autopilots
log_process       program that reads them, with limits
table             rows of numbers as samples, from a file or from memory
columns           columns of a table that form a stream
column_meaning    units and meaning of samples that the user states
first_rows        units, clock and interval by the first rows
unit_checks       whether numbers can have their units
row_selection     rows that are samples, in the order of their time
sensor_column     column that says of which sensor a row is
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
