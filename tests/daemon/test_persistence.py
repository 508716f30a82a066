"""Laws of what is kept: of one sensor as it is set, never mixed, never lost; a recording says the same."""

from __future__ import annotations

import shutil
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from imumon.checkpoint import Checkpoint, decode
from imumon.daemon import persistence
from imumon.daemon.persistence import Persistence
from imumon.model.report import SessionCounters
from imumon.model.samples import DeviceInfo, SampleBlock, Stream
from imumon.model.saved_state import unpack
from imumon.record import Record, RecordOptions
from imumon.sources.clock import HostClock

FILTER = "85 IMU filtering"
STREAM = Stream(kind="deltas", source="made", clock="startup", channels=("gyro/x", "gyro/y", "gyro/z"))


def facts(serial: str = "0100000001", filtering: str = "0,4,4,4,0") -> DeviceInfo:
    return DeviceInfo(
        id=f"vn100-{serial}", serial=serial, settings={FILTER: filtering}, data_settings=(FILTER,)
    )


def block(first: int, n: int = 200) -> SampleBlock:
    values = np.random.default_rng(first).normal(size=(n, 3)) * 1e-3
    return SampleBlock(STREAM, values, (first + np.arange(n)) * 10_000_000, np.zeros(n, dtype=np.int64), None)


def begun(directory: Path, of: DeviceInfo, *, guarded: bool = True) -> tuple[Persistence, Record, list[str]]:
    monitor = Record(RecordOptions(guarded=guarded), rate_hz=100.0)
    kept = Persistence(directory, "lab", monitor, HostClock())
    return kept, monitor, [text for text, _ in kept.restore(of)]


def leave(directory: Path) -> None:
    """A record of 200 samples of the sensor as it is set at first."""
    kept, monitor, _ = begun(directory, facts())
    monitor.feed(block(0))
    kept.close(SessionCounters(started="2026-01-01T00:00:00.000Z"), None)


def test_a_record_goes_on(tmp_path: Path) -> None:
    leave(tmp_path)
    kept, monitor, said = begun(tmp_path, facts())
    monitor.feed(block(300))
    assert monitor.samples == 400
    assert "continues" in said[0]
    assert kept.with_earlier_runs(SessionCounters()).restarts == 1
    kept.close(SessionCounters(started=kept.started), None)


def test_a_state_that_waits_for_the_disk_is_of_one_moment(tmp_path: Path) -> None:
    """It is written by another thread, while samples go on."""
    kept, monitor, _ = begun(tmp_path, facts())
    monitor.feed(block(0, 5000))
    waiting = kept._state(SessionCounters(), None)
    monitor.feed(block(5000, 5000))
    assert unpack(waiting).record.samples < monitor.samples
    kept.close(SessionCounters(), None)


@pytest.mark.parametrize(
    ("other", "guarded", "name", "word"),
    [
        (facts(serial="0100000002"), True, "other-sensor", "0100000001"),
        (facts(filtering="0,8,4,4,0"), True, "other-settings", FILTER),
        (facts(), False, "other-settings", "guards on"),
    ],
)
def test_another_is_set_aside_whole(
    tmp_path: Path, other: DeviceInfo, guarded: bool, name: str, word: str
) -> None:
    leave(tmp_path)
    before = (tmp_path / "lab.state").read_bytes()
    kept, monitor, said = begun(tmp_path, other, guarded=guarded)
    monitor.feed(block(0))
    assert monitor.samples == 200
    assert word in said[0]
    kept.close(SessionCounters(), None)
    assert (tmp_path / f"lab.{name}-1.state").read_bytes() == before
    assert (tmp_path / "lab.state").exists()


def test_settings_that_change_while_it_is_away_start_new_record(tmp_path: Path) -> None:
    kept, monitor, _ = begun(tmp_path, facts())
    monitor.feed(block(0))
    changed = facts(filtering="0,8,4,4,0")
    assert kept.differing(changed)
    said = kept.start_new_record(changed, SessionCounters(), None)
    monitor.forget()
    monitor.feed(block(0, 50))
    kept.close(SessionCounters(), None)
    assert "lab.other-settings-1.state" in said
    assert decode((tmp_path / "lab.other-settings-1.state").read_bytes()).record.stream
    assert decode((tmp_path / "lab.state").read_bytes()).header.settings == changed.settings


def test_the_calendar_may_be_set_between_two_runs(tmp_path: Path) -> None:
    class Tomorrow(HostClock):
        def now(self) -> datetime:
            return datetime.now(UTC) + timedelta(days=1)

    if (boot := persistence._boot_id()) is None:
        pytest.skip("this machine does not tell one boot from another")
    clock = Tomorrow()
    leave(tmp_path)
    saved = decode((tmp_path / "lab.state").read_bytes()).header
    header = replace(saved, boot=boot, saved="2026-01-01T00:00:00.000Z", uptime_s=clock.uptime_s() - 5.0)
    assert persistence._since(header, clock) == pytest.approx(5.0, abs=2.0)


def test_a_directory_that_cannot_be_written_is_said_and_then_mended(tmp_path: Path) -> None:
    kept, monitor, _ = begun(tmp_path, facts())
    monitor.feed(block(0))
    place = tmp_path / "lab.state.new"
    place.mkdir()  # nothing can be written under this name
    kept.save(SessionCounters(), None)
    kept._checkpoint.flush()
    assert [level for _, level in kept.problems()] == ["error"]
    assert not list(kept.problems())  # once per change
    place.rmdir()
    kept.close(SessionCounters(), None)
    assert Checkpoint(tmp_path, "lab").load()[0] is not None


def test_a_state_that_is_removed_is_made_again_and_said_once(tmp_path: Path) -> None:
    directory = tmp_path / "state"
    kept, monitor, _ = begun(directory, facts())
    monitor.feed(block(0))
    kept.save(SessionCounters(), None)
    assert kept._checkpoint.flush()
    assert not list(kept.problems())
    shutil.rmtree(directory)
    kept.save(SessionCounters(), None)
    assert kept._checkpoint.flush()
    ((text, level),) = kept.problems()
    assert ("removed" in text, level) == (True, "warning")
    kept.close(SessionCounters(), None)
    assert not list(kept.problems())
    assert Checkpoint(directory, "lab").load()[0] is not None
