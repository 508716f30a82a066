"""Service manager notification (sd_notify): ready, status, watchdog, stopping."""

from __future__ import annotations

import os
import socket

from imumon.report import Report


class ServiceNotifier:
    """The service manager's ear; does nothing where there is none.

    Attributes
    ----------
    watchdog_s : s, half of the time within which the manager wants a sign of life; None: it wants none.
    """

    def __init__(self) -> None:
        self._path = os.environ.get("NOTIFY_SOCKET", "")
        within = os.environ.get("WATCHDOG_USEC", "")
        self.watchdog_s = int(within) / 2e6 if within.isdigit() and self._path else None
        self._ready = False
        self._status = ""

    @property
    def listens(self) -> bool:
        """Whether a service manager started us."""
        return bool(self._path)

    def ready(self) -> None:
        """Up: the first valid sample has come, or the first "waiting"."""
        if not self._ready:
            self._ready = True
            self._send("READY=1")

    def status(self, text: str) -> None:
        if text != self._status:
            self._status = text
            self._send(f"STATUS={text}")

    def alive(self) -> None:
        self._send("WATCHDOG=1")

    def stopping(self) -> None:
        self._send("STOPPING=1")

    def _send(self, text: str) -> None:
        if not self._path:
            return
        address = "\0" + self._path[1:] if self._path.startswith("@") else self._path
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as ear:
                ear.sendto(text.encode(), address)
        except OSError:
            return  # the manager is gone: nothing depends on being heard


def status_line(made: Report) -> str:
    """One line for the service manager."""
    if made.state != "running":
        return f"{made.state}"
    grades = [f"{sensor} {grade.nearest}" for sensor, grade in made.grade.items() if grade.nearest]
    return f"running, {', '.join(grades) or 'no grade yet'}, {made.session.samples} samples"
