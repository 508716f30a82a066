"""Reserve of descriptors and memory: what the daemon needs to save, to open its port and to run its alert command.

Zenoh takes what comes: it accepts each connection before it looks at its limits, so that connections which send nothing
take all descriptors that a process may have. Those that are closed again are taken by the next ones. A state could not
be saved then, and a sensor that was plugged in again not be opened.

So the limit of the process (the soft one of RLIMIT_NOFILE) stays `FILES` below what it may be (the hard one). `granted`
lifts it for as long as a descriptor is opened. What is open stays open when the limit is lowered again, and what a
library has taken meanwhile is free for the daemon alone as soon as it is closed.

The limit is 1024 at most, whatever the process may have: pyserial waits with ``select``, which takes no higher
descriptor.

Where the memory of the process is limited (RLIMIT_AS, or a machine that grants no more than it has), `BALLAST_BYTES`
are given back for a save that needs them: see `with_memory`. They are never written to, so that they take no memory.

Only the daemon keeps a reserve, while it is in `kept`. `keep_again` follows what has lifted the limit, as each new
session of Zenoh does.
"""

from __future__ import annotations

import mmap
import resource
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TypeVar

FILES = 32
"""Descriptors of the reserve: port 7, alert command 6, state 2, history 4, recording 2, and as many again."""
MOST_FILES = 1024
"""Descriptors that ``select`` can wait for (FD_SETSIZE)."""
SHARE = 8
"""The reserve is this part of all descriptors at most."""

BALLAST_BYTES = 16 << 20
"""Bytes of the reserve of memory: a state of nine channels has 0.3 MB, and its compression takes some times as much."""

T = TypeVar("T")

_lock = threading.Lock()
_ballast: mmap.mmap | None = None
_kept = False
_grants = 0
"""Blocks of `granted` that are open, in all threads."""


@contextmanager
def kept() -> Iterator[None]:
    """Keep a reserve in this block."""
    global _kept
    _take_ballast()
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    with _lock:
        _kept = True
        _set_limit()
    try:
        yield
    finally:
        with _lock, suppress(OSError, ValueError):
            _kept = False
            resource.setrlimit(resource.RLIMIT_NOFILE, before)
        _drop_ballast()


def keep_again() -> None:
    """Lower the limit again, if there is a reserve and something has lifted the limit."""
    with _lock:
        _set_limit()


@contextmanager
def granted() -> Iterator[None]:
    """Let what is opened in this block take from the reserve; make it short."""
    global _grants
    with _lock:
        _grants += 1
        _set_limit()
    try:
        yield
    finally:
        with _lock:
            _grants -= 1
            _set_limit()


def with_memory(work: Callable[[], T]) -> T:
    """Return the result of `work`; if there is no memory for it, try again with that of the reserve.

    Raises
    ------
    MemoryError : that is not enough, either.
    """
    try:
        return work()
    except MemoryError:
        if _ballast is None:
            raise
    _drop_ballast()
    try:
        return work()
    finally:
        _take_ballast()


def _take_ballast() -> None:
    global _ballast
    with suppress(OSError, MemoryError, ValueError):
        _ballast = mmap.mmap(-1, BALLAST_BYTES)


def _drop_ballast() -> None:
    global _ballast
    ballast, _ballast = _ballast, None
    if ballast is not None:
        ballast.close()


def _set_limit() -> None:
    """Set the limit of the process; call it with the lock."""
    if not _kept:
        return
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = MOST_FILES if hard == resource.RLIM_INFINITY else min(hard, MOST_FILES)
    reserve = 0 if _grants else min(FILES, most // SHARE)
    with suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (most - reserve, hard))
