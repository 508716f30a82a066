"""Law of the guard: a record gives the same result, however its samples are split into blocks."""

from __future__ import annotations

import itertools

import numpy as np
from hypothesis import Phase, example, given, settings
from hypothesis import strategies as st
from placed import PlacedRecord

from imumon.grid.sample_clock import BREAK, PlacedSamples
from imumon.model.samples import ACCEL, GYRO, MAG, Floats, Ints

RATE = 20.0
ROWS = 4000
KINDS = ("knock", "glitch", "tail", "motion", "stuck", "clipped", "tilt", "gap", "long gap", "break")


def disturbed(kind: str, at: int, x: Floats, steps: Ints, saturated: np.ndarray) -> None:
    """Disturb a record in place from row `at` on."""
    rng = np.random.default_rng(at)
    if kind == "knock":
        x[at : at + 30, :6] += 20.0 * rng.standard_normal((30, 6))[: len(x) - at]
    elif kind == "glitch":
        x[at, at % 9] += 50.0
    elif kind == "tail":
        x[at : at + 1500, 1] *= np.where(rng.random(len(x[at : at + 1500])) < 0.05, 10.0, 1.0)
    elif kind == "motion":
        x[at : at + 900, :6] += np.cumsum(rng.standard_normal((len(x[at : at + 900]), 6)), axis=0)
    elif kind == "stuck":
        x[at : at + 300] = x[at]
    elif kind == "clipped":
        saturated[at : at + 3] = True
    elif kind == "tilt":
        x[at:, 4] += 40.0
    else:
        steps[at] = {"gap": 5, "long gap": 700, "break": BREAK}[kind]


def record(events: list[tuple[str, int]], repeats: int) -> PlacedSamples:
    """Return samples in units of the noise, magnetometer repeated, with disturbances."""
    x = np.random.default_rng(1).standard_normal((ROWS, 9))
    x[:, 6:] = x[::repeats, 6:].repeat(repeats, axis=0)[:ROWS]
    x[:, 4] = np.rint(x[:, 4])
    steps, saturated = np.ones(ROWS, dtype=np.int64), np.zeros(ROWS, dtype=bool)
    for kind, at in events:
        disturbed(kind, at, x, steps, saturated)
    return PlacedSamples(x * np.array([1e-4] * 3 + [3e-3] * 3 + [1e-3] * 3), steps, saturated)


def result(placed: PlacedSamples, edges: list[int]) -> tuple[list[object], list[Floats]]:
    """Return what must be equal, and what must be equal but for rounding."""
    channels = GYRO + ACCEL + MAG
    made = PlacedRecord(channels, RATE)
    record, happened = made.record, []
    for begin, end in itertools.pairwise([0, *edges, ROWS]):
        if end > begin:
            made.feed(placed.values[begin:end], placed.steps[begin:end], placed.saturated[begin:end])
            happened += record.events()
    record.flush()
    happened += record.events()
    happened = [event for event in happened if event.kind in ("disturbance", "rest", "motion", "stuck")]
    happened.sort(key=lambda e: (e.elapsed_s, e.kind, e.text))
    curve, moments, counts = record.sums.curve(), record.sums.moments(), record.counts()
    exact = [
        [(e.kind, e.elapsed_s, e.length_s, e.channel) for e in happened],
        counts.excluded,
        counts.disturbances,
        counts.at_rest,
        curve.terms.tolist(),
        [(m.count, m.min, m.max, m.last) for m in moments.channels],
        [s.counts for s in record.sums.histogram.result() if s is not None],
    ]
    sizes = np.array([e.size or 0.0 for e in happened])
    rounded = [sizes, curve.sigma, np.array([[m.mean, m.std] for m in moments.channels], dtype=float)]
    return exact, rounded


@example([("motion", 1500)], list(range(1, ROWS)), 3)  # single samples
@example([("gap", 496), ("long gap", 391), ("clipped", 232), ("motion", 443)], [541, 536, 541, 102, 496], 3)
@settings(max_examples=15, phases=(Phase.explicit, Phase.reuse, Phase.generate))
@given(
    st.lists(st.tuples(st.sampled_from(KINDS), st.integers(0, ROWS - 1)), max_size=5),
    st.lists(st.integers(1, ROWS - 1), max_size=40),
    st.sampled_from([1, 3]),
)
def test_any_blocks_give_the_same_result(
    events: list[tuple[str, int]], edges: list[int], repeats: int
) -> None:
    placed = record(events, repeats)
    exact, rounded = result(placed, [])
    other, near = result(placed, sorted(edges))
    for one, two in zip(exact, other, strict=True):
        assert one == two
    for a, b in zip(rounded, near, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-15)
