"""The progress bar: share, rate and time left on a terminal after two seconds, nothing on a pipe."""

from __future__ import annotations

import fcntl
import os
import re
import struct
import subprocess
import sys
import termios
import time
from pathlib import Path

import pytest
from tables import sentences
from waiting import until

from imumon.cli.progress_bar import ProgressBar


def drained(master: int) -> str:
    os.set_blocking(master, False)
    data = b""
    try:
        while part := os.read(master, 1 << 16):
            data += part
    except (BlockingIOError, OSError):
        pass
    return data.decode()


def shown_text(shown: str) -> str:
    """What a terminal shows, without colours and movements."""
    return re.sub(r"\x1b\[[?\d;]*[A-Za-z]", "", shown)


@pytest.mark.parametrize("columns", [120, 40])
def test_a_bar_shows_share_rate_and_time_left_and_leaves_an_empty_line(
    columns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))  # the streams of this process are no terminal
    master, slave = os.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    shown = ""

    def shows(text: str) -> bool:
        nonlocal shown
        shown += drained(master)
        return text in shown

    with open(slave, "w") as terminal:
        with ProgressBar(terminal, begin_s=0.05) as bar:
            until(lambda: shows("opening"))
            bar.update(0.5, 3600.0)
            until(lambda: shows("50 %"))
            bar.update(0.6, 4320.0)
            until(lambda: shows("60 %"))
        assert shows("\x1b[?25h")  # the cursor is back
    os.close(master)
    lines = shown_text(shown).split("\r")
    assert max(map(len, lines)) <= columns
    if columns == 120:
        assert re.search(
            r"60 %  1 h 12 min of record, [\d,]+ times real time ━+╺━+ [-0:\d]+\r", shown_text(shown)
        )
    assert shown.endswith("\x1b[2K")


def test_short_work_and_a_pipe_show_nothing() -> None:
    master, slave = os.openpty()
    with open(slave, "w") as terminal, ProgressBar(terminal) as bar:
        bar.update(0.5, 3600.0)
        assert drained(master) == ""
    reader, writer = os.pipe()
    with open(writer, "w") as pipe, ProgressBar(pipe, begin_s=0.0) as bar:
        bar.update(0.5, 3600.0)
        time.sleep(0.05)
    assert os.read(reader, 100) == b""
    os.close(master)
    os.close(reader)


@pytest.mark.slow
def test_a_replay_on_a_terminal_shows_a_bar_and_then_the_remarks(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("\r\n".join(sentences(4000)[1]) + "\r\n")
    command = [sys.executable, "-m", "imumon", "replay", str(path), "--rate", "100", "--speed", "10"]
    master, slave = os.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 120, 0, 0))
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=slave, timeout=60, check=False, text=True)
    shown = drained(master)
    os.close(slave)
    os.close(master)
    assert done.returncode == 0
    assert re.search(r"\d+ %  \d+ s of record, [\d.]+ times real time [━╺╸]+ 0:00:0\d", shown_text(shown))
    assert "━" not in shown.rpartition("\x1b[2K")[2]
    assert "imumon" not in shown.rpartition("\x1b[2K")[0]
    assert "4,000 samples" in done.stdout
