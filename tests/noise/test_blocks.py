"""Block means: bounded, the same for any chunking, and their cosine coefficients have the stated variances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.fft

from imumon.model.samples import Bools, Floats
from imumon.noise.blocks import BlockAccumulator, BlockMeans
from imumon.noise.power_law import cosine_variances

MOST = 16
NONE = np.zeros(2)


def array_bytes(blocks: BlockAccumulator) -> int:
    return sum(value.nbytes for value in vars(blocks).values() if isinstance(value, np.ndarray))


def accumulator(most: int = MOST) -> BlockAccumulator:
    return BlockAccumulator([0, 1], 0.5, most)


def feed(blocks: BlockAccumulator, values: Floats, valid: Bools | None = None) -> None:
    """Add (n, 2) values with their validity (n, 2)."""
    known = values if valid is None else np.where(valid, values, 0.0)
    weights = None if valid is None else np.ascontiguousarray(valid.T, dtype=np.float64)
    blocks.update(np.ascontiguousarray(known.T), weights, NONE)


def numbers(n: int, seed: int = 1) -> Floats:
    """Return (n, 2) whole numbers, whose sums are exact in any order."""
    return np.asarray(np.random.default_rng(seed).integers(-1000, 1000, (n, 2)), dtype=np.float64)


def same(one: BlockMeans, other: BlockMeans) -> None:
    for name in ("means", "share", "segment", "length", "interval_s", "offset"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


# --- the stream --------------------------------------------------------------------------------------------


def test_blocks_are_the_means_of_what_is_valid() -> None:
    values, valid = numbers(1000), np.random.default_rng(3).random((1000, 2)) >= 0.4
    for n in (15, 16, 17, 33, 100, 1000):
        blocks = accumulator()
        feed(blocks, values[:n], valid[:n])
        means = blocks.result()
        assert means.length == 1 << max(0, int(np.ceil(np.log2(n / MOST))))
        assert len(means.means) == n // means.length <= MOST
        for i, (row, share) in enumerate(zip(means.means, means.share, strict=True)):
            part = slice(i * means.length, min((i + 1) * means.length, n))
            for c in range(2):
                own = values[part, c][valid[part, c]]
                if len(own) >= 0.2 * means.length:
                    assert row[c] == own.mean()
                    assert share[c] == len(own) / means.length
                else:
                    assert np.isnan(row[c])
                    assert share[c] == 0.0


def test_joined_blocks_and_parts_are_means_over_the_same_samples() -> None:
    values, valid = numbers(64), np.random.default_rng(3).random((64, 2)) >= 0.3
    fine, coarse = accumulator(), accumulator(MOST // 2)
    for blocks in (fine, coarse):
        feed(blocks, values, valid)
    joined, whole = fine.result().joined(), coarse.result()
    assert np.isfinite(fine.result().means).all()
    np.testing.assert_allclose(joined.means, whole.means, rtol=1e-12)
    np.testing.assert_array_equal(joined.share, whole.share)
    assert joined.length == whole.length == 8
    beside = np.array(
        [[0.5, 0.3], [0.0, 0.0]]
    )  # a block and one without samples: 25 % and 15 % of both together
    pair = replace(
        whole, means=np.where(beside, 7.0, np.nan), share=beside, segment=np.zeros(2, dtype=np.int64)
    )
    np.testing.assert_array_equal(pair.joined().means, [[7.0, np.nan]])
    np.testing.assert_array_equal(whole.part(1, 31).means, whole.means[1:3])  # blocks that lie wholly within
    np.testing.assert_array_equal(whole.part(8, 32).share, whole.share[1:4])


def test_memory_is_bounded_and_a_gap_of_years_is_cheap() -> None:
    blocks = accumulator()
    feed(blocks, numbers(100))
    before = array_bytes(blocks)
    blocks.skip(10**12)
    feed(blocks, numbers(100))
    assert array_bytes(blocks) == before
    means = blocks.result()
    assert len(means.means) <= MOST
    assert means.length * MOST >= 10**12


def test_the_offset_of_a_segment_does_not_show() -> None:
    blocks = accumulator()
    for offset in (0.0, 512.0, -256.0):
        blocks.update(np.full((2, 4), 100.0 - offset), None, np.full(2, offset))
    means = blocks.result()
    np.testing.assert_array_equal(means.means, np.full((12, 2), 100.0))
    np.testing.assert_array_equal(means.offset, NONE)


# --- gaps of unknown length --------------------------------------------------------------------------------


def test_a_break_begins_a_segment_at_the_next_block() -> None:
    blocks = accumulator()
    feed(blocks, numbers(18))  # blocks of two samples
    blocks.break_()
    blocks.break_()
    feed(blocks, numbers(5, 2))
    means = blocks.result()
    np.testing.assert_array_equal(np.unique(means.segment).size, 2)
    np.testing.assert_array_equal(means.segment[:9], 0)
    assert (means.segment[9:] > 0).all()
    np.testing.assert_array_equal(means.means[9:11], numbers(5, 2)[:4].reshape(2, 2, 2).mean(axis=1))


def test_a_block_over_which_two_segments_meet_counts_as_missing() -> None:
    blocks = accumulator()
    feed(blocks, numbers(9))
    blocks.break_()
    feed(blocks, numbers(40, 2))
    means = blocks.result()
    assert means.length == 4
    np.testing.assert_array_equal(means.segment[:4], [0, 0, -1, 1])
    assert np.isnan(means.means[2]).all()
    assert not means.share[2].any()
    both = np.concatenate((numbers(9), numbers(40, 2)))
    np.testing.assert_array_equal(means.means[3:12], both[12:48].reshape(9, 4, 2).mean(axis=1))


@pytest.mark.few
@pytest.mark.parametrize(("n", "m"), [(5, 200), (200, 5), (100, 100), (16, 16), (7, 3)])
def test_appended_blocks_are_those_of_one_run_with_a_break(n: int, m: int) -> None:
    """Where their lengths differ, the blocks of the shorter record have joined; no sample is lost or moved."""
    one, a, b = accumulator(), accumulator(), accumulator()
    feed(one, numbers(n))
    one.break_()
    feed(one, numbers(m, 2))
    feed(a, numbers(n))
    feed(b, numbers(m, 2))
    untouched = b.result()
    a.append(b)
    same(b.result(), untouched)
    means, whole = a.result(), one.result()
    assert means.length == whole.length
    assert len(means.means) <= MOST
    begin = -(-n // means.length)
    for own, record in ((slice(0, begin), numbers(n)), (slice(begin, None), numbers(m, 2))):
        rows, segment = means.means[own], means.segment[own]
        assert len(rows) == (len(record) // means.length if own.start else begin)
        assert len(set(segment.tolist())) <= 1
        for i, row in enumerate(rows):
            samples = record[i * means.length : (i + 1) * means.length]
            if np.isfinite(row).all():
                np.testing.assert_allclose(row, samples.mean(axis=0), atol=1e-9)
            else:
                assert own.start == 0
                assert i == len(rows) - 1  # in which the first record ends
    assert (whole.segment < 0).sum() <= 1  # the one over which the two meet


# --- cosine coefficients -----------------------------------------------------------------------------------


def exact_variances(n: int) -> Floats:
    """Return (3, n - 1) the variances of the coefficients from the covariance of averages (Greenhall 1991)."""
    lag = np.arange(n + 1.0)
    out = [np.ones(n - 1)]
    for phase in (lag**2 * np.log(np.maximum(lag, 1.0)) / (2.0 * np.pi), lag**3 / 12.0):
        by_lag = 2.0 * phase[:-1] - phase[np.abs(np.arange(n) - 1)] - phase[1:]
        matrix = by_lag[np.abs(np.arange(n)[:, None] - np.arange(n))]
        for axis in (0, 1):
            matrix = scipy.fft.dct(matrix, axis=axis, norm="ortho")
        out.append(np.diag(matrix)[1:])
    return np.stack(out)


@pytest.mark.few
@pytest.mark.parametrize("n", [16, 23, 64, 256, 300, 1024])
def test_variances_agree_with_the_exact_covariance(n: int) -> None:
    """The edge of the highest coefficients of flicker is not modelled: 1.4 % of one of 15, less of more."""
    found, exact = cosine_variances(n), exact_variances(n)
    np.testing.assert_array_equal(found[0], 1.0)
    np.testing.assert_allclose(found[1], exact[1], rtol=0.22 / n + 0.002)
    np.testing.assert_allclose(found[2], exact[2], rtol=1e-5)
