"""The C library's heap: what was freed goes back, and where it cannot nothing breaks."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest
from daemons import free_endpoint

from imumon import heap

RESIDENT = """
def resident_kb():
    return next(int(line.split()[1]) for line in open("/proc/self/smaps_rollup") if line.startswith("Rss"))
"""


FREED = (
    RESIDENT
    + """
from imumon import heap
heap.tune()
held = [bytearray(60_000) for _ in range(500)]  # too small for pages of their own
last = bytearray(60_000)  # and what is above them stays
del held
before = resident_kb()
heap.give_back()
print(before - resident_kb())
"""
)


TUPLES = """
import sys
from imumon import heap
def blocks():
    return sys.getallocatedblocks()
heap.settle()
heap.tidy()
before = blocks()
for length in range(2, 20):
    held = [tuple(i for i in range(length)) for _ in range(1500)]
    del held
kept = blocks() - before
heap.tidy()
print(kept, blocks() - before)
"""


ARRAYS = (
    RESIDENT
    + """
import numpy as np
from imumon import heap
heap.tune()
def sizes(more):
    held = [[np.zeros(more + size, dtype=np.uint8) for size in range(1, 1024)] for _ in range(7)]
    assert not any(array.any() for row in held for array in row)
before = np.ones(100)
heap.bypass_cache()
after = np.arange(100.0)
after.resize(3000, refcheck=False)
assert (after[:100] == np.arange(100.0)).all() and not after[100:].any()
del before, after
sizes(2000)  # too large for a cache: what else comes with so many arrays is there
heap.tidy()
began = resident_kb()
sizes(0)
heap.tidy()
print(resident_kb() - began)
"""
)


KEPT = (
    """
from imumon import heap
heap.tune()
"""
    + RESIDENT
    + """
import ctypes
take, free = ctypes.pythonapi.PyMem_RawMalloc, ctypes.pythonapi.PyMem_RawFree
take.restype, take.argtypes, free.argtypes = ctypes.c_void_p, (ctypes.c_size_t,), (ctypes.c_void_p,)
heap.give_back()
before = resident_kb()
pieces = [(take(size), take(10_000)) for size in range(24, 1033, 16) for _ in range(7)]
for pair in pieces:
    for piece in pair:
        free(piece)
heap.give_back()
print(resident_kb() - before)
"""
)


NAMES = """
import tracemalloc
import numpy as np
from imumon.noise.statistics.spectral_lines import BINS, side_levels
power = np.ones((1, BINS))
side_levels(power)
tracemalloc.start()
for _ in range(4000):
    side_levels(power)
print(tracemalloc.get_traced_memory()[0])
"""


def test_no_names_come_and_go() -> None:
    """Each takes a place in Python's table of names; when some thousand are used up, it doubles."""
    done = subprocess.run([sys.executable, "-c", NAMES], capture_output=True, text=True, check=True)
    assert int(done.stdout) < 100_000


def test_freed_tuples_are_not_kept() -> None:
    done = subprocess.run([sys.executable, "-c", TUPLES], capture_output=True, text=True, check=True)
    kept, left = (int(word) for word in done.stdout.split())
    assert left < 0.05 * kept


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc and glibc")
def test_freed_memory_goes_back_to_the_system() -> None:
    done = subprocess.run([sys.executable, "-c", FREED], capture_output=True, text=True, check=True)
    assert int(done.stdout) > 20_000


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc and glibc")
def test_small_arrays_are_not_kept() -> None:
    """A cache would hold 3.5 MB of them: seven of each size."""
    done = subprocess.run([sys.executable, "-c", ARRAYS], capture_output=True, text=True, check=True)
    assert int(done.stdout) < 1000


PLAIN = {
    name: value
    for name, value in os.environ.items()
    if name not in ("PYTHONMALLOC", "PYTHONDEVMODE", heap.TUNABLES)
}
glibc = pytest.mark.skipif(not hasattr(ctypes.pythonapi, "malloc_trim"), reason="needs glibc")


@glibc
def test_nothing_is_kept_for_a_thread() -> None:
    """Seven freed pieces of each size, each on a page of its own, would be 1.2 MB."""
    done = subprocess.run([sys.executable, "-c", KEPT], capture_output=True, text=True, check=True, env=PLAIN)
    assert int(done.stdout) < 400


APART = """
import ctypes, threading
from imumon import heap
heap.tune()
libc = ctypes.pythonapi
class Told(ctypes.Structure):
    _fields_ = [(name, ctypes.c_size_t) for name in "arena ordblks smblks hblks hblkhd usmblks".split()]
    _fields_ += [(name, ctypes.c_size_t) for name in "fsmblks uordblks fordblks keepcost".split()]
libc.mallinfo2.restype = Told
before = libc.mallinfo2().hblks
held = [bytearray(100_000) for _ in range(20)]
print(libc.mallinfo2().hblks - before, flush=True)
take, wait = libc.PyMem_RawMalloc, threading.Event()
take.restype, take.argtypes = ctypes.c_void_p, (ctypes.c_size_t,)
for _ in range(3):
    threading.Thread(target=lambda: (take(2000), wait.wait())).start()
libc.malloc_info(0, ctypes.c_void_p.in_dll(libc, "stdout"))
libc.fflush(None)
wait.set()
"""


@glibc
@pytest.mark.parametrize(("told", "apart"), [("", True), ("glibc.malloc.mmap_threshold=1000000", False)])
def test_large_pieces_lie_apart_and_threads_share_one_heap_unless_the_user_says_else(
    told: str, apart: bool
) -> None:
    words = [sys.executable, "-c", APART]
    done = subprocess.run(
        words, capture_output=True, text=True, check=True, env={**PLAIN, heap.TUNABLES: told}
    )
    assert (int(done.stdout.split()[0]) > 15) is apart  # of 20
    assert done.stdout.count("<heap nr=") == 1


TUNED = """
import os, sys
from imumon import heap
name = open("/proc/self/comm").read().strip()
print(os.getpid(), sys.argv[1:], sys.flags.utf8_mode, os.environ.get(heap.TUNABLES, ""), flush=True)
heap.tune()
print(os.environ.get(heap.STARTED), open("/proc/self/comm").read().strip())
"""


def started(environment: Mapping[str, str], *before: str) -> list[str]:
    """What the script above says each time it begins and once it goes on."""
    words = [*before, sys.executable, "-X", "utf8", "-c", TUNED, "a b", ""]
    done = subprocess.run(words, capture_output=True, text=True, check=True, env={**PLAIN, **environment})
    return done.stdout.splitlines()


@glibc
def test_a_program_starts_anew_once_with_its_own_words() -> None:
    first, second, on = started({heap.TUNABLES: "glibc.malloc.arena_max=3"})
    process, rest = first.split(" ", 1)
    assert rest == "['a b', ''] 1 glibc.malloc.arena_max=3"
    assert second == f"{process} ['a b', ''] 1 {heap.TUNED}:glibc.malloc.arena_max=3"
    assert on.startswith("None ")  # not for its children


@glibc
def test_who_says_it_has_started_starts_once() -> None:
    begun, on = started({heap.STARTED: "other"})
    assert (begun.split(" ", 1)[1], on) == ("['a b', ''] 1 ", "None other")


@glibc
def test_where_it_cannot_start_in_the_same_way_it_goes_on() -> None:
    """No Python, another one, or one under another name, by which it then looks for itself."""
    code = "import sys; sys.executable = sys.argv[1] or None\n" + TUNED
    for other in ("", "/nowhere/python", "/bin/sh"):
        done = subprocess.run(
            [sys.executable, "-c", code, other], capture_output=True, text=True, check=True, env=PLAIN
        )
        assert len(done.stdout.splitlines()) == 2
    begun, _ = started({}, "bash", "-c", 'exec -a imumon "$@"', "bash")
    assert begun.endswith("['a b', ''] 1 ")


@glibc
@pytest.mark.parametrize("module", [True, False], ids=["module", "script"])
def test_a_daemon_runs_with_a_heap_that_was_told_how(module: bool, tmp_path: Path) -> None:
    """And is called what it was called."""
    program = [sys.executable, "-m", "imumon"] if module else [str(Path(sys.executable).with_name("imumon"))]
    words = [*program, "run", "--port", "sim", "--listen", free_endpoint()]
    home = {**PLAIN, "HOME": str(tmp_path)}
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True, env=home) as daemon:
        try:
            assert daemon.stderr is not None
            assert "reading VN-100" in daemon.stderr.readline()
            told = Path(f"/proc/{daemon.pid}/environ").read_text().replace("\0", ":")  # glibc cuts it there
            name = Path(f"/proc/{daemon.pid}/comm").read_text().strip()
        finally:
            daemon.terminate()
    assert f"{heap.TUNABLES}={heap.TUNED}" in told
    assert name == Path(program[0]).name[:15]


LATE = """
from imumon import heap
import numpy as np
heap.bypass_cache()
np.held = [np.arange(n) for n in range(300)]  # goes after what was there before numpy
"""

TRACED = """
import tracemalloc
import numpy as np
from imumon import heap
tracemalloc.start()
heap.bypass_cache()
tracemalloc.stop()
assert np.arange(1000).sum() == 499500
"""


@pytest.mark.parametrize("script", [LATE, TRACED], ids=["at the end", "traced"])
def test_arrays_past_the_cache_are_sound(script: str) -> None:
    """Those that go after all modules, and those of a Python that counted its memory for a while."""
    done = subprocess.run([sys.executable, "-X", "dev", "-c", script], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_another_c_library_is_no_obstacle(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ctypes.pythonapi", object())
    monkeypatch.setattr("os.confstr", lambda name: None)
    monkeypatch.setattr("os.execve", pytest.fail)
    heap.tune()
    heap.bypass_cache()
    heap.give_back()
