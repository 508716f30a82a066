"""Measure the noise of an IMU topic: ros2 launch imumon_ros imumon.launch.py topic:=/imu/data."""

import os

from imumon_ros.monitor import command
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration

ARGUMENTS = {
    "topic": ("/imu/data", "topic of sensor_msgs/msg/Imu"),
    "accel": ("", "separate topic of the accelerometer"),
    "mag": ("", "topic of sensor_msgs/msg/MagneticField"),
    "temperature": ("", "topic of sensor_msgs/msg/Temperature"),
    "router": ("", "Zenoh endpoint of the router, if it runs elsewhere"),
    "diagnostics": ("false", "publish reports on /diagnostics"),
    "state": ("", "directory of the accumulated statistics"),
    "config": ("", "settings file of imumon"),
}


def words(values, environment):
    """Return the command for the values of the arguments."""
    options = ["--publish-diagnostics"] if values["diagnostics"].lower() in ("true", "1") else []
    for name, option in (
        ("state", "--state"),
        ("config", "--config"),
    ):
        options += [option, values[name]] if values[name] else []
    names = ("accel", "mag", "temperature", "router")
    return command(values["topic"], environment, options, **{name: values[name] for name in names})


def start(context):
    """Return the process, when the values of the arguments are known."""
    values = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    # imumon saves its state at the end: it gets more time than the 5 s of launch
    return [
        ExecuteProcess(
            cmd=words(values, os.environ), output="screen", sigterm_timeout="15", sigkill_timeout="20"
        )
    ]


def generate_launch_description():
    """Return the arguments and the process."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=start)])
