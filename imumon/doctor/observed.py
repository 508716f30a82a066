"""Observations of the probes; `checks` turns them into lines with a status and a cure.

The observation of a device is `imumon.sources.device.Observation`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from imumon.model.errors import ImumonError
from imumon.model.report import Report


@dataclass(frozen=True, slots=True, kw_only=True)
class ZenohObservation:
    """Daemons on Zenoh, and whether another one could listen."""

    reports: tuple[Report, ...] = ()  # newest of each daemon that answers
    # Zenoh ids of the sessions of each device that several publish, the one that is shown first
    rivals: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    free: str | None = None  # endpoint on which a daemon could listen now; None: none
    error: ImumonError | None = None  # why there is none, or what is wrong with the settings
    unreachable: tuple[str, ...] = ()  # configured routers that do not answer


@dataclass(frozen=True, slots=True, kw_only=True)
class StateObservation:
    """The state directory of the daemon."""

    path: Path
    problem: str | None = None  # why nothing can be created in it
    free_bytes: int | None = None  # on its file system; None: unknown
    records: int = 0  # number of saved states


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceObservation:
    """The service manager."""

    running: bool  # systemd runs on this machine
    installed: bool = False  # the unit of imumon is installed
    units: tuple[tuple[str, str], ...] = ()  # instances of it with their states (``active``, ``failed`` ...)
