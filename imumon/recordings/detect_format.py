"""Kinds of recordings, told apart by what they hold: raw bytes, CSV, NumPy archives, ROS bags."""

from __future__ import annotations

import contextlib
from typing import TypeAlias

from imumon.errors import SourceError
from imumon.recordings.columns import layout
from imumon.recordings.csv import Csv, header_line, separator_of, split
from imumon.recordings.npz import Archive
from imumon.recordings.raw_capture import MARK, Recording
from imumon.recordings.rosbag import Bag, is_bag
from imumon.recordings.table import Wanted

File: TypeAlias = Recording | Csv | Archive | Bag


def open_file(path: str, wanted: Wanted) -> File:
    """A recording of whatever kind.

    Raises
    ------
    SourceError : it cannot be read, or is plainly something else.
    """
    head = b""
    if path != "-":
        with contextlib.suppress(OSError), open(path, "rb") as file:
            head = file.read(16)
    if is_bag(path, head):
        return Bag(path, wanted)
    if head.startswith(b"PK\x03\x04") and path.endswith(".npz"):
        return Archive(path, wanted)
    recording = Recording(path)
    if recording.head[:2] in (b"\xff\xfe", b"\xfe\xff") and recording.head[:200].count(0) > 50:
        raise SourceError(f"{path} is text in UTF-16: save it as UTF-8")
    return Csv(recording, wanted) if is_csv(path, recording.head, wanted) else recording


def is_csv(path: str, head: bytes, wanted: Wanted) -> bool:
    """Whether text is a table: its name says so, or its header names an inertial sensor."""
    if b"$VN" in head or head.startswith(MARK):
        return False
    name = path.lower().removesuffix(".gz")
    if name.endswith((".csv", ".tsv")) or wanted.given:
        return True
    if b"\0" in head:
        return False
    lines = head[: 1 << 14].decode("utf-8-sig", "replace").splitlines()
    at = header_line(lines)
    if at is None:
        return False
    try:
        layout(split(lines[at], separator_of(lines[at])))
    except SourceError:
        return False
    return True
