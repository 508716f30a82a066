"""A state directory that others may write: links, pipes, devices and forged states do no harm and end nothing."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from imumon.checkpoint import Checkpoint, StateError, encode
from imumon.model.saved_state import pack

STATE = pack({"serial": "7", "samples": 7})
OBSTACLES: dict[str, Callable[[Path], Any]] = {
    "link": lambda path: path.symlink_to(path.with_name("target")),
    "pipe": os.mkfifo,
    "endless-device": lambda path: path.symlink_to("/dev/zero"),
    "bomb": lambda path: path.write_bytes(encode(bytes(300 << 20))),
    "nested": lambda path: path.write_bytes(encode((200_000).to_bytes(8, "little") + b"[" * 200_000)),
    "no-object": lambda path: path.write_bytes(encode(b"12345678")),
}


@pytest.mark.few(2)
@pytest.mark.parametrize("kind", OBSTACLES)
@pytest.mark.parametrize("name", ["d.state", "d.state.1"])
def test_what_is_no_state_is_set_aside_and_replaced(kind: str, name: str, tmp_path: Path) -> None:
    """What a link points to stays as it is."""
    (tmp_path / "target").write_bytes(encode(STATE))
    OBSTACLES[kind](tmp_path / name)
    checkpoint = Checkpoint(tmp_path, "d")
    assert checkpoint.load()[0] is None
    assert not os.path.lexists(tmp_path / name)
    checkpoint.close(STATE)
    assert checkpoint.failed is None
    assert Checkpoint(tmp_path, "d").load()[0] is not None
    assert (tmp_path / "target").read_bytes() == encode(STATE)


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
