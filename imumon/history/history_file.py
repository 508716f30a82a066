"""Files of the history: their names, their errors, and where a file goes that cannot be used."""

from __future__ import annotations

import itertools
import os
import re
import stat
from contextlib import suppress
from pathlib import Path

from imumon.errors import ImumonError

SUFFIX = ".history.sqlite"


class HistoryError(ImumonError):
    """The history cannot be read or written."""


def damaged(path: Path) -> HistoryError:
    """Return the error of a file that is no history of imumon, or of which parts are lost."""
    message = f"history {path} is damaged, or not a history of imumon"
    return HistoryError("history_damaged", message, "the daemon sets it aside and begins a new one")


def set_aside(path: Path, reason: str) -> Path:
    """Rename a file and what belongs to it; return its new path, ``DEVICE.REASON-N.history.sqlite``."""
    stem = path.name.removesuffix(SUFFIX)
    names = (path.with_name(f"{stem}.{reason}-{number}{SUFFIX}") for number in itertools.count(1))
    aside = next(name for name in names if not os.path.lexists(name))
    os.rename(path, aside)
    for extra in ("-wal", "-shm"):
        with suppress(OSError):
            os.rename(f"{path}{extra}", f"{aside}{extra}")
    return aside


def check_file(path: Path, write: bool) -> None:
    """Raise an error if there is no file to read, or something that is no regular file."""
    try:
        mode = os.lstat(path).st_mode
    except FileNotFoundError:
        if write:
            return
        message = f"there is no history {path}"
        raise HistoryError(
            "no_history", message, "start a daemon, or name its directory with --state"
        ) from None
    if not stat.S_ISREG(mode):
        raise damaged(path)


def devices(directory: Path) -> list[str]:
    """Return the names of the devices that have a history in a directory."""
    pattern = re.compile(r"([a-z0-9_-]{1,64})" + re.escape(SUFFIX))
    try:
        return sorted(found[1] for name in os.listdir(directory) if (found := pattern.fullmatch(name)))
    except OSError:
        return []
