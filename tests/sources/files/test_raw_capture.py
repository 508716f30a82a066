"""Raw captures: written, read back, and what is left of corrupt ones."""

from __future__ import annotations

import contextlib
import gzip
import os
import random
import subprocess
import sys
import zlib
from pathlib import Path

import pytest
from waiting import until

from imumon.sources.files import CaptureWriter, RawCapture, RecordingError
from imumon.sources.files.raw_capture import INFLATED_AT_ONCE


def contents(path: Path | str) -> bytes:
    return b"".join(RawCapture(str(path)))


@pytest.fixture(scope="module")
def noise() -> bytes:
    return random.Random(5).randbytes(700_000)


@pytest.mark.parametrize("name", ["run.bin", "run.bin.gz"])
@pytest.mark.parametrize("rotate", [0, 100_000])
def test_a_recording_is_read_back(tmp_path: Path, noise: bytes, name: str, rotate: int) -> None:
    path = str(tmp_path / name)
    recorder = CaptureWriter(
        path, {"time": "2026-01-01T00:00:00Z", "serial": "0100056785"}, rotate_bytes=rotate
    )
    for at in range(0, len(noise), 70_000):
        recorder.write(noise[at : at + 70_000])
        if rotate:
            until(lambda at=at: recorder.written_bytes >= at)
    recorder.close()
    assert recorder.stopped is None
    assert recorder.written_bytes == len(noise)
    recording = RawCapture(path)
    assert recording.header is not None
    assert recording.header["serial"] == "0100056785"
    assert b"".join(recording) == noise
    assert recording.problem is None
    assert recording.progress == 1.0


@pytest.fixture(autouse=True)
def _no_delay(monkeypatch: pytest.MonkeyPatch) -> None:
    """Flush at once: these tests wait for what is on disk."""
    monkeypatch.setattr("imumon.sources.files.capture_writer.FLUSH_S", 0.01)


def test_an_old_recording_is_never_overwritten_nor_mixed(tmp_path: Path) -> None:
    path = str(tmp_path / "run.bin")
    for data in (b"first", b"second"):
        recorder = CaptureWriter(path, {})
        recorder.write(data)
        recorder.close()
    assert contents(path) == b"first"
    assert contents(tmp_path / "run.0001.bin") == b"second"


def test_a_slow_disk_never_blocks_the_reading(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imumon.sources.files.capture_writer.BACKLOG", 10_000)
    fifo = tmp_path / "slow"
    os.mkfifo(fifo)
    reader = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)
    recorder = CaptureWriter(str(fifo), {})
    until(lambda: recorder.write(bytes(1000)) or recorder.stopped)  # a write that waits has no end
    assert "too slow" in str(recorder.stopped)
    os.close(reader)
    recorder.close()


def test_a_recording_of_a_killed_process_is_readable_to_the_last_second(tmp_path: Path, noise: bytes) -> None:
    path = tmp_path / "run.bin.gz"
    recorder = CaptureWriter(str(path), {})
    recorder.write(noise[:1000])
    until(lambda: recorder.written_bytes == 1000)
    os.link(path, tmp_path / "as killed")
    (tmp_path / "copy.gz").write_bytes(path.read_bytes())
    recording = RawCapture(str(tmp_path / "copy.gz"))
    assert b"".join(recording) == noise[:1000]
    assert recording.problem is not None
    assert "truncated" in recording.problem
    recorder.close()


def test_what_lies_before_a_corruption_is_read(tmp_path: Path, noise: bytes) -> None:
    path, data = tmp_path / "run.gz", bytearray(gzip.compress(noise, 1))
    data[300_000:300_100] = bytes(100)
    path.write_bytes(data)
    member, readable = zlib.decompressobj(wbits=31), bytearray()
    with contextlib.suppress(zlib.error):
        for byte in data:
            readable += member.decompress(bytes([byte]))
    read = b"".join(RawCapture(str(path)))
    assert readable.startswith(read)
    assert len(readable) - len(read) < 2 * INFLATED_AT_ONCE


def test_a_file_that_is_no_recording_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "empty").write_bytes(b"")
    (tmp_path / "zip").write_bytes(b"PK\x03\x04 and so on")
    for name, code in {
        "missing": "not_readable",
        ".": "not_readable",
        "empty": "empty",
        "zip": "format_zip",
    }.items():
        with pytest.raises(RecordingError) as error:
            RawCapture(str(tmp_path / name))
        assert error.value.code == code


@pytest.mark.parametrize(
    "header",
    [
        b"[]",
        b'{"caveats": [{}], "settings": [1], "id": 3, "alias_factor": NaN, "rate_hz": 1e400, "part": "x"}',
        b'{"base": "/etc/passwd", "part": 0}',
        b'{"time": "garbage", "base": "a\\u0000b", "part": 0}',
        b"[" * 60_000,
        b"\xff\xfe",
    ],
    ids=["list", "types", "elsewhere", "garbage", "deep", "no-text"],
)
def test_an_invalid_header_is_ignored(tmp_path: Path, header: bytes) -> None:
    (tmp_path / "a.bin").write_bytes(b"#imumon-recording " + header + b"\nabc")
    recording = RawCapture(str(tmp_path / "a.bin"))
    assert b"".join(recording) == b"abc"
    assert recording.problem is None


def test_standard_input_is_a_recording(noise: bytes) -> None:
    code = "from imumon.sources.files import RawCapture as R; r = R('-'); print(sum(map(len, r)), r.progress)"
    done = subprocess.run(
        [sys.executable, "-c", code], input=gzip.compress(noise), capture_output=True, check=True
    )
    assert done.stdout.split() == [b"700000", b"None"]
