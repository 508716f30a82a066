"""Sources: where bytes and samples come from.

port        a serial port or a pyserial URL
recording   raw bytes kept on disk, and read back
header      what such a recording says of itself
columns     which column of a table is which channel
plausible   of which units its numbers can be
table       rows of numbers as samples
dates       times that are written as people read them
csv         CSV, in pieces
archive     NumPy archives
bag         ROS bags
kinds       which of them a file is
"""

from imumon.errors import OptionNotApplicable, RateUnknown, SourceError
from imumon.recordings.detect_format import open_file
from imumon.recordings.raw_capture import CaptureWriter, LinkLoss, RawCapture, check_place, read_file
from imumon.recordings.rosbag import RosbagFile
from imumon.recordings.table import ReadOptions

__all__ = [
    "CaptureWriter",
    "LinkLoss",
    "OptionNotApplicable",
    "RateUnknown",
    "RawCapture",
    "ReadOptions",
    "RosbagFile",
    "SourceError",
    "check_place",
    "open_file",
    "read_file",
]
