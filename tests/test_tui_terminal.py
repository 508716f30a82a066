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
from terminals import ENVIRONMENT, Tmux, until

HERE = Path(__file__).parent
ACTOR = [sys.executable, str(HERE / "screen_actor.py")]


@pytest.fixture
def tmux(tmp_path: Path) -> Iterator[Callable[..., Tmux]]:
    if shutil.which("tmux") is None:
        pytest.skip("tmux is not installed")
    made: list[Tmux] = []

    def make(command: str, size: tuple[int, int] = (150, 40)) -> Tmux:
        made.append(Tmux(tmp_path / f"tmux-{len(made)}", command, size))
        return made[-1]

    yield make
    for one in made:
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
    until(lambda: pane.text().splitlines()[0] != before)  # the elapsed time goes on
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
    until(lambda: "INDUSTRIAL" in pane.text())
    assert "±" in pane.text()
    pane.press("q")
    until(lambda: "EXIT=0" in pane.text())
    assert pane.flag("alternate_on") == "0"
    assert pane.flag("mouse_any_flag") == "0"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_a_signal_ends_it_and_restores_the_terminal(
    tmux: Callable[..., Tmux], number: signal.Signals
) -> None:
    pane = tmux(shell())
    until(lambda: "● live" in pane.text())
    os.kill(pane.screen(), number)
    until(lambda: f"EXIT={128 + number}" in pane.text())
    assert pane.flag("alternate_on") == "0"
    assert pane.flag("mouse_any_flag") == "0"


def test_ctrl_c_quits(tmux: Callable[..., Tmux]) -> None:
    pane = tmux(shell())
    until(lambda: "● live" in pane.text())
    pane.press("C-c")
    until(lambda: "EXIT=0" in pane.text())


@pytest.mark.parametrize("change", ["NO_COLOR=1", "TERM=linux", "COLORTERM= TERM=screen"])
def test_poor_terminals(tmux: Callable[..., Tmux], change: str) -> None:
    pane = tmux(f"env {change} {shell()}", (80, 24))
    until(lambda: "● live" in pane.text())
    pane.press("q")
    until(lambda: "EXIT=0" in pane.text())


def test_a_terminal_that_knows_ascii_alone(tmux: Callable[..., Tmux]) -> None:
    pane = tmux(f"env LC_ALL=C PYTHONUTF8=0 PYTHONCOERCECLOCALE=0 {shell()}", (80, 24))
    until(lambda: "* live" in pane.text())
    assert "\\u" not in pane.text()
    assert all(len(line) <= 80 for line in pane.text().splitlines())
    assert pane.text().isascii()
    pane.press("q")
    until(lambda: "EXIT=0" in pane.text())


# ---------------------------------------------------------------------------- without a multiplexer


def start(**options: object) -> tuple[subprocess.Popen[bytes], int]:
    """The screen on a pseudo-terminal of ours; its process and our end of the line."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))

    def own_terminal() -> None:
        os.setsid()
        fcntl.ioctl(0, termios.TIOCSCTTY, 0)
        if options.get("ignore_hangup"):
            signal.signal(signal.SIGHUP, signal.SIG_IGN)

    process = subprocess.Popen(
        ACTOR, stdin=theirs, stdout=theirs, stderr=theirs, env=ENVIRONMENT, preexec_fn=own_terminal
    )
    os.close(theirs)
    return process, ours


def read_until(line: int, expected: bytes, seconds: float = 20.0) -> None:
    end, got = time.monotonic() + seconds, b""
    while expected not in got:
        assert time.monotonic() < end, got[-200:]
        got += os.read(line, 65536)


@pytest.mark.parametrize("ignore_hangup", [False, True])
def test_it_ends_when_its_terminal_vanishes(ignore_hangup: bool) -> None:
    """A closed window, a lost connection: no process keeps spinning."""
    process, line = start(ignore_hangup=ignore_hangup)
    try:
        read_until(line, b"live")
        os.close(line)
        assert process.wait(20) == 129
    finally:
        process.kill()
        process.wait()


@pytest.mark.parametrize("closed", ["stdin", "stderr"])
def test_without_a_terminal_it_says_what_to_use(closed: str) -> None:
    """No escapes into a pipe, no endless run: one line and out."""
    ours, theirs = pty.openpty()
    try:
        done = subprocess.run(
            ACTOR,
            stdin=subprocess.DEVNULL if closed == "stdin" else theirs,
            stdout=theirs,
            stderr=subprocess.PIPE,
            env=ENVIRONMENT,
            timeout=30,
        )
    finally:
        os.close(ours)
        os.close(theirs)
    assert done.returncode == 1
    said = done.stderr.decode()
    assert said.count("\n") == 1
    assert "imumon status --json" in said
    assert "\x1b" not in said


def test_a_dumb_terminal_is_refused() -> None:
    ours, theirs = pty.openpty()
    environment = {**ENVIRONMENT, "TERM": "dumb"}
    process = subprocess.Popen(ACTOR, stdin=theirs, stdout=theirs, stderr=theirs, env=environment)
    os.close(theirs)
    try:
        assert process.wait(30) == 1
        assert b"imumon status" in os.read(ours, 4096)
    finally:
        os.close(ours)


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
