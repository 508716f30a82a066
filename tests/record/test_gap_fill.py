"""Laws of gap filling: every sample keeps its place, and every tick occurs once."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from imumon.grid.sample_clock import BREAK, PlacedSamples
from imumon.record.gap_fill import LONG_GAP, MOST_ROWS, Break, DenseBlock, LongGap, fill_gaps


@given(st.lists(st.sampled_from([1, 1, 1, 2, 5, LONG_GAP, LONG_GAP + 1, 10**9, BREAK]), max_size=60))
def test_ticks_and_samples_are_conserved(steps: list[int]) -> None:
    n = len(steps)
    placed = PlacedSamples(np.arange(n, dtype=float)[:, None], np.array(steps, dtype=np.int64), None)
    at, tick, ticks = [], 0, 0
    for part in fill_gaps(placed):
        if isinstance(part, DenseBlock):
            present = np.ones(len(part.values), dtype=bool) if part.present is None else part.present
            at += [(tick + int(i), float(part.values[i, 0])) for i in np.flatnonzero(present)]
            tick += len(present)
            ticks += len(present)
        elif isinstance(part, LongGap):
            tick += part.ticks
            ticks += part.ticks
        else:
            assert isinstance(part, Break)
    assert [value for _, value in at] == list(range(n))
    assert ticks == sum(1 if s == BREAK else s for s in steps)
    place = np.cumsum([1 if s == BREAK else s for s in steps]) - 1
    assert [p for p, _ in at] == place.tolist()


def test_many_short_gaps_make_no_long_block() -> None:
    steps = np.full(1 << 15, LONG_GAP)
    placed = PlacedSamples(np.zeros((len(steps), 1)), steps, None)
    lengths = [len(part.values) for part in fill_gaps(placed) if isinstance(part, DenseBlock)]
    assert sum(lengths) == len(steps) * LONG_GAP
    assert max(lengths) <= MOST_ROWS + LONG_GAP
