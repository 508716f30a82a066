"""Alert command: a command of the user that runs at warnings and errors.

The command gets the event as JSON on standard input. It runs in a thread of its own, so that whatever it does never
delays the daemon: `AlertCommand.submit` returns at once, one command runs at a time, and one that takes longer than
`KILL_S` is killed with its children. Of each kind of event, one a minute is passed on. What is not passed on is
counted: the next event of that kind has the number, and the log has the sum at the end.
"""

from __future__ import annotations

import json
import logging
import os
import signal
import subprocess
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, Full, Queue

from imumon.model.errors import why
from imumon.model.report import Event
from imumon.model.report_json import to_json

KILL_S = 10.0
"""s that the command may take."""
PAUSE_S = 60.0
"""s from one event of a kind that is passed on to the next."""
QUEUE_EVENTS = 100
"""Events that may wait for the command."""
CLOSE_S = 2.0
"""s that events may take at the end of the daemon: it has 10 s for everything."""
LEVELS = ("warning", "error")
"""Levels of the events that are passed on."""
_PRIVATE = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID")
"""Variables between the service manager and the daemon."""

log = logging.getLogger(__name__)


class AlertCommand:
    """Passes events on to a command.

    Parameters
    ----------
    command : for ``/bin/sh``; empty: nothing is done.
    clock : s of a monotonic clock.
    """

    def __init__(self, command: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._command, self._clock = command, clock
        self._queue: Queue[tuple[Event, int] | None] = Queue(QUEUE_EVENTS)
        self._passed_at: dict[str, float] = {}  # by kind, s of the clock
        self._suppressed: Counter[str] = Counter()  # by kind, since the last one that was passed on
        self._all_suppressed = 0
        self._problem: str | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._closing = False
        self._thread: threading.Thread | None = None

    def submit(self, event: Event) -> None:
        """Pass an event on if it matters and its kind is not suppressed; return at once."""
        if not self._command or event.level not in LEVELS or self._closing:
            return
        now, kind = self._clock(), event.kind
        if now - self._passed_at.get(kind, now - PAUSE_S) < PAUSE_S:
            self._suppress(kind)
            return
        try:
            self._queue.put_nowait((event, self._suppressed[kind]))
        except Full:
            self._suppress(kind)
            return
        self._passed_at[kind] = now
        self._suppressed[kind] = 0
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="imumon-alert", daemon=True)
            self._thread.start()

    def _suppress(self, kind: str) -> None:
        self._suppressed[kind] += 1
        self._all_suppressed += 1

    def close(self, within_s: float = CLOSE_S) -> None:
        """Pass on what waits, for at most `within_s` and `CLOSE_S`, then kill a running command."""
        self._closing = True
        lost = 0
        if self._thread is not None:
            with suppress(Full):
                self._queue.put_nowait(None)
                self._thread.join(max(min(within_s, CLOSE_S), 0.0))
            with suppress(Empty):  # the thread must not start another one
                while True:
                    lost += self._queue.get_nowait() is not None
            self._queue.put_nowait(None)
            self._kill(self._process)
            self._thread.join(1.0)
            self._kill(self._process)  # one that began meanwhile
        if self._all_suppressed or lost:
            log.info(
                "the alert command did not get %d events: it gets one of a kind a minute",
                self._all_suppressed + lost,
            )

    def _run(self) -> None:
        while (entry := self._queue.get()) is not None:
            event, suppressed = entry
            data = json.dumps(json.loads(to_json(event)) | {"suppressed": suppressed}, ensure_ascii=False)
            problem = self._execute(data.encode())
            if problem != self._problem and not self._closing:
                self._problem = problem
                if problem is not None:
                    log.warning("the alert command %s", problem)

    def _execute(self, data: bytes) -> str | None:
        """Run the command; return what is wrong with it, None if it has succeeded."""
        environment = {name: value for name, value in os.environ.items() if name not in _PRIVATE}
        try:
            process = self._process = subprocess.Popen(
                ["/bin/sh", "-c", self._command],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                start_new_session=True,
                env=environment,
            )
        except (OSError, ValueError) as error:
            return f"cannot be started: {why(error)}"
        try:
            process.communicate(data + b"\n", KILL_S)
        except subprocess.TimeoutExpired:
            self._kill(process)
            return f"was killed: it took longer than {KILL_S:g} s"
        if process.returncode:
            return f"failed with exit code {process.returncode}"
        return None

    def _kill(self, process: subprocess.Popen[bytes] | None) -> None:
        """Kill the process and its children, which are in its session."""
        if process is not None and process.poll() is None:
            with suppress(OSError):
                os.killpg(process.pid, signal.SIGKILL)
            with suppress(subprocess.TimeoutExpired):
                process.wait(1.0)
