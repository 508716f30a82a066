"""Clients of a pseudo-terminal: whether any process has it open.

Bytes on a serial line without a reader are lost; a pseudo-terminal keeps kilobytes of them for the next client.
Linux reports every opening and closing of a file, also of a terminal (inotify(7)). Where that is not available,
a client is always assumed.
"""

from __future__ import annotations

import ctypes
import os
import struct

_OPEN, _CLOSE = 0x20, 0x08 | 0x10  # IN_OPEN; IN_CLOSE_WRITE or IN_CLOSE_NOWRITE
_EVENT = struct.Struct("iIII")


class PtyClients:
    """Clients that have opened a path since this object was created.

    Attributes
    ----------
    descriptor : readable when a client opened or closed the path; None if that is not available.
    """

    def __init__(self, path: str) -> None:
        self._clients = 0
        self.descriptor: int | None = None
        libc = ctypes.CDLL(None, use_errno=True)  # the standard library of Python has no inotify
        if not hasattr(libc, "inotify_init1"):
            return
        descriptor = libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        if descriptor >= 0:
            if libc.inotify_add_watch(descriptor, path.encode(), _OPEN | _CLOSE) >= 0:
                self.descriptor = descriptor
            else:
                os.close(descriptor)

    @property
    def any(self) -> bool:
        return self.descriptor is None or self._clients > 0

    def update(self) -> bool:
        """Return whether the terminal was without a client since the last call."""
        if self.descriptor is None:
            return False
        try:
            events = os.read(self.descriptor, 4096)
        except BlockingIOError:
            return False
        left = False
        for _, mask, _, _ in _EVENT.iter_unpack(events):  # without names: the path is a file, no directory
            self._clients = max(0, self._clients + bool(mask & _OPEN) - bool(mask & _CLOSE))
            left |= self._clients == 0
        return left

    def close(self) -> None:
        if self.descriptor is not None:
            os.close(self.descriptor)
            self.descriptor = None
