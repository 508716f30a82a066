"""Daemon: read a device, feed the pipeline, publish and save.

daemon         the loop
run_limits     what ends a run, and how long a device may be silent
persistence    the record on disk: restored, saved, set aside
recorder       the raw bytes on disk
alert_command  a command of the user that runs at warnings
metadata       what of the device is in a report, a recording and the state
log            standard error: text, journal or JSON
sd_notify      the service manager
"""

from imumon.daemon.daemon import Daemon, RunOptions, RunResult

__all__ = ["Daemon", "RunOptions", "RunResult"]
