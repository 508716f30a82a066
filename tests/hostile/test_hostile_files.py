"""Files that somebody made to harm, or that are damaged: an error or a normal read, in bounded time and memory."""

from __future__ import annotations

import gzip
import io
import json
import os
import random
import sqlite3
import struct
import sys
import threading
import time
import zipfile
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import messages, write_imu
from commands import imumon
from hostile_input import ESCAPES, Hostile, check, file, little_memory, printable
from recordings import IN_PROCESS, WRITERS, text
from tables import csv, options, read, truth

from imumon.api.replay_options import ReplayOptions
from imumon.checkpoint import Checkpoint, encode
from imumon.history.store import HistoryError, HistoryStore
from imumon.model.errors import ImumonError
from imumon.model.report import Event
from imumon.model.saved_state import pack
from imumon.sources.files.recording import Recording

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


@pytest.mark.timeout(150)
@pytest.mark.few
@pytest.mark.parametrize("hostile", RECORDINGS, ids=lambda hostile: hostile.name)
def test_a_hostile_recording_does_what_the_corpus_says(hostile: Hostile, tmp_path: Path) -> None:
    check(hostile, tmp_path)


def sparse(place: Path) -> Path:
    """Write a file of 1 TB that takes no place on the disk."""
    path = place / "report.json"
    with path.open("wb") as out:
        out.write(b"{")
        out.truncate(1 << 40)
    return path


@pytest.mark.parametrize(
    "make",
    [
        file("a\x1b]0;owned\x07.json", lambda: '{"\x1b]0;owned\x07": 1}'),
        lambda place: place / "none\x1b[2J",
        sparse,
    ],
    ids=["escapes", "escapes in a missing file", "1 TB"],
)
def test_a_hostile_report_is_refused_in_printable_words(make: Callable[[Path], Path], tmp_path: Path) -> None:
    with little_memory(1 << 30):
        printable(imumon("report", make(tmp_path), code=1).rstrip("\n"))


# ---------------------------------------------------------------------- more than one file or process


def test_a_pipe_is_read_once(tmp_path: Path) -> None:
    data = table(tmp_path).read_bytes()
    os.mkfifo(tmp_path / "pipe.csv")
    writer = threading.Thread(target=(tmp_path / "pipe.csv").write_bytes, args=(data,))
    writer.start()
    assert len(read(tmp_path / "pipe.csv")) == 300
    writer.join()


def test_a_part_lies_in_the_folder_of_its_recording(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for part, name in enumerate(("in/a.bin", "b.0001.bin")):
        header = {"run": "r", "part": part, "base": "../b.bin"}
        file(name, capture(json.dumps(header).encode()))(tmp_path)
    source = ReplayOptions(path=str(tmp_path / "in/a.bin")).open()
    list(source)
    assert source.fed == 3


# ---------------------------------------- a state directory that others may write


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


# ---------------------------------------- damage that no checksum shows


def read_samples(path: Path) -> tuple[int, Recording]:
    recording = options(path).open()
    return sum(len(item) for items in recording for item in items if hasattr(item, "values")), recording


@pytest.mark.parametrize("beyond", [5e22, -4e16, 3e38])
def test_a_number_of_no_sensor_is_no_sample(beyond: float, tmp_path: Path) -> None:
    t, gyro, accel = truth(300)
    gyro[100, 1] = beyond
    samples, recording = read_samples(text(tmp_path / "a.csv", (t, gyro, accel)))
    assert (samples, recording.bad_checksums) == (299, 1)
    assert any("of no sensor" in remark for remark in recording.remarks)


def test_bytes_between_the_messages_of_a_log_are_remarked(tmp_path: Path) -> None:
    path = sample("a.BIN", tmp_path)
    whole, recording = read_samples(path)
    assert recording.problem is None
    data = path.read_bytes()
    place = data.index(b"\xa3\x95", len(data) // 2)
    path.write_bytes(data[:place] + b"\0" + data[place + 1 :])
    samples, recording = read_samples(path)
    assert samples == whole - 1
    assert "bytes between its messages" in recording.problem


EVENT = Event(time="2026-01-01T00:00:00Z", kind="gap", text="b", device="a", level="warning")


def history(path: Path) -> Path:
    with HistoryStore(path, write=True) as store:
        store.add_events([(1e9, EVENT)])
    return path


@pytest.mark.parametrize("damage", ["DROP TABLE event", "UPDATE event SET text = CAST(x'ff' AS TEXT)"])
def test_a_damaged_history_is_an_error_with_a_code(damage: str, tmp_path: Path) -> None:
    path = history(tmp_path / "a.history.sqlite")
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(damage)
    with HistoryStore(path) as store, pytest.raises(HistoryError) as raised:
        store.events(0.0, 2e9)
    assert raised.value.code == "history_damaged"


LONGEST_S = 10.0
"""s of processor time for one file; most take a hundredth of one, and the process of a log has limits of its own."""


def two_parts(place: Path) -> Path:
    """Write two parts of a raw capture with a pause between them."""
    header = {
        "run": "r",
        "part": 0,
        "base": "a.bin",
        "rate_hz": 100.0,
        "settings": {"a": "b"},
        "time": "2026-01-01",
    }
    sentence = b"$VNYMR,+006.380,+000.023,-001.953,+1.0640,-0.2531,+3.0614,+00.005,+00.344,-09.758,-0.001222,-0.000450,-0.001218*67\r\n"  # noqa: E501
    lines = sentence * 50
    path = place / "a.bin"
    path.write_bytes(MARK + json.dumps(header).encode() + b"\n" + lines + MARK + b'{"away_s": 3}\n' + lines)
    return path


def sample(kind: str, place: Path) -> Path:
    """Write a small valid recording of a kind; return the file that has its samples."""
    if kind == "capture":
        return two_parts(place)
    path = WRITERS[kind](place / kind, truth(40 if kind in IN_PROCESS else 300))
    return next(file for file in path.iterdir() if file.suffix != ".yaml") if path.is_dir() else path


def damaged(rng: random.Random, data: bytes) -> bytes:
    """Flip bits, cut, repeat, or enlarge what may be a length."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 5))):
        place = rng.randrange(len(out)) if out else 0
        match rng.randrange(6):
            case 0:
                out[place : place + 1] = bytes([rng.randrange(256)])
            case 1:
                del out[place : place + rng.choice((1, 8, 1000))]
            case 2:
                out[place : place + 4] = struct.pack("<I", rng.choice((0, 1, 2**31 - 1, 2**32 - 1, 2**28)))
            case 3:
                out[place : place + 8] = struct.pack("<Q", rng.choice((0, 2**63 - 1, 2**64 - 1, 2**40)))
            case 4:
                out[place:place] = out[place : place + rng.choice((4, 64, 4096))]
            case _:
                out[place : place + 2] = rng.choice((b"\n\n", b"\x1b[", b',"', b"\0\0", b"\xff\xff", b"1e"))
    return bytes(out)


def read_damaged(path: Path, seeds: range) -> None:
    """Read a recording with many kinds of damage: an error that a user may see, or samples."""
    data = path.read_bytes()
    for seed in seeds:
        path.write_bytes(damaged(random.Random(seed), data))
        begin = time.process_time()
        try:
            recording = options(path).open()
            for _ in recording:
                pass
            recording.no_samples()
        except ImumonError as error:
            assert str(error).isprintable(), seed  # noqa: PT017
        except BaseException as error:
            raise AssertionError(seed) from error
        assert time.process_time() - begin < LONGEST_S, seed


@pytest.mark.few
@pytest.mark.parametrize("kind", [*WRITERS, "capture"])
def test_a_damaged_recording_is_an_error_or_is_read(tmp_path: Path, kind: str) -> None:
    with little_memory(2 << 30):
        read_damaged(sample(kind, tmp_path), range(2 if kind in IN_PROCESS else 30))
