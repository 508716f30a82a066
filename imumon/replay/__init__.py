"""Replay: the loop of the daemon over a recording."""

from imumon.replay.replay import NotARecording, ReplayOptions, Samples, bar, open_samples, replay

__all__ = [
    "NotARecording",
    "ReplayOptions",
    "Samples",
    "bar",
    "open_samples",
    "replay",
]
