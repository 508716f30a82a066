"""Scenarios: faults of the cable, the sensor, the host, the disk, signals, and kills again and again."""

from __future__ import annotations

import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from laws import ON_THE_WAY, PACKET, Fault, adds_up, is_kept
from scene import ID, STOP_S, Scene, scene
from waiting import until

from imumon.checkpoint import decode
from imumon.history import HistoryStore, Selection
from imumon.history.store import SUFFIX
from imumon.model.report import Report, from_json
from imumon.sources.linux_tty import holders

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("probability", [1e-4, 1e-2])
def test_03_corrupted_bytes(tmp_path: Path, probability: float) -> None:
    with scene(tmp_path, seed=3) as play:
        before = play.calm()
        begun = play.sensor.ask(f"fault corrupt={probability}")["made"]
        play.calm(more=200)
        exposed = play.sensor.ask("fault")["made"] - begun
        after = play.calm(more=250)  # a busy machine has damaged messages on the way
        damaged = 1.0 - (1.0 - probability) ** PACKET
        assert after.report.session.bad_checksums > 0 or damaged * exposed < 5
        play.end(before, after, Fault(exposed=exposed, damaged=damaged))


@pytest.mark.parametrize(
    ("commands", "fault"),
    [
        (("unplug", "replug"), Fault(on_the_way=ON_THE_WAY)),
        # beside a full terminal: what comes while it is opened and configured again
        (("silence 8", "counters"), Fault(on_the_way=8 * ON_THE_WAY, beside=10_000)),
        # its clock begins again: a gap of a length that nobody knows, and the record continues
        (("reboot", "counters"), Fault(unknown=1, beside=10_000)),
    ],
    ids=["unplugged", "silent", "restarted"],
)
def test_01_a_sensor_goes_and_comes_back(tmp_path: Path, commands: tuple[str, str], fault: Fault) -> None:
    with scene(tmp_path, seed=1) as play:
        before = play.calm()
        play.sensor.ask(commands[0])
        play.daemon.wait(lambda r: r.state == "waiting" or r.session.restarts == 1)
        play.sensor.ask(commands[1])
        after = play.calm()
        if fault.unknown:
            assert play.events("reconfigured")
        else:
            assert after.report.session.gaps == 1
            assert [each.kind for each in play.events("connect", "disconnect")][-2:] == [
                "disconnect",
                "connect",
            ]
        play.end(before, after, fault)


# ---------------------------------------- faults of the host


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


SLOW_DISK = Path(__file__).parents[1] / "slow_disk.c"


def waiting_for_a_port(play: Scene) -> None:
    """Under a service manager, which is told."""
    play.sensor.ask("unplug")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(play.folder / "notify"))
        manager.settimeout(20.0)
        play.start(environment={"NOTIFY_SOCKET": str(play.folder / "notify")})
        while not manager.recv(4096).startswith(b"STATUS=waiting"):
            pass


def shaking_hands(play: Scene) -> None:
    """The sensor does not answer yet."""
    play.sensor.ask("silence 30")
    pid = play.start().process.pid
    until(lambda: pid in holders(play.port))


def saving(play: Scene) -> None:
    """The disk has stopped answering in the middle of a save; it comes back a second later."""
    if shutil.which("cc") is None:
        pytest.skip("a C compiler makes the slow disk; install gcc")
    library = play.folder / "slow_disk.so"
    subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", library, SLOW_DISK, "-ldl"], check=True)
    play.start(environment={"LD_PRELOAD": str(library), "SLOW_DISK": str(play.state)})
    play.calm()
    hang = Path(f"{play.state}.hang")
    hang.touch()
    play.daemon.wait(lambda r: (play.state / f"{ID}.state.new").exists())
    subprocess.Popen(["sh", "-c", 'sleep 1; rm "$0"', str(hang)])


def reconnecting(play: Scene) -> None:
    play.start()
    play.calm()
    play.sensor.ask("unplug")
    play.daemon.wait(lambda r: r.state == "waiting")


def stopping(play: Scene) -> None:
    """It is told a second time while it stops."""
    play.start()
    play.calm()
    play.daemon.process.send_signal(signal.SIGTERM)
    time.sleep(0.1)


PHASES = [waiting_for_a_port, shaking_hands, saving, reconnecting, stopping]


@pytest.mark.parametrize("phase", PHASES, ids=lambda phase: phase.__name__)
def test_19_terminated_while(tmp_path: Path, phase: Callable[[Scene], None]) -> None:
    with scene(tmp_path, seed=19, start=False) as play:
        phase(play)
        asked = time.monotonic()
        code, out, said = play.daemon.stop(signal.SIGTERM)
        assert time.monotonic() - asked < STOP_S
        assert code == 0, said
        assert not list(play.state.glob("*.found.json")) or phase is reconnecting
        if out:
            final = from_json(Report, out)
            assert final.state == "stopped"
            adds_up(final)
            if final.session.samples:
                is_kept(play.state / f"{ID}.state", final)
        else:
            assert phase in (waiting_for_a_port, shaking_hands)


# ---------------------------------------------------------------- disk and kills


NAMESPACE = ("unshare", "-m") if os.geteuid() == 0 else ("unshare", "-Urm")
"""A view of the file systems for one process; it goes with it."""


def possible() -> bool:
    """Whether a process may mount something of its own here."""
    trial = "mount -t tmpfs none /mnt && mount --bind /mnt /mnt && mount -o remount,ro,bind /mnt"
    try:
        return (
            subprocess.run([*NAMESPACE, "sh", "-c", trial], capture_output=True, check=False).returncode == 0
        )
    except OSError:
        return False


mounts = pytest.mark.skipif(not possible(), reason="nothing can be mounted here, not even for one process")


def within(command: str, place: Path) -> tuple[str, ...]:
    """Words in front of a daemon that mount something at `place` for it alone."""
    place.mkdir(exist_ok=True)
    return (*NAMESPACE, "sh", "-c", f'{command} && exec "$@"', str(place))


def told(play: Scene, kind: str, text: str) -> bool:
    return any(text in event.text for event in play.events(kind))


def fill(directory: Path) -> bool:
    """Take all room of a disk, also what a daemon has given up for its next save; always true."""
    with suppress(OSError), (directory / "filler").open("ab", buffering=0) as filler:
        while filler.write(bytes(1 << 12)):
            pass
    return True


@mounts
@pytest.mark.parametrize(("size", "records"), [("2m", True), ("700k", False)])
def test_09_disk_is_full_and_has_room_again(tmp_path: Path, size: str, records: bool) -> None:
    """State and recording on one small disk: the recording ends, the state waits, both are said once.

    The smaller disk has room for two states and a history, and no more. The state stays saved, and nothing else takes
    its room.
    """
    with scene(tmp_path, seed=9, start=False) as play:
        disk = within(f'mount -t tmpfs -o size={size} none "$0"', play.state)
        play.start(*(("--record", str(play.state / "raw.bin")) if records else ()), before=disk)
        before = play.calm()
        seen = Path(f"/proc/{play.daemon.process.pid}/root") / play.state.relative_to("/")
        play.daemon.wait(
            lambda r: (
                fill(seen)
                and told(play, "state", "kB are needed")
                and (not records or told(play, "recording", "ended"))
            )
        )
        (seen / "filler").unlink()
        play.daemon.wait(lambda r: told(play, "state", "saved again"))
        after = play.calm(more=300)
        assert after.report.session.missing == 0
        state = decode((seen / f"{ID}.state").read_bytes())
        assert state.record.samples > before.report.session.samples
        play.end(before, after, code=int(records))  # 1: the recording has ended before the record
        assert play.said.count("the state cannot be saved") == 1
        assert play.said.count(" error: recording to ") == int(records)


@mounts
@pytest.mark.parametrize("output", ["--state DIR", "--record DIR/raw.bin"])
def test_a_directory_that_is_read_only_is_refused_at_the_start(tmp_path: Path, output: str) -> None:
    """Root may write everything, but not there."""
    place = tmp_path / "read-only"
    mounted = within('mount -t tmpfs none "$0" && mount -o remount,ro "$0"', place)
    words = output.replace("DIR", str(place)).split()
    command = (*mounted, sys.executable, "-m", "imumon", "run", "--port", "sim", "--duration", "60", *words)
    done = subprocess.run(command, capture_output=True, text=True, timeout=50, check=False)
    assert done.returncode == 1, done.stderr
    assert f"{place} cannot be written" in done.stderr
    assert len(done.stderr.splitlines()) == 1, done.stderr


# ---------------------------------------- faults of the history


EVER = Selection(since=0.0, until=1e12)


def kept(path: Path) -> int:
    """Samples in the hours of a file."""
    copy = (
        Path(tempfile.mkdtemp()) / path.name
    )  # SQLite cannot follow the path into the view of another process
    for suffix in ("", "-wal"):
        if Path(f"{path}{suffix}").exists():
            Path(f"{copy}{suffix}").write_bytes(Path(f"{path}{suffix}").read_bytes())
    with HistoryStore(copy) as store:
        return sum(timed.period.samples for timed in store.periods(EVER))


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
