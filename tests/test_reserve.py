"""Descriptors that are left for saving when something else has taken all others."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

EXHAUST = """
import os, sys
from contextlib import suppress
from imumon import reserve
from imumon.files import lack_of_files

def exhaust():
    taken = []
    with suppress(OSError):
        while True:
            taken.append(os.open(os.devnull, os.O_RDONLY))
    return taken
"""


def done(script: str, *words: str, files: int = 64) -> str:
    """What a script prints that has so many descriptors."""
    command = ["prlimit", f"--nofile={files}", sys.executable, "-c", EXHAUST + script, *words]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert ran.returncode == 0, ran.stderr
    return ran.stdout


def test_a_state_a_history_and_an_alert_need_no_descriptor_of_others(tmp_path: Path) -> None:
    """They work on with none left, and others get none that they have given back."""
    script = """
from pathlib import Path
from imumon.checkpoint import Checkpoint, SavedState
from imumon.daemon.alert_command import AlertCommand
from imumon.history.history import History
from imumon.report import Event
directory = Path(sys.argv[1])
with reserve.kept():
    checkpoint = Checkpoint(directory, "a")
    taken = exhaust()
    assert lack_of_files() is not None
    for _ in range(20):
        checkpoint.save(SavedState({"serial": "7"}, {}))
        assert checkpoint.flush()
        assert checkpoint.failed is None, checkpoint.failed
    history = History(directory, "a", keep_days=1.0)
    history.close()
    assert history.problems() == []
    alert = AlertCommand(f"cat > {directory}/alert")
    alert.submit(Event(time="2026-01-01T00:00:00Z", kind="gap", text="b", device="a", level="warning"))
    alert.close()
    assert not exhaust()
    os.close(taken.pop())
    assert len(exhaust()) == 1
assert len(exhaust()) == 64 // reserve.SHARE
"""
    done(script, str(tmp_path))
    assert (tmp_path / "a.state.1").exists()
    assert (tmp_path / "a.history.sqlite").exists()
    assert b'"kind"' in (tmp_path / "alert").read_bytes()


def test_a_limit_that_a_library_lifts_is_lowered_again() -> None:
    script = """
import resource
with reserve.kept():
    resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))
    reserve.keep_again()
    with reserve.granted(), reserve.granted():
        print(resource.getrlimit(resource.RLIMIT_NOFILE)[0])
    print(resource.getrlimit(resource.RLIMIT_NOFILE)[0])
reserve.keep_again()
print(resource.getrlimit(resource.RLIMIT_NOFILE)[0])
"""
    assert done(script).split() == ["64", "56", "64"]


def test_without_a_descriptor_the_cure_is_to_allow_more(tmp_path: Path) -> None:
    """Without a reserve: SQLite says only that it cannot open the file."""
    script = """
from pathlib import Path
from imumon.checkpoint import Checkpoint, SavedState
from imumon.history.history import History
checkpoint = Checkpoint(Path(sys.argv[1]), "a")
taken = exhaust()
checkpoint.save(SavedState({}, {}))
checkpoint.flush()
print(checkpoint.failed)
history = History(Path(sys.argv[1]), "a", keep_days=1.0)
history.close()
print(*[text for text, _ in history.problems()])
"""
    for line in done(script, str(tmp_path)).splitlines():
        assert "oo many open files: allow more open files: ulimit -n" in line


def test_a_save_may_take_the_memory_of_the_reserve() -> None:
    """Without it, the same work fails."""
    script = """
import resource
from imumon.reserve import BALLAST_BYTES, kept, with_memory

def room(more):
    pages = int(open("/proc/self/statm").read().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + more, resource.RLIM_INFINITY))

size = BALLAST_BYTES // 2
with kept():
    room(size // 2)
    try:
        bytes(size)
    except MemoryError:
        print("none")
    for _ in range(3):
        print(len(with_memory(lambda: bytes(size))))
    try:
        with_memory(lambda: bytes(4 * size))
    except MemoryError:
        print("not enough")
"""
    assert done(script).split("\n")[:-1] == ["none", *[str(8 << 20)] * 3, "not enough"]
