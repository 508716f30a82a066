"""Faults of the sensor and of the host: a reboot, a wrong calendar, a process that is stopped and goes on."""

from __future__ import annotations

import shutil
import signal
import struct
import subprocess
import time
from datetime import datetime
from pathlib import Path

import pytest
from laws import Fault
from scene import ID, scene
from test_07_history import kept

from imumon.history.store import SUFFIX

pytestmark = pytest.mark.slow

DAY_S = 86400


def test_05_sensor_reboots(tmp_path: Path) -> None:
    """Its clock begins anew: a gap of a length that nobody knows, and the record goes on."""
    with scene(tmp_path, seed=5) as play:
        before = play.calm()
        play.sensor.ask("reboot")
        play.daemon.wait(lambda r: r.session.restarts == 1)
        after = play.calm()
        assert play.events("reconfigured")
        play.end(before, after, Fault(unknown=1, beside=10_000))


@pytest.mark.skipif(shutil.which("cc") is None, reason="a C compiler makes the wrong calendar; install gcc")
@pytest.mark.parametrize("step_s", [3600, DAY_S, 20 * 365 * DAY_S], ids=["hour", "day", "years"])
def test_07_calendar_of_the_host_steps(tmp_path: Path, step_s: int) -> None:
    """Forward, twice as far back, forward again: nothing but the stamps of the reports may notice."""
    library, off = tmp_path / "calendar.so", tmp_path / "off"
    source = Path(__file__).with_name("calendar.c")
    subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", library, source, "-ldl"], check=True)
    off.write_bytes(struct.pack("q", 0))
    with scene(tmp_path, seed=7, start=False) as play:
        world = {"LD_PRELOAD": str(library), "CALENDAR_OFF": str(off)}
        play.start(environment=world)
        before = play.calm()
        stepped = []
        for steps in (1, -1):
            with open(off, "r+b") as file:
                file.write(struct.pack("q", steps * step_s))
            report = play.calm().report
            stamp = datetime.fromisoformat(report.time).timestamp()
            stepped.append(round((stamp - time.time()) / step_s, 1))
        assert stepped == [1.0, -1.0]
        middle = play.calm()
        assert middle.report.session.missing == 0
        play.stop()
        off.write_bytes(struct.pack("q", 0))
        play.start(environment=world)  # of a state that was saved at the other time
        after = play.calm()
        assert after.report.session.gaps == 1
        final = play.end(before, after, Fault(restarts=1))
        # the period in progress is complete in the state alone; nothing is in the history twice
        assert 0 < kept(play.state / f"{ID}{SUFFIX}") <= final.session.samples


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
