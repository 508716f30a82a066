"""A state directory that others may write: links, pipes, devices and forged states do no harm and end nothing."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
from pathlib import Path

import pytest
from corpus import through
from corpus_states import bomb
from doors import go_through
from hostile_input import Hostile

from imumon.checkpoint import Checkpoint, StateError


@pytest.mark.timeout(120)
@pytest.mark.parametrize("hostile", through("state", "save", "sensor-settings"))
def test_a_hostile_state_does_what_the_corpus_says(hostile: Hostile, tmp_path: Path) -> None:
    go_through(hostile, tmp_path)


def test_only_the_owner_can_lock_the_state(tmp_path: Path) -> None:
    """Who may read a lock file may lock it, and the daemon would not start."""
    (tmp_path / "d.lock").touch(0o644)
    checkpoint = Checkpoint(tmp_path, "d")
    assert (tmp_path / "d.lock").stat().st_mode & 0o077 == 0
    with pytest.raises(StateError, match="another imumon"):
        Checkpoint(tmp_path, "d")
    checkpoint.close()
    with open(tmp_path / "d.lock") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)


@pytest.mark.slow
def test_a_start_with_little_memory_sets_a_bomb_aside(tmp_path: Path) -> None:
    (tmp_path / "d.state").write_bytes(bomb())
    code = f"from imumon.checkpoint import Checkpoint; from pathlib import Path; c = Checkpoint(Path({str(tmp_path)!r}), 'd'); print(c.load()); c.close()"  # noqa: E501
    done = subprocess.run(
        ["bash", "-c", 'ulimit -v 400000; exec "$0" -c "$1"', sys.executable, code],
        capture_output=True, text=True, timeout=30, check=False,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "d.damaged-1.state").exists()
