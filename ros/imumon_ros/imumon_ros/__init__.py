"""Starts imumon in a ROS 2 system."""
