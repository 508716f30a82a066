"""Recordings: files as sources of samples.

recording         opening a file of any format, decoding raw captures
base              what every recording offers, how it is read, errors
raw_capture       raw bytes of a device, read back
capture_writer    raw bytes of a device, kept on disk
recording_header  what a capture says of itself
csv, npz, rosbag  tables and bags
table             rows of numbers as samples
columns           which columns of a table make a stream
column_names      what the name of a column says
unit_inference    which units the numbers of a column can have
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
