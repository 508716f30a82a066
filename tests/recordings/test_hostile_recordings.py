"""Recordings and settings that somebody made to harm: an error or a normal read, in bounded time and memory."""

from __future__ import annotations

import gzip
import io
import json
import os
import random
import resource
import sqlite3
import struct
import subprocess
import sys
import threading
import time
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import imumon
from paths import ROOT
from tables import csv, read, replayed, truth
from test_tables import BAGS, write_bag2

from imumon.config import ConfigError, load
from imumon.errors import ImumonError
from imumon.replay import ReplayOptions, replay

NAMES = ["time [s]", *(f"gyro_{a} [rad/s]" for a in "xyz"), *(f"accel_{a} [m/s2]" for a in "xyz")]
KINDS = ["csv", "gz", "npz", "capture", *BAGS]


@contextmanager
def little_memory(extra: int = 1 << 30) -> Iterator[None]:
    """Let this process have so many bytes more than it has now."""
    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    limits = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (now + extra, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limits)


def code_of(path: Path | str, **more: Any) -> str:
    """Return the code of the error that a file causes, with a text that a terminal may show."""
    with pytest.raises(ImumonError) as error:
        replay(ReplayOptions(path=str(path), guarded=False, **more))
    assert str(error.value).isprintable()
    return error.value.code


# ---------------------------------------------------------------- lines


def seconds(path: Path) -> float:
    begin = time.process_time()
    with pytest.raises(ImumonError):
        replay(ReplayOptions(path=str(path)))
    return time.process_time() - begin


def test_the_time_for_a_line_without_an_end_is_linear(tmp_path: Path) -> None:
    """The time for 100 MB in one line was 21 s."""
    head = (",".join(NAMES) + "\n").encode()
    times = []
    for megabytes in (8, 32):
        path = tmp_path / f"{megabytes}.csv"
        path.write_bytes(head + b"1," * (megabytes << 19))
        times.append(min(seconds(path) for _ in range(2)))
    assert times[1] < 7 * times[0] + 0.05
    assert code_of(path) == "line_too_long"


def test_a_line_that_is_too_long_is_one_invalid_row(tmp_path: Path) -> None:
    t, gyro, accel = truth(400)
    path = csv(tmp_path / "a.csv", NAMES, t, gyro, accel)
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join((*lines[:200], bytes(700_000), b"\n", *lines[200:], bytes(1_000_000))))
    report, remarks = replayed(path)
    assert report.session.samples == 400
    assert "line 201 is too long" in remarks


@pytest.mark.parametrize("name", ["", "\x1b]0;owned\x07", "x" * 70_000])
def test_a_header_of_any_width_is_read_in_bounded_time(tmp_path: Path, name: str) -> None:
    path = tmp_path / "wide.csv"
    path.write_text(
        ",".join([f"{name}gyro_x"] * (7000 if len(name) < 99 else 2)) + "\n" + ",".join("1" * 7000) + "\n"
    )
    begin = time.process_time()
    assert code_of(path) in ("too_many_columns", "line_too_long")
    assert time.process_time() - begin < 2.0


def test_tiny_gzip_members_and_lines_of_a_capture_are_read_in_linear_time(tmp_path: Path) -> None:
    member = gzip.compress(b"")
    attacks = {
        "members.csv.gz": member * 20_000 + gzip.compress(b"a,b\n"),
        "marks.bin": b"#imumon-recording " * 60_000,
        "lines.bin": b'#imumon-recording {"run": "a"}\n' * 30_000,
        "pieces.bin": b'#imumon-recording {"run": "a"}\nx' * 30_000,
    }
    for name, data in attacks.items():
        (tmp_path / name).write_bytes(data)
        assert seconds(tmp_path / name) < 2.5, name


# ---------------------------------------------------------------- texts


ESCAPES = "\x1b]0;owned\x07\x1b[2J\x9b1m\u202e"


def test_no_escape_sequence_of_a_file_reaches_a_message(tmp_path: Path) -> None:
    t, gyro, accel = truth(300)
    names = [*NAMES, "mag\x1b\x9b_x"]
    path = csv(tmp_path / "a.csv", names, t, gyro, accel, t)
    _, remarks = replayed(path)
    assert remarks.replace("\n", "").isprintable()
    assert "mag_x" in remarks
    for header in ([f"{ESCAPES}{n}" for n in ("a", "b", "c")], [f"gyro_x [{ESCAPES}]", "b", "c"]):
        code_of(csv(tmp_path / "b.csv", header, gyro[:, 0], gyro[:, 1], gyro[:, 2]))
    code_of(csv(tmp_path / "c.csv", [ESCAPES, *NAMES[1:]], t, gyro, accel))
    np.savez(tmp_path / "d.npz", **{f"{ESCAPES}gyro_x": t})
    code_of(tmp_path / "d.npz")
    code_of(csv(tmp_path / f"{ESCAPES}.csv", ["a", "b"], t, t))
    code_of(tmp_path / f"{ESCAPES}missing.csv")
    (tmp_path / "e.bin").write_text('#imumon-recording {"driver": "\\u001b]0;owned"}\n')
    code_of(tmp_path / "e.bin")
    text = imumon("replay", tmp_path / "b.csv", code=1)
    assert text.rstrip("\n").isprintable()


@pytest.mark.parametrize(
    "text",
    ['"a\\u001b]0;x\\u0007" = 1', '["\\u001b[2J"]\na = 1', '[device]\n"\\u001b]0;x" = 2', '[device]\nbaud = "\\u009b"',
     '[device]\nport = "a\\u0000\\u001b"', '[device]\nid = 3 # \x9b', "\x1b = 1"],
)  # fmt: skip
def test_no_escape_sequence_of_the_settings_reaches_a_message(tmp_path: Path, text: str) -> None:
    (tmp_path / "config.toml").write_text(text)
    with pytest.raises(ConfigError) as error:
        load(tmp_path / "config.toml")
    assert all(line.isprintable() for line in str(error.value).split("\n"))


# ---------------------------------------------------------------- types of files


@pytest.mark.timeout(120)
def test_a_device_is_no_recording_and_a_pipe_is_read_once(tmp_path: Path) -> None:
    assert code_of("/dev/zero") == "not_readable"
    (tmp_path / "link.csv").symlink_to("/dev/zero")
    assert code_of(tmp_path / "link.csv") == "not_readable"
    t, gyro, accel = truth(300)
    path = csv(tmp_path / "a.csv", NAMES, t, gyro, accel)
    (tmp_path / "named.csv").symlink_to(path)
    assert len(read(tmp_path / "named.csv")) == 300
    os.mkfifo(tmp_path / "pipe.csv")
    writer = threading.Thread(target=(tmp_path / "pipe.csv").write_bytes, args=(path.read_bytes(),))
    writer.start()
    assert len(read(tmp_path / "pipe.csv")) == 300
    writer.join()


@pytest.mark.timeout(120)
def test_no_pipe_beside_a_recording_is_opened(tmp_path: Path) -> None:
    header = {"run": "r", "part": 0, "base": "a.bin"}
    (tmp_path / "a.bin").write_bytes(b"#imumon-recording " + json.dumps(header).encode() + b"\nabc")
    os.mkfifo(tmp_path / "a.0001.bin")
    assert code_of(tmp_path / "a.bin") == "no_messages"
    bag = write_bag2(tmp_path / "bag", messages(3))
    os.mkfifo(bag / "more")
    assert code_of(bag) == "bag_corrupt"


def test_a_part_lies_in_the_folder_of_its_recording(tmp_path: Path) -> None:
    for place in ("in/a.bin", "b.0001.bin"):
        (tmp_path / place).parent.mkdir(exist_ok=True)
        header = {"run": "r", "part": int("1" in place), "base": "../b.bin"}
        (tmp_path / place).write_bytes(b"#imumon-recording " + json.dumps(header).encode() + b"\nabc")
    recording = ReplayOptions(path=str(tmp_path / "in/a.bin")).open()
    list(recording)
    assert recording.fed == 3


# ---------------------------------------------------------------- more than a file holds


def npz_header(shape: tuple[int, ...], kind: str = "<f8") -> bytes:
    out = io.BytesIO()
    np.lib.format.write_array_header_1_0(out, {"descr": kind, "fortran_order": False, "shape": shape})
    return out.getvalue()


@pytest.mark.parametrize("shape", [(10**15,), (10**10, 3), (2**62, 2**62), (3 * 10**8,)])
def test_an_archive_that_claims_more_than_it_holds_is_corrupt(tmp_path: Path, shape: tuple[int, ...]) -> None:
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("gyro.npy", npz_header(shape) + bytes(24))
    with little_memory():
        assert code_of(tmp_path / "a.npz") == "npz_corrupt"
        assert "is corrupt" in imumon("replay", tmp_path / "a.npz", code=1)


def test_an_archive_of_zeros_is_no_bomb_for_the_memory(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("gyro.npy", npz_header((12 << 20, 3)) + bytes(288 << 20))
    with little_memory(400 << 20):
        assert code_of(tmp_path / "a.npz") == "npz_corrupt"


def test_a_gzip_bomb_needs_no_memory(tmp_path: Path) -> None:
    for name, piece in (
        ("a.csv.gz", b"1,1,1,1\n" * (1 << 17)),
        ("b.bin.gz", bytes(1 << 20)),
        ("c.csv.gz", bytes(1 << 20)),
    ):
        with gzip.open(tmp_path / name, "wb", 1) as out:
            for _ in range(40):
                out.write(piece)
        with little_memory(32 << 20):
            code_of(tmp_path / name)


def test_a_capture_header_has_no_power(tmp_path: Path) -> None:
    for fields in (
        b'{"part": %s, "base": "a.bin"}' % (b"9" * 4200), b"[" * 60_000, b'{"rate_hz": 1e400, "alias_factor": NaN}',
        b'{"base": "/etc/passwd", "part": 0}', b'{"base": "a\\u0000", "part": 0}',
        b'{"time": "0001-01-01T00:00+14:00"}',
        b'{"caveats": {"a": 1}, "settings": [1], "id": {}}', b'{"away_s": 1e999}', b"\xff\xfe",
    ):  # fmt: skip
        (tmp_path / "a.bin").write_bytes(b"#imumon-recording " + fields + b"\nabc")
        assert code_of(tmp_path / "a.bin") == "no_messages"


# ---------------------------------------------------------------- bags


def messages(n: int) -> list[tuple[int, np.ndarray, np.ndarray]]:
    t, gyro, accel = truth(n)
    stamps = 1_700_000_000_000_000_000 + np.rint(t * 1e9).astype(np.int64)
    return [(int(stamps[k]), gyro[k], accel[k]) for k in range(n)]


def chunk_of_zeros(size: int) -> bytes:
    """Return an MCAP file of one chunk of zstd data that has `size` bytes."""
    zstd = (
        pytest.importorskip("backports.zstd")
        if sys.version_info < (3, 14)
        else __import__("compression.zstd").zstd
    )
    data = zstd.compress(bytes(size))

    def record(op: int, body: bytes) -> bytes:
        return struct.pack("<BQ", op, len(body)) + body

    def text(value: bytes) -> bytes:
        return struct.pack("<I", len(value)) + value

    chunk = struct.pack("<QQQI", 0, 1, size, 0) + text(b"zstd") + struct.pack("<Q", len(data)) + data
    magic = b"\x89MCAP0\r\n"
    return magic + record(1, text(b"ros2") + text(b"")) + record(6, chunk) + record(2, bytes(20)) + magic


def yaml_bomb(path: Path) -> Path:
    bag = write_bag2(path, messages(3))
    lines = ["a0: &a0 {x: 1, y: 2}"]
    lines += [f"a{k}: &a{k} {{<<: [{','.join([f'*a{k - 1}'] * 9)}]}}" for k in range(1, 12)]
    (bag / "metadata.yaml").write_text("\n".join(lines))
    return bag


def endless_view(path: Path) -> Path:
    bag = write_bag2(path, messages(3))
    file = next(bag.glob("*.db3"))
    with sqlite3.connect(file) as base:
        base.execute("DROP TABLE message_definitions")
        endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)"
        columns = "i AS id, 'a' AS topic_type, 'b' AS encoding, zeroblob(1000) AS encoded_message_definition"
        base.execute(
            f"CREATE VIEW message_definitions AS {endless} SELECT {columns}, '' AS type_description_hash FROM n"
        )
    return file


def mcap_bomb(path: Path) -> Path:
    file = path.with_suffix(".mcap")
    file.write_bytes(chunk_of_zeros(600 << 20))
    return file


@pytest.mark.slow
@pytest.mark.timeout(150)
@pytest.mark.parametrize("bomb", [yaml_bomb, endless_view, mcap_bomb])
def test_a_bag_that_expands_ends_its_own_process_only(tmp_path: Path, bomb: Callable[[Path], Path]) -> None:
    path = bomb(tmp_path / "bag")
    with little_memory():
        assert "cannot be read as a bag" in imumon("replay", path, code=1)


def test_a_bag_cannot_have_more_memory_than_its_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The limit of the process that reads it is the kernel's, here a low one that it inherits."""
    path = mcap_bomb(tmp_path / "bag")
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    assert hard == resource.RLIM_INFINITY
    code = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_AS, (800 << 20, 800 << 20));"
        "from imumon.__main__ import main; sys.exit(main())"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, "replay", str(path)], capture_output=True, text=True, timeout=60, check=False,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    assert done.returncode == 1
    assert "far more memory than its size allows" in done.stderr


def test_a_bag_with_another_definition_is_an_error(tmp_path: Path) -> None:
    path = BAGS["rosbag 1"](tmp_path / "bag", messages(3))
    path.write_bytes(path.read_bytes().replace(b"6a62c6daae103f4ff57a132d6f95cec2", b"0" * 32))
    assert code_of(path) == "bag_corrupt"


# ---------------------------------------------------------------- fuzz


def sample(tmp_path: Path, kind: str) -> Path:
    """Write a small valid recording."""
    t, gyro, accel = truth(300)
    if kind in BAGS:
        found = BAGS[kind](tmp_path / "bag", messages(40))
        return next(found.glob("*.db3")) if found.is_dir() else found
    if kind == "npz":
        np.savez_compressed(tmp_path / "a.npz", t=t, gyro=gyro, accel=accel)
        return tmp_path / "a.npz"
    if kind == "capture":
        header = {
            "run": "r",
            "part": 0,
            "base": "a.bin",
            "rate_hz": 100.0,
            "settings": {"a": "b"},
            "time": "2026-01-01",
        }
        lines = b"".join(
            b"$VNYMR,+006.380,+000.023,-001.953,+1.0640,-0.2531,+3.0614,+00.005,+00.344,-09.758,-0.001222,-0.000450,-0.001218*4F\r\n"
            for _ in range(50)
        )
        mark = b"#imumon-recording "
        (tmp_path / "a.bin").write_bytes(
            mark + json.dumps(header).encode() + b"\n" + lines + mark + b'{"away_s": 3}\n' + lines
        )
        return tmp_path / "a.bin"
    return csv(tmp_path / ("a.csv.gz" if kind == "gz" else "a.csv"), NAMES, t, gyro, accel)


def damaged(rng: random.Random, data: bytes) -> bytes:
    """Flip bits, cut, repeat, or enlarge what may be a length."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 5))):
        at = rng.randrange(len(out)) if out else 0
        match rng.randrange(6):
            case 0:
                out[at : at + 1] = bytes([rng.randrange(256)])
            case 1:
                del out[at : at + rng.choice((1, 8, 1000))]
            case 2:
                out[at : at + 4] = struct.pack("<I", rng.choice((0, 1, 2**31 - 1, 2**32 - 1, 2**28)))
            case 3:
                out[at : at + 8] = struct.pack("<Q", rng.choice((0, 2**63 - 1, 2**64 - 1, 2**40)))
            case 4:
                out[at:at] = out[at : at + rng.choice((4, 64, 4096))]
            case _:
                out[at : at + 2] = rng.choice((b"\n\n", b"\x1b[", b',"', b"\0\0", b"\xff\xff", b"1e"))
    return bytes(out)


def fuzz(path: Path, seeds: range) -> None:
    """Read a recording with many kinds of damage: an error that a user may see, or samples."""
    data = path.read_bytes()
    for seed in seeds:
        path.write_bytes(damaged(random.Random(seed), data))
        begin = time.monotonic()
        try:
            recording = ReplayOptions(path=str(path)).open()
            for _ in recording:
                pass
            recording.no_samples()
        except ImumonError as error:
            assert str(error).isprintable(), seed  # noqa: PT017
        except BaseException as error:
            raise AssertionError(seed) from error
        assert time.monotonic() - begin < 60.0, seed


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_recording_is_an_error_or_is_read(tmp_path: Path, kind: str) -> None:
    with little_memory(2 << 30):
        fuzz(sample(tmp_path, kind), range(2 if kind in BAGS else 30))


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("kind", KINDS)
def test_much_damage_to_a_recording_is_an_error_or_is_read(tmp_path: Path, kind: str) -> None:
    with little_memory(2 << 30):
        fuzz(sample(tmp_path, kind), range(100, 200 if kind in BAGS else 3000))


# ---------------------------------------------------------------- settings


BAD_SETTINGS = {
    "dots": "a" + ".a" * 100_000 + " = 1",
    "dots on many lines": "\n".join(f"x{k}" + ".a" * 480 + " = 1" for k in range(200)),
    "blanks": "[" + " " * 200_000,
    "many blanks": ("[" + " " * 900 + "\n") * 200,
    "nested": "a = " + "[" * 900,
    "many sections": "\n".join(f"[s{k}]" for k in range(20_000)),
    "many settings": "[device]\n" + "\n".join(f"s{k} = 1" for k in range(20_000)),
    "large": "#\n" * 1_000_000,
    "long number": "[device]\nrate_hz = " + "9" * 900,
    "long list": "[zenoh]\nconnect = [" + "1,\n" * 60_000 + "]",
}


@pytest.mark.parametrize("name", BAD_SETTINGS)
def test_bad_settings_are_an_error_in_bounded_time(tmp_path: Path, name: str) -> None:
    path = tmp_path / "config.toml"
    path.write_text(BAD_SETTINGS[name])
    begin = time.process_time()
    with pytest.raises(ConfigError) as error:
        load(path)
    assert time.process_time() - begin < 3.0
    assert len(error.value.faults) <= 100


def test_settings_without_an_end_are_an_error() -> None:
    with pytest.raises(ConfigError, match="larger"):
        load("/dev/zero")
    load("/dev/null")


def test_damaged_settings_are_faults_or_are_read(tmp_path: Path) -> None:
    data = (ROOT / "config.toml").read_bytes()
    path = tmp_path / "config.toml"
    for seed in range(150):
        path.write_bytes(damaged(random.Random(seed), data))
        try:
            load(path)
        except ConfigError as error:
            assert all(line.isprintable() for line in str(error).split("\n")), seed  # noqa: PT017
