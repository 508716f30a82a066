"""The daemon as a user runs it: real emulator, real port, real bus."""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from daemons import Daemon, free_endpoint, n_is_within_a_tenth
from faulty_sensor import spawn
from free_ports import free_port
from waiting import until

from imumon.checkpoint import decode
from imumon.config import load
from imumon.daemon import Daemon as Reader
from imumon.daemon import RunOptions
from imumon.documents.summary import summary_text
from imumon.model.report import Report
from imumon.model.samples import DeviceInfo
from imumon.sources.device import Interrupted
from imumon.sources.serial_port import SerialPort
from imumon.sources.vn100.emulator import EmulatorSettings
from imumon.sources.vn100.vn100_session import Vn100Session


def adds_up(report: Report) -> None:
    """The laws of the counters."""
    session = report.session
    rate = report.device.sample_rate_hz
    assert rate is not None
    assert round(session.elapsed_s * rate) == session.samples + session.missing


def test_from_bytes_to_a_grade_and_back_to_rest(tmp_path: Path) -> None:
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
        assert n.low is not None
        assert n.high is not None
        assert 0.9 * n.low < 6.1e-5 < 1.1 * n.high
        code, _, _ = daemon.stop()
        assert code == 0
        assert not list(tmp_path.glob("*.found.json"))  # the sensor has its own settings back


def test_bytes_that_never_become_samples_are_shown(tmp_path: Path) -> None:
    """Within seconds, in the report and in the log: what became of them, and how they begin."""
    port, ending = free_port(), threading.Event()

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as board:
            while not ending.wait(0.02):
                board.sendto(b"IMU \x1b[2J ready\n", ("127.0.0.1", port))

    thread = threading.Thread(target=send)
    thread.start()
    try:
        with Daemon(f"lines:udp://:{port}", tmp_path) as daemon:
            made = daemon.wait(lambda r: any("no sample yet" in text for text in r.device.remarks))
            assert made.state == "starting"
            (remark,) = (text for text in made.device.remarks if "no sample yet" in text)
            assert " start; the first line is 'IMU \\x1b[2J ready'" in remark
            assert remark in summary_text(made, 1000)
            assert remark in daemon.stop()[2]
    finally:
        ending.set()
        thread.join()


def test_restart_goes_on_with_an_exact_hole(tmp_path: Path) -> None:
    away_s = 1.0
    with spawn(EmulatorSettings(seed=2)) as sensor:
        with Daemon(sensor.path, tmp_path) as first:
            before = first.samples(200)
            asked = time.monotonic()
            code, _, _ = first.stop()
            assert code == 0
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
        reader = here(sensor.path, tmp_path, duration_s=4.0)
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
    words = (
        "--listen-only",
        "--rate",
        "40",
    )  # a silent sensor is asked nothing: all that is sent are samples
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
        daemon.samples(first.session.samples + 60)
        time.sleep(0.3)  # more gathers, and is in no report yet
        after = sensor.ask("stall 600")
        all_is_read()
        time.sleep(0.1)  # the thread that has read it puts it into the queue
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
        outcome = here(sensor.path, tmp_path, duration_s=4.0).run()
    assert outcome.report is not None
    assert saved == [outcome.report.session.samples]


@pytest.mark.few
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT])
def test_a_signal_that_ends_the_daemon_restores_the_sensor(tmp_path: Path, number: signal.Signals) -> None:
    with spawn(EmulatorSettings(seed=2)) as sensor, Daemon(sensor.path, tmp_path) as daemon:
        daemon.samples(100)
        code, _, _ = daemon.stop(number)
        assert code == (130 if number == signal.SIGINT else 0)
        assert not list(tmp_path.glob("*.found.json"))  # the sensor has its own settings back
