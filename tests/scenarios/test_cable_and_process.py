"""Faults of the cable, the sensor and the host, and SIGTERM in every phase of a daemon's life."""

from __future__ import annotations

import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from laws import ON_THE_WAY, PACKET, Fault, adds_up, is_kept
from scene import ID, STOP_S, Scene, scene
from waiting import until

from imumon.model.report import Report, from_json
from imumon.sources.linux_tty import holders

pytestmark = pytest.mark.slow


def test_01_unplug_and_replug(tmp_path: Path) -> None:
    with scene(tmp_path, seed=1) as play:
        before = play.calm()
        play.sensor.ask("unplug")
        play.daemon.wait(lambda r: r.state == "waiting")
        play.sensor.ask("replug")
        after = play.calm()
        assert after.report.session.gaps == 1
        kinds = [event.kind for event in play.events("connect", "disconnect")]
        assert kinds[-2:] == ["disconnect", "connect"]
        play.end(before, after, Fault(on_the_way=ON_THE_WAY))


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


# ---------------------------------------- faults of the sensor and of the host


def test_05_sensor_reboots(tmp_path: Path) -> None:
    """Its clock begins anew: a gap of a length that nobody knows, and the record goes on."""
    with scene(tmp_path, seed=5) as play:
        before = play.calm()
        play.sensor.ask("reboot")
        play.daemon.wait(lambda r: r.session.restarts == 1)
        after = play.calm()
        assert play.events("reconfigured")
        play.end(before, after, Fault(unknown=1, beside=10_000))


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


# ---------------------------------------- SIGTERM in every phase of a daemon's life


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
