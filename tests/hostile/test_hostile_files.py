"""Files that somebody made to harm, or that are damaged: an error or a normal read, in bounded time and memory."""

from __future__ import annotations

import fcntl
import json
import os
import random
import sqlite3
import threading
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from corpus_recordings import RECORDINGS, SAVED, SETTINGS, capture, table
from damage import OWN_PROCESS, SAMPLES, damaged, read_damaged
from hostile_input import Hostile, file, go_through, little_memory, printable, rows
from paths import ROOT
from tables import csv, read, truth

from imumon.api.replay_options import ReplayOptions
from imumon.checkpoint import Checkpoint, StateError, encode
from imumon.config import ConfigError, load
from imumon.history.store import HistoryError, HistoryStore
from imumon.model.report import Event
from imumon.model.saved_state import pack
from imumon.sources.files.recording import Recording


@pytest.mark.timeout(150)
@pytest.mark.parametrize("hostile", rows((*RECORDINGS, *SETTINGS, *SAVED)))
def test_a_hostile_file_does_what_the_corpus_says(hostile: Hostile, tmp_path: Path) -> None:
    go_through(hostile, tmp_path)


# ---------------------------------------------------------------------- random damage


@pytest.mark.few
@pytest.mark.parametrize("kind", SAMPLES)
def test_a_damaged_recording_is_an_error_or_is_read(tmp_path: Path, kind: str) -> None:
    with little_memory(2 << 30):
        read_damaged(SAMPLES[kind](tmp_path), range(2 if kind in OWN_PROCESS else 30))


def test_damaged_settings_are_faults_or_are_read(tmp_path: Path) -> None:
    data = (ROOT / "config.toml").read_bytes()
    path = tmp_path / "config.toml"
    for seed in range(150):
        path.write_bytes(damaged(random.Random(seed), data))
        try:
            load(path)
        except ConfigError as error:
            printable(str(error))


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


# ---------------------------------------- damage that no checksum shows


def read_samples(path: Path) -> tuple[int, Recording]:
    recording = ReplayOptions(path=str(path), accept=True).open()
    return sum(len(item) for items in recording for item in items if hasattr(item, "values")), recording


@pytest.mark.parametrize("beyond", [5e22, -4e16, 3e38])
def test_a_number_of_no_sensor_is_no_sample(beyond: float, tmp_path: Path) -> None:
    t, gyro, accel = truth(300)
    gyro[100, 1] = beyond
    names = ["time [s]", *(f"gyro_{a} [rad/s]" for a in "xyz"), *(f"accel_{a} [m/s2]" for a in "xyz")]
    samples, recording = read_samples(csv(tmp_path / "a.csv", names, t, *gyro.T, *accel.T))
    assert (samples, recording.bad_checksums) == (299, 1)
    assert any("of no sensor" in remark for remark in recording.remarks)


def test_bytes_between_the_messages_of_a_log_are_remarked(tmp_path: Path) -> None:
    path = SAMPLES["ardupilot"](tmp_path)
    whole, recording = read_samples(path)
    assert recording.problem is None
    data = path.read_bytes()
    place = data.index(b"\xa3\x95", len(data) // 2)
    path.write_bytes(data[:place] + b"\0" + data[place + 1 :])
    samples, recording = read_samples(path)
    assert samples == whole - 1
    assert recording.problem is not None
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
