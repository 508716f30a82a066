"""The screen in a browser: it is shown and follows keys; other sites cannot; nothing stays on the server."""

from __future__ import annotations

import asyncio
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import aiohttp
import pytest
from daemons import free_endpoint
from free_ports import free_port
from waiting import until

from imumon.tui.web import MOST_BROWSERS


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
        until(lambda: not children(process.pid))  # the browser has gone, and its screen with it
        process.send_signal(signal.SIGTERM)
        process.wait(60)
    assert list((tmp_path / "empty").iterdir()) == []
