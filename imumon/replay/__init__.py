"""Replay: a recording through the same pipeline as the daemon."""

from imumon.replay.progress_bar import ProgressBar
from imumon.replay.replay import replay
from imumon.replay.replay_options import ReplayOptions, SensorFilter
from imumon.replay.replayed_record import ReplayedRecord

__all__ = ["ProgressBar", "ReplayOptions", "ReplayedRecord", "SensorFilter", "replay"]
