"""The screen on a real terminal and in a browser: what it needs, how it ends, what it restores."""

from __future__ import annotations

import asyncio
import fcntl
import io
import os
import pty
import shutil
import signal
import socket
import struct
import subprocess
import sys
import termios
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import aiohttp
import psutil
import pytest
from browser import PROGRAMS, browser
from commands import imumon
from daemons import Daemon
from free_ports import free_endpoint, free_port
from paths import TESTS
from waiting import until

from imumon.tui.web import MOST_BROWSERS

CHROMIUM = next(filter(None, map(shutil.which, PROGRAMS)), None)

ACTOR = [sys.executable, str(TESTS / "screen_actor.py")]


@pytest.fixture
def tmux(tmp_path: Path) -> Iterator[Callable[..., Tmux]]:
    if shutil.which("tmux") is None:
        pytest.skip("tmux is not installed")
    panes: list[Tmux] = []

    def make(command: str, size: tuple[int, int] = (150, 40)) -> Tmux:
        panes.append(Tmux(tmp_path / f"tmux-{len(panes)}", command, size))
        return panes[-1]

    yield make
    for one in panes:
        one.close()


def shell(*arguments: str) -> str:
    return " ".join([*ACTOR, *arguments])


def test_from_end_to_end_in_a_terminal(tmux: Callable[..., Tmux]) -> None:
    """It draws, updates, reacts to keys, and restores the terminal."""
    pane = tmux(shell())
    until(lambda: "● live" in pane.text())
    until(lambda: ("█" in pane.text() and "⠤" in pane.text()) or "⠑" in pane.text())
    assert pane.flag("alternate_on") == "1"
    before = pane.text().splitlines()[0]
    until(lambda: pane.text().splitlines()[0] != before)  # the elapsed time grows
    pane.press("Down")
    until(lambda: "▌  y" in pane.text())
    pane.press("2")
    until(lambda: "distribution" in pane.text())
    pane.press("?")
    until(lambda: "signal: keys" in pane.text())
    pane.press("Escape")
    until(lambda: "signal: keys" not in pane.text())
    pane.command("resize-window", "-x", "80", "-y", "24")
    pane.press("1")
    until(lambda: "ready for kalibr" in pane.text())
    assert "±" in pane.text()
    pane.press("q")
    until(lambda: "EXIT=0" in pane.text())
    assert pane.flag("alternate_on") == "0"
    assert pane.flag("mouse_any_flag") == "0"


@pytest.mark.few
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_a_signal_ends_the_screen_and_restores_the_terminal(
    tmux: Callable[..., Tmux], number: signal.Signals
) -> None:
    pane = tmux(shell())
    until(lambda: "● live" in pane.text())
    os.kill(pane.screen(), number)
    until(lambda: f"EXIT={128 + number}" in pane.text())
    assert pane.flag("alternate_on") == "0"
    assert pane.flag("mouse_any_flag") == "0"


@pytest.mark.few
@pytest.mark.parametrize("change", ["NO_COLOR=1", "TERM=linux", "COLORTERM= TERM=screen"])
def test_terminals_with_few_capabilities(tmux: Callable[..., Tmux], change: str) -> None:
    pane = tmux(f"env {change} {shell()}", (80, 24))
    until(lambda: f"{'*' if 'linux' in change else '●'} live" in pane.text())
    assert pane.text().isascii() == ("linux" in change)  # the console of Linux has no braille
    pane.press("q")
    until(lambda: "EXIT=0" in pane.text())


# ---------------------------------------------------------------------------- without a multiplexer


def start(**options: object) -> tuple[subprocess.Popen[bytes], int]:
    """Start the screen on a pseudo-terminal; return its process and the master side."""
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))

    def own_terminal() -> None:
        os.setsid()
        fcntl.ioctl(0, termios.TIOCSCTTY, 0)
        if options.get("ignore_hangup"):
            signal.signal(signal.SIGHUP, signal.SIG_IGN)

    process = subprocess.Popen(
        ACTOR, stdin=slave, stdout=slave, stderr=slave, env=ENVIRONMENT, preexec_fn=own_terminal
    )
    os.close(slave)
    return process, master


def read_until(line: int, expected: bytes, seconds: float = 60.0) -> None:
    end, got = time.monotonic() + seconds, b""
    while expected not in got:
        assert time.monotonic() < end, got[-200:]
        got += os.read(line, 65536)


@pytest.mark.few
@pytest.mark.parametrize("ignore_hangup", [False, True])
def test_the_screen_ends_with_its_terminal(ignore_hangup: bool) -> None:
    """A closed window or a lost connection leaves no process behind."""
    process, line = start(ignore_hangup=ignore_hangup)
    try:
        read_until(line, b"live")
        os.close(line)
        assert process.wait(60) == 129
    finally:
        process.kill()
        process.wait()


def test_without_a_terminal_it_names_the_alternative() -> None:
    """It prints one line without escape sequences and ends."""
    error = imumon("tui", code=2)
    assert "imumon status --json" in error
    assert "\x1b" not in error


# ---------------------------------------------------------------- a terminal for tests


HERE = Path(__file__).parent
ENVIRONMENT = {**os.environ, "TERM": "xterm-256color", "LANG": "C.UTF-8", "PYTHONPATH": str(HERE.parent)}


class Tmux:
    """A separate tmux server with one pane that runs the screen."""

    def __init__(self, socket: Path, command: str, size: tuple[int, int] = (150, 40)) -> None:
        self._base = ["tmux", "-S", str(socket)]
        run = f"{command}; echo EXIT=$?; exec cat"
        environment = [part for k in ("LANG", "PYTHONPATH") for part in ("-e", f"{k}={ENVIRONMENT[k]}")]
        where = ["-x", str(size[0]), "-y", str(size[1])]
        self.command("-f", "/dev/null", "new-session", "-d", *environment, *where, "sh", "-c", run)

    def command(self, *arguments: str) -> str:
        done = subprocess.run(
            [*self._base, *arguments], capture_output=True, text=True, check=True, timeout=60
        )
        return done.stdout

    def text(self) -> str:
        return self.command("capture-pane", "-p")

    def flag(self, name: str) -> str:
        return self.command("display-message", "-p", f"#{{{name}}}").strip()

    def press(self, *keys: str) -> None:
        self.command("send-keys", *keys)

    def screen(self) -> int:
        """Process of the screen in the pane."""
        return psutil.Process(int(self.flag("pane_pid"))).children()[0].pid

    def close(self) -> None:
        subprocess.run([*self._base, "kill-server"], capture_output=True, check=False, timeout=60)


# ---------------------------------------------------------------- in a browser


@contextmanager
def page(folder: Path, *words: str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """`imumon web` in an empty directory: its address and process."""
    folder.mkdir(exist_ok=True)
    address = f"127.0.0.1:{free_port()}"
    command = [sys.executable, "-m", "imumon", "web", "--listen", address, *words]
    with subprocess.Popen(command, cwd=folder, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert address in process.stderr.readline()
            yield f"http://{address}", process
        finally:
            process.kill()


def status(address: str, **headers: str) -> int:
    try:
        with urllib.request.urlopen(urllib.request.Request(address, headers=headers), timeout=60) as reply:
            assert "default-src 'self'" in reply.headers["Content-Security-Policy"]
            return int(reply.status)
    except urllib.error.HTTPError as error:
        return error.code
    except OSError:  # it starts
        return 0


def test_only_the_page_itself_may_connect(tmp_path: Path) -> None:
    with page(tmp_path) as (address, process):
        host = address.removeprefix("http://")
        until(lambda: status(address) == 200)
        assert status(address, Origin=address) == 200
        assert status(address, Origin="http://evil.example") == 403
        assert status(address, Host="evil.example", Origin="http://evil.example") == 403
        assert status(f"{address}/ws", Origin="http://evil.example") == 403
        again = [sys.executable, "-m", "imumon", "web", "--listen", host]
        second = subprocess.run(again, capture_output=True, text=True, timeout=60, check=False)
        assert second.returncode == 1
        assert "in use" in second.stderr
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) in (0, -signal.SIGTERM)


def open_screen(address: str) -> socket.socket:
    """A connection as a browser opens it for a screen."""
    host, _, port = address.removeprefix("http://").rpartition(":")
    client = socket.create_connection((host, int(port)), timeout=60)
    key = "dGhlIHNhbXBsZSBub25jZQ=="
    client.sendall(
        f"GET /ws?width=80&height=24 HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    return client


def accepted(client: socket.socket) -> bool:
    return b" 101 " in client.recv(4096)


@pytest.mark.slow
def test_the_page_has_so_many_screens_and_one_that_is_gone_makes_room(tmp_path: Path) -> None:
    with page(tmp_path) as (address, process), ExitStack() as browsers:
        opened = [browsers.enter_context(open_screen(address)) for _ in range(MOST_BROWSERS)]
        assert all(map(accepted, opened))
        with open_screen(address) as further:
            assert not accepted(further)
        opened[0].close()

        def free() -> bool:
            with open_screen(address) as client:
                return accepted(client)

        assert until(free)
        process.send_signal(signal.SIGTERM)  # the others do not answer its end
        assert process.wait(60) == 0


def test_a_browser_shows_the_screen_and_follows_the_keys(tmp_path: Path) -> None:
    """The part of the page in a browser is a program of others: here are its messages."""

    async def look(address: str) -> None:
        async with (
            aiohttp.ClientSession() as session,
            session.ws_connect(f"{address}/ws?width=80&height=24", origin=address) as socket,
        ):

            async def shows(word: bytes) -> None:
                received = b""
                while word not in received:
                    message = await socket.receive(60)
                    received += message.data if isinstance(message.data, bytes) else b""

            await shows(b"no daemon")
            await socket.send_json(["stdin", "?"])
            await shows(b"keys")

    with page(tmp_path / "empty", "--connect", free_endpoint()) as (address, process):
        until(lambda: status(address) == 200)
        asyncio.run(look(address))
        until(
            lambda: not psutil.Process(process.pid).children()
        )  # the browser has gone, and its screen with it
        process.send_signal(signal.SIGTERM)
        process.wait(60)
    assert list((tmp_path / "empty").iterdir()) == []


def selected_tab(picture: bytes) -> int:
    """Column of the left edge of the highlighted view in the bottom line of a picture."""
    from PIL import Image

    shown = Image.open(io.BytesIO(picture)).convert("L")
    width, height = shown.size
    rows = [[shown.getpixel((x, y)) for x in range(width // 2)] for y in range(height - 25, height)]
    lightest = max(rows, key=sum)
    return next(x for x, value in enumerate(lightest) if value > 100)


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")
def test_a_real_browser_shows_the_screen_and_follows_the_keys(tmp_path: Path) -> None:
    """IMUMON_SCREENSHOTS names a directory that keeps the pictures for people."""
    from PIL import Image

    pictures = Path(os.environ.get("IMUMON_SCREENSHOTS", tmp_path))

    async def look(address: str) -> None:
        async with browser(CHROMIUM, tmp_path, address) as shown:
            end = time.monotonic() + 60
            while not await shown.value("document.body.classList.contains('-first-byte')"):
                assert time.monotonic() < end, shown.log
                await asyncio.sleep(0.2)
            await asyncio.sleep(4.0)
            first = await shown.screenshot(pictures / "overview.png")
            await shown.press("2")  # without a click before
            end = time.monotonic() + 20
            while selected_tab(second := await shown.screenshot(pictures / "signal.png")) == selected_tab(
                first
            ):
                assert time.monotonic() < end, "the key 2 does nothing"
                await asyncio.sleep(0.2)
            for data in (first, second):
                colours = Image.open(io.BytesIO(data)).convert("RGB").getcolors(1 << 24)
                assert len(colours) > 100  # text and a curve, not an empty page
            assert first != second
            others = [url for url in shown.requested if not url.startswith((address, "data:", "blob:"))]
            assert len(shown.blocked) == len(
                others
            )  # the page names a font of another host: it is not fetched

    words = ("--speed", "60", "--id", "lab")
    with Daemon("sim", tmp_path / "state", *words) as daemon:
        daemon.wait(lambda r: r.session.elapsed_s > 60)
        with page(tmp_path / "empty", "--connect", daemon.endpoint) as (address, process):
            asyncio.run(look(address))
            end = time.monotonic() + 20
            while psutil.Process(process.pid).children():  # the browser has gone, and its screen with it
                assert time.monotonic() < end
                time.sleep(0.2)
            process.send_signal(signal.SIGTERM)
            process.wait(60)
        assert list((tmp_path / "empty").iterdir()) == []
