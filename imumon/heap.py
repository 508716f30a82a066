"""Heap: memory that was freed, given back to the system, for nothing else will do it.

glibc keeps what was freed below what is still in use. It gives each thread a heap of its own, which costs
4 MB here and gains nothing. For each thread it keeps seven freed pieces (16 from 2.43 on) of each of 64 sizes
below a kilobyte: 0.4 MB in all, but what lies between them does not join to larger pieces, and a page goes
back only whole, so that memory grows with all that comes and goes. And once a large piece was freed, others
as large come from amid the rest, not on pages of their own (a mark of 32 kB for these, though, costs the
monitor a seventh of its time). All three it can be told, the second only before a program starts: so the
program starts twice (`tune`). It is asked for what is left after every report, and what lives long is renewed
where it lies.

Python keeps up to two thousand freed tuples of each length below twenty, which fill report by report to 4 MB;
only a full collection lets them go. And numpy keeps up to seven freed pieces of each size below a kilobyte,
3.5 MB when all have come; a record that grows brings ever new ones. Where one of these cannot be had, with
another C library or a Python without ctypes, that stays as it is.
"""

from __future__ import annotations

import gc
import os
import sys
from contextlib import suppress
from importlib import import_module
from typing import Any

TUNABLES = "GLIBC_TUNABLES"
TUNED = ":".join(
    f"glibc.malloc.{name}={value}"
    for name, value in {"arena_max": 1, "mmap_threshold": 1 << 16, "tcache_count": 0}.items()
)
"""One heap, large pieces apart (bytes), nothing kept for a thread."""

STARTED = "IMUMON_STARTED"
"""Name of the process that was started anew; where it is set, once is enough."""
_NAME = "/proc/self/comm"

_RAW = 0  # of Python's memory domains: the C library, without a lock
_GET_VERSION, _SET_HANDLER = 0, 304  # places among numpy's functions, in all of this version
_VERSION = 0x2000000
_HANDLER = b"mem_handler"
_UNABLE = (AttributeError, ImportError, OSError, MemoryError, TypeError, ValueError)


def tune() -> None:
    """Start this program anew, with the words for the C library; what the user says to it stands.

    Returns in the program that was started anew, which keeps its number and its name; and at once, with
    nothing told, where `STARTED` is set, where there is no such C library, or where Python cannot be started
    in the same way. What was done before is done again, so call it first of all; Python starts twice.
    """
    with suppress(*_UNABLE):
        named = os.environ.pop(STARTED, "")
        if named:
            with open(_NAME, "w") as name:  # else it has Python's
                name.write(named)
            return
        if not os.confstr("CS_GNU_LIBC_VERSION") or not os.path.samefile(sys.executable, "/proc/self/exe"):
            return
        told = ":".join(filter(None, (TUNED, os.environ.get(TUNABLES))))  # what comes last stands
        with open(_NAME) as name:
            words = {TUNABLES: told, STARTED: name.read().strip()}
        os.execve(sys.executable, sys.orig_argv, {**os.environ, **words})


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


def tidy() -> None:
    """Free what nobody can reach and what Python keeps, and give it back: milliseconds, so now and then."""
    gc.collect()
    give_back()
