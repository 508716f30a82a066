"""Replay: recordings through the whole pipeline, as a user runs it."""

from __future__ import annotations

import gzip
import json
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import documents
import forked
import numpy as np
import pytest
from commands import imumon
from free_ports import free_endpoint
from paths import RECORDINGS, needs_recordings
from waiting import until

from imumon.api.replay import replay
from imumon.api.replay_options import ReplayOptions
from imumon.bus import Publisher, Subscriber
from imumon.config import ZenohSettings
from imumon.documents.appendix import event_rows
from imumon.model.report import DeviceDescription, Report, SessionCounters, from_json
from imumon.model.report_json import to_json
from imumon.model.samples import SampleBlock
from imumon.noise.synthesis import NoiseStream
from imumon.record import Record, RecordOptions
from imumon.record.events import DetectedEvent
from imumon.sources.files import ReadOptions, open_recording
from imumon.sources.vn100 import ascii as sentences
from imumon.sources.vn100 import binary

KIRAN = RECORDINGS / "kiran_stat5min.vnymr.txt.gz"


@needs_recordings
def test_real_recording_agrees_with_an_independent_tool() -> None:
    report = json.loads(imumon("replay", KIRAN, "--rate", "40", "--json", "--no-guards"))
    expected = json.loads(KIRAN.with_name("kiran_stat5min.oadev.json").read_text())["axes"]
    assert report["session"]["samples"] == 13223
    assert report["session"]["missing"] == 0
    for key, axis in (("gyro", "g"), ("accel", "a")):
        for letter in "xyz":
            channel, truth = report["channels"][f"{key}/{letter}"], expected[axis + letter]
            found = np.array(channel["allan"]["sigma"])
            theirs = np.array(truth["oadev"][: len(found)])
            np.testing.assert_allclose(found[:4], theirs[:4], rtol=1e-9)
            # longer octaves see 98 % of the pairs: equal within a part of their own deviation
            spread = 1.0 / np.sqrt(2.0 * np.array(channel["allan"]["edf"][4:]))
            assert np.all(np.abs(found[4:] / theirs[4:] - 1.0) < 0.5 * spread + 0.01)
            assert channel["mean"] == pytest.approx(truth["mean"], rel=1e-9)
            assert channel["std"] == pytest.approx(truth["std_ddof1"], rel=1e-9)
    assert report["grade"]["gyro"]["meets"] == "consumer"
    assert report["grade"]["accel"]["meets"] == "consumer"


def capture(rows: Iterable[Sequence[float]]) -> bytes:
    """Return sentences of a VN-100 with these numbers."""
    return b"".join(sentences.encode(sentences.sentence("VNYMR", row)) for row in rows)


def at_rest(samples: int) -> bytes:
    """Return a capture of a sensor at rest."""
    rng = np.random.default_rng(5)
    mean, size = (
        [0.0, 0.0, 0.0, 0.2, 0.0, 0.4, 0.0, 0.0, -9.8, *[0.0] * 3],
        [*[0.0] * 6, *[0.013] * 3, *[7e-4] * 3],
    )
    return capture(rng.normal(mean, size, (samples, 12)))


def test_a_table_of_unknown_origin_is_unknown_and_gets_no_advice_about_a_vn100(tmp_path: Path) -> None:
    rng, path = np.random.default_rng(1), tmp_path / "a.npz"
    gyro, accel = rng.normal(0.0, 1e-3, (400, 3)), rng.normal((0.0, 0.0, 9.8), 1e-2, (400, 3))
    np.savez(path, t_s=np.arange(400) / 40.0, gyro_rads=gyro, accel_ms2=accel)
    report = from_json(Report, imumon("replay", path, "--json"))
    assert report.device.stream == "unknown"
    assert report.device.driver is None
    assert "unknown_compensation" in report.caveats
    known = from_json(Report, imumon("replay", path, "--json", "--stream", "uncompensated"))
    assert known.device.stream == "uncompensated"
    assert known.caveats == ()
    saved = tmp_path / "a.json"
    saved.write_text(to_json(report))
    shown = imumon("replay", path) + "".join(
        imumon("report", saved, "--format", form) for form in ("md", "kalibr", "ros")
    )
    assert not re.search(r"VN-?100|register|factory|listen-only", shown, re.IGNORECASE)
    assert "The filter of the sensor is unknown" in shown
    (tmp_path / "a.txt").write_bytes(at_rest(400))
    raw = imumon("replay", tmp_path / "a.txt", "--rate", "40", "--verbose")
    assert "If it is a VN-100 with factory settings" in raw
    assert "--filter names it" in raw


def test_a_report_lists_what_was_excluded_and_when(tmp_path: Path) -> None:
    rng, path, n = np.random.default_rng(2), tmp_path / "a.npz", 8_000
    gyro, accel = rng.normal(0.0, 1e-3, (n, 3)), rng.normal((0.0, 0.0, 9.8), 1e-2, (n, 3))
    at = [4000 + 800 * k for k in range(4)]
    for k in at:
        accel[k : k + 20] += rng.normal(0.0, 2.0, (20, 3))
    np.savez(path, t_s=np.arange(n) / 40.0, gyro_uncomp_rads=gyro, accel_uncomp_ms2=accel)
    saved = tmp_path / "a.json"
    saved.write_text(imumon("replay", path, "--json"))
    report = from_json(Report, saved.read_text())
    excluded = [event for event in report.events if event.kind == "disturbance"]
    assert len(excluded) == report.session.disturbances
    for event in excluded:
        assert any(event.elapsed_s - 5.0 < k / 40.0 < event.elapsed_s + event.length_s + 5.0 for k in at)
    times = [event.elapsed_s or 0.0 for event in report.events]
    assert times == sorted(times)
    for shown in (imumon("replay", path, "--verbose"), imumon("report", saved)):
        assert all(event.text in shown and f"{event.elapsed_s:,.1f} s" in shown for event in excluded)
    many = replace(report, events=tuple(replace(excluded[0], elapsed_s=100.0 + k) for k in range(24)))
    ((begin, sentence),) = event_rows(many)
    assert (begin, sentence[:29]) == ("100.0 s", "24 disturbances until 123.0 s")
    bare = replay(ReplayOptions(path=str(path), record=RecordOptions(guarded=False)))
    assert "disturbance" not in {event.kind for event in bare.events}
    # N is that of the record without the knocks
    n = report.channels["accel/x"].N
    assert n.low < 1e-2 / np.sqrt(40.0) < n.high


def test_signal_findings_are_reported(tmp_path: Path) -> None:
    """Of known truth: a machine that shakes two axes, mains, and biases."""
    n, path = 20_000, tmp_path / "a.npz"
    t, rng = np.arange(n) / 40.0, np.random.default_rng(8)
    gyro, accel = rng.normal((1e-3, 0, 0), 4e-4, (n, 3)), rng.normal((0.011, 0, -9.787), 6e-3, (n, 3))
    mag = rng.normal((0.2, 0, 0.4), 1e-3, (n, 3)) + 2e-3 * np.sin(2 * np.pi * 50.0 * t)[:, None] * [
        1.0,
        0.0,
        0.0,
    ]
    accel[:, :2] += 0.01 * np.sin(2 * np.pi * 13.3 * t)[:, None]
    np.savez(path, t_s=t, gyro_uncomp_rps=gyro, accel_uncomp_mps2=accel, mag_gauss=mag)
    report = replay(ReplayOptions(path=str(path)))
    for name, bias in (("gyro/x", 1e-3), ("accel/z", 0.02)):
        shape = report.channels[name].distribution
        assert shape.bias_low < bias < shape.bias_high
    assert report.channels["accel/x"].distribution.bias is None
    shown = documents.text(report, "md")
    assert re.search(r"^\| accel/x, .*\| not separable from tilt ", shown, re.M)
    for text in ("accel/x: moves together with accel/y (+0.5", "13.3 Hz of 0.0", "(50 Hz mains)"):
        assert text in shown
    assert not [name for name in ("gyro/x", "gyro/z", "accel/z", "mag/y") if f"\n{name}:" in shown]


def test_a_corrupt_recording_is_used_up_to_the_corruption(tmp_path: Path) -> None:
    path, data = tmp_path / "a.txt.gz", gzip.compress(at_rest(2000))
    path.write_bytes(data[: len(data) // 2])
    done = forked.run("replay", str(path), "--rate", "40", "--json")
    report = json.loads(done.stdout)
    assert 900 < report["session"]["samples"] < 1200
    assert "truncated" in report["channels"]["gyro/x"]["caveats"]
    assert done.stderr.count("\n") == 1
    assert str(path) in done.stderr


def test_a_replay_publishes_its_report_and_its_events_under_one_name(tmp_path: Path) -> None:
    """That of the command: the name of the sensor is that of the daemon beside it."""
    rows, place, path = (
        np.random.default_rng(2).normal(0, 1e-3, (4000, 12)),
        free_endpoint(),
        tmp_path / "run.bin",
    )
    rows[:, 8] -= 9.8
    rows[2000:, 10] = rows[2000, 10]  # stuck
    path.write_bytes(b'#imumon-recording {"id": "vn100-7", "rate_hz": 40.0}\n' + capture(rows))
    with Publisher("replay", ZenohSettings(listen=(place,))) as bus, Subscriber([place]) as viewer:
        final = replay(ReplayOptions(path=str(path)), bus=bus)
        report = viewer.wait_report("replay", timeout=60.0)
        until(lambda: "disturbance" in [event.kind for event in viewer.events("replay")])
    assert (report.device.id, final.device.id) == ("replay", "vn100-7")


# ---------- the report and the events of a replay are those of a live run over the same bytes


RATE = 5.0
SAMPLES = 50_000
LAYOUT = binary.BinaryLayout.of({binary.Group.TIME: 0x0001, binary.Group.IMU: 0x000C})
FOUND_BY_REPORTS = (
    "grade",
    "constant",
    "first half",
    "against the time before",
    "differ from the time before",
)
"""Kinds of events, or part of their texts, that reports note: in a replay, that is the last one."""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A record of almost three hours in which everything happens; in rows, of which five are a second."""
    n = np.array([6.1e-5] * 3 + [1.4e-3] * 3)
    values = NoiseStream(RATE, n, n / 10.0, 0.0, seed=4).generate(SAMPLES)
    values[18_000:, 5] *= 1.5  # a change between hours
    values[:, 5] -= 9.8
    rng, at = np.random.default_rng(5), np.arange(SAMPLES)
    values[:, 1] += 2e-3 * np.exp(-at / RATE / 100.0)  # a warm-up
    values[10_000:10_010, 3:] += rng.normal(0.0, 2.0, (10, 3))  # a knock
    values[15_000:15_300] += np.cumsum(rng.normal(0.0, 0.05, (300, 6)), axis=0)  # motion, and another place
    values[15_300:, 3:] += values[15_299, 3:] - values[15_300, 3:]
    values[20_000:20_200] = values[20_000]  # stuck
    clock = at * round(1e9 / RATE) + 10**9
    clock[45_000:] -= clock[45_000] - 10**8  # the clock is reset
    kept = np.ones(SAMPLES, dtype=bool)
    for gap, length in ((25_000, 3), (25_020, 2), (25_150, 1), (26_000, 2000), (30_000, 1)):
        kept[gap : gap + length] = False
    kept[31_000:32_000] &= rng.random(1000) < 0.7  # a lossy link
    fields = {"timeStartup": clock, "uncompAccel": values[:, 3:], "uncompGyro": values[:, :3]}
    path = tmp_path_factory.mktemp("capture") / "run.bin"
    path.write_bytes(LAYOUT.encode({name: value[kept] for name, value in fields.items()}))
    return path


def live(path: Path, block_bytes: int) -> tuple[Report, list[DetectedEvent]]:
    """Read a recording in small blocks, with reports in between, as a daemon that publishes does."""
    monitor, events, due_s = Record(), list[DetectedEvent](), 0.0

    def report(state: str) -> Report:
        made = monitor.report(NOW, DeviceDescription(id="replay"), state, SessionCounters())  # type: ignore[arg-type]
        events.extend(monitor.events())
        return made

    for items in open_recording(str(path), ReadOptions(block_bytes=block_bytes)):
        for item in items:
            assert isinstance(item, SampleBlock)
            monitor.feed(item)
            if monitor.samples / RATE >= due_s:
                due_s += 3600.0
                report("running")
    monitor.flush()
    return report("stopped"), events


NOW = datetime(2026, 1, 1, tzinfo=UTC)


def pairs(one: Any, other: Any, path: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Yield the places and the values of two JSON values of the same shape."""
    assert type(one) is type(other), path
    if isinstance(one, dict):
        assert one.keys() == other.keys(), path
        for key in one:
            yield from pairs(one[key], other[key], f"{path}/{key}")
    elif isinstance(one, list):
        assert len(one) == len(other), path
        for k, both in enumerate(zip(one, other, strict=True)):
            yield from pairs(*both, f"{path}/{k}")
    else:
        yield path, one, other


def without_earlier(report: Report) -> Report:
    """Return a report without what was stated of shorter records, and the times that follow from it.

    It is noted whenever a report is asked for, and a replay asks for none before its end.
    """
    channels = {
        name: replace(channel, convergence=None, time_to=None) for name, channel in report.channels.items()
    }
    return replace(report, channels=channels)


def test_the_report_and_the_events_are_those_of_a_live_run(recording: Path) -> None:
    made, detected = live(recording, 9000)
    offline = replay(ReplayOptions(path=str(recording)))
    same = replace(made, time=offline.time, device=offline.device, session=offline.session)
    for path, one, other in pairs(
        json.loads(to_json(without_earlier(replace(offline, events=())))),
        json.loads(to_json(without_earlier(same))),
    ):
        near = pytest.approx(other, rel=1e-6, abs=1e-12) if isinstance(other, float) else other
        assert one == near, path
    counted = (
        "samples",
        "missing",
        "gaps",
        "disturbances",
        "excluded_s",
        "warmup_s",
        "restarts",
        "elapsed_s",
    )
    assert [getattr(offline.session, name) for name in counted] == [
        getattr(made.session, name) for name in counted
    ]

    def listed(events: object) -> list[tuple[str, str, float]]:
        assert isinstance(events, list | tuple)
        rows = [
            (e.kind, e.text, e.elapsed_s)
            for e in events
            if not any(part in f"{e.kind} {e.text}" for part in FOUND_BY_REPORTS)
        ]
        return sorted(rows, key=lambda row: (row[2], row[0], row[1]))

    expected, found = listed(detected), listed(offline.events)
    assert {kind for kind, _, _ in expected} >= {
        "warmup", "disturbance", "motion", "rest", "stuck", "gap", "loss", "restart", "change",
    }  # fmt: skip
    assert [row[:2] for row in found] == [row[:2] for row in expected]
    for one, other in zip(found, expected, strict=True):
        assert one[2] == pytest.approx(other[2], abs=1.0 if one[0] == "loss" else 1e-6), one


def test_a_file_without_a_sample_ends_with_3(tmp_path: Path) -> None:
    (tmp_path / "noise.bin").write_bytes(np.random.default_rng(1).bytes(20_000))
    assert "noise.bin has no valid message" in imumon("replay", tmp_path / "noise.bin", code=3)
