"""The progress bar: share, rate and time left on a terminal after two seconds, nothing on a pipe."""

from __future__ import annotations

import fcntl
import os
import re
import struct
import termios

import pytest
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
