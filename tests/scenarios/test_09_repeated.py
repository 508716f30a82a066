"""Faults that come again and again, or in each phase: kills, an unplugged cable, a full disk at every write."""

from __future__ import annotations

import random
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest
from daemons import Daemon
from laws import ON_THE_WAY, Fault
from scene import CONFIG, ID, scene
from test_03_disk import NAMESPACE, mounts
from test_07_history import kept

from imumon.checkpoint import decode
from imumon.history.store import SUFFIX
from imumon.model.report import Report, from_json
from imumon.model.report_json import to_json

pytestmark = pytest.mark.slow

KILLS = 30


@pytest.mark.timeout(900)
def test_26_killed_thirty_times(tmp_path: Path) -> None:
    """At any moment, also within a save: each start goes on with what was saved, at most a second before."""
    moments = random.Random(26)
    with scene(tmp_path, seed=26) as play:
        before = play.calm()
        play.daemon.wait(lambda r: (play.state / f"{ID}.state").exists())
        saved = 0
        for _ in range(KILLS):
            play.daemon.samples(saved + 1)
            time.sleep(moments.uniform(0.0, 1.5))
            play.kill()
            left = time.monotonic()
            record = decode((play.state / f"{ID}.state").read_bytes()).record
            assert record.samples >= saved
            saved = record.samples
            play.start()
            assert play.daemon.samples(saved + 1).session.restarts
            # the save period, and what it takes to save
            play.away_s += time.monotonic() - left + 2.0
        play._left = None
        after = play.calm()
        # a start that is killed before its first save leaves no trace
        restarts = after.report.session.restarts
        assert 1 <= restarts <= KILLS
        final = play.end(before, after, Fault(restarts=restarts, on_the_way=KILLS * ON_THE_WAY))
        # the period in progress is complete in the state alone; nothing is in the history twice
        assert 0 < kept(play.state / f"{ID}{SUFFIX}") <= final.session.samples
        assert not [
            path.name for path in play.state.iterdir() if "damaged" in path.name or ".new" in path.name
        ]


DOCUMENTS = ("json", "csv", "html")


@mounts
@pytest.mark.timeout(600)
def test_29_documents_on_a_full_disk(tmp_path: Path) -> None:
    """Whatever is free, a document is written whole, or its place is as before, with one line and a cure."""
    source, disk = tmp_path / "r.json", tmp_path / "disk"
    disk.mkdir()
    with scene(tmp_path / "scene", seed=29) as play:
        play.calm()
        final = play.stop()
    source.write_text(to_json(final))
    program = (
        "import pathlib, sys\n"
        "disk, source = pathlib.Path(sys.argv[1]), sys.argv[2]\n"
        "filler = disk / 'filler'\n"
        "from imumon.cli import main\n"
        "for name in sys.argv[3:]:\n"
        "    path, free = disk / f'a.{name}', 4\n"
        "    path.write_text('before')\n"
        "    while True:\n"
        "        size = (8 << 20) - (free << 10)\n"
        "        with filler.open('wb') as file:\n"
        "            try:\n"
        "                for _ in range(size >> 12): file.write(bytes(4096)); file.flush()\n"
        "            except OSError: pass\n"
        "        code = main(['report', source, '-o', str(path)])\n"
        "        rest = sorted(p.name for p in disk.iterdir() if p != filler and p.name[2:] not in sys.argv[3:])\n"
        "        print(name, free, code, path.read_bytes() == b'before', path.stat().st_size, rest, flush=True)\n"
        "        if code == 0 or free > 4096: break\n"
        "        free *= 8\n"
        "    path.unlink()\n"
    )
    mount = f'mount -t tmpfs -o size=8m none {disk} && exec "$@"'
    command = [*NAMESPACE, "sh", "-c", mount, "sh", sys.executable, "-c", program]
    done = subprocess.run(
        [*command, str(disk), str(source), *DOCUMENTS], capture_output=True, text=True, check=False
    )
    assert "Traceback" not in done.stderr, done.stderr
    lines = [line.split(maxsplit=5) for line in done.stdout.splitlines()]
    written = {line[0] for line in lines if line[2] == "0"}
    refused = [line for line in lines if line[2] != "0"]
    assert written == set(DOCUMENTS), done.stdout + done.stderr
    assert refused
    for line in refused:
        assert (line[2], line[3], line[5]) == ("1", "True", "[]"), done.stdout
    complaints = [line for line in done.stderr.splitlines() if "space" in line.lower()]
    assert len(complaints) == len(refused)


CALLS_OF_A_SAVE, CALLS_OF_A_DAEMON = 24, 8
"""Calls that write of one save of state and history, with some more; the log has a message ten times an hour."""


DAYS, STEP_S, PERIOD_S = 30, 10, 3600
SAMPLES = DAYS * 86400 // STEP_S


class QuickSensor:
    """A TCP server of lines with a sample every ten seconds, which it sends as fast as they are read.

    Attributes
    ----------
    sent : lines so far.
    until : so many lines, and no more before it is raised.
    """

    def __init__(self) -> None:
        self.sent = self.until = 0
        self._noise = random.Random(32)
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.settimeout(0.1)
        self.url = f"lines:tcp://127.0.0.1:{self._server.getsockname()[1]}?columns=t_us,gx,gy,gz"
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._ending.is_set():
            with suppress(OSError):
                client, _ = self._server.accept()
                with client:
                    self._send(client)

    def _send(self, client: socket.socket) -> None:
        draw = self._noise.gauss
        client.setblocking(True)
        while not self._ending.is_set():
            count = min(self.until - self.sent, 500)
            if not count:
                self._ending.wait(0.02)
                if select.select([client], [], [], 0.0)[0]:
                    return  # the daemon is gone
                continue
            lines = (
                f"{(self.sent + k) * STEP_S * 1_000_000},{draw(0, 1e-3):.6f},{draw(0, 1e-3):.6f},{draw(0, 1e-3):.6f}\n"
                for k in range(count)
            )
            client.sendall("".join(lines).encode())
            self.sent += count

    def close(self) -> None:
        self._ending.set()
        self._thread.join(10)
        self._server.close()


@pytest.mark.timeout(2400)
def test_32_a_month(tmp_path: Path) -> None:
    """Killed after a third and stopped after two: samples, ledger and history add up at the end."""
    config, state, third = tmp_path / "config.toml", tmp_path / "state", SAMPLES // 3
    config.write_text(CONFIG)
    words, known = ("--config", str(config), "--id", ID, "--json"), 0
    sensor = QuickSensor()
    for how in (signal.SIGKILL, signal.SIGTERM, signal.SIGTERM):
        sensor.until += third
        with Daemon(sensor.url, state, *words) as daemon:
            # the last one waits for what shows its time
            daemon.wait(lambda r, least=known + third - 2: r.session.samples >= least, 900.0)
            _, out, said = daemon.stop(how)
        assert "Traceback" not in said
        record = decode((state / f"{ID}.state").read_bytes()).record
        known = record.samples
    sensor.close()
    final = from_json(Report, out)
    session, ledger = final.session, dict(final.session.ledger)
    assert session.samples == known
    assert (
        round(session.elapsed_s * (final.device.sample_rate_hz or 0.0)) == session.samples + session.missing
    )
    assert ledger.pop("received") == sum(ledger.values())
    assert ledger["samples"] == session.samples
    # the kill takes what was read since the last save
    assert 0.5 * sensor.sent < session.samples <= sensor.sent
    assert session.restarts >= 2
    in_history = kept(state / f"{ID}{SUFFIX}")
    # at most the period that was in progress at the kill
    assert session.samples - PERIOD_S // STEP_S <= in_history <= session.samples
