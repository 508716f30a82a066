"""Kinds of recordings, told apart by what they hold: raw bytes, CSV, NumPy archives, ROS bags."""

from __future__ import annotations

import contextlib
from typing import TypeAlias

from imumon.errors import SourceError
from imumon.recordings.columns import layout
from imumon.recordings.csv import CsvFile, header_line, separator_of, split
from imumon.recordings.npz import NpzFile
from imumon.recordings.raw_capture import MARK, RawCapture
from imumon.recordings.rosbag import RosbagFile, is_bag
from imumon.recordings.table import ReadOptions

File: TypeAlias = RawCapture | CsvFile | NpzFile | RosbagFile


def open_file(path: str, wanted: ReadOptions) -> File:
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
        return RosbagFile(path, wanted)
    if head.startswith(b"PK\x03\x04") and path.endswith(".npz"):
        return NpzFile(path, wanted)
    recording = RawCapture(path)
    if recording.head[:2] in (b"\xff\xfe", b"\xfe\xff") and recording.head[:200].count(0) > 50:
        raise SourceError(f"{path} is text in UTF-16: save it as UTF-8")
    return CsvFile(recording, wanted) if is_csv(path, recording.head, wanted) else recording


def is_csv(path: str, head: bytes, wanted: ReadOptions) -> bool:
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
