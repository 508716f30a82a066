"""Faults of what watches the daemon: an alert command that hangs."""

from __future__ import annotations

from pathlib import Path

import pytest
from laws import ON_THE_WAY, Fault
from scene import scene

pytestmark = pytest.mark.slow


def test_24_alert_command_hangs(tmp_path: Path) -> None:
    """It is killed with its children after 10 s, which is said once; the daemon neither waits nor loses a sample."""
    pids = tmp_path / "pids"
    hangs = f"[alert]\ncommand = 'echo $$ >> {pids}; sleep 600 & echo $! >> {pids}; wait'\n"
    with scene(tmp_path, seed=24, start=False) as play:
        play.start(settings=hangs)
        before = play.calm()
        play.sensor.ask("unplug")
        play.daemon.wait(lambda r: r.state == "waiting")
        play.sensor.ask("replug")
        during = play.calm()
        command, child = (int(pid) for pid in pids.read_text().split()[:2])
        assert Path(f"/proc/{child}").exists()
        play.daemon.wait(lambda r: "the alert command was killed" in play.daemon.log)
        assert not Path(f"/proc/{command}").exists()
        play.daemon.wait(lambda r: not Path(f"/proc/{child}").exists())
        after = play.calm()
        assert after.report.session.missing == during.report.session.missing
        play.end(before, after, Fault(on_the_way=ON_THE_WAY))
        assert play.said.count("the alert command was killed") == 1
