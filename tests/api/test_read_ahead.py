"""Reading ahead: everything in order, errors where they happen, and no thread that stays."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import closing

import pytest

from imumon.api.read_ahead import read_ahead
from imumon.model.samples import Gap, SampleBlock
from imumon.sources.files import Recording, RecordingError


class Counting(Recording):
    """A recording of gaps, 1 s, 2 s ..., whose progress is their number; it may fail."""

    def __init__(self, count: int, error: Exception | None = None) -> None:
        self.count, self.error, self.progress = count, error, 0.0

    def __iter__(self) -> Iterator[Sequence[SampleBlock | Gap]]:
        for k in range(1, self.count + 1):
            self.progress = float(k)
            yield [Gap(float(k))]
        if self.error is not None:
            raise self.error


def reading() -> bool:
    return any(thread.name == "reading" for thread in threading.enumerate())


def test_an_error_comes_behind_what_was_read_before() -> None:
    ahead = read_ahead(Counting(7, RecordingError("torn", "the tape is torn")))
    assert len([next(ahead) for _ in range(7)]) == 7
    with pytest.raises(RecordingError, match="torn"):
        next(ahead)


def test_the_thread_has_ended_when_the_work_on_its_samples_fails() -> None:
    """A thread inside a library in C++ when the interpreter ends aborts the process."""
    with closing(read_ahead(Counting(1000))) as ahead:
        next(ahead)
        assert reading()
    assert not reading()
