"""Replay: a recording through the same pipeline as the daemon."""

from imumon.replay.progress_bar import ProgressBar
from imumon.replay.replay import ReplayOptions, SensorFilter, replay

__all__ = ["ProgressBar", "ReplayOptions", "SensorFilter", "replay"]
