"""Events of a record: none is lost, doubled or at a wrong time; loss, its share and its level."""

from __future__ import annotations

import signal
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from blocks_at_rest import NOW, report_of

from imumon.grid.sample_clock import BREAK
from imumon.model.samples import GYRO, Floats, Ints, SampleBlock, Stream
from imumon.model.saved_state import pack, unpack
from imumon.record import Record, RecordOptions
from imumon.record.events import DetectedEvent, EventLog
from imumon.record.loss import WINDOW_S, LossWindow
from imumon.sources.vn100 import ascii

STREAM = Stream("uncompensated", GYRO, "simulated", "startup")
RATE = 100.0


def noise(seconds: float, rate: float = RATE, seed: int = 3) -> Floats:
    return np.random.default_rng(seed).normal(0.0, 1e-3, (round(seconds * rate), 3))


def clock(values: Floats, rate: float = RATE, after_s: float = 1.0) -> Ints:
    return (round(after_s * 1e9) + np.arange(len(values)) * round(1e9 / rate)).astype(np.int64)


def feed(monitor: Record, values: Floats, time: Ints, block: int = 5000) -> None:
    for begin in range(0, len(values), block):
        part = values[begin : begin + block]
        lost = np.zeros(len(part), dtype=np.int64)
        monitor.feed(SampleBlock(STREAM, part, time[begin : begin + block], lost))


def drained(monitor: Record, kind: str) -> list[tuple[str, float | None, str]]:
    return [(e.text, e.elapsed_s, e.stamped(NOW, "x").level) for e in monitor.events() if e.kind == kind]


def drifted(rate: float = 10.0, seed: int = 1) -> Floats:
    """Samples (n, 3) of 7300 s whose second hour has more noise on one axis."""
    values = noise(7300.0, rate, seed)
    values[round(3600 * rate) :, 2] *= 1.5
    return values


def test_a_new_record_reports_the_changes_that_the_record_before_had() -> None:
    monitor, before, after = Record(), drifted(), drifted(8.0, 2)
    feed(monitor, before, clock(before, 10.0))
    feed(monitor, after, clock(after, 8.0, 7301.0))
    changes = drained(monitor, "change")
    assert [elapsed_s for _, elapsed_s, _ in changes] == [7200.0, 7200.0]


def test_changes_between_hours_are_reported_once_over_a_restart_of_the_daemon() -> None:
    before, monitor = drifted(), Record()
    feed(monitor, before, clock(before, 10.0))
    assert len(drained(monitor, "change")) == 1
    saved = pack(monitor.save())
    for factor, expected in ((1.5, []), (1.25, ["gyro/z: N does not differ from the hours before any more"])):
        again = Record()
        again.restore(unpack(saved), 0.0)
        after = noise(3600.0, 10.0, 9)
        after[:, 2] *= factor
        feed(again, after, clock(after, 10.0, 7301.0))
        assert [text for text, _, _ in drained(again, "change")] == expected


def test_each_end_of_a_warm_up_is_an_event_for_any_splitting_of_the_samples() -> None:
    values = 0.1 * noise(2000.0, 10.0)
    values[:, 1] += 5e-3 * np.exp(-np.arange(len(values)) / 1000.0)
    found = []
    for size in (100, len(values)):
        monitor = Record()
        feed(monitor, values, clock(values, 10.0), size)
        found.append(drained(monitor, "warmup"))
    assert found[0] == found[1]
    assert len(found[0]) >= 2


def test_a_stuck_axis_and_its_recovery_are_events_and_lost_samples_end_neither() -> None:
    values = noise(200.0)
    values[12_000:16_000, 0] = values[12_000, 0]
    kept = np.ones(len(values), dtype=bool)
    kept[14_010:14_085] = False  # most of a frame
    monitor = Record()
    feed(monitor, values[kept], clock(values)[kept])
    assert [event[1:] for event in drained(monitor, "stuck")] == [(122.0, "warning"), (161.0, "notice")]


def test_no_event_is_behind_the_end_of_the_record() -> None:
    values = noise(140.56)
    values[14_000:] = values[14_000]
    monitor = Record()
    feed(monitor, values, clock(values))
    monitor.flush()
    events = [event for event in monitor.events() if event.kind in ("stuck", "disturbance")]
    assert {event.kind for event in events} == {"stuck", "disturbance"}
    ends = [(event.elapsed_s or 0.0) + (event.length_s or 0.0) for event in events]
    assert max(ends) <= 140.56 + 1e-9


def test_a_disturbance_that_a_new_record_ends_is_an_event() -> None:
    values, after = noise(160.0), noise(10.0, 80.0, 5)
    steps = np.random.default_rng(1).normal(0.0, 0.05, (2000, 3))
    values[14_000:] += np.cumsum(steps, axis=0)
    monitor = Record()
    feed(monitor, values, clock(values))
    assert drained(monitor, "disturbance") == []
    feed(monitor, after, clock(after, 80.0, 161.0))
    events: list[DetectedEvent] = monitor.events()
    assert [event.kind for event in events] == ["disturbance", "restart"]
    assert monitor.restarts == 1


def test_an_error_while_a_pipe_is_open_is_no_crash() -> None:
    """A thread that waits for standard input must not hold what the interpreter closes at its end."""
    row = [0.0, 0.0, 0.0, 0.1, 0.2, 0.3, 0.0, 0.0, -9.8, 0.001, 0.002, 0.003]
    with subprocess.Popen(
        [sys.executable, "-P", "-m", "imumon", "replay", "-"], stdin=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        sentence = ascii.encode(ascii.sentence("VNYMR", row))
        process.stdin.write(sentence * ((1 << 20) // len(sentence) + 100))
        process.stdin.flush()
        assert process.wait(120.0) == 2
        assert process.stderr.read().decode() == (
            "imumon: $VNYMR has no clock: give its sample rate with --rate\n"
        )


@pytest.mark.few
@pytest.mark.parametrize("second", [signal.SIGTERM, signal.SIGHUP])
def test_a_second_signal_does_not_interrupt_the_cleaning_up(second: signal.Signals, tmp_path: Path) -> None:
    cleaned = tmp_path / "cleaned"
    program = f"""
import os, pathlib, signal
from imumon.cli.run_command import _temporary
with _temporary() as directory:
    try:
        os.kill(os.getpid(), signal.SIGHUP)
    finally:
        os.kill(os.getpid(), {int(second)})
        pathlib.Path({str(cleaned)!r}).write_text(directory)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, timeout=120.0, check=False)
    assert (done.returncode, done.stderr) == (-signal.SIGHUP, b"")
    assert not Path(cleaned.read_text()).exists()


@pytest.mark.few
@pytest.mark.parametrize("size", [1, 7, 6000])
def test_a_clock_that_is_reset_all_the_time_does_not_flood_the_log(size: int) -> None:
    events, steps, span = EventLog(), np.where(np.arange(6000) % 50 == 49, BREAK, 1), 0
    events.begin(STREAM.channels, 0.01)
    for begin in range(0, len(steps), size):
        part = steps[begin : begin + size]
        span += len(part)
        events.update_steps(part, span)
    found = [event.elapsed_s for event in events.drain()]
    assert found == pytest.approx([0.49, 10.49, 20.49, 30.49, 40.49, 50.49])


# ---------------------------------------------------------------- loss


RATE = 100.0


def lossy(seconds: float, share: float, seed: int = 1) -> Ints:
    """Return the grid steps of a stream that loses single samples at random."""
    there = np.random.default_rng(seed).random(int(seconds * RATE)) >= share
    return np.diff(np.flatnonzero(there), prepend=-1)


def missing_by_brute_force(steps: Ints) -> int:
    """Return the samples that are missing in the last 60 bins of a second."""
    ends = np.cumsum(steps)
    seconds = (ends / RATE).astype(int)
    return int((steps - 1)[seconds > seconds[-1] - WINDOW_S].sum())


@pytest.mark.few
@pytest.mark.parametrize("share", [0.2, 0.003, 0.0])
@pytest.mark.parametrize("seed", [1, 2])
def test_any_chunking_gives_the_share_of_the_last_minute(share: float, seed: int) -> None:
    steps = np.concatenate(([1], lossy(200.0, share, seed)))
    cuts = np.sort(np.random.default_rng(seed).integers(1, len(steps), 50))
    for edges in ([0, len(steps)], [0, *cuts, len(steps)]):
        window = LossWindow(1.0 / RATE)
        for a, b in pairwise(edges):
            window.update(steps[a:b])
        assert window.share == pytest.approx(missing_by_brute_force(steps) / (WINDOW_S * RATE))


def test_the_monitor_reports_loss_with_its_level_and_time() -> None:
    monitor, values = Record(RecordOptions(max_loss=0.05)), noise(120.0)
    there = np.random.default_rng(1).random(12_000) >= np.where(np.arange(12_000) < 2000, 0.0, 0.2)
    feed(monitor, values[there], clock(values)[there])
    monitor.flush()
    report = report_of(monitor)
    assert report.session.recent_loss == pytest.approx(0.2, abs=0.02)
    (event,) = [event for event in monitor.events() if event.kind == "loss"]
    assert 30.0 < event.elapsed_s < 40.0  # a twentieth of a minute is lost in 15 s
    assert event.stamped(NOW, "x").level == "warning"
    monitor.gap(3600.0)
    again, complete = lossy(30.0, 0.2, 2), clock(noise(130.0), after_s=3721.0)
    there = np.cumsum(again) - 1
    feed(monitor, noise(30.0)[there], complete[there])
    after = report_of(monitor).session
    assert after.missing > 300_000
    assert drained(monitor, "loss") == [], "a link that is reconnected has not recovered before a minute"
    feed(monitor, noise(100.0), complete[3000:])
    ((_, ended_s, level),) = drained(monitor, "loss")
    assert level == "notice"
    assert 3780.0 < ended_s < 3811.0  # a minute after it is back, and a minute after its last loss
    assert report_of(monitor).session.recent_loss == 0.0
