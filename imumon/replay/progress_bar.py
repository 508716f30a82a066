"""Progress bar of what takes long, on a terminal: share, rate and time left; nothing on a pipe.

A thread draws it, so that it also moves while the recording is opened and while the last report is made, and it
begins after two seconds, so that short work shows nothing. It ends with an empty line: what is printed next starts
where the bar was.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from types import TracebackType
from typing import TextIO

from imumon.units import duration

BEGIN_S = 2.0
"""s after which the bar appears."""

REDRAW_S = 0.2
"""s between two drawings."""

WIDTH = 20
"""Characters of the bar."""


class ProgressBar:
    """Progress bar, as a context manager.

    Parameters
    ----------
    stream : terminal, default standard error; nothing is drawn if it is another file.
    begin_s : s after which the bar appears.
    """

    def __init__(self, stream: TextIO | None = None, begin_s: float = BEGIN_S) -> None:
        self._stream = stream or sys.stderr
        self._begin_s = begin_s
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._draw_until_end, daemon=True)
        self._begun = time.monotonic()
        self._share: float | None = None
        self._record_s: float | None = None  # None: nothing has been read
        self._drawn = False

    def __enter__(self) -> ProgressBar:
        self._begun = time.monotonic()
        if self._stream.isatty():
            self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()
        if self._drawn:
            self._write("")

    def update(self, share: float | None, record_s: float) -> None:
        """Set the share that is done, None if it is unknown, and the length of the record so far in s."""
        self._share, self._record_s = share, record_s

    def _draw_until_end(self) -> None:
        self._ended.wait(self._begin_s)
        while not self._ended.is_set():
            self._drawn = True
            self._write(bar_text(self._share, self._record_s, time.monotonic() - self._begun))
            self._ended.wait(REDRAW_S)

    def _write(self, line: str) -> None:
        try:
            line = line[
                : os.get_terminal_size(self._stream.fileno()).columns - 1
            ]  # a wrapped line would remain
        except (OSError, ValueError):
            line = line[: WIDTH * 3]
        self._stream.write(f"\r{line}\x1b[K")
        self._stream.flush()


def bar_text(share: float | None, record_s: float | None, spent_s: float) -> str:
    """Return the line of a progress bar.

    Parameters
    ----------
    share : done, 0 to 1; None: unknown.
    record_s : s of the record that have been processed; None: it is being opened.
    spent_s : s since the begin.

    >>> bar_text(0.25, 3600.0, 9.0)[20:]
    '  25 %  1 h of record, 400 times real time, 27 s left'
    >>> bar_text(None, 40.0, 20.0), bar_text(None, None, 3.0), bar_text(1.0, 40.0, 3.0)[20:]
    ('40 s of record, 2 times real time, 20 s', 'opening, 3 s', ' 100 %  40 s of record, last analysis')
    """
    if record_s is None:
        return f"opening, {duration(spent_s)}"
    rate = record_s / spent_s if spent_s > 0.0 else 0.0
    text = f"{duration(record_s)} of record"
    times = f"{rate:,.0f}" if rate >= 1.0 else f"{rate:.1g}"
    if share is None:
        return f"{text}, {times} times real time, {duration(spent_s)}"
    done = round(share * WIDTH)
    bar = f"{'━' * done}{'╌' * (WIDTH - done)} {100.0 * share:3.0f} %  {text}"
    if share >= 1.0:
        return f"{bar}, last analysis"
    left = f", {duration(spent_s * (1.0 - share) / share)} left" if share > 0.0 else ""
    return f"{bar}, {times} times real time{left}"
