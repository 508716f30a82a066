"""Web server of the terminal UI, by textual-serve: each browser gets a process of its own that draws the screen.

The page is for people who may read the bus anyway, and it has no password. Three things protect it: a page of another
site cannot connect to it (the origin must be the page itself, and on a loopback address the host must be one), nothing
is loaded from other hosts, and the number of browsers is bounded. Nothing is written on the server: what a user saves
goes to the browser.
"""

from __future__ import annotations

import asyncio
import errno
import shlex
import signal
import sys
from collections.abc import Awaitable, Callable, Sequence
from ipaddress import ip_address
from typing import Any
from urllib.parse import urlsplit

from imumon.errors import ImumonError, why

MOST_BROWSERS = 8
"""Browsers at once; each is a process of about 60 MB."""
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
    try:
        from aiohttp import web
        from textual_serve.server import Server
    except ImportError:
        cure = "install imumon with the extra web: pip install 'imumon[web]'"
        raise WebError("web_not_installed", "the package textual-serve is not installed", cure) from None

    own = shlex.join([sys.executable, "-P", "-m", "imumon", "tui", *arguments])
    shown = f"[{host}]" if ":" in host else host

    @web.middleware
    async def guarded(request: Any, handler: Callable[[Any], Awaitable[Any]]) -> Any:
        if not allowed(host, request.headers.get("Host", ""), request.headers.get("Origin")):
            raise web.HTTPForbidden(text="this page is for another address")
        if request.path == "/ws":
            if len(browsers) >= MOST_BROWSERS:
                raise web.HTTPServiceUnavailable(text="too many browsers")
            browsers.add(id(request))
            try:
                return await handler(request)
            finally:
                browsers.discard(id(request))
        response = await handler(request)
        if request.path == "/":
            response.text = response.text.replace("</body>", f"{FOCUS}</body>")
        response.headers["Content-Security-Policy"] = POLICY
        response.headers["Referrer-Policy"] = "no-referrer"
        return response

    browsers: set[int] = set()
    interrupts: list[int] = []

    class GuardedServer(Server):
        """The server of textual-serve, without its banner, behind `guarded`."""

        async def _make_app(self) -> Any:
            app = await super()._make_app()
            app.middlewares.append(guarded)
            return app

        def initialize_logging(self) -> None:
            """Log nothing: standard error is for messages of imumon."""

        async def on_startup(self, app: Any) -> None:
            asyncio.get_running_loop().add_signal_handler(signal.SIGINT, self.interrupt)
            ready(f"http://{shown}:{port}")

        def interrupt(self) -> None:
            interrupts.append(signal.SIGINT)
            self.request_exit()

    # a relative address in the page: the browser may know this machine by another name, or through a proxy
    server = GuardedServer(f"exec {own}", host=host, port=port, title="imumon")
    try:
        server.serve()
    except OSError as error:
        reason = "in use" if error.errno == errno.EADDRINUSE else why(error)
        cure = "choose another address with --listen"
        raise WebError("web_not_served", f"{shown}:{port}: {reason}", cure) from None
    return bool(interrupts)


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
