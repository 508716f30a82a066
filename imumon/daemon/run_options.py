"""Run: what to run, and how it ended."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from imumon.evaluation import Provenance
from imumon.report import Report


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOptions:
    """What to run, beside the settings.

    Attributes
    ----------
    url : of the device, see `imumon.devices.registry.driver_of`; empty: the only one that is found.
    state_directory : of the accumulated statistics.
    duration_s : s of the host clock; None: unlimited.
    fresh : start a new record; the old state is kept under another name.
    temporary : the state directory is deleted after the run.
    speed : seconds of the sample clock per second of the host clock; not 1 for an emulator in time-lapse.
    baseline : an earlier report of the same sensor, to compare with.
    provenance : program and host, for the reports; None: they do not name them.
    """

    url: str
    state_directory: Path
    duration_s: float | None = None
    fresh: bool = False
    temporary: bool = False
    speed: float = 1.0
    baseline: Report | None = None
    provenance: Provenance | None = None


@dataclass(frozen=True, slots=True)
class RunResult:
    """How a run ended: the final report, None if no device was ever there, and the signal that ended it."""

    report: Report | None
    signal: int | None
