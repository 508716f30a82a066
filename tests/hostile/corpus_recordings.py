"""Hostile recordings: tables, kinds of files, archives and bags that expand, raw captures."""

from __future__ import annotations

import gzip
import io
import os
import sqlite3
import struct
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bags import messages, write_imu
from hostile_input import ESCAPES, Hostile, file
from tables import csv, truth

# ---------------------------------------------------------------------- tables

NAMES = ["time [s]", *(f"gyro_{a} [rad/s]" for a in "xyz"), *(f"accel_{a} [m/s2]" for a in "xyz")]
HEAD = (",".join(NAMES) + "\n").encode()


def table(place: Path, name: str = "a.csv", rows: int = 300, header: list[str] = NAMES) -> Path:
    """Write a valid table of a sensor at rest."""
    t, gyro, accel = truth(rows)
    columns = [t, *gyro.T, *accel.T, t]
    return csv(place / name, header, *columns[: len(header)])


def with_long_lines(place: Path) -> Path:
    path = table(place, rows=400)
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join((*lines[:200], bytes(700_000), b"\n", *lines[200:], bytes(1_000_000))))
    return path


TABLES = (
    Hostile("line-without-an-end", file("a.csv", lambda: HEAD + b"1," * (4 << 20)), "line_too_long"),
    Hostile("lines-that-are-too-long", with_long_lines, "400 samples", says="first line 201"),
    Hostile(
        "header-of-7000-columns",
        file("a.csv", lambda: ",".join(["gyro_x"] * 7000) + "\n" + ",".join("1" * 7000) + "\n"), "too_many_columns",
        seconds=2.0,
    ),
    Hostile(
        "escapes-in-an-unused-column", lambda place: table(place, header=[*NAMES, "mag\x1b\x9b_x"]),
        "300 samples",
    ),
    Hostile("escapes-in-a-missing-file", lambda place: place / f"{ESCAPES}.csv", "not_readable"),
)  # fmt: skip


def capture(fields: bytes) -> Callable[[], bytes]:
    """Return what makes a raw capture with this header and no message."""
    return lambda: b"#imumon-recording " + fields + b"\nabc"


def pipe_beside_a_capture(place: Path) -> Path:
    """Lay a pipe where the second part of a capture would be: to open it would wait for a writer."""
    os.mkfifo(place / "a.0001.bin")
    return file("a.bin", capture(b'{"run": "r", "part": 0, "base": "a.bin"}'))(place)


def pipe_in_a_bag(place: Path) -> Path:
    bag = write_imu(place / "bag", messages(*truth(3)))
    os.mkfifo(bag / "more")
    return bag


KINDS_OF_FILES = (
    Hostile("endless-device", lambda place: Path("/dev/zero"), "not_readable"),
    Hostile("pipe-beside-a-capture", pipe_beside_a_capture, "no_messages"),
    Hostile("pipe-in-a-bag", pipe_in_a_bag, "bag_corrupt"),
)


# ---------------------------------------------------------------------- more than a file holds


def npz_header(shape: tuple[int, ...], kind: str = "<f8") -> bytes:
    out = io.BytesIO()
    np.lib.format.write_array_header_1_0(out, {"descr": kind, "fortran_order": False, "shape": shape})
    return out.getvalue()


def archive(content: Callable[[], bytes], compression: int = zipfile.ZIP_STORED) -> Callable[[Path], Path]:
    """Return what writes an archive of NumPy whose only array is these bytes."""

    def write(place: Path) -> Path:
        with zipfile.ZipFile(place / "a.npz", "w", compression, compresslevel=1) as out:
            out.writestr("gyro.npy", content())
        return place / "a.npz"

    return write


def gzip_bomb(place: Path) -> Path:
    """Write 40 MB of equal rows, compressed."""
    with gzip.open(place / "a.csv.gz", "wb", 1) as out:
        for _ in range(40):
            out.write(b"1,1,1,1\n" * (1 << 17))
    return place / "a.csv.gz"


MORE_THAN_A_FILE_HOLDS = (
    Hostile(
        "archive-that-claims-2^124-numbers",
        archive(lambda: npz_header((2**62, 2**62)) + bytes(24)), "npz_corrupt", says="is corrupt",
    ),
    Hostile(
        "archive-of-288-MB-of-zeros",
        archive(lambda: npz_header((12 << 20, 3)) + bytes(288 << 20), zipfile.ZIP_DEFLATED), "npz_corrupt",
        memory=400 << 20,
    ),
    Hostile("gzip-bomb-of-rows", gzip_bomb, "no_sensor", memory=32 << 20),
    Hostile(
        "gzip-of-20000-empty-members",
        file("a.csv.gz", lambda: gzip.compress(b"") * 20_000 + gzip.compress(b"a,b\n")), "no_rows", seconds=2.5,
    ),
)  # fmt: skip


# ---------------------------------------------------------------------- raw captures

MARK = b"#imumon-recording "
CAPTURES = (
    Hostile(
        "capture-of-an-unknown-driver", file("a.bin", capture(b'{"driver": "\\u001b]0;owned"}')),
        "unknown_device_scheme",
    ),
    Hostile(
        "capture-of-30000-pieces", file("a.bin", lambda: (MARK + b'{"run": "a"}\nx') * 30_000),
        "no_messages", seconds=2.5,
    ),
)  # fmt: skip


# ---------------------------------------------------------------------- bags


def mcap_bomb(place: Path) -> Path:
    """Write an MCAP file of one chunk of zstd data that expands to 600 MB."""
    zstd = (
        pytest.importorskip("backports.zstd", reason="backports.zstd is not installed: it makes the bomb")
        if sys.version_info < (3, 14)
        else __import__("compression.zstd").zstd
    )
    size = 600 << 20
    data = zstd.compress(bytes(size))

    def record(op: int, body: bytes) -> bytes:
        return struct.pack("<BQ", op, len(body)) + body

    def text(value: bytes) -> bytes:
        return struct.pack("<I", len(value)) + value

    chunk = struct.pack("<QQQI", 0, 1, size, 0) + text(b"zstd") + struct.pack("<Q", len(data)) + data
    magic = b"\x89MCAP0\r\n"
    (place / "bag.mcap").write_bytes(
        magic + record(1, text(b"ros2") + text(b"")) + record(6, chunk) + record(2, bytes(20)) + magic
    )
    return place / "bag.mcap"


def yaml_bomb(place: Path) -> Path:
    """Write a bag whose description expands to 9^11 entries."""
    bag = write_imu(place / "bag", messages(*truth(3)))
    lines = ["a0: &a0 {x: 1, y: 2}"]
    lines += [f"a{k}: &a{k} {{<<: [{','.join([f'*a{k - 1}'] * 9)}]}}" for k in range(1, 12)]
    (bag / "metadata.yaml").write_text("\n".join(lines))
    return bag


def endless_view(place: Path) -> Path:
    """Write a bag whose table of definitions is a view without an end."""
    path = next(write_imu(place / "bag", messages(*truth(3))).glob("*.db3"))
    with sqlite3.connect(path) as base:
        base.execute("DROP TABLE message_definitions")
        endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)"
        columns = "i AS id, 'a' AS topic_type, 'b' AS encoding, zeroblob(1000) AS encoded_message_definition"
        base.execute(
            f"CREATE VIEW message_definitions AS {endless} SELECT {columns}, '' AS type_description_hash FROM n"
        )
    return path


IN_BAGS = (
    Hostile("bag-of-expanding-yaml", yaml_bomb, "bag_corrupt", says="cannot be read as a bag"),
    Hostile("bag-of-an-endless-view", endless_view, "bag_corrupt", says="cannot be read as a bag"),
    Hostile("bag-of-expanding-chunks", mcap_bomb, "bag_corrupt", says="cannot be read as a bag"),
)

RECORDINGS = (*TABLES, *KINDS_OF_FILES, *MORE_THAN_A_FILE_HOLDS, *CAPTURES, *IN_BAGS)
