"""VectorNav VN-100 on a serial line, as a device and as an emulator (docs/SENSOR.md, docs/EMULATOR.md)."""

from imumon.devices.vn100.decoder import Vn100Decoder

__all__ = ["Vn100Decoder"]
