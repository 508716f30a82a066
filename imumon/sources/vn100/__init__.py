"""VectorNav VN-100 on a serial line, as a device and as an emulator (docs/VN100.md)."""
