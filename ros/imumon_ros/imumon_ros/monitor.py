"""Command line of imumon for a topic, from the environment of ROS 2.

``ros2 run imumon_ros monitor /imu/data [options of imumon run]`` replaces itself with ``imumon run``. Middleware and
domain are those of the terminal: RMW_IMPLEMENTATION and ROS_DOMAIN_ID.
"""

import os
import sys
from urllib.parse import urlencode


def url(topic, environment, **parameters):
    """Return the URL of a topic; empty parameters are left out."""
    # without the variable, a distribution runs DDS
    rmw = "zenoh" if "zenoh" in environment.get("RMW_IMPLEMENTATION", "") else "dds"
    values = {"rmw": rmw, "domain": environment.get("ROS_DOMAIN_ID") or "0", **parameters}
    query = urlencode({name: value for name, value in values.items() if value}, safe="/:")
    return f"ros2:{topic}?{query}"


def command(topic, environment, options=(), **parameters):
    """Return the words that start imumon."""
    return ["imumon", "run", "--port", url(topic, environment, **parameters), *options]


def without_ros_arguments(words):
    """Return the words of a command line without what `ros2 run` and launch add: ``--ros-args ... [--]``."""
    kept, inside = [], False
    for word in words:
        if word == "--ros-args":
            inside = True
        elif inside and word == "--":
            inside = False
        elif not inside:
            kept.append(word)
    return kept


def main():
    """Replace this process with imumon."""
    words = without_ros_arguments(sys.argv[1:])
    if not words or words[0].startswith("-"):
        sys.exit("usage: ros2 run imumon_ros monitor TOPIC [options of imumon run]")
    line = command(words[0], os.environ, words[1:])
    try:
        os.execvp(line[0], line)
    except FileNotFoundError:
        sys.exit("imumon_ros: the program imumon is not installed: pip install imumon")
