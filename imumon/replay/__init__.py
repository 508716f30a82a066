"""Replay: the loop of the daemon over a recording."""

from imumon.replay.replay import (
    NotARecording,
    Replay,
    Samples,
    bar,
    open_samples,
    replay,
)

__all__ = [
    "NotARecording",
    "Replay",
    "Samples",
    "bar",
    "open_samples",
    "replay",
]
