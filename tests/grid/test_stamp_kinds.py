"""The decision which kind of stamps a stream has: one for streams and recordings."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.grid.stamp_kinds import CLOCK, KINDS, StampCandidate, decide, shows_rate
from imumon.model.samples import Ints

CLOCK_NS = 5_000_000 * np.arange(2000, dtype=np.int64)
RNG = np.random.default_rng(4)


def batches(ns: int) -> Ints:
    return -(-CLOCK_NS // ns) * ns


STAMPS = {
    "single_row": CLOCK_NS[:1],
    "time_descending": CLOCK_NS[::-1],
    "time_constant": np.zeros(2000, np.int64),
    "time_too_coarse": batches(2_000_000_000),
    "time_rate_impossible": np.arange(2000, dtype=np.int64),
    "clock": CLOCK_NS,
    "coarse": batches(2_000_000),
    "host": np.maximum.accumulate(CLOCK_NS + RNG.exponential(3e6, 2000).astype(np.int64)),
}
"""By the name of a kind: stamps of a sensor at 200 Hz."""


def test_each_kind_has_an_example() -> None:
    assert [kind.name for kind in KINDS] == list(STAMPS)


@pytest.mark.parametrize("name", STAMPS)
def test_stamps_are_of_the_first_kind_that_holds(name: str) -> None:
    decision = decide([StampCandidate(STAMPS[name])], 2e6 if name == "coarse" else 0.0)
    assert decision.kind.name == name
    assert (decision.interval is None) == (not decision.kind.has_rate)
    if decision.interval is not None:
        assert 1e9 / decision.interval == pytest.approx(200.0, rel=1e-3)


def test_the_first_candidate_that_shows_a_rate_is_used() -> None:
    nothing, constant = np.empty(0, np.int64), STAMPS["time_constant"]
    decision = decide([StampCandidate(times) for times in (nothing, constant, CLOCK_NS, STAMPS["host"])])
    assert (decision.candidate, decision.kind) == (2, CLOCK)
    assert [kind.name for kind in decision.refused] == ["single_row", "time_constant"]
    decision = decide([StampCandidate(constant), StampCandidate(nothing)])
    assert (decision.candidate, decision.kind.name, decision.interval) == (0, "time_constant", None)


def test_times_of_a_host_are_never_those_of_a_sample_clock() -> None:
    assert decide([StampCandidate(CLOCK_NS, of_sensor=False)]).kind.name == "host"


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e12])
def test_whether_times_show_a_rate_does_not_depend_on_their_unit(scale: float) -> None:
    for name, times in STAMPS.items():
        few = ("single_row", "time_descending", "time_constant", "time_too_coarse")
        assert shows_rate(times * scale) == (name not in few)


@pytest.mark.parametrize("name", STAMPS)
def test_every_row_gets_a_place(name: str) -> None:
    stamps = STAMPS[name]
    placer = decide([StampCandidate(stamps)]).placer(stamps)
    placed = placer.place(stamps, np.zeros(len(stamps), np.int64)).then(placer.release())
    assert len(placed.times) == len(placed.steps) == len(stamps)
    assert placed.steps[0] == 1
    assert int(placed.steps.min()) >= 1
