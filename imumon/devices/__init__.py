"""Devices: live sources of samples behind one contract.

base           the contract: Device, DeviceDriver and what other packages need of a device
registry       URL scheme to driver, by entry points
device_reader  one device in a thread of its own, its items in one bounded queue
serial_port    serial ports and pyserial URLs
linux_tty      what the kernel knows of a serial port
vn100          the VectorNav VN-100
"""
