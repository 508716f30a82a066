"""A record that is fed with the places of its samples on the grid, as its clock would find them."""

from __future__ import annotations

import copy

import numpy as np

from imumon.grid.sample_clock import BREAK
from imumon.model.samples import Bools, Floats, Ints, Kind, SampleBlock, Stream
from imumon.model.saved_state import pack, unpack
from imumon.record import Record, RecordOptions

MONTHS = 1 << 40
"""Samples, a gap that is longer than any of known length."""


class PlacedRecord:
    """A record of a stream without a clock: the lost samples say where each sample lies."""

    def __init__(
        self,
        channels: tuple[str, ...],
        rate_hz: float,
        *,
        kind: Kind = "deltas",
        options: RecordOptions | None = None,
    ) -> None:
        self.record = Record(options)
        self._stream = Stream(kind, channels, "made", "none", interval_s=1.0 / rate_hz)

    def feed(self, values: Floats, steps: Ints, saturated: Bools | None = None) -> None:
        lost = np.where(steps == BREAK, MONTHS, steps - 1)
        self.record.feed(SampleBlock(self._stream, values, None, lost, saturated))

    def saved(self) -> bytes:
        return pack(self.record.save())

    def restored(self) -> PlacedRecord:
        """Return the record as another process restores it, as if no time had passed between both."""
        again = copy.copy(self)
        again.record = Record(self.record.options)
        again.record.restore(unpack(self.saved()), 0.0)
        again.record.accept_restored()
        again.record.clock._unknown_gap = False
        return again
