"""Benchmark of the doors: what attacks on a daemon cost its measurement, with 256 descriptors.

    python benchmarks/doors.py [--seconds 30] [ATTACK ...]

Each attack is made with real sockets on loopback against a daemon of its own. It is calm for a while first, and what
the attack adds is stated: samples that the clock of the sensor proves to be lost, the longest time between two saves
(the period is 2 s), the slowest of some `imumon status`, memory, descriptors, lines of the log, and the time to the end
after SIGTERM. `status` is a process of its own, most of whose time is its start; the line ``quiet`` shows how much.
Exit code 1 if a number is beyond `MOST`.
"""

from __future__ import annotations

import argparse
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "hostile"))

import attackers
from daemons import Daemon
from line_sender import LineSender
from scraping import free_port
from slow_clients import SlowClients
from usage import resident_kb

DESCRIPTORS = 256
CALM_S = 8.0
SAVE_S = 2.0
MOST = {"lost": 0, "save_s": 2.0 * SAVE_S + 1.0, "memory_mb": 20.0, "lines": 50, "end_s": 10.0}
"""A save that is due takes its time; the rest is what the project promises."""


@dataclass
class Door:
    """A daemon to attack, with the ports of its doors."""

    daemon: Daemon
    metrics: int
    sensor: LineSender | None


Attack = Callable[[Door, float], object]


@contextmanager
def slow_clients(count: int, door: Door) -> Iterator[None]:
    clients = SlowClients(door.metrics, count)
    try:
        yield
    finally:
        clients.stop()


@contextmanager
def on_the_bus(door: Door, seconds: float, *ways: Callable[..., int]) -> Iterator[None]:
    with attackers.attacking(door.daemon.endpoint, "a", seconds, *ways):
        yield


@contextmanager
def datagrams(door: Door, rate_hz: float) -> Iterator[None]:
    """Another sender on the port of the sensor, with the clock of the sensor; 0: as fast as it can."""
    assert door.sensor is not None
    port = int(door.sensor.url.partition("?")[0].rpartition(":")[2])
    ending, begin = threading.Event(), time.monotonic()

    def send() -> None:
        count = 0
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not ending.is_set():
                stamp = round((time.monotonic() - begin) * 1e6)
                with suppress(OSError):
                    sender.sendto(b"%d,1,1,1,1,1,1\n" % stamp, ("127.0.0.1", port))
                count += 1
                if rate_hz:
                    time.sleep(max(0.0, begin + count / rate_hz - time.monotonic()))

    thread = threading.Thread(target=send, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ending.set()
        thread.join()


@contextmanager
def together(door: Door, seconds: float) -> Iterator[None]:
    with slow_clients(1100, door), on_the_bus(door, seconds, *attackers.WAYS):
        yield


ATTACKS: dict[str, tuple[str, Callable[[Door, float], object]]] = {
    "quiet": ("sim", lambda door, seconds: ExitStack()),
    "metrics-1100": ("sim", lambda door, seconds: slow_clients(1100, door)),
    "metrics-4000": ("sim", lambda door, seconds: slow_clients(4000, door)),
    "half-open-1500": ("sim", lambda door, seconds: on_the_bus(door, seconds, attackers.half_open)),
    "queries": ("sim", lambda door, seconds: on_the_bus(door, seconds, attackers.storm, attackers.many)),
    "sessions": ("sim", lambda door, seconds: on_the_bus(door, seconds, attackers.sessions)),
    "together": ("sim", together),
    "datagrams-200": ("udp", lambda door, seconds: datagrams(door, 200.0)),
    "datagrams-flood": ("udp", lambda door, seconds: datagrams(door, 0.0)),
}
"""Kind of the sensor, and what attacks."""


@dataclass
class Figures:
    """What an attack has cost."""

    lost: int = 0
    save_s: float = 0.0
    status_s: float = 0.0
    memory_mb: float = 0.0
    descriptors: int = 0
    lines: int = 0
    end_s: float = 0.0

    def beyond(self) -> list[str]:
        return [name for name, most in MOST.items() if getattr(self, name) > most]


def status_s(daemon: Daemon) -> float:
    """Return how long `imumon status` takes, s; infinite if it has no answer."""
    begin = time.monotonic()
    command = [sys.executable, "-m", "imumon", "status", "--json", "--connect", daemon.endpoint]
    done = subprocess.run(command, capture_output=True, timeout=120, check=False)
    return time.monotonic() - begin if done.returncode == 0 else float("inf")


def newest_save(directory: Path) -> float:
    """Return when the state was saved, s since 1970; between two renames, that before is the newest."""
    times = []
    for path in (directory / "a.state", directory / "a.state.1"):
        with suppress(OSError):
            times.append(path.stat().st_mtime)
    return max(times)


def played(kind: str, attack: Callable[[Door, float], object], seconds: float, folder: Path) -> Figures:
    """Attack a daemon and return what it cost."""
    port, settings, figures = free_port(), folder / "config.toml", Figures()
    tables = f'[metrics]\nlisten = "127.0.0.1:{port}"\n[state]\nsave_period_s = {SAVE_S}\n'
    settings.write_text(tables)
    with ExitStack() as stack:
        sensor = LineSender("udp", folder) if kind == "udp" else None
        if sensor is not None:
            stack.callback(sensor.close)
        url = "sim" if sensor is None else sensor.url
        few = ("prlimit", f"--nofile={DESCRIPTORS}")
        words = ("--config", str(settings), "--id", "a", "--json")
        daemon = stack.enter_context(Daemon(url, folder / "state", *words, before=few))
        calm = daemon.wait(lambda r: r.session.elapsed_s > CALM_S)
        status_s(daemon)  # the files of the program are in memory from now on
        pid = daemon.process.pid
        quiet_kb, lines = resident_kb(pid), len(daemon.log.splitlines())
        end, next_status = time.monotonic() + seconds, time.monotonic() + 0.4 * seconds
        with attack(Door(daemon, port, sensor), seconds):  # type: ignore[attr-defined]
            while time.monotonic() < end:
                figures.save_s = max(figures.save_s, time.time() - newest_save(folder / "state"))
                figures.memory_mb = max(figures.memory_mb, (resident_kb(pid) - quiet_kb) / 1e3)
                with suppress(OSError):
                    figures.descriptors = max(figures.descriptors, len(os.listdir(f"/proc/{pid}/fd")))
                if time.monotonic() > next_status:
                    figures.status_s = max(figures.status_s, status_s(daemon))
                    next_status = time.monotonic() + 0.3 * seconds
                time.sleep(0.1)
            asked = time.monotonic()
            code, out, said = daemon.stop()
            figures.end_s = time.monotonic() - asked
        assert code == 0, said
        from imumon.report import Report, from_json

        final = from_json(Report, out)
        figures.lost = final.session.missing - calm.session.missing
        figures.lines = len(said.splitlines()) - lines
    return figures


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=30.0, help="of each attack")
    parser.add_argument("attack", nargs="*", metavar="ATTACK", help=", ".join(ATTACKS))
    arguments = parser.parse_args()
    print("| attack | lost | save, s | status, s | memory, MB | descriptors | log lines | end, s | beyond |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|---|")
    failed = False
    for name in arguments.attack or ATTACKS:
        kind, attack = ATTACKS[name]
        with tempfile.TemporaryDirectory() as folder:
            f = played(kind, attack, arguments.seconds, Path(folder))
        failed |= bool(f.beyond())
        print(
            f"| {name} | {f.lost} | {f.save_s:.1f} | {f.status_s:.1f} | {f.memory_mb:.0f} | {f.descriptors} |"
            f" {f.lines} | {f.end_s:.1f} | {', '.join(f.beyond())} |",
            flush=True,
        )
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
