"""Daemon: read a device, feed the pipeline, publish and save."""

from imumon.daemon.daemon import (
    Daemon,
    Outcome,
    Task,
)

__all__ = [
    "Daemon",
    "Outcome",
    "Task",
]
