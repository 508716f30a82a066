"""Host probe: observation of the state directory and the service manager."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from imumon.doctor.observed import ServiceObservation, StateObservation
from imumon.model.errors import why


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
