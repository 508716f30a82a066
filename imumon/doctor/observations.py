"""Observations: what the probes have seen; `checks` turns them into lines with a status and a cure.

The observation of a device is `imumon.devices.base.Observation`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from imumon.errors import ImumonError
from imumon.report import Report

_URL = re.compile(r"[a-z][a-z0-9+.-]*:")


@dataclass(frozen=True, slots=True, kw_only=True)
class PortObservation:
    """A port as the file system shows it.

    Attributes
    ----------
    path : device path or URL; only `daemon` is known of a URL.
    exists, is_character_device : of the file.
    accessible : this process may read and write it.
    group, user : group of the file, and the user of this process.
    group_member : the user database has the user in that group.
    holders : other processes that have it open, ``name (pid)``.
    daemon : id of the daemon that reads it, according to its report; None: none.
    latency_ms : ms, timer of an FTDI adapter while the port is open; None: another adapter, or unknown.
    description : of the adapter.
    other_ports : paths of the other ports of this machine.
    """

    path: str
    exists: bool = True
    is_character_device: bool = True
    accessible: bool = True
    group: str | None = None
    user: str = ""
    group_member: bool = False
    holders: tuple[str, ...] = ()
    daemon: str | None = None
    latency_ms: int | None = None
    description: str = ""
    other_ports: tuple[str, ...] = ()

    @property
    def is_url(self) -> bool:
        """Whether the port is a URL instead of a path.

        >>> [PortObservation(path=p).is_url for p in ("/dev/ttyUSB0", "socket://10.0.0.2:4001", "fake:a")]
        [False, True, True]
        """
        return _URL.match(self.path) is not None


@dataclass(frozen=True, slots=True, kw_only=True)
class ZenohObservation:
    """Daemons on Zenoh, and whether another one could listen.

    Attributes
    ----------
    reports : newest report of each daemon that answers.
    free : endpoint on which a daemon could listen now; None: none.
    error : why there is none, or what is wrong with the settings.
    exposed : endpoints of the settings that are open to the network without encryption.
    unreachable : routers of the settings that do not answer.
    """

    reports: tuple[Report, ...] = ()
    free: str | None = None
    error: ImumonError | None = None
    exposed: tuple[str, ...] = ()
    unreachable: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class StateObservation:
    """The state directory.

    Attributes
    ----------
    writable : files can be created in it, or the directory itself can be created.
    problem : why it is not writable.
    free_bytes : on its file system; None: unknown.
    records : number of saved states.
    """

    path: Path
    writable: bool
    problem: str | None = None
    free_bytes: int | None = None
    records: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceObservation:
    """The service manager.

    Attributes
    ----------
    running : systemd runs on this machine.
    installed : the unit of imumon is installed.
    units : instances of it with their states (``active``, ``failed`` ...).
    """

    running: bool
    installed: bool = False
    units: tuple[tuple[str, str], ...] = ()
