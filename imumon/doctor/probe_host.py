"""Host probe: observation of the file of a port, the state directory and the service manager."""

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

from imumon.doctor.observed import PortObservation, ServiceObservation, StateObservation
from imumon.model.errors import why
from imumon.sources.linux_tty import holders, locker
from imumon.sources.ports import find_ports


def observe_port(path: str, daemon: str | None = None) -> PortObservation:
    """Observe a port without opening it; `daemon` is the id of the daemon that reads it."""
    port = PortObservation(path=path, daemon=daemon)
    if port.is_url:
        return port
    ports = find_ports()
    real = os.path.realpath(path)
    port = replace(
        port,
        other_ports=tuple(info.path for info in ports if info.path != path),
        description=next((info.description for info in ports if os.path.realpath(info.path) == real), ""),
    )
    try:
        status = os.stat(path)
    except (OSError, ValueError):
        return replace(port, exists=False)
    group, group_member, user = None, False, _user()
    programs = holders(path)
    if daemon is not None:
        programs.pop(locker(path) or 0, None)  # a daemon locks its port
    with contextlib.suppress(KeyError):
        entry = grp.getgrgid(status.st_gid)
        group, group_member = entry.gr_name, user in entry.gr_mem
    return replace(
        port,
        is_character_device=stat.S_ISCHR(status.st_mode),
        accessible=os.access(path, os.R_OK | os.W_OK),
        group=group,
        user=user,
        group_member=group_member,
        holders=tuple(programs.values()),
        all_users=os.geteuid() == 0,
    )


def observe_state(path: Path) -> StateObservation:
    """Observe the state directory: whether a file, or the directory itself, can be created in it."""
    existing = path
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    problem = None
    if not existing.is_dir():
        problem = f"{existing} is a file, not a directory"
    elif existing == path:
        try:
            with tempfile.NamedTemporaryFile(dir=path, prefix=".doctor-"):
                pass
        except OSError as error:
            problem = f"{path}: {why(error)}"
    elif not os.access(existing, os.W_OK | os.X_OK):
        problem = f"{existing}: permission denied"
    free = None
    with contextlib.suppress(OSError):
        free = shutil.disk_usage(existing).free
    records = 0
    with contextlib.suppress(OSError):
        records = sum(1 for entry in path.iterdir() if entry.is_file() and entry.suffix == ".state")
    return StateObservation(path=path, problem=problem, free_bytes=free, records=records)


def observe_service() -> ServiceObservation:
    """Observe the units of imumon, if there is a service manager."""
    if not Path("/run/systemd/system").is_dir() or shutil.which("systemctl") is None:
        return ServiceObservation(running=False)
    installed = bool(_systemctl("list-unit-files", "imumon@*"))
    rows = [line.split() for line in _systemctl("list-units", "--all", "imumon@*")]
    units = tuple((row[0], row[2]) for row in rows if len(row) > 2)
    return ServiceObservation(running=True, installed=installed or bool(units), units=units)


def _systemctl(*arguments: str) -> list[str]:
    command = ["systemctl", "--no-legend", "--plain", "--no-pager", *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=5.0, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return []
    return [line for line in done.stdout.splitlines() if line.strip()]


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a user without an entry in the user database
        return str(os.getuid())
