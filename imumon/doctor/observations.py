"""Looks: what the doctor has seen, as plain facts; `judge` makes checks of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from imumon.devices.vn100.device_info import Vn100Info
from imumon.report import Report


@dataclass(frozen=True, slots=True, kw_only=True)
class PortLook:
    """A port as the file system shows it.

    Attributes
    ----------
    exists, character : there is such a file, and it is a character device.
    accessible : this process may read and write it.
    group, user : that owns the file; who we are.
    member : the user database has us in that group.
    holders : other processes that have it open, ``name (pid)``.
    daemon : name of a daemon of ours that reads it, as it says itself; None: none.
    latency_ms : ms, of an FTDI adapter's timer while the port is open; None: another adapter, or not known.
    others : other ports of this machine.
    """

    path: str
    exists: bool = True
    character: bool = True
    accessible: bool = True
    group: str | None = None
    user: str = ""
    member: bool = False
    holders: tuple[str, ...] = ()
    daemon: str | None = None
    latency_ms: int | None = None
    described: str = ""
    others: tuple[str, ...] = ()

    @property
    def is_url(self) -> bool:
        return "://" in self.path


@dataclass(frozen=True, slots=True, kw_only=True)
class Heard:
    """What a few seconds of the line told.

    Attributes
    ----------
    facts : who the sensor is, its settings and its stream.
    seconds : s of the room, how long was listened.
    bytes, messages, bad_checksums, discarded : since the first valid message.
    samples : of the stream that would be characterised.
    missing : samples that the sensor's clock, or broken frames, show to be lost; None: no telling.
    rate_hz : samples a second of the room, None below two of them.
    clock_ratio : seconds of the sensor in one of the room; None without a clock.
    leaps : times the sensor's clock went backwards or leapt by more than 10 s.
    longest_pause_s : s without a byte.
    gone : why the port went away while it was listened to.
    daemon : who was asked instead of listening.
    state : of that daemon.
    """

    facts: Vn100Info
    seconds: float
    bytes: int = 0
    messages: int = 0
    bad_checksums: int = 0
    discarded: int = 0
    samples: int = 0
    missing: int | None = None
    rate_hz: float | None = None
    clock_ratio: float | None = None
    leaps: int = 0
    longest_pause_s: float = 0.0
    gone: str | None = None
    daemon: str | None = None
    state: str = "running"


@dataclass(frozen=True, slots=True, kw_only=True)
class BusLook:
    """Who is on Zenoh, and whether a daemon would find room.

    Attributes
    ----------
    reports : newest report of every daemon that answers.
    free : endpoint a daemon could listen on now; None: none.
    fault : why not, or what is wrong with the settings.
    exposed : endpoints open to the network without encryption, by the settings' own wish.
    unreachable : routers of the settings that do not answer.
    """

    reports: tuple[Report, ...] = ()
    free: str | None = None
    fault: str | None = None
    exposed: tuple[str, ...] = ()
    unreachable: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class StateLook:
    """The directory of the accumulated statistics; `records` are the sensors it knows."""

    path: Path
    writable: bool
    fault: str | None = None
    free_bytes: int | None = None
    records: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceLook:
    """The service manager: units by name with their state (``active``, ``failed`` ...)."""

    running: bool
    installed: bool = False
    units: tuple[tuple[str, str], ...] = ()
