"""Stop: what ends a run, a signal or that its time is over.

A signal is only noted; wherever the daemon waits it asks, and leaves by `ShutdownRequested`.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)


class ShutdownRequested(Exception):
    """The daemon is to stop."""


class Shutdown:
    """The end of one run.

    Parameters
    ----------
    duration_s : s of the room until it comes by itself, from now on; None: never.

    Attributes
    ----------
    signal : the one that came last, None before.
    """

    def __init__(self, duration_s: float | None) -> None:
        self.signal: int | None = None
        self._deadline = time.monotonic() + duration_s if duration_s else None

    def ask(self) -> None:
        """Raise `ShutdownRequested` when the daemon is to stop."""
        if self.signal is not None or (self._deadline is not None and time.monotonic() >= self._deadline):
            raise ShutdownRequested

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Meanwhile signals end the run, not the process."""

        def note(number: int, frame: FrameType | None) -> None:
            self.signal = number

        # a terminal that closes is none of the business of what was started with nohup
        heeded = [n for n in SIGNALS if n != signal.SIGHUP or signal.getsignal(n) != signal.SIG_IGN]
        before = {number: signal.signal(number, note) for number in heeded}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
