"""Faults of what watches the daemon: an alert command that hangs, a metrics port that others have."""

from __future__ import annotations

import socket
from contextlib import ExitStack
from pathlib import Path

import pytest
from commands import imumon
from daemons import free_endpoint
from free_ports import free_port
from laws import ON_THE_WAY, Fault
from scene import scene

from imumon.history.metrics import PORTS

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


def test_25_metrics_port_is_taken(tmp_path: Path) -> None:
    """The next free one serves, and the log has it; if all are taken, the start is refused in one line."""
    first = free_port()
    listen = f"[metrics]\nlisten = '127.0.0.1:{first}'\n"
    with scene(tmp_path, seed=25, start=False) as play, ExitStack() as others:

        def take(port: int) -> None:
            other = others.enter_context(socket.socket())
            try:
                other.bind(("127.0.0.1", port))
                other.listen()
            except OSError:  # somebody has it already
                return

        take(first)
        play.start(settings=listen)
        before = play.calm()
        assert play.daemon.metrics["imumon_up",] == 1.0
        assert f"metrics on http://127.0.0.1:{first}/" not in play.daemon.log
        for port in range(first, first + PORTS):
            take(port)
        (tmp_path / "taken.toml").write_text(listen)
        words = ("run", "--port", "sim", "--state", tmp_path / "b", "--listen", free_endpoint())
        said = imumon(*words, "--config", tmp_path / "taken.toml", code=1)
        assert f"127.0.0.1:{first}" in said
        play.end(before, play.calm())
