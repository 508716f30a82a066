"""Replay: a recording through the same pipeline as the daemon."""

from imumon.replay.replay import ReplayOptions, progress_bar, replay

__all__ = ["ReplayOptions", "progress_bar", "replay"]
