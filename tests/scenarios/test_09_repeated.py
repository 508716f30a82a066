"""Faults that come again and again, or in each phase: kills, an unplugged cable, a full disk at every write."""

from __future__ import annotations

import json
import random
import select
import shutil
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from daemons import Daemon
from laws import ON_THE_WAY, Fault, adds_up, is_kept, nothing_invented
from scene import CONFIG, ID, Scene, scene
from test_03_disk import NAMESPACE, mounts
from test_05_signals import first_samples, reconnecting, running, saving, shaking_hands, starting, stopping
from test_07_history import EVER, kept
from waiting import until

from imumon.checkpoint import Checkpoint, decode
from imumon.history.store import SUFFIX, HistoryStore
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


PHASES = (starting, shaking_hands, first_samples, running, saving, reconnecting, stopping)
UNSTARTED = (starting, shaking_hands)
"""A machine that is free has started by then; it waits for the sensor."""


def has_waited(play: Scene) -> bool:
    return any(report.state == "waiting" for report, _ in play.daemon.viewer.reports().values())


@pytest.mark.parametrize("phase", PHASES, ids=lambda phase: phase.__name__)
def test_27_unplugged_while(tmp_path: Path, phase: Callable[[Scene], None]) -> None:
    """A start without the sensor is an error of one line; whoever has measured waits for it, and goes on."""
    with scene(tmp_path, seed=27, start=False) as play:
        phase(play)
        if phase is not reconnecting:
            play.sensor.ask("unplug")
        until(lambda: play.daemon.process.poll() is not None or has_waited(play))
        if not has_waited(play):
            assert phase in UNSTARTED or phase is stopping
            out, said = play.daemon.ended()
            assert "Traceback" not in said
            assert play.daemon.process.returncode in ((0,) if phase is stopping else (1, 3)), said
            if phase is stopping:
                final = from_json(Report, out)
                adds_up(final)
                is_kept(play.state / f"{ID}.state", final)
            else:
                error = json.loads(said.splitlines()[-1])["error"]
                assert error["code"] in ("port_not_found", "device_lost")
                assert error["cure"]
            return
        play.daemon.wait(lambda r: r.state == "waiting")
        play.sensor.ask("replug")
        report = play.calm().report
        assert report.session.gaps >= 1
        final = play.stop()
        adds_up(final)
        told = play.sensor.ask("counters")
        nothing_invented(final, told["sent"] - told["replies"])


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
ROOM = struct.Struct("qq")
"""Calls that still succeed, and those that have failed, as `full_disk.c` has them."""
PATIENCE_S = 30.0


class FullDisk:
    """The disk of a daemon, which is full after so many more calls that write, or has room."""

    def __init__(self, folder: Path, directory: Path) -> None:
        library, source = folder / "full_disk.so", Path(__file__).with_name("full_disk.c")
        subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", library, source, "-ldl"], check=True)
        self._room = folder / "room"
        self._room.write_bytes(ROOM.pack(-1, 0))
        self.world = {
            "LD_PRELOAD": str(library), "FULL_DISK": str(directory), "FULL_DISK_ROOM": str(self._room)
        }  # fmt: skip

    def leave(self, calls: int) -> None:
        with self._room.open("r+b") as file:
            file.write(ROOM.pack(calls, 0))

    @property
    def failed(self) -> int:
        return int(ROOM.unpack(self._room.read_bytes())[1])


SAYS = {
    "state": ("the state cannot be saved", "saved again"),
    "history": ("the history cannot be", "written again"),
}
"""Texts of the lines for a disk that is full, and that has room again."""


def unsaved(play: Scene) -> list[str]:
    """Return what is said to be unsaved; each full disk is said once, with its cure, and so is its end."""
    lines = play.daemon.log.splitlines()
    of_kind = {kind: [line for line in lines if any(text in line for text in SAYS[kind])] for kind in SAYS}
    for kind, said in of_kind.items():
        full, again = SAYS[kind]
        assert all(full in line and ": free space" in line for line in said[::2]), said
        assert all(again in line for line in said[1::2]), said
    return [kind for kind, said in of_kind.items() if len(said) % 2]


def readable(directory: Path, scratch: Path, least: int) -> int:
    """Return the samples of the state that a daemon would continue; nothing is set aside, and the history is read."""
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir()
    for path in directory.iterdir():
        with suppress(FileNotFoundError):  # what a save in progress removes
            shutil.copy2(path, scratch)
    loaded, messages = Checkpoint(scratch, ID).load()
    assert loaded is not None
    assert not messages
    samples = loaded.record.samples
    assert samples >= least
    with HistoryStore(scratch / f"{ID}{SUFFIX}") as store:
        assert sum(timed.period.samples for timed in store.periods(EVER)) > 0
    return int(samples)


@pytest.mark.skipif(shutil.which("cc") is None, reason="a C compiler makes the full disk; install gcc")
@pytest.mark.parametrize("first", range(0, CALLS_OF_A_SAVE, CALLS_OF_A_DAEMON))
def test_30_disk_is_full_at_each_write(tmp_path: Path, first: int) -> None:
    """The first call of a save that fails is each in turn: the state before stays, one line each, and it recovers."""
    with scene(tmp_path, seed=30, start=False) as play:
        disk = FullDisk(tmp_path, play.state)
        play.start(environment=disk.world)
        play.daemon.wait(
            lambda r: (play.state / f"{ID}.state.1").exists() and kept(play.state / f"{ID}{SUFFIX}") > 0
        )
        least = 0
        for calls in range(first, first + CALLS_OF_A_DAEMON):
            disk.leave(calls)
            until(lambda: disk.failed > 0 and unsaved(play), PATIENCE_S)
            further = disk.failed + 1
            until(lambda further=further: disk.failed > further, PATIENCE_S)
            least = readable(play.state, tmp_path / "copy", least)
            disk.leave(-1)
            until(lambda: not unsaved(play), PATIENCE_S)
        final = play.stop()
        adds_up(final)
        told_by = play.sensor.ask("counters")
        nothing_invented(final, told_by["sent"] - told_by["replies"])
        assert final.session.missing == 0
        assert 0 < kept(play.state / f"{ID}{SUFFIX}") <= final.session.samples
        assert not [
            path.name for path in play.state.iterdir() if "damaged" in path.name or ".new" in path.name
        ]


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
