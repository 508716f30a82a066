"""Laws of the sample clock."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from cases import case
from hypothesis import given
from hypothesis import strategies as st

from imumon.grid.sample_clock import BREAK, PlacedSamples, SampleClock
from imumon.model.samples import GYRO, SampleBlock, Stream

TICK = 25_000_000  # ns at 40 Hz
LOOP_S = 1.0 / 800.0  # s, tick of a device whose intervals are multiples of one


def block(
    times: list[int] | np.ndarray, clock: str = "startup", lost: list[int] | None = None
) -> SampleBlock:
    time = np.asarray(times, dtype=np.int64)
    stream = Stream("uncompensated", GYRO, "test", clock)  # type: ignore[arg-type]
    values = np.arange(len(time), dtype=float)[:, None] * np.ones(3)
    gone = np.zeros(len(time), dtype=np.int64) if lost is None else np.array(lost)
    return SampleBlock(stream, values, None if clock == "none" else time, gone)


def place(
    clock: SampleClock, whole: SampleBlock, cuts: list[int] | None = None
) -> tuple[list[int], list[float]]:
    edges = [0, *sorted(cuts or []), len(whole)]
    out: list[PlacedSamples] = []
    for a, b in pairwise(edges):
        time = None if whole.time_ns is None else whole.time_ns[a:b]
        out += clock.place(SampleBlock(whole.stream, whole.values[a:b], time, whole.lost[a:b]))
    out += clock.finish()
    steps = [int(s) for p in out for s in p.steps]
    return steps, [float(v) for p in out for v in p.values[:, 0]]


def after(steps: list[int]) -> np.ndarray:
    """Return ticks with these steps between them, the first of which leads to the first tick."""
    return np.cumsum(steps)


KNOWN = ("startup", 0.025)
STREAMS: dict[str, tuple[tuple[object, ...], np.ndarray, list[int], float]] = {
    "regular": (("startup",), np.arange(100) * TICK + 7, [1] * 100, 0.025),
    "coarse stamps": (("startup",), np.arange(200) * 6.25 // 1 * 1e6, [1] * 200, 0.00625),
    "gaps": (KNOWN, after([1, 1, 1, 3, 1, 994, 1]) * TICK, [1, 1, 1, 3, 1, 994, 1], 0.025),
    "longer than plausible": (KNOWN, after([1, 1, 1, 399_998, 1]) * TICK, [1, 1, 1, 399_998, 1], 0.025),
    "restart": (
        KNOWN, np.append(np.arange(10) + 5000, np.arange(10) + 3) * TICK, [1] * 10 + [BREAK] + [1] * 9, 0.025,
    ),
    "loop ticks": (
        ("counter", None, LOOP_S), np.delete(np.arange(100) * 20 + 543, [50, 51]), [1] * 50 + [3] + [1] * 47, 0.025,
    ),
    "count of 32 bits": (
        ("counter",), (np.arange(200) * 25_000 + (1 << 32) - 90 * 25_000) % (1 << 32), [1] * 200, 0.025,
    ),
    "intervals": (("dt",), np.where(np.arange(60) == 40, 3, 1) * 10_000_000, [1] * 40 + [3] + [1] * 19, 0.01),
    **{
        f"lossy start {pattern}": (("startup",), after(pattern * 20) * TICK, [1, *(pattern * 20)[1:]], 0.025)
        for pattern in ([2, 1, 2, 2], [2, 2, 2, 1], [1, 5, 1, 9])
    },
    "a restart whose second sample has the last time": (
        KNOWN, np.append(np.arange(50), np.arange(48, 98)) * TICK, [1] * 50 + [BREAK] + [1] * 49, 0.025,
    ),
    "a duplicate": (KNOWN, np.array([0, 1, 1, 2, 3]) * TICK, [1] * 4, 0.025),
    "every other lost": (KNOWN, after([2] * 40 + [1] * 40) * TICK, [1] + [2] * 39 + [1] * 40, 0.025),
}  # fmt: skip
"""By name: words of the clock, stamps, steps, and the interval in s."""


@pytest.mark.parametrize("name", STREAMS)
def test_a_stream_has_its_interval_and_loses_nothing_unseen(name: str) -> None:
    words, times, steps, interval_s = STREAMS[name]
    for cuts in ([], [len(times) // 3, len(times) // 2]):
        clock = SampleClock(*words)  # type: ignore[arg-type]
        placed, values = place(clock, block(times, str(words[0])), cuts)
        assert placed == steps
        assert len(values) == len(set(values)) == len(times) - clock.duplicates
        assert (clock.duplicates, clock.out_of_order) == (int(name == "a duplicate"), 0)
        assert clock.interval_s == pytest.approx(interval_s, rel=1e-6)


def test_samples_out_of_order_give_the_right_interval() -> None:
    clock = SampleClock("startup")
    place(clock, block(np.arange(60).reshape(-1, 2)[:, ::-1].ravel() * TICK))
    assert clock.interval_s == 0.025


@pytest.mark.parametrize("bad", [10**15, 0, 5 * TICK, 99 * TICK + 10**9 * 100])
def test_a_damaged_stamp_does_not_change_the_grid(bad: int) -> None:
    times = (np.arange(50) + 100) * TICK
    times[20] = bad
    clock = SampleClock("startup", 0.025)
    steps, values = place(clock, block(times))
    assert 20.0 not in values
    assert steps == [1] * 20 + [2] + [1] * 28
    assert (clock.out_of_order, clock.wrong_times) == ((1, 0) if bad < times[19] else (0, 1))


@pytest.mark.few
@pytest.mark.parametrize("step_ns", [1, 10**14])
def test_samples_whose_time_has_another_unit_are_excluded_and_counted(step_ns: int) -> None:
    """They show a rate of no sensor, and it would size the frames of the guard."""
    clock = SampleClock("startup")
    steps, _ = place(clock, block(step_ns * np.arange(2000)))
    assert (clock.interval_s, steps) == (None, [])
    assert clock.wrong_times + clock.held == 2000
    assert clock.impossible_hz == pytest.approx(1e9 / step_ns)
    assert place(clock, block(2000 * step_ns + TICK * np.arange(100)))[0][-99:] == [1] * 99


def test_without_a_clock_damaged_messages_are_lost_ticks() -> None:
    clock = SampleClock("none", 0.025)
    steps, _ = place(clock, block([0] * 4, "none", [0, 0, 2, 0]))
    assert steps == [1, 1, 3, 1]
    clock.gap()
    steps, _ = place(clock, block([0] * 2, "none", [0, 0]))
    assert steps == [BREAK, 1]


def test_no_clock_and_no_rate_is_refused() -> None:
    with pytest.raises(ValueError, match="rate"):
        SampleClock("none")


def test_a_restored_clock_continues() -> None:
    clock = SampleClock("startup")
    place(clock, block(np.arange(100) * TICK))
    restored = SampleClock.restore("startup", clock.save())
    steps, _ = place(restored, block((np.arange(10) + 500) * TICK))
    assert steps == [401] + [1] * 9
    assert restored.interval_s == clock.interval_s


@pytest.mark.parametrize(("length_s", "step"), [(10.0, 401), (60.0, BREAK), (None, 401)])
def test_gap_that_another_clock_contradicts_is_of_unknown_length(length_s: float | None, step: int) -> None:
    clock = SampleClock("startup", 0.025)
    place(clock, block(np.arange(100) * TICK))
    clock.gap(length_s)
    steps, _ = place(clock, block((np.arange(10) + 500) * TICK))
    assert steps == [step] + [1] * 9


@pytest.mark.parametrize("factor", [0.5, 0.625, 0.8, 0.875, 1.04, 1.25, 4 / 3, 1.5, 1.6, 2.0, 2.5, 3.0])
def test_another_rate_is_detected_and_its_samples_are_separated(factor: float) -> None:
    for cuts in ([], [190, 230, 231], list(range(0, 600, 7))):
        with case(cuts):
            steps = np.concatenate([np.ones(200), np.full(400, factor)])
            whole = block((np.cumsum(steps) * TICK).astype(np.int64))
            clock = SampleClock("startup")
            placed, kept = [], 0
            edges = [0, *cuts, 600]
            for a, b in pairwise(edges):
                if clock.rest is None:
                    placed += clock.place(
                        SampleBlock(whole.stream, whole.values[a:b], whole.time_ns[a:b], whole.lost[a:b])
                    )
                    kept = b
            assert kept - len(clock.rest) == 263  # 64 equal steps in a row, wherever the cuts are


def test_jitter_and_losses_are_no_other_rate() -> None:
    rng = np.random.default_rng(11)
    kept = np.flatnonzero(rng.random(100_000) > 0.3)
    clock = SampleClock("startup", 0.025)
    place(clock, block((kept + rng.uniform(-0.2, 0.2, len(kept))) * TICK))
    assert clock.rest is None


def test_a_clock_that_stops_needs_no_memory_and_is_learned_when_it_runs() -> None:
    clock = SampleClock("startup", 0.025)
    for count in range(40, 2001, 40):
        assert not clock.place(block(np.full(40, 7 * TICK)))
        assert count - clock.duplicates <= 40
    steps, _ = place(clock, block((np.arange(100) + 8) * TICK))
    assert steps == [1] * 101  # the last one of the stopped clock, and those after it
    assert clock.interval_s == 0.025
    assert clock.duplicates == 50 * 40 - 1


@pytest.mark.few
@pytest.mark.parametrize("away_s", [5.0, 70.0, 6000.0])
def test_the_gap_of_a_restart_has_a_known_length(away_s: float) -> None:
    clock = SampleClock("startup", 0.025)
    place(clock, block(np.arange(100) * TICK))
    restored = SampleClock.restore("startup", clock.save())
    restored.gap(away_s)
    gap = round(away_s / 0.025)
    out = restored.place(block((np.arange(10) + 99 + gap) * TICK), host_s=0.0)
    assert [int(s) for p in out for s in p.steps] == [gap] + [1] * 9


def test_a_jump_of_the_last_sample_is_no_gap_of_known_length() -> None:
    clock = SampleClock("startup", 0.025)
    clock.place(block(np.append(np.arange(100), 20 * 86400 * 40) * TICK), host_s=2.5)
    [last] = clock.finish()
    assert last.steps.tolist() == [BREAK]


def test_a_jump_that_the_host_clock_does_not_confirm_is_no_gap() -> None:
    clock = SampleClock("startup", 0.025)
    out = clock.place(block(np.arange(100) * TICK), host_s=2.5)
    out += clock.place(block((np.arange(100) + 100 + 144_000) * TICK), host_s=2.5)
    assert [int(s) for p in out for s in p.steps] == [1] * 100 + [BREAK] + [1] * 99


@pytest.mark.parametrize("blocks", [1, 3])
def test_the_gap_of_a_pause_is_known_if_older_samples_come_first(blocks: int) -> None:
    clock = SampleClock("startup", 0.025)
    out = clock.place(block(np.arange(100) * TICK), host_s=2.5)
    for k in range(blocks):
        old = np.arange(100) + 100 * (k + 1)
        out += clock.place(block(old * TICK), host_s=0.0 if k else 3600.0)
    out += clock.place(block((np.arange(100) + 144_000) * TICK), host_s=0.2)
    gap = 144_000 - 100 * (blocks + 1) + 1
    assert [int(s) for p in out for s in p.steps] == [1] * 100 * (blocks + 1) + [gap] + [1] * 99
    out = clock.place(block((np.arange(100) + 288_000) * TICK), host_s=2.5)
    assert out[0].steps[0] == BREAK, "time that samples account for is not open again"


# ---------------------------------------------------------------- clocks without a tick

RATES = [101.0, 810.0, 416.0, 104.0, 199.9]
JITTER = {
    "none": lambda rng, n: np.zeros(n),
    "uniform": lambda rng, n: rng.uniform(-0.1, 0.1, n),
    "normal": lambda rng, n: np.clip(rng.normal(0.0, 0.1, n), -0.4, 0.4),
}
"""Deviation of n time stamps from their grid, in ticks."""


def stamps(rate: float, jitter: str, n: int, seed: int = 1) -> np.ndarray:
    """Return (n,) ns, strictly increasing time stamps of a clock of this rate."""
    ticks = np.arange(n) + JITTER[jitter](np.random.default_rng(seed), n)
    return np.rint(np.sort(ticks) / rate * 1e9).astype(np.int64) + 10**12


@pytest.mark.few
@pytest.mark.parametrize("jitter", JITTER)
@pytest.mark.parametrize("nominal", [None, 1.0, 1.009])
def test_a_clock_without_a_tick_has_its_own_rate(jitter: str, nominal: float | None) -> None:
    for rate, size in [*((rate, 5000) for rate in RATES), (101.0, 1), (199.9, 7)]:
        with case((rate, size)):
            clock = SampleClock("startup", None if nominal is None else nominal / rate)
            count = min(5000, 1000 * size)
            steps, _ = place(clock, block(stamps(rate, jitter, count)), list(range(size, count, size)))
            assert clock.interval_s * rate == pytest.approx(1.0, rel=1e-7 if jitter == "none" else 5e-4)
            assert steps == [1] * count


@pytest.mark.few
@pytest.mark.parametrize("jitter", JITTER)
def test_the_learned_rate_has_no_bias(jitter: str) -> None:
    errors = []
    for seed in range(60):
        clock = SampleClock("startup")
        place(clock, block(stamps(101.3, jitter, 1100, seed)))
        errors.append(clock.interval_s * 101.3 - 1.0)
    spread = max(float(np.std(errors)), 1e-9)
    assert abs(np.mean(errors)) < 4.0 * spread / np.sqrt(len(errors))
    assert spread < 2e-4


@pytest.mark.few
@pytest.mark.parametrize("rate", [104.0, 97.3, 99.5, 208.0])
def test_stamps_rounded_to_a_millisecond_do_not_make_the_interval_a_multiple_of_it(rate: float) -> None:
    clock = SampleClock("startup", tick_s=1e-3)
    stamps = np.floor(np.arange(3000) / rate * 1e3).astype(np.int64) * 1_000_000
    steps, _ = place(clock, block(stamps))
    assert clock.interval_s == pytest.approx(1.0 / rate, rel=1e-4)
    assert set(steps) == {1}


@pytest.mark.few
@pytest.mark.parametrize("rate", [100.0, 99.9, 101.0])
def test_a_clock_with_a_tick_has_a_multiple_of_it(rate: float) -> None:
    clock = SampleClock("startup", tick_s=LOOP_S)
    place(clock, block(stamps(rate, "none", 100)))
    assert clock.interval_s == 0.01


@pytest.mark.few
@pytest.mark.parametrize("jitter", JITTER)
def test_an_hour_of_jitter_and_drift_does_not_change_the_grid(jitter: str) -> None:
    n = 3600 * 101
    rng = np.random.default_rng(7)
    kept = rng.random(n) > 0.001
    kept[[0, -1]] = True
    times = stamps(101.0 * (1.0 + 20e-6), jitter, n)[kept]
    clock = SampleClock("startup")
    steps, values = place(clock, block(times), list(range(1000, len(times), 1000)))
    assert (clock.duplicates, clock.rest) == (0, None)
    assert len(values) == len(times)
    np.testing.assert_array_equal(np.cumsum(steps) - 1, np.flatnonzero(kept))


@given(
    st.lists(st.sampled_from([0, 1, 1, 1, 1, 1, 2, 7, 5000, -40, 10**7]), min_size=1, max_size=80),
    st.lists(st.floats(-0.45, 0.45), min_size=80, max_size=80),
    st.lists(st.integers(0, 80), max_size=6),
    st.booleans(),
)
def test_any_chunking_gives_the_same_grid_with_jitter(
    jumps: list[int], jitter: list[float], cuts: list[int], known: bool
) -> None:
    ticks = np.cumsum(jumps) + 10**6 + np.array(jitter[: len(jumps)])
    whole = block(np.rint(ticks * TICK).astype(np.int64))
    cuts = [c for c in cuts if c <= len(whole)]
    interval = 0.025 if known else None
    one, many = SampleClock("startup", interval), SampleClock("startup", interval)
    assert place(one, whole) == place(many, whole, cuts)
    assert one.duplicates == many.duplicates
