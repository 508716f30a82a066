"""The daemon as a user runs it: real emulator, real port, real bus; its history and its alert command."""

from __future__ import annotations

import json
import logging
import os
import signal
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh_sessions
from commands import imumon
from daemons import Daemon, n_is_within_a_tenth
from faulty_sensor import spawn
from free_ports import free_endpoint, free_port
from histories import with_slopes, write
from line_sender import datagrams
from waiting import until

from imumon.checkpoint import decode
from imumon.config import load
from imumon.daemon import Daemon as Reader
from imumon.daemon import RunOptions, alert_command
from imumon.daemon.alert_command import AlertCommand
from imumon.documents.summary import summary_text
from imumon.model.report import Event, Report
from imumon.model.samples import DeviceInfo
from imumon.sources.device import BATCH_S, Interrupted
from imumon.sources.serial_port import SerialPort
from imumon.sources.vn100.emulator import EmulatorSettings
from imumon.sources.vn100.vn100_session import Vn100Session


def adds_up(report: Report) -> None:
    """The laws of the counters."""
    session = report.session
    rate = report.device.sample_rate_hz
    assert round(session.elapsed_s * rate) == session.samples + session.missing


@pytest.mark.few
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT])
def test_from_bytes_to_a_grade_and_back_to_rest(tmp_path: Path, number: signal.Signals) -> None:
    with spawn(EmulatorSettings(seed=1)) as sensor, Daemon(sensor.path, tmp_path) as daemon:
        report = daemon.wait(
            lambda r: (
                "gyro" in r.grade
                and r.grade["gyro"].meets is not None
                and n_is_within_a_tenth(r.channels["gyro/x"])
            )
        )
        assert report.state == "running"
        assert report.device.stream == "deltas"
        assert report.device.alias_factor == 1.0
        assert report.device.serial == "0100056785"
        assert report.session.missing == 0
        adds_up(report)
        n = report.channels["gyro/x"].coefficients["N"]
        assert n.status == "measured"
        assert 0.9 * n.low < 6.1e-5 < 1.1 * n.high
        code, _, _ = daemon.stop(number)
        assert code == (130 if number == signal.SIGINT else 0)
        assert not list(tmp_path.glob("*.found.json"))  # the sensor has its own settings back


def test_bytes_that_never_become_samples_are_shown(tmp_path: Path) -> None:
    """Within seconds, in the report and in the log: what became of them, and how they begin."""
    port = free_port()
    with datagrams(port, b"IMU \x1b[2J ready\n"), Daemon(f"lines:udp://:{port}", tmp_path) as daemon:
        made = daemon.wait(lambda r: any("no sample yet" in text for text in r.device.remarks))
        assert made.state == "starting"
        (remark,) = (text for text in made.device.remarks if "no sample yet" in text)
        assert " start; the first line is 'IMU \\x1b[2J ready'" in remark
        assert remark in summary_text(made, 1000)
        assert remark in daemon.stop()[2]


def test_restart_goes_on_with_an_exact_hole(tmp_path: Path) -> None:
    away_s = 1.0
    with spawn(EmulatorSettings(seed=2)) as sensor:
        with Daemon(sensor.path, tmp_path) as first:
            before = first.samples(200)
            asked = time.monotonic()
            code, _, err = first.stop()
            assert code == 0, err
        time.sleep(away_s)
        with Daemon(sensor.path, tmp_path) as second:
            # the first reports may have no samples yet, or those of the kept record
            resumed = second.wait(lambda r: r.session.restarts == 1 and r.session.gaps > 0)
            passed = time.monotonic() - asked
            after = second.samples(resumed.session.samples + 200)
            assert after.session.gaps == 1
            assert 100 * away_s < after.session.missing < 100 * (passed + 2.0)  # at 100 Hz
            assert after.session.started == before.session.started
            adds_up(after)
            second.stop()


def here(port: str, state: Path, **options: Any) -> Reader:
    """A daemon in this process."""
    settings = load(None, {"zenoh.listen": [free_endpoint()], "log.level": "error"})
    return Reader(settings, RunOptions(url=port, state_directory=state, **options))


def test_a_stop_while_it_is_being_set_up_leaves_the_kept_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    configure = Vn100Session.configure

    def stopped(session: Vn100Session) -> DeviceInfo:
        configure(session)
        time.sleep(0.3)  # samples have arrived by now
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(0.3)
        raise Interrupted

    with spawn(EmulatorSettings(seed=2)) as sensor:
        with Daemon(sensor.path, tmp_path) as first:
            first.samples(200)
            first.stop()
        kept = {path.name: path.read_bytes() for path in tmp_path.glob("*.state*")}
        assert kept
        monkeypatch.setattr(Vn100Session, "configure", stopped)
        here(sensor.path, tmp_path).run()
        assert {path.name: path.read_bytes() for path in tmp_path.glob("*.state*")} == kept


def test_a_line_that_is_never_silent_does_not_keep_it_from_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with spawn(EmulatorSettings(seed=2)) as sensor:
        reader = here(sensor.path, tmp_path, duration_s=2.0)
        read = SerialPort.read

        def flood(port: SerialPort, timeout: float) -> bytes:
            return read(port, timeout) or (bytes(1000) if reader._connection.state == "running" else b"")

        monkeypatch.setattr(SerialPort, "read", flood)
        monkeypatch.setattr(SerialPort, "waits", True)
        begun = time.monotonic()
        outcome = reader.run()
        assert time.monotonic() - begun < 60.0
        assert outcome.report.session.samples > 50


def test_what_has_come_by_the_stop_counts(tmp_path: Path) -> None:
    config = tmp_path / "config.toml"
    # reports come so fast that the first stall ends before the daemon takes the sensor for lost, and none before the
    # next batch of bytes
    config.write_text(f"[report]\nperiod_s = {BATCH_S + 0.1}\n")
    # a silent sensor is asked nothing: all that is sent are samples
    words = ("--listen-only", "--rate", "40", "--config", str(config))
    with spawn(EmulatorSettings(seed=2)) as sensor, Daemon(sensor.path, tmp_path, *words) as daemon:

        def all_is_read() -> None:
            until(lambda: not sensor.ask("counters")["unread"])

        daemon.samples(100)
        before = sensor.ask("stall 600")
        all_is_read()
        # the next report may have been on its way; one has all samples when the one after it has no more
        told = daemon.samples()
        later = daemon.wait(lambda r: r.time > told.time)
        first = daemon.wait(lambda r: r.time > later.time)
        while (
            later := daemon.wait(lambda r, t=first.time: r.time > t)
        ).session.samples > first.session.samples:
            first = later
        sensor.ask("stall 0")

        def sent_since() -> int:
            return sensor.ask("counters")["sent"] - before["sent"]

        # what gathered in the silence is in a report, but for two seconds of samples: the end of a run has a time limit
        daemon.wait(lambda r: r.session.samples - first.session.samples > max(60, sent_since() - 80))
        time.sleep(0.3)  # more gathers, and is in no report yet
        after = sensor.ask("stall 600")
        all_is_read()
        daemon.process.send_signal(signal.SIGTERM)
        last = daemon.wait(lambda r: r.state == "stopped")
        assert after["replies"] == 0
        assert last.session.samples - first.session.samples == after["sent"] - before["sent"]
        adds_up(last)


def test_a_stop_saves_before_its_last_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A last report may take seconds, and a service manager kills what takes too long."""
    publish, saved = Reader._publish, []

    def late(reader: Reader) -> Report:
        if reader._connection.state == "stopped":
            (path,) = until(lambda: list(tmp_path.glob("*.state")))
            samples = reader._record.samples
            until(lambda: decode(path.read_bytes()).record.samples == samples)
            saved.append(samples)
        return publish(reader)

    monkeypatch.setattr(Reader, "_publish", late)
    with spawn(EmulatorSettings(seed=2)) as sensor:
        outcome = here(sensor.path, tmp_path, duration_s=2.0).run()
    assert saved == [outcome.report.session.samples]


# ---------------------------------------- the history of a real daemon


CONFIG = "[state]\nsave_period_s = 1.0\n[report]\nperiod_s = 0.25\n"


def ask(endpoint: str, selector: str) -> tuple[list[dict[str, object]], list[str]]:
    """Replies and refusals of a get by plain Zenoh."""
    found: list[dict[str, object]] = []
    refused = []
    with zenoh_sessions.client(endpoint) as session:
        for reply in session.get(selector):
            if reply.ok is not None:
                assert str(reply.ok.encoding) == "application/json"
                found += json.loads(reply.ok.payload.to_bytes())
            else:
                refused.append(json.loads(reply.err.payload.to_bytes())["error"]["code"])
    return found, refused


def two_rows(endpoint: str) -> list[dict[str, object]] | None:
    """The rows of a channel; None if there are not two yet."""
    rows, _ = ask(endpoint, "imumon/lab/history?channel=gyro/x")
    return rows if len(rows) > 1 else None


@pytest.mark.slow
def test_history_of_a_daemon_from_the_bus_to_the_file(tmp_path: Path) -> None:
    """In time-lapse, 200 s a second: killed in the middle of a row, which then goes on."""
    config = tmp_path / "config.toml"
    config.write_text(CONFIG)
    words = ("--speed", "200", "--seed", "3", "--id", "lab", "--config", str(config))
    with Daemon("sim", tmp_path, *words) as daemon:
        daemon.wait(lambda r: r.session.elapsed_s > 3700, 150.0)
        rows = until(lambda: two_rows(daemon.endpoint))
        assert [row["complete"] for row in rows[:-1]] == [True] * (len(rows) - 1)
        assert rows[-1]["complete"] is False
        assert {(row["device"], row["channel"], row["step"]) for row in rows} == {("lab", "gyro/x", "1h")}
        assert rows[0]["N"]["status"] == "measured"
        assert ask(daemon.endpoint, "imumon/lab/history?_time=[now(-2h)..now(-1h)]") == ([], [])
        assert ask(daemon.endpoint, "imumon/lab/history?step=7m") == ([], ["step_invalid"])
        whole, _ = ask(daemon.endpoint, "imumon/lab/history?step=1d")
        assert {row["channel"] for row in whole} >= {"gyro/x", "accel/z", "temperature"}
        kinds = {each["kind"] for each in ask(daemon.endpoint, "imumon/lab/history/event")[0]}
        assert {"connect", "grade"} <= kinds
        said = imumon("history", "--connect", daemon.endpoint, "--channel", "gyro/y", code=0)
        assert len(said.splitlines()) >= 3
        daemon.stop(signal.SIGKILL)
    before = json.loads(imumon("history", "--state", str(tmp_path), "--channel", "gyro/x", "--json"))
    assert len(before) >= 2
    assert sum(row["samples"] for row in before) > 3600 * 100


def test_a_restarted_daemon_reports_that_the_slope_of_the_bias_has_changed(tmp_path: Path) -> None:
    """The days are those of earlier runs, some of which ended in the middle of a day."""
    scatter = 1e-7 * np.random.default_rng(5).standard_normal(31)
    slopes = np.where(np.arange(31) < 24, -1e-6, 1e-6) + scatter
    days = with_slopes(slopes.tolist(), 1e-7, begin=time.time() - 32 * 86400)
    for number, day in enumerate(days[20:], 20):
        cut = replace(day.period, complete=False, number=0)
        days[number] = replace(
            day, record=f"2026-02-{number:02}T00:00:00.000Z", end=day.begin + 40_000, period=cut
        )
    write(tmp_path, "lab", days)
    with Daemon("sim", tmp_path, "--id", "lab", "--fresh") as daemon:
        daemon.samples(10)
        (event,) = until(lambda: [e for e in daemon.viewer.events("lab") if e.kind == "change"])
        assert (event.channel, event.level) == ("gyro/x", "warning")
        assert event.text.startswith("gyro/x: the slope against the temperature has moved from -")


# ---------------------------------------- alert command


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
