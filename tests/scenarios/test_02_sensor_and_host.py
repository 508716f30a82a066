"""Faults of the sensor and of the host: a reboot, and a process that is stopped and continues."""

from __future__ import annotations

import signal
import time
from pathlib import Path

import pytest
from laws import Fault
from scene import ID, scene

pytestmark = pytest.mark.slow


def test_05_sensor_reboots(tmp_path: Path) -> None:
    """Its clock begins anew: a gap of a length that nobody knows, and the record goes on."""
    with scene(tmp_path, seed=5) as play:
        before = play.calm()
        play.sensor.ask("reboot")
        play.daemon.wait(lambda r: r.session.restarts == 1)
        after = play.calm()
        assert play.events("reconfigured")
        play.end(before, after, Fault(unknown=1, beside=10_000))


@pytest.mark.parametrize("seconds", [1.5, 60.0])
def test_08_stopped_and_continued(tmp_path: Path, seconds: float) -> None:
    """What the terminal holds is read afterwards; what it could not hold is missing, to the sample."""
    with scene(tmp_path, seed=8) as play:
        before = play.calm()
        play.daemon.process.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        assert seconds < 4.0 or not play.daemon.viewer.alive()  # beyond the lease the subscriber misses it
        play.daemon.process.send_signal(signal.SIGCONT)
        gone_s = before.report.session.elapsed_s + seconds
        play.daemon.wait(lambda r: r.session.elapsed_s > gone_s)
        after = play.calm()
        play.daemon.wait(lambda r: play.daemon.viewer.alive() == {ID})
        dropped = after.told["dropped"] - before.told["dropped"]
        assert after.report.session.missing == dropped
        assert dropped > 0 or seconds < 4.0
        play.end(before, after)
