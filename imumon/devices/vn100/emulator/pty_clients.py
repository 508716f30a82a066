"""Presence of clients: who has the terminal open.

A serial line forgets what nobody listens to; a pseudo-terminal would keep kilobytes of it, and give them to
the next client as if they were fresh. Linux tells of every opening and closing of a file, of a terminal too
(inotify(7)). Where that cannot be had, somebody is always taken to be there.
"""

from __future__ import annotations

import ctypes
import os
import struct

_OPEN, _CLOSE = 0x20, 0x08 | 0x10
_EVENT = struct.Struct("iIII")


class PtyClients:
    """Clients that have a path open, without those who had it when this began.

    Attributes
    ----------
    descriptor : readable when somebody came or went; None where it cannot be told.
    """

    def __init__(self, path: str) -> None:
        self._clients = 0
        self.descriptor: int | None = None
        libc = ctypes.CDLL(None, use_errno=True)
        if not hasattr(libc, "inotify_init1"):
            return
        descriptor = libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        if descriptor >= 0:
            if libc.inotify_add_watch(descriptor, path.encode(), _OPEN | _CLOSE) >= 0:
                self.descriptor = descriptor
            else:
                os.close(descriptor)

    @property
    def anyone(self) -> bool:
        return self.descriptor is None or self._clients > 0

    def changes(self) -> list[bool]:
        """Whether anyone was there after each coming and going since the last call."""
        if self.descriptor is None:
            return []
        seen = []
        try:
            events = os.read(self.descriptor, 4096)
        except BlockingIOError:
            return []
        while events:
            _, mask, _, length = _EVENT.unpack_from(events)
            events = events[_EVENT.size + length :]
            self._clients = max(0, self._clients + bool(mask & _OPEN) - bool(mask & _CLOSE))
            seen.append(self._clients > 0)
        return seen

    def close(self) -> None:
        if self.descriptor is not None:
            os.close(self.descriptor)
            self.descriptor = None
