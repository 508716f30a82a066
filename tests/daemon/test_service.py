"""The service: the unit, the messages to the service manager, and the log."""

from __future__ import annotations

import logging
import os
import re
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from daemons import Daemon
from paths import ROOT

from imumon.config import Settings
from imumon.daemon import Daemon as Reader
from imumon.daemon import RunOptions
from imumon.daemon.log import configure_logging
from imumon.sources.vn100.emulator import EmulatorSettings, spawn

UNIT = ROOT / "systemd" / "imumon@.service"


def test_the_settings_of_the_unit() -> None:
    unit = dict(re.findall(r"^(\w+)=(.*)$", UNIT.read_text(), re.MULTILINE))
    assert unit.items() >= {
        "Type": "notify", "ExecStart": "imumon run --port /dev/%I", "Documentation": "man:imumon(1)",
        "DynamicUser": "yes", "SupplementaryGroups": "dialout", "StateDirectory": "imumon/%i",
    }.items()  # fmt: skip
    assert int(unit["WatchdogSec"]) >= 10
    assert "BindsTo" not in unit  # it would end the record at every replug


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
def test_the_exposure_is_low() -> None:
    command = ["systemd-analyze", "security", "--offline=true", "--threshold=13", "--no-pager", UNIT]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout.splitlines()[-1:]


class NotifySocket:
    """The end of the notification socket that a service manager reads."""

    def __init__(self, directory: Path) -> None:
        self.path = directory / "notify"
        self.messages: list[str] = []
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(self.path))
        self._socket.settimeout(90.0)

    def until(self, text: str, count: int = 1) -> int:
        """Return the index of the `count`-th message that starts with the text."""
        while len(places := [k for k, said in enumerate(self.messages) if said.startswith(text)]) < count:
            self.messages.append(self._socket.recv(4096).decode())
        return places[count - 1]

    def close(self) -> None:
        self._socket.close()


@contextmanager
def managed(port: str, directory: Path) -> Iterator[tuple[NotifySocket, Daemon]]:
    """Yield a daemon with this process as its service manager."""
    manager = NotifySocket(directory)
    settings = {"NOTIFY_SOCKET": str(manager.path), "WATCHDOG_USEC": "1000000"}
    with Daemon(port, directory, environment=settings) as daemon:
        yield manager, daemon
    manager.close()


def test_ready_comes_with_the_first_sample_and_the_grade_with_the_status(tmp_path: Path) -> None:
    with spawn(EmulatorSettings(seed=1)) as sensor, managed(sensor.path, tmp_path) as (manager, daemon):
        assert manager.until("STATUS=starting") < manager.until("READY=1") < manager.until("STATUS=running")
        manager.until("STATUS=running; gyro: consumer")
        assert manager.messages.count("READY=1") == 1
        manager.until("WATCHDOG=1", count=3)
        assert daemon.stop()[0] == 0
        manager.until("STOPPING=1")
        manager.until("STATUS=stopped")


def test_ready_comes_with_the_first_waiting(tmp_path: Path) -> None:
    with managed(str(tmp_path / "ttyNONE"), tmp_path) as (manager, daemon):
        manager.until("READY=1")
        manager.until("STATUS=waiting: no port")
        manager.until("WATCHDOG=1")
        code, _, log = daemon.stop()
    assert code == 0
    assert log.count("waiting") == 1  # logged once, however long it lasts


def test_a_device_that_is_silent_from_the_start_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise it would never be ready, and be killed and started again and again."""
    daemon = Reader(Settings(), RunOptions(url="", state_directory=tmp_path))
    daemon._connection.connected = True
    monkeypatch.setattr("imumon.daemon.run_limits.timeout_s", lambda rate_hz: 0.0)
    daemon._handle(None)
    assert daemon._connection.state == "starting"
    daemon._handle(None)
    assert daemon._connection.state == "waiting"


LOGGER = logging.getLogger("imumon.daemon")


def test_a_full_standard_error_does_not_block_and_drops_are_counted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ours, theirs = os.pipe()
    read: list[bytes] = []
    with open(ours, "rb") as reader:
        with open(theirs, "w") as pipe:
            monkeypatch.setattr(sys, "stderr", pipe)
            close = configure_logging("debug", format="text")
            for k in range(5000):  # a pipe holds 64 kB
                LOGGER.debug("line %050d", k)
            thread = threading.Thread(target=lambda: read.append(reader.read()))
            thread.start()
            queue = logging.getLogger("imumon").handlers[0].queue
            while not queue.empty():
                time.sleep(0.01)
            LOGGER.info("at last")
            close()
        thread.join(60.0)
    text = b"".join(read).decode()
    written = [int(number) for number in re.findall(r" line (\d+)$", text, re.MULTILINE)]
    dropped = [int(number) for number in re.findall(r" (\d+) log lines? dropped: ", text)]
    assert written == sorted(set(written))
    assert len(written) + sum(dropped) == 5000
    assert sum(dropped) > 0
    assert text.endswith(" at last\n")


def test_faults_of_libraries_and_threads_are_lines(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with (tmp_path / "err").open("w") as file:
        monkeypatch.setattr(sys, "stderr", file)
        close = configure_logging(format="text")
        try:
            raise OSError("too many open files")
        except OSError:
            logging.getLogger("asyncio").exception("socket.accept() out of system resource")
        thread = threading.Thread(target=lambda: 1 // 0)
        thread.start()
        thread.join()
        close()
    of_library, of_thread = (tmp_path / "err").read_text().splitlines()
    assert "out of system resource: OSError: too many open files" in of_library
    assert "has ended: ZeroDivisionError" in of_thread


@pytest.mark.parametrize("form", ["auto", "journal", "json", "text"])
def test_only_the_journal_gets_priorities(form: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with (tmp_path / "err").open("w") as file:
        monkeypatch.setattr(sys, "stderr", file)
        monkeypatch.setenv("JOURNAL_STREAM", "9:1")  # inherited from another, as in a terminal of a desktop
        close = configure_logging(format=form)
        LOGGER.warning("elsewhere")
        close()
        status = os.fstat(file.fileno())
        monkeypatch.setenv("JOURNAL_STREAM", f"{status.st_dev}:{status.st_ino}")
        close = configure_logging(format=form)
        LOGGER.error("here")
        close()
    elsewhere, here = (tmp_path / "err").read_text().splitlines()
    assert elsewhere.startswith("<4>") == (form == "journal")
    assert here.startswith("<3>")
