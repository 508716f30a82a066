"""VN-100: its line protocol, without the line.

decoder   bytes to samples, responses and errors
ascii     sentences, read and written
binary    packets, read and written
streams   which quantities of a message become samples
checksum  XOR and CRC16
"""

from imumon.sensors.vn100.decoder import Decoder

__all__ = ["Decoder"]
