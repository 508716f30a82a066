"""Laws of parts: what is known since a marked place is what a record that begins there would know."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.model.samples import Floats
from imumon.noise.allan import AllanCurve, OctaveCascade
from imumon.noise.blocks.block_means import BLOCK
from imumon.noise.stretches.parts import Parts

RNG = np.random.default_rng(11)


def two_channels() -> Parts:
    return Parts([0, 0], [0, 1], 0.01)


def marked(values: Floats, place: int) -> Parts:
    """Return the parts of a record with a mark, at which a curve begins."""
    parts = two_channels()
    parts.update(values[:place])
    parts.mark(curve=True)
    parts.update(values[place:])
    return parts


def alone(values: Floats) -> OctaveCascade:
    cascade = OctaveCascade(2, 0.01)
    cascade.update(values)
    return cascade


def test_a_part_equals_a_cascade_that_begins_there() -> None:
    x = np.cumsum(RNG.normal(size=(40_000, 2)), axis=0) + 100.0
    curve = marked(x, 7 * BLOCK).curve(7 * BLOCK)
    expected = alone(x[7 * BLOCK :]).result()
    assert len(curve.m) == len(expected.m)
    assert curve.span == expected.span
    # at most one block of differences is missing at each octave, and none is added
    lost = expected.terms - curve.terms
    assert np.all(lost >= 0)
    assert np.all(lost <= BLOCK / expected.stride[:, None])
    np.testing.assert_allclose(curve.avar[:8], expected.avar[:8], rtol=0.05)


@settings(max_examples=25)
@given(st.lists(st.integers(1, 9_000), max_size=5), st.integers(0, 12_000))
def test_any_chunking_gives_the_same_part(cuts: list[int], place: int) -> None:
    x = np.random.default_rng(5).normal(size=(14_000, 2))
    curves: list[AllanCurve] = []
    for pieces in ([], cuts):
        parts, begin = two_channels(), 0
        for end in sorted({*(cut for cut in pieces if cut < 14_000), place, 14_000}):
            parts.update(x[begin:end])
            begin = end
            if end == place:
                parts.mark(curve=True)
        parts.mark(curve=True)  # at the place, or of no use
        curves.append(parts.curve(place))
    one, other = curves
    np.testing.assert_array_equal(one.terms, other.terms)
    np.testing.assert_array_equal(one.avar, other.avar)
    if place:  # the whole record is by bin
        assert one.sums.pooled
    np.testing.assert_array_equal(one.sums.blocks.means, other.sums.blocks.means)
    for level, same in zip(one.sums.levels, other.sums.levels, strict=True):
        np.testing.assert_array_equal(level.power, same.power)
        np.testing.assert_array_equal(level.averages, same.averages)


def test_the_parts_between_marks_add_up_to_the_record() -> None:
    x = RNG.normal(size=(30 * BLOCK + 77, 2))
    parts = two_channels()
    for begin in range(0, len(x), 10 * BLOCK):
        parts.update(x[begin : begin + 10 * BLOCK])
        parts.mark()
    places = ((0, 10 * BLOCK), (10 * BLOCK, 20 * BLOCK), (20 * BLOCK, 30 * BLOCK), (30 * BLOCK, None))
    each = [parts.sums(*ends) for ends in places]
    whole = parts.sums(0)
    for level, of_record in enumerate(whole.levels):
        np.testing.assert_allclose(sum(part.levels[level].power for part in each), of_record.power, rtol=1e-9)
        assert sum(int(part.levels[level].averages[0]) for part in each) == of_record.averages[0]
    np.testing.assert_array_equal(np.concatenate([part.blocks.means for part in each]), whole.blocks.means)
    counts = [parts.moments(*ends).result().channels[0].count for ends in places]
    assert sum(counts) == parts.moments().result().channels[0].count == len(x)


def test_the_sums_of_the_noise_of_a_part_are_those_of_a_cascade_that_begins_there() -> None:
    """Segments may begin up to a hop later, and the filters have a past; blocks lie on the grid of the record."""
    x, place = np.random.default_rng(7).normal(size=(60_000, 2)), 64 * BLOCK
    parts = marked(x, place)
    part, other = parts.sums(place), alone(x[place:]).result().sums
    assert part.pooled
    assert not other.pooled
    for level, (a, b) in enumerate(zip(part.levels, other.levels, strict=False)):
        assert abs(int(a.averages[0]) - int(b.averages[0])) <= 2
        if level < 3:
            np.testing.assert_allclose(a.power.sum(axis=1), b.power.sum(axis=1), rtol=0.05)
    whole = parts.cascade.blocks.result()
    first = -(-place // whole.length)
    np.testing.assert_array_equal(part.blocks.means, whole.means[first : first + len(part.blocks.means)])
