"""Law of a replay: the report and the events are those of a live run over the same bytes."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imumon.api.replay import replay
from imumon.api.replay_options import ReplayOptions
from imumon.model.report import DeviceDescription, Report, SessionCounters
from imumon.model.report_json import to_json
from imumon.model.samples import SampleBlock
from imumon.noise.synthesis import NoiseStream
from imumon.record import Record
from imumon.record.events import DetectedEvent
from imumon.sources.files import ReadOptions, open_recording
from imumon.sources.vn100 import binary

RATE = 10.0
SAMPLES = 100_000
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
    """A record of almost three hours in which everything happens."""
    n = np.array([6.1e-5] * 3 + [1.4e-3] * 3)
    values = NoiseStream(RATE, n, n / 10.0, 0.0, seed=4).generate(SAMPLES)
    values[36_000:, 5] *= 1.5  # a change between hours
    values[:, 5] -= 9.8
    rng, at = np.random.default_rng(5), np.arange(SAMPLES)
    values[:, 1] += 2e-3 * np.exp(-at / RATE / 100.0)  # a warm-up
    values[20_000:20_020, 3:] += rng.normal(0.0, 2.0, (20, 3))  # a knock
    values[30_000:30_600] += np.cumsum(rng.normal(0.0, 0.05, (600, 6)), axis=0)  # motion, and another place
    values[30_600:, 3:] += values[30_599, 3:] - values[30_600, 3:]
    values[40_000:40_400] = values[40_000]  # stuck
    clock = at * round(1e9 / RATE) + 10**9
    clock[90_000:] -= clock[90_000] - 10**8  # the clock is reset
    kept = np.ones(SAMPLES, dtype=bool)
    for gap, length in ((50_000, 3), (50_040, 2), (50_300, 1), (52_000, 4000), (60_000, 1)):
        kept[gap : gap + length] = False
    kept[62_000:64_000] &= rng.random(2000) < 0.7  # a lossy link
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
