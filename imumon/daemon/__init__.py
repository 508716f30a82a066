"""Daemon: read a device, feed the pipeline, publish and save."""

from imumon.daemon.daemon import Daemon, RunOptions, RunResult

__all__ = [
    "Daemon",
    "RunOptions",
    "RunResult",
]
