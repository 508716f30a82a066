"""Laws of the state file."""

from __future__ import annotations

import errno
import fcntl
import os
import shutil
import threading
import time
import weakref
import zlib
from pathlib import Path

import numpy as np
import pytest

from imumon.checkpoint import Checkpoint, SavedState, StateError, decode, encode

STATE = SavedState({"serial": "0100000001", "samples": 7}, {"sum": np.arange(5.0), "count": np.array([3])})


def same(a: SavedState | None, b: SavedState) -> bool:
    return (
        a is not None and a.meta == b.meta and all(np.array_equal(a.arrays[k], b.arrays[k]) for k in b.arrays)
    )


def test_what_is_read_is_what_was_written(tmp_path: Path) -> None:
    Checkpoint(tmp_path, "vn100-1").close(STATE)
    state, said = Checkpoint(tmp_path, "vn100-1").load()
    assert same(state, STATE)
    assert said == []


def test_no_state_is_no_error(tmp_path: Path) -> None:
    assert Checkpoint(tmp_path / "new", "vn100-1").load() == (None, [])


@pytest.mark.parametrize("damage", ["cut", "flip", "empty", "other"])
def test_damaged_file_is_set_aside_and_the_generation_before_serves(tmp_path: Path, damage: str) -> None:
    Checkpoint(tmp_path, "d").close(STATE)
    newer = SavedState({**STATE.meta, "samples": 9}, STATE.arrays)
    Checkpoint(tmp_path, "d").close(newer)
    path = tmp_path / "d.state"
    data = path.read_bytes()
    flipped = data[:-40] + bytes([data[-40] ^ 1]) + data[-39:]
    path.write_bytes({"cut": data[:-9], "flip": flipped, "empty": b"", "other": b"GIF89a"}[damage])
    kept = path.read_bytes()
    state, said = Checkpoint(tmp_path, "d").load()
    assert same(state, STATE)
    assert len(said) == 1
    assert (tmp_path / "d.damaged-1.state").read_bytes() == kept


def test_newer_format_is_not_touched_but_named() -> None:
    data = encode(STATE).replace(b"imumon-state 2", b"imumon-state 9", 1)
    with pytest.raises(StateError, match="format 9"):
        decode(data)


def test_a_state_of_another_version_is_not_called_damaged(tmp_path: Path) -> None:
    old = encode(STATE).replace(b"imumon-state 2", b"imumon-state 1", 1)
    (tmp_path / "d.state").write_bytes(old)
    state, said = Checkpoint(tmp_path, "d").load()
    assert state is None
    assert "another version" in said[0]
    assert "damaged" not in said[0]
    assert (tmp_path / "d.other-version-1.state").read_bytes() == old


def test_a_wrong_byte_anywhere_is_refused_in_words() -> None:
    data = encode(STATE)
    for at in range(len(data)):
        for value in (data[at] ^ 1, 0, 32, 255):
            if value != data[at]:
                with pytest.raises(StateError) as refused:
                    decode(data[:at] + bytes([value]) + data[at + 1 :])
                assert str(refused.value).isprintable()


@pytest.mark.parametrize("inside", [b"", b"[]\n", b'{"meta":{},"arrays":[["x","zz",[1]]]}\n12345678'])
def test_what_was_packed_by_another_hand_is_refused(inside: bytes) -> None:
    packed = zlib.compress(inside)
    data = b"imumon-state 2 %08x %d\n" % (zlib.crc32(packed), len(packed)) + packed
    with pytest.raises(StateError):
        decode(data)


def test_every_cut_of_a_file_is_refused() -> None:
    data = encode(STATE)
    for length in range(0, len(data), 37):
        with pytest.raises(StateError):
            decode(data[:length])


def test_two_daemons_do_not_share_a_state(tmp_path: Path) -> None:
    first = Checkpoint(tmp_path, "d")
    with pytest.raises(StateError, match="another imumon"):
        Checkpoint(tmp_path, "d")
    first.close()
    Checkpoint(tmp_path, "d").close()


def test_a_share_without_locks_is_not_taken_for_another_daemon(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", refused)
    with pytest.raises(StateError, match=r"no locks available.*--state") as told:
        Checkpoint(tmp_path, "d")
    assert "another imumon" not in str(told.value)


def test_directory_that_cannot_be_had_is_one_clear_line_until_it_can(tmp_path: Path) -> None:
    place = tmp_path / "file"
    place.write_text("")
    keeper = Checkpoint(place / "state", "d")
    assert keeper.failed is not None
    assert "--state" in keeper.failed
    keeper.save(STATE)
    keeper.settle()
    assert keeper.failed
    place.unlink()
    keeper.close(STATE)
    assert keeper.failed is None
    assert same(Checkpoint(place / "state", "d").load()[0], STATE)


def test_a_directory_that_is_removed_is_made_anew_and_locked_anew(tmp_path: Path) -> None:
    place = tmp_path / "state"
    keeper = Checkpoint(place, "d")
    keeper.save(STATE)
    assert keeper.settle()
    shutil.rmtree(place)
    keeper.save(STATE)
    assert keeper.settle()
    assert keeper.failed is None
    with pytest.raises(StateError, match="another imumon"):
        Checkpoint(place, "d")
    shutil.rmtree(place)
    other = Checkpoint(place, "d")  # it was quicker
    keeper.save(SavedState({}, {}))
    assert keeper.settle()
    assert "another imumon" in str(keeper.failed)
    other.close(STATE)
    keeper.close()
    assert same(Checkpoint(place, "d").load()[0], STATE)


def test_what_cannot_be_set_aside_now_is_not_overwritten_and_no_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keeper = Checkpoint(tmp_path, "d")
    keeper.save(STATE)
    assert keeper.settle()
    with monkeypatch.context() as disk:

        def refused(*_: object) -> None:
            raise OSError(errno.EROFS, os.strerror(errno.EROFS))

        disk.setattr(Path, "rename", refused)
        assert keeper.set_aside("other-settings").name == "d.state"
        keeper.save(SavedState({}, {}))
        assert keeper.settle()
        assert "read-only" in str(keeper.failed).lower()
        assert same(decode((tmp_path / "d.state").read_bytes()), STATE)
    keeper.close(SavedState({}, {}))
    assert keeper.failed is None
    assert same(decode((tmp_path / "d.other-settings-1.state").read_bytes()), STATE)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_what_does_not_serve_is_set_aside_once_that_can_be_done(tmp_path: Path) -> None:
    (tmp_path / "d.state").write_bytes(b"GIF89a")
    tmp_path.chmod(0o500)
    keeper = Checkpoint(tmp_path, "d")
    state, said = keeper.load()
    assert state is None
    assert "d.state" in said[0]
    tmp_path.chmod(0o700)
    keeper.close(STATE)
    assert (tmp_path / "d.damaged-1.state").read_bytes() == b"GIF89a"
    assert same(Checkpoint(tmp_path, "d").load()[0], STATE)


def test_failing_disk_is_said_and_the_old_state_stays(tmp_path: Path) -> None:
    Checkpoint(tmp_path, "d").close(STATE)
    if os.geteuid() == 0:
        keeper = Checkpoint(tmp_path, "d")
        (tmp_path / "d.state.new").mkdir()  # the name of the new file is taken
    else:
        keeper = Checkpoint(tmp_path, "d")
        tmp_path.chmod(0o500)
    keeper.close(SavedState({}, {}))
    tmp_path.chmod(0o700)
    assert keeper.failed
    assert same(decode((tmp_path / "d.state").read_bytes()), STATE)


def test_what_is_written_is_let_go_of(tmp_path: Path) -> None:
    checkpoint, array = Checkpoint(tmp_path, "x"), np.zeros(3)
    there = weakref.ref(array)
    checkpoint.save(SavedState({}, {"a": array}))
    del array
    assert checkpoint.settle()
    until = time.monotonic() + 5.0
    while there() is not None and time.monotonic() < until:
        time.sleep(0.01)
    assert there() is None
    checkpoint.close()


def writers() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "checkpoint"]


def test_between_two_saves_no_thread_waits(tmp_path: Path) -> None:
    """For the C library keeps memory for each as long as it lives."""
    checkpoint = Checkpoint(tmp_path, "x")
    for count in (1, 2, 3):
        checkpoint.save(SavedState({"samples": count}, {}))
        assert checkpoint.settle()
        for thread in writers():
            thread.join(5.0)
        assert writers() == []
        assert (checkpoint.saved, checkpoint.failed) == (count, None)
    checkpoint.close()


def test_of_states_that_come_while_one_is_written_the_newest_is_kept(tmp_path: Path) -> None:
    checkpoint = Checkpoint(tmp_path, "x")
    for count in range(100):
        checkpoint.save(SavedState({"samples": count}, STATE.arrays))
    assert checkpoint.settle()
    assert 1 <= checkpoint.saved <= 100
    assert decode(checkpoint.path.read_bytes()).meta["samples"] == 99
    checkpoint.close()


def test_where_no_thread_can_begin_that_is_said_and_the_last_state_is_written_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def begin(self: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    checkpoint = Checkpoint(tmp_path, "x")
    monkeypatch.setattr(threading.Thread, "start", begin)
    checkpoint.save(SavedState({"samples": 1}, {}))
    assert checkpoint.settle(1.0)
    assert checkpoint.failed == "no thread can begin: grant more memory, or more threads"
    checkpoint.close(STATE)
    assert checkpoint.failed is None
    assert same(Checkpoint(tmp_path, "x").load()[0], STATE)


def test_an_error_that_cannot_even_be_told_ends_no_later_save(tmp_path: Path) -> None:
    class Untold(Exception):
        def __str__(self) -> str:
            raise MemoryError

    class Full(Checkpoint):
        def _write(self, data: bytes) -> None:
            raise Untold

    checkpoint = Full(tmp_path, "x")
    for _ in range(2):
        checkpoint.failed = None
        checkpoint.save(STATE)
        assert checkpoint.settle(1.0)
        assert checkpoint.failed == "out of memory: grant more"
    checkpoint.close()


def test_fresh_start_keeps_the_old_one(tmp_path: Path) -> None:
    Checkpoint(tmp_path, "d").close(STATE)
    keeper = Checkpoint(tmp_path, "d")
    aside = keeper.set_aside("before-fresh")
    assert keeper.load() == (None, [])
    assert same(decode(aside.read_bytes()), STATE)


def test_arrays_of_any_kind_and_shape_come_back() -> None:
    arrays = {
        "scalar": np.array(3),
        "empty": np.zeros((0, 4)),
        "words": np.array(["gyro", "accel"]),
        "flags": np.array([[True, False]]),
        "across": np.arange(12.0).reshape(3, 4).T,
        "unknown": np.array([np.nan, 1.0], dtype=np.float32),
    }
    back = decode(encode(SavedState({}, arrays))).arrays
    assert list(back) == list(arrays)
    for name, array in arrays.items():
        assert back[name].dtype == array.dtype
        np.testing.assert_array_equal(back[name], array)
