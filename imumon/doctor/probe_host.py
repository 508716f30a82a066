"""Machine: looks at the port's file, the disk and the service manager, and touches none of them."""

from __future__ import annotations

import contextlib
import getpass
import grp
import os
import shutil
import stat
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path

from imumon.doctor.observations import PortLook, ServiceLook, StateLook
from imumon.devices.serial_port import find_ports, holders


def look_at_port(path: str, daemon: str | None = None) -> PortLook:
    """What can be known of a port without opening it; `daemon` says that it reads it."""
    if "://" in path:
        return PortLook(path=path, daemon=daemon)
    ports = find_ports()
    others = tuple(port.path for port in ports if port.path != path)
    real = os.path.realpath(path)
    described = next((p.description for p in ports if os.path.realpath(p.path) == real), "")
    try:
        found = os.stat(path)
    except (OSError, ValueError):
        return PortLook(path=path, exists=False, daemon=daemon, others=others)
    group, member = None, False
    with contextlib.suppress(KeyError):
        entry = grp.getgrgid(found.st_gid)
        group, member = entry.gr_name, _user() in entry.gr_mem
    return PortLook(
        path=path,
        character=stat.S_ISCHR(found.st_mode),
        accessible=os.access(path, os.R_OK | os.W_OK),
        group=group,
        user=_user(),
        member=member,
        # who made a pseudo-terminal has it open itself: there, opening it tells
        holders=() if real.startswith("/dev/pts/") else tuple(holders(path)),
        daemon=daemon,
        described=described,
        others=others,
    )


def with_latency(look: PortLook, root: Path = Path("/sys/class/tty")) -> PortLook:
    """The look with the adapter's latency timer, to be called while the port is open."""
    name = Path(os.path.realpath(look.path)).name
    try:
        text = (root / name / "device" / "latency_timer").read_text()
        return replace(look, latency_ms=int(text))
    except (OSError, ValueError):
        return look


def look_at_state(path: Path) -> StateLook:
    """Whether a file can be made in the directory, or the directory itself; what is made is removed."""
    there = path
    while not there.exists() and there != there.parent:
        there = there.parent
    fault = None
    if not there.is_dir():
        fault = f"{there} is a file, not a directory"
    elif there == path:
        try:
            with tempfile.NamedTemporaryFile(dir=path, prefix=".doctor-"):
                pass
        except OSError as error:
            fault = f"{path}: {(error.strerror or str(error)).lower()}"
    elif not os.access(there, os.W_OK | os.X_OK):
        fault = f"{there}: permission denied"
    free = None
    with contextlib.suppress(OSError):
        free = shutil.disk_usage(there).free
    records = 0
    with contextlib.suppress(OSError):
        records = sum(1 for entry in path.iterdir() if entry.is_file() and entry.suffix == ".state")
    return StateLook(path=path, writable=fault is None, fault=fault, free_bytes=free, records=records)


def look_at_service() -> ServiceLook:
    """What the service manager says of our units, where there is one."""
    if not Path("/run/systemd/system").is_dir() or shutil.which("systemctl") is None:
        return ServiceLook(running=False)
    installed = bool(_systemctl("list-unit-files", "imumon@*"))
    lines = [line.split() for line in _systemctl("list-units", "--all", "imumon@*")]
    units = tuple((words[0], words[2]) for words in lines if len(words) > 2)
    return ServiceLook(running=True, installed=installed or bool(units), units=units)


def _systemctl(*words: str) -> list[str]:
    command = ["systemctl", "--no-legend", "--plain", "--no-pager", *words]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=5.0, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return []
    return [line for line in done.stdout.splitlines() if line.strip()]


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a user that the database does not know
        return str(os.getuid())
