"""The screen in a browser: a real Chromium shows it; other sites cannot; nothing stays on the server."""

from __future__ import annotations

import asyncio
import io
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from browser import PROGRAMS, browser
from daemons import Daemon
from free_ports import free_port
from waiting import until

from imumon.tui.web import MOST_BROWSERS

CHROMIUM = next(filter(None, map(shutil.which, PROGRAMS)), None)


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
        with urllib.request.urlopen(urllib.request.Request(address, headers=headers), timeout=5) as reply:
            assert "default-src 'self'" in reply.headers["Content-Security-Policy"]
            return int(reply.status)
    except urllib.error.HTTPError as error:
        return error.code


def test_only_the_page_itself_may_connect(tmp_path: Path) -> None:
    with page(tmp_path) as (address, process):
        host = address.removeprefix("http://")
        end = time.monotonic() + 60
        while True:
            try:
                assert status(address) == 200
                break
            except OSError:
                assert time.monotonic() < end
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


def children(pid: int) -> list[int]:
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


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
def test_a_browser_shows_the_screen_and_follows_the_keys(tmp_path: Path) -> None:
    """IMUMON_SCREENSHOTS names a directory that keeps the pictures for people."""
    from PIL import Image

    pictures = Path(os.environ.get("IMUMON_SCREENSHOTS", tmp_path))

    async def look(address: str) -> None:
        assert CHROMIUM is not None
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
                assert colours is not None
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
            while children(process.pid):  # the browser has gone, and its screen with it
                assert time.monotonic() < end
                time.sleep(0.2)
            process.send_signal(signal.SIGTERM)
            process.wait(60)
        assert list((tmp_path / "empty").iterdir()) == []
