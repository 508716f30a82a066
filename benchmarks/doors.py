"""Benchmark of the doors: what attacks on a daemon cost its measurement, with 256 descriptors.

    python benchmarks/doors.py [--seconds 30] [ATTACK ...]

Each attack is made with real sockets on loopback against a daemon of its own. It is calm for a while first, and what
the attack adds is stated: samples that the clock of the sensor proves to be lost, the longest time between two saves
(the period is 2 s), the slowest of some `imumon status`, memory, descriptors, lines of the log, and the time to the end
after SIGTERM. `status` is a process of its own: its time depends on what else the machine does, and the line ``quiet``
shows how much. The load of the machine is printed below.

Some attacks are on other programs: on `imumon web`, whose answer is that of its page, and whose end has a browser that
does not answer; on `imumon replay`; and on what people see, if two daemons have one name. Exit code 1 if a number is
beyond `MOST`.
"""

from __future__ import annotations

import argparse
import gzip
import os
import shutil
import signal
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
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "hostile"))

import attackers
from daemons import Daemon, free_endpoint
from faulty_senders import ImpossibleMt, ResettingServer
from line_sender import LineSender
from scraping import free_port
from slow_clients import SlowClients
from terminals import Tmux
from usage import peak_kb, resident_kb

DESCRIPTORS = 256
CALM_S = 8.0
SAVE_S = 2.0
MOST = {
    "lost": 0, "save_s": 2.0 * SAVE_S + 1.0, "lines": 50, "end_s": 10.0
}  # fmt: skip
"""A save that is due takes its time; the rest is what the project promises."""
ATTACK_MOST_MB, READ_MOST_MB = 20.0, 300.0
"""MB that an attack may add to a daemon, and that reading a file may take."""
ANSWER_S, TIMES = 2.0, 3.0
"""Most time of an answer, s; on a busy machine, its most factor over an answer without an attack."""
HEAD = ("lost", "save, s", "quiet answer, s", "answer, s", "memory, MB", "descriptors", "log lines", "end, s")
WEB_END_S = 5.0
BOMB_MB = 10_000
"""Size of what a file of a thousandth of it holds."""


@dataclass
class Door:
    """A daemon to attack, with the ports of its doors."""

    daemon: Daemon
    metrics: int
    sensor: LineSender | ResettingServer | ImpossibleMt | None


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
    assert isinstance(door.sensor, LineSender)
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
def failing(door: Door) -> Iterator[None]:
    """Resets, or packets with impossible numbers, which are the samples that are missing."""
    assert isinstance(door.sensor, ImpossibleMt | ResettingServer)
    door.sensor.failing = True
    yield


@contextmanager
def together(door: Door, seconds: float) -> Iterator[None]:
    with slow_clients(1100, door), on_the_bus(door, seconds, *attackers.WAYS):
        yield


ATTACKS: dict[str, tuple[str, Callable[[Door, float], object]]] = {
    "quiet": ("sim", lambda door, seconds: ExitStack()),
    "metrics-1100": ("sim", lambda door, seconds: slow_clients(1100, door)),
    "metrics-4000": ("sim", lambda door, seconds: slow_clients(4000, door)),
    "half-open-1500": ("sim", lambda door, seconds: on_the_bus(door, seconds, attackers.half_open)),
    "half-said-1500": ("sim", lambda door, seconds: on_the_bus(door, seconds, attackers.half_said)),
    "greeted-1500": ("sim", lambda door, seconds: on_the_bus(door, seconds, attackers.greeted)),
    "queries": ("sim", lambda door, seconds: on_the_bus(door, seconds, attackers.storm, attackers.many)),
    "sessions": ("sim", lambda door, seconds: on_the_bus(door, seconds, attackers.sessions)),
    "together": ("sim", together),
    "datagrams-200": ("udp", lambda door, seconds: datagrams(door, 200.0)),
    "datagrams-flood": ("udp", lambda door, seconds: datagrams(door, 0.0)),
    "resets": ("resets", lambda door, seconds: failing(door)),
    "impossible": ("mti", lambda door, seconds: failing(door)),
}
"""Kind of the sensor, and what attacks."""


@dataclass
class Figures:
    """What an attack has cost."""

    lost: int = 0
    save_s: float = 0.0
    quiet_s: float = 0.0
    answer_s: float = 0.0
    memory_mb: float = 0.0
    descriptors: int = 0
    lines: int = 0
    end_s: float = 0.0
    unseen: tuple[str, ...] = ()
    most_mb: float = ATTACK_MOST_MB

    def beyond(self) -> list[str]:
        names = [name for name, most in MOST.items() if getattr(self, name) > most]
        names += ["memory_mb"] if self.memory_mb > self.most_mb else []
        late = self.answer_s > max(ANSWER_S, TIMES * self.quiet_s)
        return [*names, *(["answer_s"] if late else []), *self.unseen]

    def row(self, name: str) -> str:
        numbers = (
            f"{self.lost}", f"{self.save_s:.1f}", f"{self.quiet_s:.1f}", f"{self.answer_s:.1f}",
            f"{self.memory_mb:.0f}", f"{self.descriptors}", f"{self.lines}", f"{self.end_s:.1f}",
        )  # fmt: skip
        return f"| {name} | {' | '.join(numbers)} | {', '.join(self.beyond())} |"


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
        sensor, url = started(kind, folder, stack)
        few = ("prlimit", f"--nofile={DESCRIPTORS}")
        words = ("--config", str(settings), "--id", "a", "--json")
        daemon = stack.enter_context(Daemon(url, folder / "state", *words, before=few))
        calm = daemon.wait(lambda r: r.session.elapsed_s > CALM_S)
        status_s(daemon)  # the files of the program are in memory from now on
        figures.quiet_s = status_s(daemon)
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
                    figures.answer_s = max(figures.answer_s, status_s(daemon))
                    next_status = time.monotonic() + 0.3 * seconds
                time.sleep(0.1)
            asked = time.monotonic()
            code, out, said = daemon.stop()
            figures.end_s = time.monotonic() - asked
        assert code == 0, said
        from imumon.report import Report, from_json

        final = from_json(Report, out)
        figures.lost = final.session.missing - calm.session.missing
        if isinstance(sensor, ResettingServer):
            figures.lost = 0  # what it does not send is missing, and the amount is unknown
        elif isinstance(sensor, ImpossibleMt):
            figures.lost = max(
                0, figures.lost - sensor.impossible
            )  # the last one shows with the next sample only
            largest = max(abs(channel.max or 0.0) for channel in final.channels.values())
            figures.unseen = () if largest < 100.0 else (f"a value of {largest:g}",)
        figures.lines = len(said.splitlines()) - lines
    return figures


def started(kind: str, folder: Path, stack: ExitStack) -> tuple[Any, str]:
    """Return the sensor of a kind and the value of ``--port`` that reads it."""
    if kind == "mti":
        mti = stack.enter_context(ImpossibleMt(folder / "mti"))
        return mti, f"xsens:{folder / 'mti'}"
    if kind == "sim":
        return None, "sim"
    sensor = LineSender("udp", folder) if kind == "udp" else ResettingServer(50)
    if isinstance(sensor, ResettingServer):
        sensor.failing = False
    stack.callback(sensor.close)
    return sensor, sensor.url


def browser(port: int) -> socket.socket:
    """Return a connection as a browser opens it for a screen; it reads nothing."""
    client = socket.create_connection(("127.0.0.1", port), timeout=30)
    client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    host = f"127.0.0.1:{port}"
    client.sendall(
        f"GET /ws?width=80&height=24 HTTP/1.1\r\nHost: {host}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    return client


def page_s(port: int) -> float:
    """Return how long the page takes, s; infinite if there is none in 20 s."""
    begin = time.monotonic()
    try:
        with socket.create_connection(("127.0.0.1", port), timeout=20) as client:
            client.settimeout(20)
            client.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nConnection: close\r\n\r\n".encode())
            good = b" 200 " in client.recv(4096)
    except OSError:
        good = False
    return time.monotonic() - begin if good else float("inf")


def web_played(seconds: float, folder: Path) -> Figures:
    """Half requests and eight browsers that read nothing; their seats are free within a minute, and it ends in time."""
    figures, port = Figures(), free_port()
    command = ["prlimit", f"--nofile={DESCRIPTORS}", sys.executable, "-m", "imumon", "web"]
    said = folder / "said"
    with ExitStack() as stack, said.open("w") as err:
        process = subprocess.Popen([*command, "--listen", f"127.0.0.1:{port}"], cwd=folder, stderr=err)
        stack.callback(process.kill)
        while page_s(port) > 5.0:
            time.sleep(0.2)
        quiet_kb, figures.quiet_s = resident_kb(process.pid), page_s(port)
        dead = [stack.enter_context(browser(port)) for _ in range(8)]
        slow = SlowClients(port, 1100)
        stack.callback(slow.stop)
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            figures.answer_s = max(figures.answer_s, page_s(port))
            figures.memory_mb = max(figures.memory_mb, (resident_kb(process.pid) - quiet_kb) / 1e3)
            figures.descriptors = max(figures.descriptors, len(os.listdir(f"/proc/{process.pid}/fd")))
            time.sleep(0.1)
        if not seated(port, time.monotonic() + 60.0):
            figures.unseen = ("a dead browser keeps its seat",)
        last = stack.enter_context(browser(port))
        asked = time.monotonic()
        process.send_signal(signal.SIGTERM)
        process.wait(60)
        figures.end_s = time.monotonic() - asked
        figures.lines = len(said.read_text().splitlines()) - 1
        del dead, last
    if figures.end_s > WEB_END_S:
        figures.unseen += (f"ends after more than {WEB_END_S:g} s",)
    return figures


def seated(port: int, end: float) -> bool:
    """Return whether a browser gets a seat until `end`, s monotonic."""
    while time.monotonic() < end:
        with suppress(OSError), browser(port) as client:
            if b" 101 " in client.recv(4096):
                return True
        time.sleep(0.5)
    return False


def bomb_played(seconds: float, folder: Path) -> Figures:
    """A file of 10 MB that holds 10 GB of zero bytes, and one that holds as many lines."""
    figures = Figures(most_mb=READ_MOST_MB)
    for number, line in enumerate((bytes(100), b"0.01,0,0,0,0,0,9.8\n")):
        path = folder / f"{number}.csv.gz"
        head = b"t,gx,gy,gz,ax,ay,az\n"
        member = gzip.compress(line * (100_000_000 // len(line)))
        with path.open("wb") as file:
            file.write(gzip.compress(head))
            for _ in range(BOMB_MB // 100):
                file.write(member)
        begin = time.monotonic()
        with (folder / "said").open("w+") as said:
            command = [sys.executable, "-m", "imumon", "replay", str(path)]
            process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=said)
            while process.poll() is None:
                figures.memory_mb = max(figures.memory_mb, peak_kb(process.pid) / 1e3)
                time.sleep(0.02)
            figures.end_s = max(figures.end_s, time.monotonic() - begin)
            said.seek(0)
            lines = said.read().splitlines()
        figures.lines = max(figures.lines, len(lines))
        if process.returncode == 0 or any("Traceback" in line for line in lines):
            figures.unseen += (f"exit code {process.returncode}",)
        path.unlink()
    return figures


def rivals_played(seconds: float, folder: Path) -> Figures:
    """Two daemons of one name, on two endpoints: what does not say so is listed."""
    endpoints = (free_endpoint(), free_endpoint())
    both = [word for endpoint in endpoints for word in ("--connect", endpoint)]
    words, figures = [sys.executable, "-m", "imumon"], Figures()
    with ExitStack() as stack:
        for number, endpoint in enumerate(endpoints):
            state = folder / f"state-{number}"
            daemon = stack.enter_context(Daemon("sim", state, "--id", "a", listen=endpoint))
            daemon.samples()
            figures.quiet_s = status_s(daemon)
        asked = {"status": ["status"], "status --json": ["status", "--json"], "check": ["check"]}
        asked["report"] = ["report", "--format", "json"]
        asked["data sheet"] = ["report", "--format", "html", "-o", str(folder / "a.html")]
        for name, rest in asked.items():
            begin = time.monotonic()
            done = subprocess.run([*words, *rest, *both], capture_output=True, text=True, check=False)
            figures.answer_s = max(
                figures.answer_s, time.monotonic() - begin if name in ("status", "check") else 0.0
            )
            text = done.stdout + ((folder / "a.html").read_text() if name == "data sheet" else "")
            if "rival" not in text and "two programs publish" not in text:
                figures.unseen += (name,)
        if shutil.which("tmux") is not None:
            pane = Tmux(folder / "tmux", " ".join([*words, "tui", *both]))
            stack.callback(pane.close)
            end = time.monotonic() + 30.0
            while "rival" not in pane.text() and time.monotonic() < end:
                time.sleep(0.2)
            figures.unseen += () if "! rival" in pane.text() else ("screen",)
    return figures


PROGRAMS: dict[str, Callable[[float, Path], Figures]] = {
    "web": web_played,
    "gzip-bomb": bomb_played,
    "two-daemons": rivals_played,
}
"""Attacks on other programs than one daemon."""


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=30.0, help="of each attack")
    parser.add_argument("attack", nargs="*", metavar="ATTACK", help=", ".join((*ATTACKS, *PROGRAMS)))
    arguments = parser.parse_args()
    print(f"| attack | {' | '.join(HEAD)} | beyond |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|---:|---|")
    failed = False
    for name in arguments.attack or (*ATTACKS, *PROGRAMS):
        with tempfile.TemporaryDirectory() as folder:
            if name in PROGRAMS:
                figures = PROGRAMS[name](arguments.seconds, Path(folder))
            else:
                figures = played(*ATTACKS[name], arguments.seconds, Path(folder))
        failed |= bool(figures.beyond())
        print(figures.row(name), flush=True)
    print(f"load of the last 5 minutes: {os.getloadavg()[1]:.1f} on {os.cpu_count()} processors")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
