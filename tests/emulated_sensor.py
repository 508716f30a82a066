"""A sensor on a pseudo-terminal that runs in a thread, loses samples, and can be unplugged."""

from __future__ import annotations

import os
import threading
import time
import tty
from contextlib import suppress
from pathlib import Path
from typing import Self

PERIOD_S = 0.005
"""s between two turns of its loop."""


class EmulatedSensor:
    """What its messages are says a derived class in `step`. Its clock continues while it is unplugged.

    Parameters
    ----------
    link : symbolic link to its terminal; None: there is none.

    Attributes
    ----------
    path : of the terminal, or the link.
    rate_hz : messages a second.
    """

    rate_hz = 100.0

    def __init__(self, link: Path | None = None) -> None:
        self._link, self.path = link, ""
        self._lock, self._ending = threading.Lock(), threading.Event()
        self._begin, self._sent, self._hidden = time.monotonic(), 0, 0
        self._master: int | None = None
        self.replug()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join()
        self.unplug()

    def replug(self) -> None:
        """Open a terminal."""
        with self._lock:
            self._master, slave = os.openpty()
            tty.setraw(slave)
            os.set_blocking(self._master, False)
            self.path = os.ttyname(slave)
            os.close(slave)
            if self._link is not None:
                self._link.symlink_to(self.path)
                self.path = str(self._link)

    def unplug(self) -> None:
        """Hang up."""
        with self._lock:
            if self._master is not None:
                os.close(self._master)
                if self._link is not None:
                    self._link.unlink()
            self._master = None

    def lose_samples(self, count: int = 9) -> None:
        """Let some messages be lost."""
        self._hidden = count

    def step(self) -> None:
        """Send what is due, with `_lock`; what cannot be written is lost."""
        raise NotImplementedError

    def due(self) -> range:
        """Return the numbers of the messages since the last turn, without those that are to be lost."""
        until = int((time.monotonic() - self._begin) * self.rate_hz)
        first, self._sent = min(self._sent, until), until
        hidden = min(self._hidden, until - first)
        self._hidden -= hidden
        return range(first + hidden, until)

    def _run(self) -> None:
        while not self._ending.wait(PERIOD_S):
            with self._lock, suppress(OSError):
                self.step()
