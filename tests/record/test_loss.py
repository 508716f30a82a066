"""Loss: the share of samples that a link loses, its events, and their levels."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from blocks_at_rest import DELTAS, NOW, TICK, block

from imumon.model.report import DeviceDescription, SessionCounters
from imumon.model.samples import Ints, SampleBlock
from imumon.record import Record, RecordOptions
from imumon.record.events import RECOVERED, EventLog
from imumon.record.loss import WINDOW_S, LossWindow

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
@pytest.mark.parametrize("share", [0.0, 0.003, 0.2])
@pytest.mark.parametrize("seed", [1, 2])
def test_any_chunking_gives_the_share_of_the_last_minute(share: float, seed: int) -> None:
    steps = np.concatenate(([1], lossy(200.0, share, seed)))
    cuts = np.sort(np.random.default_rng(seed).integers(1, len(steps), 50))
    for edges in ([0, len(steps)], [0, *cuts, len(steps)]):
        window = LossWindow(1.0 / RATE)
        for a, b in pairwise(edges):
            window.update(steps[a:b])
        assert window.share == pytest.approx(missing_by_brute_force(steps) / (WINDOW_S * RATE))


class JudgedWindow(LossWindow):
    """A window with its alarm; `alarms` has the share of each begin, and the share of each end."""

    def __init__(self) -> None:
        super().__init__(1.0 / RATE)
        self._log = EventLog()

    def alarms(self, steps: Ints) -> list[tuple[bool, float]]:
        for _, share, full in self.update(steps):
            self._log.update_loss(share, 0.01 / full, 0.0, ends=full >= 1.0)
        return [(event.level is None, self.share) for event in self._log.drain()]


def test_a_lossy_link_is_reported_once_and_so_is_its_end() -> None:
    window = JudgedWindow()
    changes = [
        (second, change)
        for second in range(400)
        for change in window.alarms(lossy(1.0, 0.2 if 100 <= second < 200 else 0.0, second))
    ]
    (begin, (begins, begun)), (end, (again, ended)) = changes
    assert begins
    assert 102 <= begin <= 106  # 1 % of a minute is lost in 3 s
    assert begun > 0.01
    assert not again
    assert 255 <= end <= 260
    assert ended <= RECOVERED * 0.01


def test_single_losses_at_the_start_and_interruptions_are_no_loss() -> None:
    window = JudgedWindow()
    assert window.alarms(np.array([1, 1, 5, 1, 1])) == []
    window.restart()
    assert window.alarms(np.array([360_000, 1, 1])) == []
    assert window.share == 0.0


def test_a_link_that_is_reconnected_has_not_recovered_before_a_minute() -> None:
    window = JudgedWindow()
    assert len(window.alarms(lossy(30.0, 0.2))) == 1
    window.restart()
    assert window.alarms(lossy(30.0, 0.2, 2)) == []
    ended = window.alarms(np.ones(9000, dtype=np.int64))
    assert [begins for begins, _ in ended] == [False]


def test_the_share_of_a_short_record_refers_to_its_length() -> None:
    window = JudgedWindow()
    window.update(lossy(20.0, 0.1))
    assert window.share == pytest.approx(0.1, abs=0.02)


def test_the_monitor_reports_loss_with_its_level_and_time() -> None:
    monitor = Record(RecordOptions(max_loss=0.05))
    whole = block(12_000)
    there = np.random.default_rng(1).random(12_000) >= np.where(np.arange(12_000) < 2000, 0.0, 0.2)
    values, time, lost = whole.values[there], whole.time_ns[there], whole.lost[there]
    monitor.feed(SampleBlock(DELTAS, values, time, lost))
    monitor.flush()
    report = monitor.report(NOW, DeviceDescription(id="x"), "running", SessionCounters())
    assert report.session.recent_loss == pytest.approx(0.2, abs=0.02)
    (event,) = [event for event in monitor.events() if event.kind == "loss"]
    assert event.elapsed_s is not None
    assert 30.0 < event.elapsed_s < 40.0  # a twentieth of a minute is lost in 15 s
    assert event.stamped(NOW, "x").level == "warning"
    monitor.gap(3600.0)
    monitor.feed(
        SampleBlock(DELTAS, block(100).values, (np.arange(100) + 372_000) * TICK, np.zeros(100, np.int64))
    )
    after = monitor.report(NOW, DeviceDescription(id="x"), "running", SessionCounters()).session
    assert after.missing > 300_000
    assert after.recent_loss == 0.0


def test_a_stuck_sensor_and_its_recovery_are_events() -> None:
    monitor, part = Record(), block(9000)
    part.values[4000:6000] = part.values[4000]
    levels = []
    for a in range(0, 9000, 100):
        monitor.feed(
            SampleBlock(DELTAS, part.values[a : a + 100], part.time_ns[a : a + 100], part.lost[a : a + 100])
        )
        levels += [e.stamped(NOW, "x").level for e in monitor.events() if e.kind == "stuck"]
    assert levels == ["warning", "notice"]
