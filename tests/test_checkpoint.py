"""Laws of the state file, and of files that are written whole or not at all."""

from __future__ import annotations

import errno
import fcntl
import os
import resource
import signal
import stat
import threading
from pathlib import Path
from typing import Any

import pytest

from imumon import checkpoint as format_of
from imumon.checkpoint import Checkpoint, StateError, decode, encode, is_state
from imumon.files import rename_aside, replace_file, write_new
from imumon.model.saved_state import pack, unpack

STATE = pack({"serial": "0100000001", "samples": 7, "sum": [1.5, 2.5]})


def same(a: Any, b: bytes) -> bool:
    return bool(a == unpack(b))


@pytest.mark.parametrize("links", [True, False], ids=["links", "no-links"])
def test_a_state_has_its_name_at_each_moment_of_a_save(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, links: bool
) -> None:
    """A program that reads it during a save, or after a kill within one, finds the old state or the new one."""
    path, present = tmp_path / "d.state", []
    Checkpoint(tmp_path, "d").close(STATE)
    replace = os.replace

    def watched(source: Path, target: Path) -> None:
        replace(source, target)
        present.append(path.exists())

    def refused(*_: object, **__: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "replace", watched)
    if not links:
        monkeypatch.setattr(os, "link", refused)
    for _ in range(2):
        Checkpoint(tmp_path, "d").close(STATE)
    assert present == [links, True] * 2
    assert sorted(file.name for file in tmp_path.iterdir()) == ["d.lock", "d.state", "d.state.1"]


@pytest.mark.parametrize("damage", ["cut", "flip", "empty", "other"])
def test_a_damaged_file_is_set_aside_and_the_previous_generation_is_loaded(
    tmp_path: Path, damage: str
) -> None:
    Checkpoint(tmp_path, "d").close(STATE)
    newer = pack({"samples": 9})
    Checkpoint(tmp_path, "d").close(newer)
    path = tmp_path / "d.state"
    data = path.read_bytes()
    flipped = data[:-40] + bytes([data[-40] ^ 1]) + data[-39:]
    path.write_bytes({"cut": data[:-9], "flip": flipped, "empty": b"", "other": b"GIF89a"}[damage])
    kept = path.read_bytes()
    state, messages = Checkpoint(tmp_path, "d").load()
    assert same(state, STATE)
    assert len(messages) == 1
    assert (tmp_path / "d.damaged-1.state").read_bytes() == kept


def of_another_version(monkeypatch: pytest.MonkeyPatch) -> bytes:
    with monkeypatch.context() as other:
        other.setattr(format_of, "FORMAT", 99)
        return encode(STATE)


def test_another_format_has_its_own_error(monkeypatch: pytest.MonkeyPatch) -> None:
    data = of_another_version(monkeypatch)
    assert is_state(data[:256])
    with pytest.raises(StateError) as caught:
        decode(data)
    assert caught.value.code == "state_version"


def test_a_wrong_byte_anywhere_is_detected() -> None:
    data = encode(STATE)
    for at in range(len(data)):
        for value in (data[at] ^ 1, 0, 32, 255):
            if value != data[at]:
                with pytest.raises(StateError) as caught:
                    decode(data[:at] + bytes([value]) + data[at + 1 :])
                assert caught.value.code in ("state_invalid", "state_version", "state_damaged")
                assert str(caught.value).isprintable()


def test_two_daemons_cannot_use_the_same_state_and_only_its_owner_can_lock_it(tmp_path: Path) -> None:
    """Who may read a lock file may lock it, and the daemon would not start."""
    (tmp_path / "d.lock").touch(0o644)
    first = Checkpoint(tmp_path, "d")
    assert (tmp_path / "d.lock").stat().st_mode & 0o077 == 0
    with pytest.raises(StateError) as caught:
        Checkpoint(tmp_path, "d")
    assert caught.value.code == "state_locked"
    first.close()
    Checkpoint(tmp_path, "d").close()


def test_a_file_system_without_locks_has_its_own_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", refuse)
    with pytest.raises(StateError, match=r"no locks available.*--state") as caught:
        Checkpoint(tmp_path, "d")
    assert caught.value.code == "state_not_lockable"


def test_an_unusable_directory_is_reported_until_it_becomes_usable(tmp_path: Path) -> None:
    directory = tmp_path / "file"
    directory.write_text("")
    checkpoint = Checkpoint(directory / "state", "d")
    assert "--state" in checkpoint.failed
    checkpoint.save(STATE)
    checkpoint.flush()
    assert checkpoint.failed
    directory.unlink()
    checkpoint.close(STATE)
    assert checkpoint.failed is None
    assert same(Checkpoint(directory / "state", "d").load()[0], STATE)


def test_a_state_that_cannot_be_set_aside_is_not_overwritten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    checkpoint = Checkpoint(tmp_path, "d")
    checkpoint.save(STATE)
    assert checkpoint.flush()
    with monkeypatch.context() as disk:

        def refuse(*_: object) -> None:
            raise OSError(errno.EROFS, os.strerror(errno.EROFS))

        disk.setattr(Path, "rename", refuse)
        assert checkpoint.set_aside("other-settings").name == "d.state"
        checkpoint.save(pack({}))
        assert checkpoint.flush()
        assert "read-only" in str(checkpoint.failed).lower()
        assert same(decode((tmp_path / "d.state").read_bytes()), STATE)
    checkpoint.close(pack({}))
    assert checkpoint.failed is None
    assert same(decode((tmp_path / "d.other-settings-1.state").read_bytes()), STATE)


def test_of_states_saved_during_a_write_the_newest_is_written(tmp_path: Path) -> None:
    checkpoint = Checkpoint(tmp_path, "x")
    for count in range(100):
        checkpoint.save(pack({"samples": count}))
    assert checkpoint.flush()
    assert decode(checkpoint.path.read_bytes())["samples"] == 99
    checkpoint.close()


def test_without_a_thread_the_failure_is_reported_and_close_still_writes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def begin(self: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    checkpoint = Checkpoint(tmp_path, "x")
    monkeypatch.setattr(threading.Thread, "start", begin)
    checkpoint.save(pack({"samples": 1}))
    assert checkpoint.flush()
    assert checkpoint.failed == "a thread cannot be started: grant more memory or more threads"
    checkpoint.close(STATE)
    assert checkpoint.failed is None
    assert same(Checkpoint(tmp_path, "x").load()[0], STATE)


def test_a_disk_with_room_for_two_states_keeps_the_newest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The older generation makes room: the newest state stays until the next one is whole."""
    room = int(2.5 * len(encode(pack({"samples": 9, "sum": [1.5] * 40}))))

    def small(path: Path, data: bytes) -> None:
        used = {file.stat().st_ino: file.stat().st_size for file in tmp_path.iterdir() if file != path}
        if sum(used.values()) + len(data) > room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        write_new(path, data)
        assert path.name == "d.state.new"

    monkeypatch.setattr(format_of, "write_new", small)
    checkpoint = Checkpoint(tmp_path, "d")
    for samples in range(5):
        checkpoint.save(pack({"samples": samples, "sum": [1.5] * 40}))
        assert checkpoint.flush()
        assert checkpoint.failed is None
    other = tmp_path / "other"
    other.write_bytes(bytes(room))
    newest = checkpoint.path.read_bytes()
    checkpoint.save(STATE)
    assert checkpoint.flush()
    assert checkpoint.failed is not None
    assert checkpoint.path.read_bytes() == newest
    other.unlink()
    checkpoint.close(STATE)
    assert checkpoint.failed is None
    assert same(Checkpoint(tmp_path, "d").load()[0], STATE)


# ---------------------------------------- files that are written whole or not at all


def test_a_file_is_replaced_with_its_mode_and_through_its_link(tmp_path: Path) -> None:
    file, link = tmp_path / "page.html", tmp_path / "link.html"
    file.write_bytes(b"old")
    file.chmod(0o640)
    link.symlink_to(file)
    replace_file(link, b"new")
    assert link.is_symlink()
    assert file.read_bytes() == b"new"
    assert stat.S_IMODE(file.stat().st_mode) == 0o640
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link.html", "page.html"]


def test_a_full_disk_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    """A limit on the size of files replaces the disk."""
    file = tmp_path / "page.html"
    file.write_bytes(b"old")
    before, handler = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        with pytest.raises(OSError, match="too large"):
            replace_file(file, b"x" * 5000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    assert file.read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]


def test_a_pipe_is_written_as_it_is(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    replace_file(pipe, b"data")
    assert os.read(reader, 100) == b"data"
    os.close(reader)


@pytest.mark.parametrize(("reason", "kept"), [("damaged", range(16, 26)), ("other-version", range(1, 26))])
def test_of_files_that_nobody_can_use_the_newest_are_kept(tmp_path: Path, reason: str, kept: range) -> None:
    (tmp_path / "a.damaged-x.state").write_text("of somebody else")
    for number in range(1, 26):
        (tmp_path / "a.state").write_text(str(number))
        assert rename_aside(tmp_path / "a.state", "a", reason, ".state").read_text() == str(number)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"a.damaged-x.state", *(f"a.{reason}-{number}.state" for number in kept)}
