"""What the screen needs of the terminal, and how the screen ends.

The screen is drawn on stderr and keys are read from stdin, so both must be a terminal. A signal that ends the
process, or a terminal that is closed, must end the screen properly: otherwise the terminal stays in its
alternate mode, or the process keeps polling a closed terminal.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import termios
import threading
import time
from collections.abc import Callable

CURE = "the screen needs a terminal; use `imumon status` or `imumon status --json` instead"


def in_browser() -> bool:
    """Return whether the screen is drawn by a browser: `imumon.tui.web` has started this process."""
    return "WebDriver" in os.environ.get("TEXTUAL_DRIVER", "")


def obstacle() -> str | None:
    """Return in one line why the screen cannot be drawn here; None if it can."""
    if in_browser():
        return None
    for stream, name in ((sys.stdin, "stdin"), (sys.stderr, "stderr")):
        try:
            usable = stream is not None and os.isatty(stream.fileno())
        except (OSError, ValueError):
            usable = False
        if not usable:
            return f"{name} is not a terminal: {CURE}"
    if os.environ.get("TERM") == "dumb":
        return f"TERM is dumb: {CURE}"
    return None


def closed() -> bool:
    """Return whether the terminal was closed while the screen runs."""
    try:
        termios.tcgetattr(0)
    except (termios.error, OSError):
        return True
    return False


def exit_when_closed(period_s: float) -> None:
    """End the process when its terminal is closed; check every `period_s` seconds.

    This runs in its own thread: without the terminal, the event loop may block in a write, and the reader of
    the keys spins because a closed terminal is always readable. There is no screen to restore.
    """

    def check() -> None:
        while not closed():
            time.sleep(period_s)
        os._exit(128 + signal.SIGHUP)

    threading.Thread(target=check, name="terminal", daemon=True).start()


def exit_with_parent(period_s: float) -> None:
    """End the process when the one that started it has ended; check every `period_s` seconds."""
    parent = os.getppid()

    def check() -> None:
        while os.getppid() == parent:
            time.sleep(period_s)
        os._exit(128 + signal.SIGHUP)

    threading.Thread(target=check, name="parent", daemon=True).start()


def only_ascii() -> bool:
    """Return whether the encoding or the font of the terminal lacks the characters of the screen."""
    if in_browser():
        return False
    if os.environ.get("TERM") == "linux":  # its console has at most 512 glyphs, and no braille
        return True
    encoding = (getattr(sys.stderr, "encoding", None) or "ascii").lower().replace("-", "")
    return "utf" not in encoding


def on_signals(end: Callable[[int], None]) -> None:
    """Call `end(128 + number)` in the event loop at SIGTERM, SIGHUP and SIGINT."""
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
        loop.add_signal_handler(number, end, 128 + number)
