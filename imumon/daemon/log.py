"""Log of the daemon on standard error, by `logging`.

Modules log with ``logging.getLogger(__name__)``; an event adds its kind with ``extra={"kind": kind}``. Its
line goes into a bounded queue, and a thread of its own writes it, so that a standard error that is full or
that no one reads never blocks the daemon. Lines that do not fit are dropped and counted; the next one that
fits is preceded by their number.

Warnings and errors of libraries, and of threads that fail, are lines of this log, too: a library alone would print a
traceback for each.
"""

from __future__ import annotations

import json
import logging
import os
import sys
import threading
import traceback
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime
from queue import Full, Queue
from typing import TypeAlias

from imumon.model.report import stamp
from imumon.model.report_json import plain

LEVELS: dict[str, int] = {
    "error": logging.ERROR,
    "warning": logging.WARNING,
    "notice": logging.INFO + 5,
    "info": logging.INFO,
    "debug": logging.DEBUG,
}
"""Levels of the settings and events as those of `logging`."""

logging.addLevelName(logging.INFO + 5, "NOTICE")

PRIORITIES = {level: priority for priority, level in enumerate(LEVELS.values(), 3)}
"""Levels as priorities of the journal (sd-daemon(3))."""

QUEUE_LINES = 1000
"""Lines that may wait to be written."""

CLOSE_S = 1.0
"""How long to wait at the end until all lines are written, s."""

Line: TypeAlias = Callable[[logging.LogRecord, str], str]
"""Return the line of a record and its text."""

ROOT = "imumon"
"""Name of the logger that all others of this program are below."""


def configure_logging(level: str = "info", format: str = "auto") -> Callable[[], None]:
    """Log to standard error.

    Parameters
    ----------
    level : lowest level that is logged: ``error``, ``warning``, ``notice``, ``info`` or ``debug``.
    format : ``text``, ``journal`` (without the time, which the journal adds), ``json``, or ``auto``: journal if
        the journal reads standard error, else text.

    Returns
    -------
    Function that writes what waits, for at most `CLOSE_S`, and ends logging.

    Raises
    ------
    MemoryError : the thread that writes cannot be started.
    """
    to_journal = _journal_reads_stderr()
    form = ("journal" if to_journal else "text") if format == "auto" else format
    handler = _QueuedHandler(_LINES[form], priority=to_journal or format == "journal")
    try:
        handler.thread.start()
    except RuntimeError as error:  # it says "can't start new thread"
        raise MemoryError from error
    logger, libraries = logging.getLogger(ROOT), logging.getLogger()
    logger.setLevel(LEVELS[level])
    logger.addHandler(handler)
    logger.propagate = False
    libraries.addHandler(handler)  # from their level on, which is warning unless somebody has set another
    fault_of_thread, threading.excepthook = threading.excepthook, _log_fault_of_thread

    def close() -> None:
        threading.excepthook = fault_of_thread
        libraries.removeHandler(handler)
        logger.removeHandler(handler)
        logger.propagate = True
        handler.finish()

    return close


def _log_fault_of_thread(fault: threading.ExceptHookArgs) -> None:
    """Log an exception that ends a thread in one line, with the line of code that has raised it."""
    name = fault.thread.name if fault.thread is not None else "of a library"
    logging.getLogger(ROOT).error("%s", f"thread {name} has ended: {_fault_text(fault.exc_value)}")


def _fault_text(error: BaseException | None) -> str:
    """Return type, text and place of an exception."""
    frames = traceback.extract_tb(error.__traceback__) if error is not None else None
    place = f" ({os.path.basename(frames[-1].filename)}:{frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {error}{place}"


class _QueuedHandler(logging.Handler):
    """Handler whose lines a thread writes: it drops them and counts them while too many wait.

    The thread writes straight to the descriptor of standard error. `sys.stderr` has a lock: a thread that blocks
    while it holds that lock would keep the interpreter from ending.

    Parameters
    ----------
    line : the line of a record and its text, without the prefix.
    priority : add the prefix ``<N>``, which the journal removes.
    """

    def __init__(self, line: Line, *, priority: bool) -> None:
        super().__init__()
        self._line, self._priority = line, priority
        self.queue: Queue[str | None] = Queue(QUEUE_LINES)
        self._dropped = 0
        self._stream = sys.stderr
        try:
            self._descriptor: int | None = self._stream.fileno()
        except (OSError, ValueError, AttributeError):
            self._descriptor = None
        self.thread = threading.Thread(target=self._run, name="imumon-log", daemon=True)

    def emit(self, record: logging.LogRecord) -> None:
        self._report_dropped()
        try:
            if self._dropped:
                raise Full
            self.queue.put_nowait(self.format(record))
        except Exception:  # the queue is full, or a record of a library has words that do not fit its text
            self._dropped += 1

    def format(self, record: logging.LogRecord) -> str:
        text = record.getMessage()
        if record.exc_info and record.exc_info[1] is not None:
            text = f"{text}: {_fault_text(record.exc_info[1])}"
        prefix = f"<{PRIORITIES.get(record.levelno, 6)}>" if self._priority else ""
        # devices and Zenoh word some messages
        return prefix + plain(self._line(record, text).replace("\n", " "))

    def _report_dropped(self) -> None:
        """Enqueue the number of dropped lines, if there are any and the queue has space for it."""
        if self._dropped and self.queue.qsize() < QUEUE_LINES // 2:
            text = f"{self._dropped} log line{'s' * (self._dropped > 1)} dropped: standard error is full or too slow"
            record = logging.LogRecord(__name__, logging.INFO, __file__, 0, text, None, None)
            self.queue.put_nowait(
                self.format(record)
            )  # only this thread adds lines: it has the lock of the handler
            self._dropped = 0

    def finish(self) -> None:
        """Write what waits, for at most `CLOSE_S`; what waits while standard error blocks is lost."""
        with suppress(Full):
            self._report_dropped()
            self.queue.put(None, timeout=CLOSE_S)
            self.thread.join(CLOSE_S)

    def _run(self) -> None:
        for line in iter(self.queue.get, None):
            # it is closed, or its disk is full: the daemon continues
            with suppress(OSError, ValueError, AttributeError):
                self._write(f"{line}\n")

    def _write(self, line: str) -> None:
        if self._descriptor is None:
            self._stream.write(line)
            return
        data = line.encode(self._stream.encoding or "utf-8", self._stream.errors or "replace")
        while data:
            data = data[os.write(self._descriptor, data) :]


def _text(record: logging.LogRecord, text: str) -> str:
    """Return local time, level unless it is ``info``, and text."""
    level = "" if record.levelno == logging.INFO else f"{record.levelname.lower()}: "
    return f"{datetime.fromtimestamp(record.created):%H:%M:%S} {level}{text}"


def _json(record: logging.LogRecord, text: str) -> str:
    """Return an object with ``time``, ``level``, ``kind`` and ``text``."""
    fields = {
        "time": stamp(datetime.fromtimestamp(record.created, UTC)),
        "level": record.levelname.lower(),
        "kind": getattr(record, "kind", ""),
        "text": text,
    }
    return json.dumps(fields, ensure_ascii=False)


_LINES: dict[str, Line] = {"text": _text, "journal": lambda _, text: text, "json": _json}


def _journal_reads_stderr() -> bool:
    """Return whether standard error goes to the journal.

    The variable alone does not show it: every shell of a desktop inherits it.
    """
    try:
        stderr = os.fstat(sys.stderr.fileno())
    except (OSError, ValueError, AttributeError):
        return False
    return os.environ.get("JOURNAL_STREAM") == f"{stderr.st_dev}:{stderr.st_ino}"
