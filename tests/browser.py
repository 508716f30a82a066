"""A headless Chromium for tests, controlled through the DevTools protocol."""

from __future__ import annotations

import asyncio
import base64
import itertools
import json
import subprocess
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import aiohttp

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")


class Page:
    """One page of a browser.

    Attributes
    ----------
    log : messages of the console.
    requested : addresses that the page names, also those that the policy blocks.
    blocked : requests that the policy has blocked.
    """

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self._socket, self._numbers = socket, itertools.count(1)
        self._replies: dict[int, asyncio.Future[Any]] = {}
        self.log: list[str] = []
        self.requested: list[str] = []
        self.blocked: list[str] = []
        self._reader = asyncio.create_task(self._read())

    async def _read(self) -> None:
        async for message in self._socket:
            data = json.loads(message.data)
            if "id" in data:
                self._replies.pop(data["id"]).set_result(data.get("result", data))
            elif data["method"] == "Network.requestWillBeSent":
                self.requested.append(data["params"]["request"]["url"])
            elif data["method"] == "Network.loadingFailed" and data["params"].get("blockedReason") == "csp":
                self.blocked.append(data["params"]["requestId"])
            elif data["method"] == "Log.entryAdded":
                self.log.append(data["params"]["entry"]["text"])

    async def call(self, method: str, **parameters: Any) -> Any:
        number = next(self._numbers)
        self._replies[number] = asyncio.get_running_loop().create_future()
        await self._socket.send_json({"id": number, "method": method, "params": parameters})
        return await asyncio.wait_for(self._replies[number], 30)

    async def value(self, expression: str) -> Any:
        """Value of an expression of JavaScript in the page."""
        reply = await self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        return reply["result"].get("value")

    async def press(self, key: str) -> None:
        for kind in ("keyDown", "keyUp"):
            await self.call(
                "Input.dispatchKeyEvent", type=kind, key=key, text=key if kind == "keyDown" else ""
            )

    async def screenshot(self, path: Path) -> bytes:
        data = base64.b64decode((await self.call("Page.captureScreenshot", format="png"))["data"])
        path.write_bytes(data)
        return data


@asynccontextmanager
async def browser(program: str, folder: Path, address: str) -> AsyncIterator[Page]:
    """A page of a new browser that shows an address."""
    profile = folder / "profile"
    command = [
        program, "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run",
        f"--user-data-dir={profile}", "--remote-debugging-port=0", "--window-size=1400,900", "about:blank",
    ]  # fmt: skip
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            port, end = profile / "DevToolsActivePort", time.monotonic() + 30
            while not (port.exists() and port.read_text().count("\n")):
                assert time.monotonic() < end, "the browser did not start"
                await asyncio.sleep(0.1)
            debugger = f"http://127.0.0.1:{port.read_text().splitlines()[0]}"
            async with aiohttp.ClientSession() as session:
                async with session.get(f"{debugger}/json") as reply:
                    (found, *_) = [each for each in await reply.json() if each["type"] == "page"]
                async with session.ws_connect(found["webSocketDebuggerUrl"], max_msg_size=0) as socket:
                    page = Page(socket)
                    for domain in ("Page", "Network", "Log", "Runtime"):
                        await page.call(f"{domain}.enable")
                    await page.call("Emulation.setFocusEmulationEnabled", enabled=True)  # as the front window
                    await page.call("Page.navigate", url=address)
                    yield page
        finally:
            process.kill()
