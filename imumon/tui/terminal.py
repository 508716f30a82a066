"""Terminal: what the screen needs of it, and how it is given back.

The screen is drawn on stderr and keys are read from stdin, so both must be a terminal. A signal that
ends the process, or a terminal that goes away, must end the screen properly: otherwise the terminal
stays in its other mode, or the process spins on a dead line for ever.
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

ADVICE = "the screen needs a terminal; use `imumon status` or `imumon status --json` instead"


def missing() -> str | None:
    """Why the screen cannot be drawn here, in one line; None when it can."""
    for stream, name in ((sys.stdin, "stdin"), (sys.stderr, "stderr")):
        try:
            fine = stream is not None and os.isatty(stream.fileno())
        except (OSError, ValueError):
            fine = False
        if not fine:
            return f"{name} is no terminal: {ADVICE}"
    if os.environ.get("TERM") == "dumb":
        return f"TERM is dumb: {ADVICE}"
    return None


def vanished() -> bool:
    """Whether the terminal has gone away under a running screen."""
    try:
        termios.tcgetattr(0)
    except (termios.error, OSError):
        return True
    return False


def watch(period: float) -> None:
    """End the process once its terminal has gone away, looking every so many seconds.

    From a thread of its own: with the terminal gone, the event loop may wait for ever to write to it,
    while the reader of the keys turns on a line that is always ready. Nobody can see or hear us, so
    nothing is put in order.
    """

    def look() -> None:
        while not vanished():
            time.sleep(period)
        os._exit(128 + signal.SIGHUP)

    threading.Thread(target=look, name="terminal", daemon=True).start()


def only_ascii() -> bool:
    """Whether the terminal's encoding cannot show what we draw."""
    encoding = (getattr(sys.stderr, "encoding", None) or "ascii").lower().replace("-", "")
    return "utf" not in encoding


def on_signals(end: Callable[[int], None]) -> None:
    """Call `end(128 + number)` inside the event loop at SIGTERM, SIGHUP and SIGINT."""
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
        loop.add_signal_handler(number, end, 128 + number)
