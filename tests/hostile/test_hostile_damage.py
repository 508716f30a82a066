"""Damage that no checksum shows: a number of no sensor, and a log that ends within a message."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from damage import SAMPLES
from tables import csv, truth

from imumon.api.replay_options import ReplayOptions
from imumon.history.store import HistoryError, HistoryStore
from imumon.model.report import Event
from imumon.sources.files.recording import Recording


def read(path: Path) -> tuple[int, Recording]:
    recording = ReplayOptions(path=str(path), accept=True).open()
    return sum(len(item) for items in recording for item in items if hasattr(item, "values")), recording


@pytest.mark.parametrize("beyond", [5e22, -4e16, 3e38])
def test_a_number_of_no_sensor_is_no_sample(beyond: float, tmp_path: Path) -> None:
    t, gyro, accel = truth(300)
    gyro[100, 1] = beyond
    names = ["time [s]", *(f"gyro_{a} [rad/s]" for a in "xyz"), *(f"accel_{a} [m/s2]" for a in "xyz")]
    samples, recording = read(csv(tmp_path / "a.csv", names, t, *gyro.T, *accel.T))
    assert (samples, recording.bad_checksums) == (299, 1)
    assert any("of no sensor" in remark for remark in recording.remarks)


def test_bytes_between_the_messages_of_a_log_are_remarked(tmp_path: Path) -> None:
    path = SAMPLES["ardupilot"](tmp_path)
    whole, recording = read(path)
    assert recording.problem is None
    data = path.read_bytes()
    place = data.index(b"\xa3\x95", len(data) // 2)
    path.write_bytes(data[:place] + b"\0" + data[place + 1 :])
    samples, recording = read(path)
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
