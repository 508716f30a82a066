"""Hostile states: what is none where a state is read, and what is in the way where one is saved."""

from __future__ import annotations

import io
import lzma
import os
import zipfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from hostile_input import Hostile

from imumon.checkpoint import FILE_BYTES, FORMAT, SavedState, encode

STATE = SavedState({"serial": "7", "samples": 7}, {"sum": np.arange(5.0)})
FOREIGN = b"of somebody"
"""Content of a file that links point to, which a save must not change."""


def forged(
    *entries: tuple[str, bytes],
    text: str = f'{{"format": {FORMAT}, "meta": {{}}}}',
    kind: int = zipfile.ZIP_STORED,
) -> bytes:
    """Return a state file with right checksums and any entries.

    Parameters
    ----------
    entries : name and content of each array.
    text : the description.
    kind : compression inside the archive.
    """
    described = io.BytesIO()
    np.save(described, np.array(text))
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", kind) as out:
        for name, content in (("imumon.state", described.getvalue()), *entries):
            out.writestr(f"{name}.npy", content)
    return lzma.compress(archive.getvalue(), preset=0)


def array(kind: str, *shape: int, content: bytes = b"") -> tuple[str, bytes]:
    """Return an entry whose header says anything."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": kind, "fortran_order": False, "shape": shape})
    return "a", header.getvalue() + content


@cache
def bomb(kind: int) -> bytes:
    """Return a small file with an array larger than any state."""
    return forged(array("|u1", 260 << 20, content=bytes(260 << 20)), kind=kind)


def target_link(path: Path) -> None:
    path.symlink_to(path.with_name("target"))


def huge_state(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(FILE_BYTES + 1)


OBSTACLES: dict[str, Callable[[Path], Any]] = {
    "link": target_link,
    "dangling-link": lambda path: path.symlink_to(path.with_name("nothing")),
    "endless-device": lambda path: path.symlink_to("/dev/zero"),
    "pipe": os.mkfifo,
    "directory": Path.mkdir,
    "larger-than-any-state": huge_state,
    "nested": lambda path: path.write_bytes(forged(text="[" * 100_000 + "]" * 100_000)),
    "bomb": lambda path: path.write_bytes(bomb(zipfile.ZIP_STORED)),
    "bomb-in-the-archive": lambda path: path.write_bytes(bomb(zipfile.ZIP_DEFLATED)),
    "no-archive": lambda path: path.write_bytes(lzma.compress(b"imumon.state.npy" + bytes(999))),
    "no-text": lambda path: path.write_bytes(forged(text="")),
    "no-object": lambda path: path.write_bytes(forged(text='{"format": 4, "meta": []}')),
    "no-format": lambda path: path.write_bytes(forged(text='{"meta": {}}')),
    "no-array": lambda path: path.write_bytes(forged(("a", b"12345678"))),
    "huge-array": lambda path: path.write_bytes(forged(array("<f8", 10**6, 10**13))),
    "large-array": lambda path: path.write_bytes(forged(array("<f8", 10**9))),
    "empty-items": lambda path: path.write_bytes(forged(array("<U0", 10**6, 10**13))),
    "objects": lambda path: path.write_bytes(forged(array("|O", 1, content=bytes(8)))),
    "negative": lambda path: path.write_bytes(forged(array("<f8", -1, -1))),
    "escapes": lambda path: path.write_bytes(forged(array("\x1b]0;x\x07", 1))),
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
        for kind in ("link", "dangling-link", "endless-device", "pipe", "larger-than-any-state")
        for name in ("d.state.new", "d.state", "d.state.1", "d.lock")
    ),
)
