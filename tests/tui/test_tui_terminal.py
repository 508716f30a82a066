"""The screen on a real terminal: what it needs, how it ends, what it restores."""

from __future__ import annotations

import fcntl
import os
import pty
import shutil
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from paths import TESTS
from terminals import ENVIRONMENT, Tmux
from waiting import until

ACTOR = [sys.executable, str(TESTS / "screen_actor.py")]
COMMAND = [sys.executable, "-m", "imumon", "tui"]


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


@pytest.mark.few
@pytest.mark.parametrize("closed", ["stdin", "stderr"])
def test_without_a_terminal_it_names_the_alternative(closed: str) -> None:
    """It prints one line without escape sequences and ends."""
    master, slave = pty.openpty()
    try:
        done = subprocess.run(
            COMMAND,
            stdin=subprocess.DEVNULL if closed == "stdin" else slave,
            stdout=slave,
            stderr=subprocess.PIPE,
            env=ENVIRONMENT,
            timeout=30,
        )
    finally:
        os.close(master)
        os.close(slave)
    assert done.returncode == 2
    error = done.stderr.decode()
    assert error.count("\n") == 1
    assert "imumon status --json" in error
    assert "\x1b" not in error


def test_the_screen_imports_no_heavy_library() -> None:
    """The screen needs neither scipy nor pydantic nor the serial port."""
    program = "import sys, imumon.tui.app; print(sorted({m.partition('.')[0] for m in sys.modules}))"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True
    )
    loaded = set(eval(done.stdout))
    assert not loaded & {"scipy", "pydantic", "serial", "zenoh", "matplotlib"}
    program = "import sys, imumon.tui; print('textual' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.strip() == "False"
