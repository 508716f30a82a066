"""Daemon: read a device, feed the pipeline, publish and save.

daemon         the loop
connection     what is known of the device: identity, state, silence
keeper         what keeps the record: state, history, recording
outputs        where reports and events go: log, bus, ROS 2, alert command
run_limits     what to run, what ends it, how long a device may be silent, when a duty is due
persistence    the record on disk: restored, saved, set aside
recorder       the raw bytes on disk
alert_command  a command of the user that runs at warnings
log            standard error: text, journal or JSON
sd_notify      the service manager
"""

from imumon.daemon.daemon import Daemon
from imumon.daemon.run_limits import RunOptions, RunResult

__all__ = ["Daemon", "RunOptions", "RunResult"]
