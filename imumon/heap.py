"""Heap: the C library's memory, one for all threads, and given back.

glibc gives each thread a heap of its own, which costs 4 MB here and gains nothing; and it keeps what was
freed below what is still in use: fits and spectra come and go in pieces of some hundred kilobytes, of which
5 MB stay behind. With another C library, a Python without ctypes, or a system that lets it not load, all
stays as it is.
"""

from __future__ import annotations

from contextlib import suppress

M_ARENA_MAX = -8  # of malloc.h
_UNABLE = (AttributeError, ImportError, OSError, MemoryError)


def share() -> None:
    """Let all threads share one heap; to be called before there are threads."""
    with suppress(*_UNABLE):
        import ctypes

        ctypes.pythonapi.mallopt(M_ARENA_MAX, 1)


def give_back() -> None:
    """Give the system what was freed: a few milliseconds, so now and then."""
    with suppress(*_UNABLE):
        import ctypes

        ctypes.pythonapi.malloc_trim(0)
