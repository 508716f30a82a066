"""Heap: memory that was freed, given back to the system, for nothing else will do it.

glibc gives each thread a heap of its own, which costs 4 MB here and gains nothing; and it keeps what was
freed below what is still in use: fits and spectra come and go in pieces of some hundred kilobytes, of which
5 MB stay behind. So it is asked for after every report, what lives long is renewed where it lies, and large
pieces keep pages of their own, where glibc would move that mark up to the largest that ever came (a mark of
32 kB costs the monitor a seventh of its time). Python keeps up to two thousand freed tuples of each length
below twenty, which fill report by report to 4 MB; only a full collection lets them go. And numpy keeps up to
seven freed pieces of each size below a kilobyte, 3.5 MB when all have come; a record that grows brings ever
new ones. glibc, too, keeps seven of each of 64 sizes below a kilobyte for each thread: 0.2 MB, but what lies
between them does not join to larger pieces, and a page goes back only whole. So those of the loop are laid
side by side, and a thread without work had better end. Where one of these cannot be had, with another C
library or a Python without ctypes, that stays as it is.
"""

from __future__ import annotations

import gc
from contextlib import suppress
from importlib import import_module
from typing import Any

M_ARENA_MAX, M_MMAP_THRESHOLD = -8, -3  # of malloc.h
APART_BYTES = 1 << 16
KEPT, KEPT_BYTES = 16, range(520, 1033, 16)
"""Freed pieces of a size that the C library keeps for a thread at most (glibc before 2.43: 7), and the sizes;
there are smaller ones, of which Python takes few."""

_RAW = 0  # of Python's memory domains: the C library, without a lock
_GET_VERSION, _SET_HANDLER = 0, 304  # places among numpy's functions, in all of this version
_VERSION = 0x2000000
_HANDLER = b"mem_handler"
_UNABLE = (AttributeError, ImportError, OSError, MemoryError, ValueError)


def share() -> None:
    """Let all threads share one heap, large pieces apart; to be called before there are threads."""
    with suppress(*_UNABLE):
        import ctypes

        ctypes.pythonapi.mallopt(M_ARENA_MAX, 1)
        ctypes.pythonapi.mallopt(M_MMAP_THRESHOLD, APART_BYTES)


def bypass_cache() -> None:
    """Let new arrays of this thread take memory from the C library, not from numpy's cache of small pieces.

    numpy takes other routines for that (NEP 49): five pointers, after a name and a version. Those that Python
    has for raw memory take the same arguments; its `free` asks for no size, and gets one to ignore. While
    Python traces them, or with another numpy than 2, all stays as it is.
    """
    with suppress(*_UNABLE):
        import _tracemalloc
        import ctypes

        class Handler(ctypes.Structure):
            _fields_ = (
                ("name", ctypes.c_char * 127),
                ("version", ctypes.c_uint8),
                ("routines", ctypes.c_void_p * 5),
            )

        def python(name: str, *types: Any) -> Any:
            return ctypes.PYFUNCTYPE(*types)((name, ctypes.pythonapi))

        api: Any = import_module("numpy._core._multiarray_umath")._ARRAY_API
        pointer = python("PyCapsule_GetPointer", ctypes.c_void_p, ctypes.py_object, ctypes.c_char_p)
        functions = ctypes.cast(pointer(api, None), ctypes.POINTER(ctypes.c_void_p))
        version = ctypes.PYFUNCTYPE(ctypes.c_uint)(functions[_GET_VERSION] or 0)
        if version() != _VERSION or _tracemalloc.is_tracing():
            return
        routines = (ctypes.c_void_p * 5)()
        python("PyMem_GetAllocator", None, ctypes.c_int, ctypes.c_void_p)(_RAW, ctypes.byref(routines))
        handler = Handler(b"imumon", 1, routines)
        for needed in (handler, _HANDLER):  # by the last array, which goes after this module
            python("Py_IncRef", None, ctypes.py_object)(needed)
        capsule = python("PyCapsule_New", ctypes.py_object, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p)
        use = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.py_object)(functions[_SET_HANDLER] or 0)
        use(capsule(ctypes.addressof(handler), _HANDLER, None))


def settle() -> None:
    """What is there now stays: collections need not look at it again, and take a tenth of the time."""
    gc.collect()
    gc.freeze()


def give_back() -> None:
    """Give the system what was freed: a tenth of a millisecond."""
    with suppress(*_UNABLE):
        import ctypes

        ctypes.pythonapi.malloc_trim(0)


def repack() -> None:
    """Let what the C library keeps for this thread lie in holes, not where it was when it was freed.

    Of each size as many are taken as are kept, and as many new ones; the new ones are freed first.
    """
    with suppress(*_UNABLE):
        import ctypes

        take, free = ctypes.pythonapi.PyMem_RawMalloc, ctypes.pythonapi.PyMem_RawFree
        take.restype, take.argtypes = ctypes.c_void_p, (ctypes.c_size_t,)
        free.restype, free.argtypes = None, (ctypes.c_void_p,)
        for size in KEPT_BYTES:
            pieces = [take(size) for _ in range(2 * KEPT)]
            for piece in pieces[KEPT:] + pieces[:KEPT]:
                free(piece)


def tidy() -> None:
    """Free what nobody can reach and what Python keeps, and give it back: milliseconds, so now and then."""
    gc.collect()
    repack()
    give_back()
