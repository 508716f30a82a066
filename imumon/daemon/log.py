"""Service manager and log: what the daemon says of itself.

`sd_notify` is a datagram to ``$NOTIFY_SOCKET``; log lines go to stderr, with the journal's priorities where
the journal reads them. Each thing is said once per change: the layers below only count.
"""

from __future__ import annotations

import json
import os
import select
import sys
from datetime import UTC, datetime
from typing import Literal, TypeAlias

from imumon.report import stamp

Level: TypeAlias = Literal["error", "warning", "info", "debug"]
PRIORITY: dict[str, int] = {"error": 3, "warning": 4, "info": 6, "debug": 7}


class DaemonLog:
    """Lines for people or for the journal.

    Parameters
    ----------
    level : least weight that is said.
    format : ``text``, ``journal`` (no time, which the journal has), ``json``, or ``auto``: journal where it
        reads our stderr, else text.
    """

    def __init__(self, level: str = "info", format: str = "auto") -> None:
        self._limit = PRIORITY[level]
        read = _journal_reads()
        self._form = ("journal" if read else "text") if format == "auto" else format
        self._ranked = read or format == "journal"
        self._left_out = 0

    def say(self, text: str, level: Level = "info", kind: str = "") -> None:
        """One line; never raises nor waits, whether stderr is full, closed or read by nobody."""
        if PRIORITY[level] > self._limit:
            return
        if not _takes_a_line():
            self._left_out += 1
            return
        if self._left_out:
            count, self._left_out = self._left_out, 0
            self._write(f"{count} line{'s' * (count > 1)} left out: nobody read them", "info", "")
        self._write(text, level, kind)

    def _write(self, text: str, level: Level, kind: str) -> None:
        weight = PRIORITY[level]
        if self._form == "journal":
            line = text
        elif self._form == "json":
            said = {"time": stamp(datetime.now(UTC)), "level": level, "kind": kind, "text": text}
            line = json.dumps(said, ensure_ascii=False)
        else:
            line = f"{datetime.now():%H:%M:%S} {'' if level == 'info' else level + ': '}{text}"
        rank = f"<{weight}>" if self._ranked else ""  # the journal takes it off
        try:
            print(f"{rank}{line}", file=sys.stderr, flush=True)
        except (OSError, ValueError):
            return


def _takes_a_line() -> bool:
    """Whether stderr has room for a line: a full pipe or a stopped terminal would hold the daemon up."""
    try:
        return bool(select.select([], [sys.stderr.fileno()], [], 0.0)[1])
    except (OSError, ValueError, AttributeError):
        return True


def _journal_reads() -> bool:
    """Whether stderr goes to the journal; its variable alone is inherited by every shell of a desktop."""
    try:
        ours = os.fstat(sys.stderr.fileno())
    except (OSError, ValueError, AttributeError):
        return False
    return os.environ.get("JOURNAL_STREAM") == f"{ours.st_dev}:{ours.st_ino}"


import logging

LEVELS = {"debug": 10, "info": 20, "notice": 25, "warning": 30, "error": 40}


class _Handler(logging.Handler):
    def __init__(self, log: DaemonLog) -> None:
        super().__init__()
        self._log = log

    def emit(self, record: logging.LogRecord) -> None:
        level = {10: "debug", 20: "info", 25: "info", 30: "warning", 40: "error"}.get(record.levelno, "info")
        self._log.say(record.getMessage(), level, getattr(record, "kind", ""))  # type: ignore[arg-type]


def configure_logging(settings: object) -> None:
    """Temporary."""
    logger = logging.getLogger("imumon")
    logger.handlers = [_Handler(DaemonLog(settings.level, settings.format))]  # type: ignore[attr-defined]
    logger.setLevel(1)
    logger.propagate = False
