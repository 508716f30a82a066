"""Log of the daemon on standard error, by `logging`.

Modules log with ``logging.getLogger(__name__)``; an event adds its kind with ``extra={"kind": kind}``. A
record goes into a bounded queue, and a thread of its own writes it, so that a standard error that is full or
that no one reads never blocks the daemon. Records that do not fit are dropped and counted; the next one that
fits is preceded by their number.

Warnings and errors of libraries, and of threads that fail, are lines of this log, too: a library alone would print a
traceback for each.
"""

from __future__ import annotations

import copy
import json
import logging
import os
import sys
import threading
import traceback
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime
from logging.handlers import QueueHandler, QueueListener
from queue import Full, Queue
from typing import Any

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

QUEUE_RECORDS = 1000
"""Records that may wait to be written."""

CLOSE_S = 1.0
"""How long to wait at the end until all records are written, s."""

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
    writer = _Writer()
    writer.setFormatter(_Formatter(_LINES[form], priority=to_journal or format == "journal"))
    handler = _BoundedHandler(Queue(QUEUE_RECORDS))
    listener = _Listener(handler.queue, writer)
    try:
        listener.start()
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
        handler.report_dropped()
        listener.stop()

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


class _BoundedHandler(QueueHandler):
    """Handler that drops records and counts them while the queue is full."""

    def __init__(self, queue: Queue[Any]) -> None:
        super().__init__(queue)
        self._dropped = 0

    def prepare(self, record: logging.LogRecord) -> logging.LogRecord:
        """Return the record with its text, in which an exception is one line. Nothing needs to be pickled."""
        text = record.getMessage()
        if record.exc_info and record.exc_info[1] is not None:
            text = f"{text}: {_fault_text(record.exc_info[1])}"
        record = copy.copy(record)  # other handlers have the same one
        record.msg, record.args, record.exc_info = text, None, None
        return record

    def emit(self, record: logging.LogRecord) -> None:
        try:
            self.enqueue(self.prepare(record))
        except Exception:  # a record of a library whose words do not fit its text
            self._dropped += 1

    def enqueue(self, record: logging.LogRecord) -> None:
        self.report_dropped()
        if self._dropped or not self._put(record):
            self._dropped += 1

    def report_dropped(self) -> None:
        """Enqueue the number of dropped records, if there are any and the queue has space for it."""
        if self._dropped and self.queue.qsize() < QUEUE_RECORDS // 2:  # type: ignore[attr-defined]
            count = self._dropped
            text = f"{count} log line{'s' * (count > 1)} dropped: standard error is full or too slow"
            if self._put(logging.LogRecord(__name__, logging.INFO, __file__, 0, text, None, None)):
                self._dropped = 0

    def _put(self, record: logging.LogRecord) -> bool:
        try:
            self.queue.put_nowait(record)
        except Full:
            return False
        return True


class _Listener(QueueListener):
    """Listener that can be ended while standard error blocks."""

    def enqueue_sentinel(self) -> None:
        self.queue.put(self._sentinel, timeout=CLOSE_S)  # type: ignore[attr-defined]

    def stop(self) -> None:
        if self._thread is None:
            return
        with suppress(Full):  # standard error blocks: what waits is lost
            self.enqueue_sentinel()
            self._thread.join(CLOSE_S)
        self._thread = None


class _Writer(logging.Handler):
    """Handler that writes straight to the descriptor of standard error.

    `sys.stderr` has a lock. A thread that blocks while it holds that lock would keep the interpreter from
    ending.
    """

    def __init__(self) -> None:
        super().__init__()
        self._stream = sys.stderr
        try:
            self._descriptor: int | None = self._stream.fileno()
        except (OSError, ValueError, AttributeError):
            self._descriptor = None

    def handle(self, record: logging.LogRecord) -> bool:
        # one thread writes, and it may block: with the lock of the handler, the end of `logging` would wait for it
        self.emit(record)
        return True

    def emit(self, record: logging.LogRecord) -> None:
        try:
            line = self.format(record) + "\n"
            if self._descriptor is None:
                self._stream.write(line)
                return
            data = line.encode(self._stream.encoding or "utf-8", self._stream.errors or "replace")
            while data:
                data = data[os.write(self._descriptor, data) :]
        except (OSError, ValueError, AttributeError):
            return  # it is closed, or its disk is full: the daemon continues


class _Formatter(logging.Formatter):
    """One line per record, with the prefix ``<N>`` if the journal reads it.

    Parameters
    ----------
    line : the line without the prefix.
    priority : add the prefix, which the journal removes.
    """

    def __init__(self, line: Callable[[logging.LogRecord], str], *, priority: bool) -> None:
        super().__init__()
        self._line, self._priority = line, priority

    def format(self, record: logging.LogRecord) -> str:
        prefix = f"<{PRIORITIES.get(record.levelno, 6)}>" if self._priority else ""
        return prefix + plain(self._line(record).replace("\n", " "))  # devices and Zenoh word some messages


def _text(record: logging.LogRecord) -> str:
    """Return local time, level unless it is ``info``, and text."""
    level = "" if record.levelno == logging.INFO else f"{record.levelname.lower()}: "
    return f"{datetime.fromtimestamp(record.created):%H:%M:%S} {level}{record.getMessage()}"


def _json(record: logging.LogRecord) -> str:
    """Return an object with ``time``, ``level``, ``kind`` and ``text``."""
    fields = {
        "time": stamp(datetime.fromtimestamp(record.created, UTC)),
        "level": record.levelname.lower(),
        "kind": getattr(record, "kind", ""),
        "text": record.getMessage(),
    }
    return json.dumps(fields, ensure_ascii=False)


_LINES: dict[str, Callable[[logging.LogRecord], str]] = {
    "text": _text,
    "journal": logging.LogRecord.getMessage,
    "json": _json,
}


def _journal_reads_stderr() -> bool:
    """Return whether standard error goes to the journal.

    The variable alone does not show it: every shell of a desktop inherits it.
    """
    try:
        stderr = os.fstat(sys.stderr.fileno())
    except (OSError, ValueError, AttributeError):
        return False
    return os.environ.get("JOURNAL_STREAM") == f"{stderr.st_dev}:{stderr.st_ino}"
