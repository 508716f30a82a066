"""Alert command: what it gets, how often, and that it never delays the daemon."""

from __future__ import annotations

import json
import logging
import os
from pathlib import Path

import pytest
from daemons import Daemon
from faulty_sensor import spawn
from waiting import until

from imumon.daemon import alert_command
from imumon.daemon.alert_command import AlertCommand
from imumon.model.report import Event
from imumon.sources.vn100.emulator import EmulatorSettings


def event(kind: str, level: str = "warning", text: str = "x") -> Event:
    return Event(time="2026-01-02T00:00:00.000Z", kind=kind, text=text, device="a", level=level)


def appended(path: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


class Clock:
    now = 1000.0

    def __call__(self) -> float:
        return self.now


def test_warnings_are_passed_on_once_a_minute_and_kind(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    out, clock = tmp_path / "out", Clock()
    alert = AlertCommand(f"cat >> '{out}'", clock)
    alert.submit(event("gap", "debug"))
    alert.submit(event("grade", "info"))
    alert.submit(event("connect", "notice"))
    for text in ("first", "second", "third"):
        alert.submit(event("loss", text=text))
    alert.submit(event("recording", "error", '"; rm -rf / # °'))
    clock.now += 61.0
    alert.submit(event("loss", text="fourth"))
    alert.submit(event("loss", text="fifth"))
    with caplog.at_level(logging.INFO, "imumon"):
        alert.close()
    alerts = appended(out)
    assert [(each["text"], each["suppressed"]) for each in alerts] == [
        ("first", 0),
        ('"; rm -rf / # °', 0),
        ("fourth", 2),
    ]
    assert alerts[0].keys() == {*Event.__dataclass_fields__, "suppressed"}
    assert "did not get 3 events" in caplog.text
    alert.submit(event("change"))  # after the end nothing happens
    assert len(appended(out)) == 3


def test_a_command_that_hangs_is_killed_with_its_children(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(alert_command, "KILL_S", 2.0)
    pids, out = tmp_path / "pids", tmp_path / "out"
    hangs = f"test -e '{pids}' && cat >> '{out}' && exit; sleep 600 & echo $! $$ > '{pids}'; wait"
    alert = AlertCommand(hangs)
    alert.submit(event("loss"))
    alert.submit(event("change"))
    until(lambda: appended(out))  # the second one runs after the first one is killed
    until(lambda: not any(runs(int(pid)) for pid in pids.read_text().split()))  # reaped by another process
    alert.close()
    assert "the alert command was killed: it took longer than 2 s" in caplog.text


@pytest.mark.parametrize(
    ("command", "problem"), [("exit 3", "failed with exit code 3"), ("a\0b", "cannot be started")]
)
def test_a_command_that_fails_is_logged_once(
    command: str, problem: str, caplog: pytest.LogCaptureFixture
) -> None:
    alert = AlertCommand(command)
    alert.submit(event("loss"))
    alert.submit(event("change"))
    until(lambda: caplog.text)
    alert.close()
    assert caplog.text.count(problem) == 1


def test_a_daemon_passes_on_that_its_sensor_is_disconnected(tmp_path: Path) -> None:
    out, config = tmp_path / "out", tmp_path / "config.toml"
    command = f"cat >> '{out}'; grep -q disconnect '{out}' && sleep 600"
    config.write_text(f'[alert]\ncommand = "{command}"\n')
    with (
        spawn(EmulatorSettings(seed=1, link=str(tmp_path / "port"))) as sensor,
        Daemon(str(tmp_path / "port"), tmp_path / "state", "--config", str(config)) as daemon,
    ):
        daemon.samples(100)
        sensor.ask("unplug")
        daemon.wait(lambda r: r.state == "waiting")
        until(lambda: "disconnect" in [each["kind"] for each in appended(out)])
        sensor.ask("replug")  # while the command hangs
        report = daemon.wait(lambda r: r.state == "running")
        daemon.samples(report.session.samples + 100)
        assert daemon.stop()[0] == 0
    (alert,) = [each for each in appended(out) if each["kind"] == "disconnect"]
    assert alert["level"] == "warning"
    assert alert["device"] == "vn100-0100056785"
    assert os.listdir(tmp_path / "state")
