"""Heap: memory that was freed, given back to the system, for nothing else will do it.

glibc gives each thread a heap of its own, which costs 4 MB here and gains nothing; and it keeps what was
freed below what is still in use: fits and spectra come and go in pieces of some hundred kilobytes, of which
5 MB stay behind. So it is asked for after every report, what lives long is renewed where it lies, and large
pieces keep pages of their own, where glibc would move that mark up to the largest that ever came (a mark of
32 kB costs the monitor a seventh of its time). Python keeps up to two thousand freed tuples of each length
below twenty, which fill report by report to 4 MB; only a full collection lets them go. With another C
library, a Python without ctypes, or a system that lets it not load, all stays as it is.
"""

from __future__ import annotations

import gc
from contextlib import suppress

M_ARENA_MAX, M_MMAP_THRESHOLD = -8, -3  # of malloc.h
APART_BYTES = 1 << 16
_UNABLE = (AttributeError, ImportError, OSError, MemoryError)


def share() -> None:
    """Let all threads share one heap, large pieces apart; to be called before there are threads."""
    with suppress(*_UNABLE):
        import ctypes

        ctypes.pythonapi.mallopt(M_ARENA_MAX, 1)
        ctypes.pythonapi.mallopt(M_MMAP_THRESHOLD, APART_BYTES)


def settle() -> None:
    """What is there now stays: collections need not look at it again, and take a tenth of the time."""
    gc.collect()
    gc.freeze()


def give_back() -> None:
    """Give the system what was freed: a tenth of a millisecond."""
    with suppress(*_UNABLE):
        import ctypes

        ctypes.pythonapi.malloc_trim(0)


def tidy() -> None:
    """Free what nobody can reach and what Python keeps, and give it back: milliseconds, so now and then."""
    gc.collect()
    give_back()
