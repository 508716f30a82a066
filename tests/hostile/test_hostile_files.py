"""Files that somebody made to harm, or that are damaged: an error or a normal read, in bounded time and memory."""

from __future__ import annotations

import json
import os
import random
import sqlite3
import struct
import threading
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from commands import imumon
from corpus_recordings import MARK, RECORDINGS, capture, table
from hostile_input import Hostile, check, file, little_memory, printable
from recordings import IN_PROCESS, WRITERS, text
from tables import options, read, truth

from imumon.api.replay_options import ReplayOptions
from imumon.checkpoint import Checkpoint, encode
from imumon.history.store import HistoryError, HistoryStore
from imumon.model.errors import ImumonError
from imumon.model.report import Event
from imumon.model.saved_state import pack
from imumon.sources.files.recording import Recording


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
