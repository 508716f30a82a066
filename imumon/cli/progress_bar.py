"""Progress bar of what takes long, on a terminal: share, rate and time left; nothing on a pipe.

It begins after two seconds, so that short work shows nothing, and goes at the end.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TextIO

from imumon.model.units import duration, figures, share_text

BEGIN_S = 2.0
"""s after which the bar appears."""


@contextmanager
def progress_bar(
    stream: TextIO | None = None, begin_s: float = BEGIN_S
) -> Iterator[Callable[[float | None, float], None]]:
    """Show a bar; give what sets the share that is done, None if unknown, and the length of the record so far, s.

    Parameters
    ----------
    stream : terminal, default standard error; nothing is drawn if it is another file.
    begin_s : s after which the bar appears.
    """
    stream = stream or sys.stderr
    if not stream.isatty():
        yield lambda share, record_s: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = TextColumn("{task.description}"), BarColumn(20), TimeRemainingColumn()
    progress = Progress(
        *columns, console=Console(file=stream), transient=True, redirect_stdout=False, redirect_stderr=False
    )
    task, begun = progress.add_task("opening", total=None), time.monotonic()

    def update(share: float | None, record_s: float) -> None:
        rate = record_s / (time.monotonic() - begun)
        done, total = ("", None) if share is None else (f"{share_text(share)}  ", 1.0)
        text = f"{done}{duration(record_s)} of record, {figures(rate, 2)} times real time"
        progress.update(task, total=total, completed=share or 0.0, description=text)

    timer = threading.Timer(begin_s, progress.start)
    timer.daemon = True
    timer.start()
    try:
        yield update
    finally:
        timer.cancel()
        timer.join()
        if progress.live.is_started:
            progress.stop()
