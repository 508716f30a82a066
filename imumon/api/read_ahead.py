"""Read ahead: one thread reads and decodes a recording while another one works on its samples.

Both spend most of their time on arrays, where Python lets threads run on two cores.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from contextlib import suppress
from contextvars import copy_context
from queue import Empty, Queue
from threading import Thread

from imumon.model.samples import Gap, SampleBlock
from imumon.sources.files import Recording

BLOCKS = 2
"""Blocks that wait: one is enough for equal blocks, a second one evens out unequal ones."""

END_S = 1.0
"""s that the end waits for the thread: a block takes far less, a pipe without data has no limit. If the
interpreter ends while a thread is inside a library in C++, that aborts the process."""

Items = Sequence[SampleBlock | Gap]


Ahead = tuple[Items, float | None, Mapping[str, int]]


def read_ahead(recording: Recording) -> Generator[Ahead, None, None]:
    """Yield what a recording yields, with its progress, share of the file, and its ledger then. Close it at the end.

    Other counters of the recording may include blocks that have not been yielded yet, until the last one has.

    Raises
    ------
    Whatever reading raises.
    """
    blocks: Queue[Ahead | BaseException | None] = Queue(BLOCKS)
    abandoned = False

    def read() -> None:
        try:
            for items in recording:
                blocks.put((items, recording.progress, recording.ledger))
                if abandoned:
                    return
        except BaseException as error:
            blocks.put(error)
        else:
            blocks.put(None)

    thread = Thread(
        target=copy_context().run, args=(read,), name="reading", daemon=True
    )  # a daemon: a pipe must not keep the program
    thread.start()
    try:
        while (received := blocks.get()) is not None:
            if isinstance(received, BaseException):
                raise received
            yield received
    finally:
        abandoned = True
        with suppress(Empty):  # so that a thread that waits for a place continues, and ends
            while True:
                blocks.get_nowait()
        thread.join(END_S)
