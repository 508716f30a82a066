"""Devices: live sources of samples behind one contract.

device         the contract: Device, DeviceDriver and what other packages need of a device
registry       URL scheme to driver, by entry points
device_reader  one device in a thread of its own, its items in one bounded queue
frame_decoder  what decoders of messages with a frame share
port_device    what sensors on serial lines share
ports          the ports of this machine, pyserial URLs, sockets and standard input, and their opening
serial_port    an open port, drained by a thread into a queue
clock          the time of the host
linux_tty      what the kernel knows of a serial port
files          recordings
vn100          the VectorNav VN-100
ros2           IMU topics of ROS 2
lines          any sensor that prints numbers
xsens          Xsens MTi
"""
