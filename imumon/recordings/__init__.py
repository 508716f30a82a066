"""Recordings: files as sources of samples.

recording         files of any format, decoded raw captures
base              contract of recordings, options for reading, errors
raw_capture       raw bytes of a device, read back
capture_writer    raw bytes of a device, written to disk
recording_header  description of the device in a capture
csv, csv_rows     tables as text
array_file        arrays of NumPy, MATLAB and Parquet
sentence_table    tables of raw sentences of a device
log_file          topics of bags and of logs of autopilots
log_process       program that reads them, with limits
table             rows of numbers as samples
columns           columns of a table that form a stream
unit_inference    possible units of the numbers of a column
"""

from imumon.recordings.base import OptionNotApplicable, ReadOptions, Recording, RecordingError
from imumon.recordings.capture_writer import CaptureWriter, check_place
from imumon.recordings.raw_capture import RawCapture
from imumon.recordings.recording import open_recording

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
