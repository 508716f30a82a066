"""IMU topics of ROS 2 as devices, without a ROS installation.

ros2_driver    the interface for other packages
ros2_device    a topic, found, lost and found again
imu_assembler  messages of one or several topics to blocks of samples
"""
