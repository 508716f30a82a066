"""VN-100: its line protocol, without the line.

session   know it, take its stream, look after it
changes   have it stream what noise needs, leave it as it was
dialogue  find its baud, ask it, write its registers
facts     what a report says of it
settings  what to ask it for, what that does to the noise, what to put back
registers fields, factory values, what may be written
meanings  what its settings do to the data, in words
decoder   bytes to samples, responses and errors
ascii     sentences, read and written
binary    packets, read and written
streams   which quantities of a message become samples
checksum  XOR and CRC16
"""

from imumon.devices.vn100.decoder import Vn100Decoder

__all__ = ["Vn100Decoder"]
