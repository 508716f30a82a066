"""Task: what to run beside the settings, and how it ended."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from imumon import report


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOptions:
    """What to run beside the settings.

    Attributes
    ----------
    path : port; None: the one sensor that is found.
    duration_s : s of the room until it stops by itself; None: never.
    fresh : start anew, the old state kept aside.
    speed : sensor seconds in one of the room; other than 1 for an emulator in time-lapse.
    state_directory : where the accumulated statistics live.
    baseline : an earlier report of the same sensor, to compare with.
    """

    path: str | None
    state_directory: Path
    duration_s: float | None = None
    fresh: bool = False
    speed: float = 1.0
    baseline: report.Report | None = None


@dataclass(frozen=True, slots=True)
class RunResult:
    """How it ended: the final report, None when no sensor was ever known, and the signal that ended it."""

    report: report.Report | None
    signal: int | None
