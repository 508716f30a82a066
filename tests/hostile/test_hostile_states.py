"""A state directory that others may write: links, pipes, devices and forged states do no harm and end nothing."""

from __future__ import annotations

import fcntl
import os
import random
import subprocess
import sys
import zipfile
from collections.abc import Iterable
from pathlib import Path

import pytest
from corpus import through
from corpus_states import bomb
from damaged_states import STREAMS, damaged, outcome, saved_record
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


def test_a_start_with_little_memory_sets_a_bomb_aside(tmp_path: Path) -> None:
    (tmp_path / "d.state").write_bytes(bomb(zipfile.ZIP_STORED))
    code = f"from imumon.checkpoint import Checkpoint; from pathlib import Path; c = Checkpoint(Path({str(tmp_path)!r}), 'd'); print(c.load()); c.close()"  # noqa: E501
    done = subprocess.run(
        ["bash", "-c", 'ulimit -v 400000; exec "$0" -c "$1"', sys.executable, code],
        capture_output=True, text=True, timeout=30, check=False,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "d.damaged-1.state").exists()


# ---------------------------------------------------------------- a damaged state, valid as a file


def faults(directory: Path, name: str, seeds: Iterable[int]) -> list[str]:
    """Return what went wrong with the damaged states of some seeds, after one that is not damaged."""
    made, state = STREAMS[name], saved_record(directory / "good", STREAMS[name])
    (directory / "damaged").mkdir()
    good = outcome(directory / "damaged", made, state)
    assert good.continues
    assert not good.fault
    wrong = []
    for seed in seeds:
        damaged_state, damage = damaged(random.Random(seed), state)
        become = outcome(directory / "damaged", made, damaged_state)
        assert become.decision.isprintable()
        if become.fault:
            wrong.append(f"seed {seed}, {damage}: {become.fault}")
    return wrong


@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", STREAMS)
def test_a_damaged_state_is_refused_or_does_no_harm(name: str, tmp_path: Path) -> None:
    assert not faults(tmp_path, name, range(15))


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", STREAMS)
def test_many_damaged_states_are_refused_or_do_no_harm(name: str, tmp_path: Path) -> None:
    assert not faults(tmp_path, name, range(15, 265))
