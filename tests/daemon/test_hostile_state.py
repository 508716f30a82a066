"""A state directory that others may write: links, pipes, devices and forged states do no harm and end nothing."""

from __future__ import annotations

import fcntl
import io
import json
import lzma
import os
import random
import subprocess
import sys
import warnings
import zipfile
from collections.abc import Callable
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imumon.checkpoint import FILE_BYTES, FORMAT, Checkpoint, SavedState, StateError, decode, encode
from imumon.daemon.persistence import Persistence
from imumon.devices.port_device import _saved_settings
from imumon.pipeline import Monitor
from imumon.report import DeviceDescription, SessionCounters, to_json
from imumon.samples import DeviceInfo, SampleBlock, Stream

STATE = SavedState({"serial": "7", "samples": 7}, {"sum": np.arange(5.0)})
STREAM = Stream(kind="deltas", source="made", clock="startup", channels=("gyro/x", "gyro/y", "gyro/z"))


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


def link(path: Path) -> None:
    path.symlink_to(path.with_name("target"))


def huge(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(FILE_BYTES + 1)


OBSTACLES: dict[str, Callable[[Path], Any]] = {
    "link": link,
    "dangling link": lambda path: path.symlink_to(path.with_name("nothing")),
    "endless device": lambda path: path.symlink_to("/dev/zero"),
    "pipe": os.mkfifo,
    "directory": Path.mkdir,
    "larger than any state": huge,
    "nested": lambda path: path.write_bytes(forged(text="[" * 100_000 + "]" * 100_000)),
    "bomb": lambda path: path.write_bytes(bomb(zipfile.ZIP_STORED)),
    "bomb in the archive": lambda path: path.write_bytes(bomb(zipfile.ZIP_DEFLATED)),
    "no archive": lambda path: path.write_bytes(lzma.compress(b"imumon.state.npy" + bytes(999))),
    "no text": lambda path: path.write_bytes(forged(text="")),
    "no object": lambda path: path.write_bytes(forged(text='{"format": 4, "meta": []}')),
    "no format": lambda path: path.write_bytes(forged(text='{"meta": {}}')),
    "no array": lambda path: path.write_bytes(forged(("a", b"12345678"))),
    "huge array": lambda path: path.write_bytes(forged(array("<f8", 10**6, 10**13))),
    "large array": lambda path: path.write_bytes(forged(array("<f8", 10**9))),
    "empty items": lambda path: path.write_bytes(forged(array("<U0", 10**6, 10**13))),
    "objects": lambda path: path.write_bytes(forged(array("|O", 1, content=bytes(8)))),
    "negative": lambda path: path.write_bytes(forged(array("<f8", -1, -1))),
    "escapes": lambda path: path.write_bytes(forged(array("\x1b]0;x\x07", 1))),
}


@pytest.mark.timeout(120)
@pytest.mark.parametrize("obstacle", OBSTACLES)
@pytest.mark.parametrize("name", ["d.state", "d.state.1"])
def test_what_cannot_be_read_is_set_aside_with_one_message(tmp_path: Path, name: str, obstacle: str) -> None:
    (tmp_path / "target").write_bytes(encode(STATE))
    OBSTACLES[obstacle](tmp_path / name)
    checkpoint = Checkpoint(tmp_path, "d")
    state, messages = checkpoint.load()
    assert state is None
    assert len(messages) == 1
    assert messages[0].isprintable()
    assert not os.path.lexists(tmp_path / name)
    assert [path.name for path in tmp_path.glob("d.*-1.state")]
    checkpoint.close(STATE)
    assert checkpoint.failed is None
    assert Checkpoint(tmp_path, "d").load()[0] is not None
    assert (tmp_path / "target").read_bytes() == encode(STATE)


@pytest.mark.timeout(120)
@pytest.mark.parametrize(
    "obstacle", ["link", "dangling link", "endless device", "pipe", "larger than any state"]
)
@pytest.mark.parametrize("name", ["d.state.new", "d.state", "d.state.1", "d.lock"])
def test_a_save_writes_through_nothing_that_is_there(tmp_path: Path, name: str, obstacle: str) -> None:
    target = tmp_path / "target"
    target.write_bytes(b"of somebody")
    OBSTACLES[obstacle](tmp_path / name)
    for _ in range(2):
        checkpoint = Checkpoint(tmp_path, "d")
        checkpoint.close(STATE)
        assert checkpoint.failed is None
    assert target.read_bytes() == b"of somebody"
    assert not (tmp_path / "nothing").exists()
    assert decode((tmp_path / "d.state").read_bytes()).meta == STATE.meta


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


def test_a_start_with_little_memory_sets_a_bomb_aside(tmp_path: Path) -> None:
    (tmp_path / "d.state").write_bytes(bomb(zipfile.ZIP_STORED))
    code = f"from imumon.checkpoint import Checkpoint; from pathlib import Path; c = Checkpoint(Path({str(tmp_path)!r}), 'd'); print(c.load()); c.close()"  # noqa: E501
    done = subprocess.run(
        ["bash", "-c", 'ulimit -v 400000; exec "$0" -c "$1"', sys.executable, code],
        capture_output=True, text=True, timeout=30, check=False,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "d.damaged-1.state").exists()


@pytest.mark.timeout(120)
@pytest.mark.parametrize(
    "content",
    [
        b'{"75": "2,8,01,0001\\r\\n$VNWNV*57"}', b'{"\xc2\xb2": "1"}', b'{"5": 115200}', b'{"5": "\\u001b"}',
        b"[" * 60_000, b'{"5": "1"' + b" " * 70_000 + b"}", b"[]", b"\xff", b"link", b"pipe", b"device",
    ],
)  # fmt: skip
def test_settings_that_somebody_else_wrote_do_not_reach_the_sensor(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "vn100-7.found.json"
    if content in (b"link", b"device"):
        (tmp_path / "target").write_text('{"5": "9600"}')
        path.symlink_to(tmp_path / "target" if content == b"link" else "/dev/zero")
    elif content == b"pipe":
        os.mkfifo(path)
    else:
        path.write_bytes(content)
    assert _saved_settings(path) is None
    path.unlink()
    path.write_text('{"5": "9600", "75": "2,8,01,0001", "new baud": "115200"}')
    assert _saved_settings(path) == json.loads(path.read_text())


# ---------------------------------------------------------------- a forged state, valid as a file


def block(first: int, n: int) -> SampleBlock:
    values = np.random.default_rng(first).normal(size=(n, 3)) * 1e-3
    return SampleBlock(STREAM, values, (first + np.arange(n)) * 10_000_000, np.zeros(n, dtype=np.int64), None)


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> SavedState:
    place = tmp_path_factory.mktemp("state")
    monitor = Monitor(rate_hz=100.0)
    kept = Persistence(place, "lab", monitor)
    kept.restore(DeviceInfo(id="lab", serial="7"))
    monitor.feed(block(0, 3000))
    kept.close(SessionCounters(started="2026-01-01T00:00:00.000Z"))
    return decode((place / "lab.state").read_bytes())


VALUES: list[Any] = [
    None, True, -1, 0, 10**9, 10**30, 10**400, 1e308, -1e308, 1e-320, float("inf"), float("nan"), "", "\x1b[2J",
    "x" * 5000, [], [[]], {}, {"a": {}}, [1, "a"],
]  # fmt: skip


def mutated(rng: random.Random, state: SavedState) -> bytes:
    """Return a state file with one or two values replaced, and the right checksum."""
    meta = json.loads(json.dumps(state.meta))
    arrays = {name: array.copy() for name, array in state.arrays.items()}
    for _ in range(rng.choice((1, 1, 2))):
        if rng.random() < 0.5:
            node: Any = meta
            while True:
                key = rng.choice(list(node) if isinstance(node, dict) else range(len(node)))
                if not isinstance(node[key], dict | list) or not node[key] or rng.random() < 0.1:
                    break
                node = node[key]
            node[key] = json.loads(json.dumps(rng.choice(VALUES)))
        else:
            name = rng.choice(list(arrays))
            array = arrays[name]
            match rng.randrange(5):
                case 0:
                    del arrays[name]
                    continue
                case 1:
                    array = array.reshape(-1)[: array.size // 2]
                case 2:
                    array = array[None]
                case 3 if array.dtype.kind != "U":
                    array = array.astype(rng.choice(("<f4", "<i2", "<U5", "|b1")))
                case _ if array.size and array.dtype.kind in "biuf":
                    array = array.reshape(-1).astype(float)
                    array[rng.randrange(array.size)] = rng.choice((np.nan, np.inf, -1.0, 1e300, 1e18, -1e18))
                    with np.errstate(invalid="ignore", over="ignore"):
                        array = array.astype(arrays[name].dtype).reshape(arrays[name].shape)
            arrays[name] = array
    entries = []
    for name, value in arrays.items():
        made = io.BytesIO()
        np.save(made, value)
        entries.append((name, made.getvalue()))
    return forged(*entries, text=json.dumps({"format": FORMAT, "meta": meta}))


def continued(place: Path, data: bytes) -> tuple[str, str | None]:
    """Start a daemon's record with a state; return what was decided, and the error that samples cause later."""
    for old in place.iterdir():
        old.unlink()
    (place / "lab.state").write_bytes(data)
    monitor = Monitor(rate_hz=100.0)
    kept = Persistence(place, "lab", monitor)
    decided = kept.restore(DeviceInfo(id="lab", serial="7"))
    assert len(decided) == 1
    assert decided[0][0].isprintable()
    error = None
    try:
        if (mismatch := monitor.feed(block(3100, 300))) is not None:
            kept.set_aside_rejected(mismatch)
        now, device = datetime.now(UTC), DeviceDescription(id="lab")
        to_json(monitor.report(now, device, "running", SessionCounters()))
        kept.close(SessionCounters())
    except Exception as later:
        error = repr(later)
        kept._checkpoint.close()
    return decided[0][0], error


def fuzz(place: Path, saved: SavedState, seeds: range) -> list[str]:
    """Return the errors after a start that succeeded; a start that fails fails the test."""
    text, error = continued(place, encode(saved))
    assert "continues" in text
    assert error is None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        errors = (continued(place, mutated(random.Random(seed), saved))[1] for seed in seeds)
        return [error for error in errors if error]


def test_a_forged_state_never_prevents_a_start(tmp_path: Path, saved: SavedState) -> None:
    assert not fuzz(tmp_path, saved, range(15))


@pytest.mark.slow
def test_hardly_any_forged_state_ends_the_daemon_later(tmp_path: Path, saved: SavedState) -> None:
    """What passes the trial at the start may still be a record that no run of imumon writes."""
    assert len(fuzz(tmp_path, saved, range(15, 1015))) <= 10
