"""Hostile states: what is none where a state is read, and what is in the way where one is saved."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from hostile_input import Hostile

from imumon.checkpoint import encode
from imumon.model.saved_state import pack

STATE = pack({"serial": "7", "samples": 7})
FOREIGN = b"of somebody"
"""Content of a file that links point to, which a save must not change."""


def forged(packed: bytes) -> bytes:
    """Return a state file with a right checksum and any content."""
    return encode(packed)


def described(**content: Any) -> bytes:
    """Return packed objects whose description says anything."""
    text = json.dumps({"root": None, "objects": [], "arrays": []} | content).encode()
    return len(text).to_bytes(8, "little") + text + bytes(64)


@cache
def bomb() -> bytes:
    """Return a small file that expands to more than any state."""
    return forged(bytes(300 << 20))


def target_link(path: Path) -> None:
    path.symlink_to(path.with_name("target"))


OBSTACLES: dict[str, Callable[[Path], Any]] = {
    "link": target_link,
    "endless-device": lambda path: path.symlink_to("/dev/zero"),
    "pipe": os.mkfifo,
    "bomb": lambda path: path.write_bytes(bomb()),
    "no-checksum": lambda path: path.write_bytes(encode(STATE)[:80]),
    "nested": lambda path: path.write_bytes(forged((200_000).to_bytes(8, "little") + b"[" * 200_000)),
    "another-class": lambda path: path.write_bytes(forged(described(objects=[["Popen", {"args": "ls"}]]))),
    "huge-array": lambda path: path.write_bytes(forged(described(arrays=[["<f8", [10**6, 10**13], "C", 0]]))),
    "escapes": lambda path: path.write_bytes(forged(described(objects=[["\x1b]0;x\x07", {}]]))),
}


def obstacle(kind: str, name: str, target: bytes) -> Callable[[Path], Path]:
    """Return what lays an obstacle under a name into a directory, beside the file that its links point to."""

    def lay(place: Path) -> Path:
        (place / "target").write_bytes(target)
        OBSTACLES[kind](place / name)
        return place

    return lay


STATES = (
    *(
        Hostile(
            "state",
            f"{kind}-as-{name}",
            obstacle(kind, name, encode(STATE)),
            "set aside",
            memory=2 << 30,
            seconds=20.0,
        )
        for kind in OBSTACLES
        for name in ("d.state", "d.state.1")
    ),
    *(
        Hostile("save", f"{kind}-as-{name}", obstacle(kind, name, FOREIGN), "replaced")
        for kind in ("link", "endless-device", "pipe")
        for name in ("d.state.new", "d.state", "d.lock")
    ),
)
