"""Web server of the terminal UI, by textual-serve: each browser gets a process of its own that draws the screen.

The page is for people who may read the bus anyway, and it has no password. A page of another site cannot connect to it:
the origin must be the page itself, and on a loopback address the host must be one. Nothing is loaded from other hosts.
Nothing is written on the server: what a user saves goes to the browser.

textual-serve asks each browser every 15 s for an answer, and ends the screen of one that gives none.
"""

from __future__ import annotations

import asyncio
import logging
import os
import shlex
import signal
import sys
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from ipaddress import ip_address
from typing import Any
from urllib.parse import urlsplit

from imumon.model.errors import ImumonError
from imumon.model.system_errors import cure_of_writing

log = logging.getLogger(__name__)

MOST_BROWSERS = 8
"""Screens at once; each is a process of about 60 MB."""
END_S = 2.0
"""s that connections may take to end at the end of the server; with a busy machine, it is then gone in 5 s."""
POLICY = (
    "default-src 'self'; style-src 'self' 'unsafe-inline'; script-src 'self' 'unsafe-inline'; "
    "connect-src 'self' ws: wss:; img-src 'self' data:; frame-ancestors 'none'"
)
"""Content security policy: nothing from other hosts, in particular no fonts."""
FOCUS = """<script>
const focus = setInterval(() => {
  const keys = document.querySelector(".xterm-helper-textarea");
  if (keys && document.body.classList.contains("-first-byte")) { keys.focus(); clearInterval(focus); }
}, 100);
</script>
"""
"""Lets the screen have the keys from the first moment: the page of textual-serve needs a click before."""


Handler = Callable[[Any], Awaitable[Any]]
"""Takes a request of aiohttp and returns its response."""
Answer = Callable[[Any, Handler], Awaitable[Any]]
"""Takes a request and the handler of its path, and returns the response."""


class WebError(ImumonError):
    """The page cannot be served."""


def serve(arguments: Sequence[str], host: str, port: int, ready: Callable[[str], None]) -> bool:
    """Serve the terminal UI until SIGINT or SIGTERM; return whether it was SIGINT.

    Parameters
    ----------
    arguments : of `imumon tui`.
    ready : called with the address of the page before it is served.

    Raises
    ------
    WebError : ``web_not_installed``, or ``web_not_served``: the address is in use or not of this machine.
    """
    page = _Page(host, port)
    command = shlex.join([sys.executable, "-P", "-m", "imumon", "tui", *arguments])
    server = _server(f"exec {command}", host, port, page.answer)
    try:
        return asyncio.run(page.serve(server, ready))
    except OSError as error:
        cure = cure_of_writing(error, "choose another address with --listen")
        reason = os.strerror(error.errno or 0).lower()  # the text of asyncio repeats the address
        raise WebError("web_not_served", f"{page.address}: {reason}", cure) from None


def _server(command: str, host: str, port: int, answer: Answer) -> Any:
    """Return the server of textual-serve, without its banner; each request passes through `answer`."""
    try:
        from aiohttp import web
        from textual_serve.server import Server
    except ImportError:
        cure = "install imumon with the extra web: pip install 'imumon[web]'"
        raise WebError("web_not_installed", "the package textual-serve is not installed", cure) from None

    @web.middleware
    async def guarded(request: Any, handler: Handler) -> Any:
        return await answer(request, handler)

    class GuardedServer(Server):
        async def _make_app(self) -> Any:
            app = await super()._make_app()
            app.middlewares.append(guarded)
            return app

        async def on_startup(self, app: Any) -> None:
            """Print nothing."""

    # a relative address in the page: the browser may know this machine by another name, or through a proxy
    return GuardedServer(command, host=host, port=port, title="imumon")


class _Page:
    """The page while it is served, and how many browsers have a screen."""

    def __init__(self, host: str, port: int) -> None:
        self._host, self._port = host, port
        self._browsers = 0

    @property
    def address(self) -> str:
        """Host and port as in a URL."""
        return f"[{self._host}]:{self._port}" if ":" in self._host else f"{self._host}:{self._port}"

    async def answer(self, request: Any, handler: Handler) -> Any:
        """Answer a request that is for this page, from a browser that is not one too many."""
        from aiohttp import web

        if not allowed(self._host, request.headers.get("Host", ""), request.headers.get("Origin")):
            raise web.HTTPForbidden(text="this page is for another address")
        if request.path == "/ws":
            if self._browsers >= MOST_BROWSERS:
                raise web.HTTPServiceUnavailable(text="too many browsers")
            self._browsers += 1
            try:
                return await handler(request)
            finally:
                self._browsers -= 1
        response = await handler(request)
        if request.path == "/":
            response.text = response.text.replace("</body>", f"{FOCUS}</body>")
        response.headers["Content-Security-Policy"] = POLICY
        response.headers["Referrer-Policy"] = "no-referrer"
        return response

    async def serve(self, server: Any, ready: Callable[[str], None]) -> bool:
        """Serve until a signal arrives; return whether it was SIGINT."""
        from aiohttp import web

        loop, signals = asyncio.get_running_loop(), asyncio.Queue[int]()
        loop.set_exception_handler(_log_fault)
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, signals.put_nowait, number)
        runner = web.AppRunner(
            await server._make_app(), access_log=None, shutdown_timeout=END_S, handler_cancellation=True
        )
        await runner.setup()
        await web.TCPSite(runner, self._host, self._port).start()
        ready(f"http://{self.address}")
        stopped_by = await signals.get()
        with suppress(TimeoutError):
            await asyncio.wait_for(runner.cleanup(), END_S)
        return stopped_by == signal.SIGINT


def _log_fault(loop: asyncio.AbstractEventLoop, context: Mapping[str, Any]) -> None:
    """Log what goes wrong outside of all requests in one line; asyncio would print a traceback."""
    log.warning("%s", f"web: {context.get('exception') or context['message']}")


def allowed(listen: str, host: str, origin: str | None) -> bool:
    """Return whether a request may be answered.

    Parameters
    ----------
    listen : address of the server.
    host, origin : headers of the request; a program that is no browser sends no origin.

    >>> allowed("127.0.0.1", "localhost:8448", "http://localhost:8448")
    True
    >>> allowed("127.0.0.1", "evil.example:8448", "http://evil.example:8448")
    False
    >>> allowed("127.0.0.1", "127.0.0.1:8448", "http://evil.example")
    False
    """
    if origin is not None and urlsplit(origin).netloc != host:
        return False
    return not is_loopback(listen) or is_loopback(urlsplit(f"//{host}").hostname or "")


def is_loopback(host: str) -> bool:
    """Return whether a host is this machine alone.

    >>> is_loopback("localhost"), is_loopback("::1"), is_loopback("0.0.0.0")
    (True, True, False)
    """
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
