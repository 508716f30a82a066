"""Progress bar of what takes long, on a terminal: share, rate and time left; nothing on a pipe.

It begins after two seconds, so that short work shows nothing, and goes at the end.
"""

from __future__ import annotations

import sys
import threading
import time
from types import TracebackType
from typing import TYPE_CHECKING, TextIO

from imumon.model.units import duration, figures, share_text

if TYPE_CHECKING:
    from rich.progress import Progress

BEGIN_S = 2.0
"""s after which the bar appears."""


class ProgressBar:
    """Progress bar, as a context manager.

    Parameters
    ----------
    stream : terminal, default standard error; nothing is drawn if it is another file.
    begin_s : s after which the bar appears.
    """

    def __init__(self, stream: TextIO | None = None, begin_s: float = BEGIN_S) -> None:
        self._stream = stream or sys.stderr
        self._timer = threading.Timer(begin_s, self._begin)
        self._timer.daemon = True
        self._begun = time.monotonic()
        self._progress: Progress | None = None  # None before it begins

    def __enter__(self) -> ProgressBar:
        self._begun = time.monotonic()
        if self._stream.isatty():
            self._timer.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._timer.cancel()
        if self._timer.is_alive():
            self._timer.join()
        if self._progress is not None:
            self._progress.stop()

    def update(self, share: float | None, record_s: float) -> None:
        """Set the share that is done, None if it is unknown, and the length of the record so far in s."""
        if self._progress is not None:
            rate = record_s / (time.monotonic() - self._begun)
            done, total = ("", None) if share is None else (f"{share_text(share)}  ", 1.0)
            text = f"{done}{duration(record_s)} of record, {figures(rate, 2)} times real time"
            for task in self._progress.task_ids:
                self._progress.update(task, total=total, completed=share or 0.0, description=text)

    def _begin(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        columns = TextColumn("{task.description}"), BarColumn(20), TimeRemainingColumn()
        console = Console(file=self._stream)
        progress = Progress(
            *columns, console=console, transient=True, redirect_stdout=False, redirect_stderr=False
        )
        progress.add_task("opening", total=None)
        self._progress = progress
        progress.start()
