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


def in_browser() -> bool:
    """Return whether the screen is drawn by a browser: `imumon.tui.web` has started this process."""
    return "WebDriver" in os.environ.get("TEXTUAL_DRIVER", "")


def is_usable() -> bool:
    """Return whether the screen can be drawn here."""
    if in_browser():
        return True
    streams = (sys.stdin, sys.stderr)
    return os.environ.get("TERM") != "dumb" and all(
        stream is not None and stream.isatty() for stream in streams
    )


def closed() -> bool:
    """Return whether the terminal was closed while the screen runs."""
    try:
        termios.tcgetattr(0)
    except (termios.error, OSError):
        return True
    return False


def exit_when(gone: Callable[[], bool], period_s: float) -> None:
    """End the process when its terminal or its server is gone; check every `period_s` seconds.

    This runs in its own thread: without the terminal, the event loop may block in a write, and the reader of
    the keys spins because a closed terminal is always readable. There is no screen to restore.
    """

    def check() -> None:
        while not gone():
            time.sleep(period_s)
        os._exit(128 + signal.SIGHUP)

    threading.Thread(target=check, name="terminal", daemon=True).start()


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
