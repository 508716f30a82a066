"""Sources: where bytes come from. A serial port or a pyserial URL, and recordings of one."""

from imumon.sources.errors import SourceError
from imumon.sources.port import PortError, PortGone, PortInfo, SerialPort, find_again, find_ports, holders
from imumon.sources.recording import Recorder, Recording, read_file

__all__ = [
    "PortError",
    "PortGone",
    "PortInfo",
    "Recorder",
    "Recording",
    "SerialPort",
    "SourceError",
    "find_again",
    "find_ports",
    "holders",
    "read_file",
]
