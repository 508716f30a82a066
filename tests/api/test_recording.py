"""Recordings of the daemon: a replay gives the same report, and a full disk ends only the recording."""

from __future__ import annotations

import json
import os
import random
import re
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import forked
import pytest
from commands import imumon
from daemons import Daemon
from faulty_sensor import spawn
from free_ports import free_endpoint

from imumon.api.replay import replay
from imumon.api.replay_options import ReplayOptions
from imumon.config import RecordingSettings
from imumon.daemon.recorder import Recorder
from imumon.model.report import Report, from_json
from imumon.model.samples import Gap
from imumon.sources.files import RawCapture, RecordingError, check_place
from imumon.sources.files.capture_writer import BACKLOG
from imumon.sources.files.raw_capture import MARK, split_lines
from imumon.sources.vn100.emulator import EmulatorSettings

CONFIG = """
[record]
rotate_mb = 0.5
gzip = true
"""


def same(live: Report, path: Path) -> Report:
    """Compare the last report of a daemon, and what its saved state shows, with the report of its recording.

    Curve and drift in the last report are those of the last analysis: a daemon ends without a further one.
    """
    again = replay(ReplayOptions(path=str(path)))
    [state] = path.parent.rglob("*.state")
    imumon("report", state, "-o", path.with_suffix(".json"))
    saved = from_json(Report, path.with_suffix(".json").read_text("utf-8"))
    again = replace(again, session=replace(again.session, restarts=live.session.restarts))
    for part, names in {
        "session": "samples missing gaps restarts elapsed_s received_bytes discarded_bytes bad_checksums "
        "duplicates excluded_s disturbances warmup_s",
        "device": "id model serial firmware stream sample_rate_hz alias_factor settings",
    }.items():
        for name in names.split():
            assert getattr(getattr(again, part), name) == getattr(getattr(live, part), name), name
    assert set(again.caveats) == set(live.caveats)
    assert set(again.channels) == set(live.channels)
    for name, channel in live.channels.items():
        other = again.channels[name]
        assert (other.count, other.min, other.max) == (channel.count, channel.min, channel.max)
        assert other.mean == pytest.approx(channel.mean, rel=1e-12, abs=1e-15)
        assert other.std == pytest.approx(channel.std, rel=1e-9)
        full = saved.channels[name]
        if full.allan is not None:
            assert other.allan.sigma == pytest.approx(full.allan.sigma, rel=1e-12)
        if full.drift is not None:
            assert other.drift is not None
            for name in ("per_hour", "per_hour_low", "per_hour_high", "explained"):
                replayed, original = getattr(other.drift, name), getattr(full.drift, name)
                assert replayed == (original if original is None else pytest.approx(original, rel=1e-6)), name
    return live


def ended(daemon: Daemon) -> tuple[Report, str]:
    """Stop a daemon that prints its report; return the report and the messages."""
    daemon.process.send_signal(signal.SIGTERM)
    out, messages = daemon.ended()
    assert "Traceback" not in messages
    return from_json(Report, out), messages


def test_a_recording_in_zipped_parts_gives_the_daemons_report(tmp_path: Path) -> None:
    config = tmp_path / "config.toml"
    config.write_text(CONFIG)
    # a speed at which a busy machine keeps up: the end of a run is limited in time
    options = ("--speed", "20", "--seed", "11", "--config", str(config), "--json", "--duration", "1e4")
    with Daemon("sim", tmp_path, "--record", str(tmp_path / "raw.bin.gz"), *options) as daemon:
        daemon.samples(12_000)
        live, _ = ended(daemon)
    same(live, tmp_path / "raw.bin.gz")
    parts = sorted(tmp_path.glob("raw*.gz"))
    assert len(parts) >= 2
    assert all(part.read_bytes()[:2] == b"\x1f\x8b" for part in parts)


def test_a_lost_link_is_in_the_recording(tmp_path: Path) -> None:
    """Of a stream that has no clock, and shows no gap by itself."""
    path, link = tmp_path / "raw.bin", tmp_path / "sensor"
    with spawn(EmulatorSettings(seed=12, link=str(link))) as sensor:
        every = ("--record", str(path), "--json", "--duration", "1e4", "--listen-only", "--rate", "40")
        with Daemon(str(link), tmp_path, *every) as daemon:
            before = daemon.samples(60)
            sensor.ask("unplug")
            daemon.wait(lambda r: r.state == "waiting")
            sensor.ask("replug")
            daemon.wait(lambda r: r.state == "running" and r.session.samples > before.session.samples + 60)
            live, _ = ended(daemon)
    assert same(live, path).session.gaps == 1
    [gap] = [item for item in RawCapture(str(path)).items() if isinstance(item, Gap)]
    assert 0.0 < gap.length_s < 10.0


def test_a_recording_continues_the_record_after_a_restart(tmp_path: Path) -> None:
    """In the next free number, which a reader of the first finds; parts joined by hand are read once."""
    path, state = tmp_path / "raw.bin", tmp_path / "state"
    with spawn(EmulatorSettings(seed=15)) as sensor:
        for run in range(2):
            with Daemon(sensor.path, state, "--record", str(path), "--json", "--duration", "1e4") as daemon:
                daemon.samples(80 * (run + 1))
                live, _ = ended(daemon)
        assert same(live, path).session.gaps == 1
        joined = tmp_path / "joined.bin"
        joined.write_bytes(path.read_bytes() + (tmp_path / "raw.0001.bin").read_bytes())
        same(live, joined)
        with Daemon(sensor.path, state, "--fresh", "--record", str(path), "--duration", "1") as daemon:
            daemon.ended()
    assert replay(ReplayOptions(path=str(path))).session.samples == live.session.samples, "another record"


def test_any_chunking_finds_the_same_lines() -> None:
    rng = random.Random(1)
    data = b"".join(
        rng.choice((b"#", MARK, MARK + b'{"away_s": 1.5}\n', MARK + b"garbage\n", b"\n", rng.randbytes(9)))
        for _ in range(300)
    )
    whole = join(split_lines(iter([data])))
    for size in (1, 2, 7, 18, 100):
        assert join(split_lines(data[at : at + size] for at in range(0, len(data), size))) == whole
    messages = sum(isinstance(item, dict) for item in whole)
    assert messages > 50
    kept = b"".join(item for item in whole if isinstance(item, bytes))
    assert kept == re.sub(re.escape(MARK) + rb"[^\n]*\n", b"", data)


def join(items: Any) -> list[Any]:
    """Bytes that follow one another as one."""
    joined: list[Any] = []
    for item in items:
        if joined and isinstance(item, bytes) and isinstance(joined[-1], bytes):
            joined[-1] += item
        else:
            joined.append(item)
    return joined


def test_a_run_whose_recording_ended_early_fails(tmp_path: Path) -> None:
    """The report is complete; the exit code says that the recording is not."""
    with spawn(EmulatorSettings(seed=15)) as sensor:
        options = ["--record", "/dev/full", "--duration", "2", "--json", "--state", str(tmp_path / "state")]
        done = forked.run("run", "--port", sensor.path, *options, "--listen", free_endpoint())
    assert done.returncode == 1, done.stderr
    error = json.loads(done.stderr.splitlines()[-1])["error"]
    assert error["code"] == "recording_stopped"
    assert "no space left on device" in error["message"]
    assert from_json(Report, done.stdout).session.samples > 50


def test_a_recording_that_has_stopped_is_reported_and_not_restarted(tmp_path: Path) -> None:
    """As on a slow disk: a pipe that is never read, and more than the recorder holds."""
    fifo = tmp_path / "slow"
    os.mkfifo(fifo)
    reader = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)
    recorder = Recorder(RecordingSettings(file=str(fifo)))
    recorder.start({})
    for size in (200_000, BACKLOG + 1):
        recorder.write(bytes(size))
    recorder.start_new_record()
    assert not recorder.needs_header
    (messages,) = recorder.problems()
    assert "has ended" in messages
    os.close(reader)


def test_a_pipe_without_a_reader_is_a_problem_and_one_with_a_reader_is_recorded_to(tmp_path: Path) -> None:
    path = str(tmp_path / "pipe")
    os.mkfifo(path)
    recorder = Recorder(RecordingSettings(file=path))
    recorder.check_file()
    assert recorder.start({}) is None
    assert "no program reads that pipe" in recorder.problems()[0]
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    recorder = Recorder(RecordingSettings(file=path))
    assert recorder.start({}) == path
    recorder.write(b"abc")
    recorder.close()
    assert os.read(reader, 4096).endswith(b"\nabc")
    assert os.read(reader, 1) == b""
    os.close(reader)


@pytest.mark.parametrize(
    ("name", "code"),
    [("file/raw.bin", "no_directory"), (".", "is_directory"), ("none/raw.bin", "no_directory")],
)
def test_wrong_places(tmp_path: Path, name: str, code: str) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(RecordingError) as error:
        check_place(str(tmp_path / name))
    assert error.value.code == code
    check_place(str(tmp_path / "file"))
    check_place("/dev/full")
