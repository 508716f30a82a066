"""Laws of a saved state: whatever an accumulator saves is valid, and each kind of damage is named."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from imumon.noise.blocks.block_means import BlockAccumulator
from imumon.noise.state_schema import InvalidState, Schema, count_field, float_field
from imumon.noise.statistics.differences import DifferenceAccumulator
from imumon.noise.statistics.envelope import Envelope
from imumon.noise.statistics.histogram import HistogramAccumulator
from imumon.noise.statistics.moments import Moments
from imumon.samples import Floats

GROUPS = [0, 0, 0, 1, 1, 2]

STREAMS: dict[str, Callable[[Floats], Floats]] = {
    "noise": lambda x: x,
    "bias": lambda x: 1e-3 * x + 9.81,
    "quantised": lambda x: np.round(x, 1),
    "zero": np.zeros_like,
    "constant": lambda x: np.full_like(x, 9.81),
    "huge": lambda x: 1e58 * x,
    "largest": lambda x: 9.9e59 * np.sign(x),
    "tiny": lambda x: 1e-200 * x,
    "random walk": lambda x: 1e6 + np.cumsum(x, axis=0),
    "spikes": lambda x: np.where(np.abs(x) > 3.0, 1e30 * x, x),
    "heavy tails": lambda x: np.exp(20.0 * x),
    "small beside its mean": lambda x: 1e9 + 1e-6 * x,
    "one step": lambda x: np.where(np.arange(len(x))[:, None] < len(x) // 2, 1.0, 1.0 + 2.0**-52) + 0.0 * x,
}


@pytest.mark.parametrize("kind", STREAMS)
@pytest.mark.parametrize("lost", [0.0, 0.3, 1.0])
def test_what_is_saved_is_valid(kind: str, lost: float) -> None:
    rng = np.random.default_rng(1)
    values = STREAMS[kind](rng.standard_normal((12_000, 6)))
    groups = np.array(GROUPS)
    moments, histogram, differences = (
        Moments(6, GROUPS),
        HistogramAccumulator(GROUPS),
        DifferenceAccumulator(GROUPS),
    )
    envelope, blocks = Envelope(GROUPS, 100.0), BlockAccumulator(GROUPS, 0.01)
    begin = 0
    while begin < len(values):
        part = values[begin : begin + int(rng.integers(1, 2000))].copy()
        begin += len(part)
        valid = rng.random((len(part), 3)) >= lost if lost else None
        if valid is not None:
            part[~valid[:, groups]] = rng.choice([np.nan, np.inf, 1e300, 0.0])
        for accumulator in (moments, histogram, differences, envelope):
            accumulator.update(part, valid)
        if valid is None:
            blocks.update(part.T.copy(), None, np.zeros(6))
        else:
            blocks.update(np.where(valid[:, groups], part, 0.0).T, valid.T.astype(float), np.zeros(6))
        if rng.random() < 0.2:
            differences.break_()
            blocks.break_()
            gap = int(rng.integers(1, 100_000))
            envelope.skip(gap)
            blocks.skip(gap)
        Moments(6, GROUPS).schema().check(moments.save())
        HistogramAccumulator(GROUPS).schema().check(histogram.save())
        DifferenceAccumulator(GROUPS).schema().check(differences.save())
        Envelope(GROUPS, 100.0).schema().check(envelope.save())
        BlockAccumulator(GROUPS, 0.01).schema().check(blocks.save())


SCHEMA = Schema(
    {"count": count_field("c"), "low": float_field("c"), "high": float_field("c")},
    (("a low above the high", lambda s: s["low"] <= s["high"]),),
    parts=lambda s: {f"part{number}.": Schema({"x": float_field()}) for number in range(int(s["count"][0]))},
    lengths={"c": 2},
)


def state(**changed: np.ndarray) -> dict[str, np.ndarray]:
    arrays = {
        "count": np.array([1]),
        "low": np.array([0.0]),
        "high": np.array([1.0]),
        "part0.x": np.array(0.0),
    }
    return {**arrays, **changed}


def test_a_valid_state_passes() -> None:
    SCHEMA.check(state())


@pytest.mark.parametrize(
    ("damaged", "reason"),
    [
        ({"count": np.array([-1])}, "count has -1, below 0"),
        ({"count": np.array([1.0])}, "count is of type float64"),
        ({"count": np.array(1)}, "count has 0 dimensions"),
        ({"count": np.array([1, 1])}, "low has the shape"),
        (
            {"low": np.zeros(3), "high": np.zeros(3), "count": np.ones(3, int)},
            "count has 3 entries, more than 2",
        ),
        ({"low": np.array([np.nan])}, "low has a number that is unknown"),
        ({"high": np.array([np.inf])}, "high has a number that is infinite"),
        ({"high": np.array([1e61])}, "above 1e[+]60"),
        ({"low": np.array([2.0])}, "a low above the high"),
        ({"other": np.array(0.0)}, "other is not known"),
        ({"part1.x": np.array(0.0)}, "part1.x is not known"),
        ({"part0.y": np.array(0.0)}, "part0.y is not known"),
        ({"count": np.array([2])}, "part1.x is missing"),
        ({"part0.x": np.array(-1e70)}, "part0.x has -1e[+]70"),
    ],
)
def test_each_damage_is_named(damaged: dict[str, np.ndarray], reason: str) -> None:
    with pytest.raises(InvalidState, match=reason):
        SCHEMA.check(state(**damaged))
