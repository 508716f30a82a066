"""Messages to the service manager, by the protocol of sd_notify(3).

A message is a datagram to the socket that ``$NOTIFY_SOCKET`` names. Without a service manager nothing is sent,
and a manager that is gone is no error.
"""

from __future__ import annotations

import os
import socket

from imumon.model.messages import grade_text
from imumon.model.report import Report


class ServiceNotifier:
    """Connection to the service manager.

    Attributes
    ----------
    enabled : a service manager has started this process and listens.
    watchdog_s : s, half of the time within which the manager expects `watchdog`; None: it expects none.
    """

    def __init__(self) -> None:
        self._path = os.environ.get("NOTIFY_SOCKET", "")
        timeout_us = os.environ.get("WATCHDOG_USEC", "")
        self.enabled = bool(self._path)
        self.watchdog_s = int(timeout_us) / 2e6 if timeout_us.isdigit() and self.enabled else None
        self._ready = False
        self._status = ""

    def ready(self) -> None:
        """Report that the daemon is up: it has the first valid sample, or waits for a device. Sent once."""
        if not self._ready:
            self._ready = True
            self._send("READY=1")

    def status(self, text: str) -> None:
        """Set the status line. Sent when it changes."""
        if text != self._status:
            self._status = text
            self._send(f"STATUS={text}")

    def watchdog(self) -> None:
        """Report that the daemon is alive."""
        self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """Report that the daemon is ending."""
        self._send("STOPPING=1")

    def _send(self, message: str) -> None:
        if not self.enabled:
            return
        address = "\0" + self._path[1:] if self._path.startswith("@") else self._path
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as connection:
                connection.sendto(message.encode(), address)
        except OSError:
            return  # the manager is gone; nothing depends on it


def status_line(report: Report) -> str:
    """Return the status line of a report: state, grades and samples."""
    if report.state != "running":
        return f"{report.state}"
    grades = "; ".join(f"{sensor}: {grade_text(grade)}" for sensor, grade in report.grade.items())
    return f"running; {grades or 'no grade yet'}; {report.session.samples} samples"
