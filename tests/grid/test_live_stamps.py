"""Live stamps: samples that arrive with stamps of any quality get a place on one grid, and single late ones too."""

from __future__ import annotations

import gzip
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from paths import RECORDINGS, needs_recordings

from imumon.grid.live_stamps import CHECK_ROWS, LiveStamps
from imumon.grid.sample_clock import BREAK, PlacedSamples, SampleClock
from imumon.grid.stamp_kinds import CLOCK, KINDS, StampCandidate, decide, shows_rate
from imumon.grid.stamp_placement import LateStamps
from imumon.model.samples import Ints, SampleBlock, Stream

STREAM = Stream("unknown", ("gyro/x",), "test", "startup")
UNIX_NS = 1_700_000_000_000_000_000
RATE_HZ = 200.0
SECONDS = 60.0


@dataclass
class Placed:
    """What the sample clock makes of a record."""

    samples: int = 0
    missing: int = 0
    duplicates: int = 0
    restarts: int = 0  # breaks, and changes of the rate


def measure(
    stamps: Ints, published: Ints | None = None, lost: Ints | None = None, chunk: int = 40
) -> tuple[Placed, float, LiveStamps]:
    """Counters, rate and stamps of a record that arrives in chunks."""
    live, clock, total, done = LiveStamps(), SampleClock("startup"), Placed(), 0
    published = stamps if published is None else published
    lost = np.zeros(len(stamps), np.int64) if lost is None else lost
    placed: list[PlacedSamples] = []

    def count(placed: list[PlacedSamples]) -> None:
        for part in placed:
            total.samples += len(part.steps)
            total.missing += int((part.steps[part.steps > 1] - 1).sum())
            total.restarts += int((part.steps == BREAK).sum())

    for begin in range(0, len(stamps), chunk):
        rows = slice(begin, begin + chunk)
        final = begin + chunk >= len(stamps)
        times = live.place(stamps[rows], published[rows], published[rows], lost[rows], final=final).times
        done += len(times)
        block = SampleBlock(STREAM, np.zeros((len(times), 1)), times, np.zeros(len(times), np.int64))
        placed = clock.place(block) if len(times) else []
        count(placed)
        while (rest := clock.rest) is not None:
            total.duplicates += clock.duplicates
            total.restarts += 1
            clock = SampleClock("startup")
            count(clock.place(rest))
    count(clock.finish())
    total.duplicates += clock.duplicates
    assert done == len(stamps)
    return total, 1.0 / clock.interval_s, live


def grid(rate_hz: float = RATE_HZ, seconds: float = SECONDS) -> Ints:
    return UNIX_NS + np.rint(np.arange(int(seconds * rate_hz)) * 1e9 / rate_hz).astype(np.int64)


def bunched(stamps: Ints, batch_ms: float) -> Ints:
    """Return the stamps of a bus that delivers batches."""
    batch = round(batch_ms * 1e6)
    return -(-stamps // batch) * batch


def late() -> Ints:
    """Return stamps each of which is late by another delay, and some by much."""
    random, true = np.random.default_rng(2), grid()
    delay = random.exponential(3e6, len(true)).astype(np.int64)
    delay[random.random(len(true)) < 0.003] += 80_000_000
    return np.maximum.accumulate(true + delay)


def set_clock(step_s: int) -> Ints:
    stamps = bunched(grid(), 16.0)
    stamps[6000:] += step_s * 10**9
    return stamps


@dataclass
class Arrived:
    """Stamps of a stream, and what must be counted: how many are missing, up to a tolerance, and given twice."""

    stamps: Ints
    missing: int = 0
    tolerance: int = 0
    duplicates: int = 0
    restarts: int = 0
    rate_hz: float = RATE_HZ
    lost: Ints | None = None
    from_clock: bool = False


KEPT = np.delete(np.arange(12_000), np.arange(3000, 11_000, 400))
ARRIVED = {
    "sample clock": Arrived(np.delete(grid(), [1000, 2000, 2001]), missing=3, from_clock=True),
    "sorted duplicates": Arrived(
        np.sort(np.append(grid(), grid()[5000:5010])), duplicates=10, from_clock=True
    ),
    "late": Arrived(late(), tolerance=2),
    "gap between batches": Arrived(
        np.delete(bunched(grid(), 16.0), np.arange(6000, 6200)), missing=200, tolerance=3
    ),
    # one lost message in a batch does not show in its stamp; the sequence number tells
    "known losses": Arrived(
        bunched(grid(), 40.0)[KEPT], missing=20, tolerance=1, lost=np.diff(KEPT, prepend=-1) - 1
    ),
    "clock set forwards": Arrived(set_clock(3600), missing=3600 * round(RATE_HZ)),
    "clock set back": Arrived(set_clock(-3600), restarts=1),
    **{
        f"batches of {batch_ms:g} ms at {rate_hz:g} Hz": Arrived(
            bunched(grid(rate_hz), batch_ms), rate_hz=rate_hz
        )
        for rate_hz, batch_ms in ((50.0, 60.0), (200.0, 16.0), (200.0, 60.0), (1000.0, 16.0))
    },
}


@pytest.mark.parametrize("name", ARRIVED)
def test_every_sample_counts_none_is_invented_and_the_rate_is_right(name: str) -> None:
    arrived = ARRIVED[name]
    session, rate, live = measure(arrived.stamps, lost=arrived.lost)
    assert session.samples + session.duplicates == len(arrived.stamps)
    assert session.missing == pytest.approx(arrived.missing, abs=arrived.tolerance)
    assert (session.duplicates, session.restarts) == (arrived.duplicates, arrived.restarts)
    assert rate == pytest.approx(arrived.rate_hz, rel=1e-12 if arrived.from_clock else 5e-4)
    assert (live.remark is None) == arrived.from_clock


@pytest.mark.few
@pytest.mark.parametrize("share", [0.07, 0.15, 0.3])
@pytest.mark.parametrize("jitter", [0.04, 0.2])
def test_losses_in_every_window_do_not_change_the_rate(share: float, jitter: float) -> None:
    """Of a host, with samples that are often lost: no second is complete, and single steps show the interval."""
    random, true = np.random.default_rng(8), grid()
    late = jitter * 1e9 / RATE_HZ * random.uniform(0.0, 1.0, len(true))
    received = random.random(len(true)) >= share
    received[[0, -1]] = True
    total, rate, live = measure((true + np.rint(late).astype(np.int64))[received])
    assert rate == pytest.approx(RATE_HZ, rel=2e-4)
    # the rows of the last second have none behind them that could say whether they are late
    last_second = 2.0 * share * RATE_HZ
    assert total.missing == pytest.approx(int((~received).sum()), abs=last_second)
    assert total.restarts == 0
    assert live.decided


@pytest.mark.parametrize("wrong", [0, UNIX_NS + 200 * 10**9, 4_000_000_000 * 10**9])
@pytest.mark.parametrize("batch_ns", [1, 16_000_000])
def test_single_wrong_stamps_do_no_harm(wrong: int, batch_ns: int) -> None:
    true = grid()
    stamps = bunched(true, 1e-6 * batch_ns)
    stamps[[400, 7000, 9000]] = wrong
    session, rate, _ = measure(stamps, true)
    assert session.samples >= len(stamps) - 3
    assert session.samples + session.missing == len(stamps)
    assert session.restarts == 0
    assert rate == pytest.approx(RATE_HZ, rel=5e-4)


@pytest.mark.parametrize("batch_ns", [1, 40_000_000])
def test_another_rate_begins_another_record(batch_ns: int) -> None:
    first = grid(200.0, 60.0)
    second = first[-1] + 12_500_000 * np.arange(1, 12001)
    stamps = -(-np.concatenate([first, second]) // batch_ns) * batch_ns
    session, rate, _ = measure(stamps)
    assert rate == pytest.approx(80.0, rel=1e-3)
    assert session.restarts == 1


def test_two_checks_show_another_rate_of_a_host_and_the_drift_of_a_clock() -> None:
    for batch_ns, ratio in ((16_000_000, 2.5), (1, 1.0003)):
        live, step = LiveStamps(), 1e9 / RATE_HZ
        steps = np.concatenate([np.full(4 * CHECK_ROWS, step), np.full(2 * CHECK_ROWS, ratio * step)])
        stamps = -(-(UNIX_NS + np.cumsum(steps).astype(np.int64)) // batch_ns) * batch_ns
        for begin in range(0, len(stamps), CHECK_ROWS):
            rows = stamps[begin : begin + CHECK_ROWS]
            live.place(rows, rows, rows, np.zeros(len(rows), np.int64))
        assert live._placer.interval == pytest.approx(ratio * step, rel=1e-5)


@pytest.mark.few
@pytest.mark.parametrize("count", [0, 1, 2, 5])
def test_a_short_stream_is_returned_at_its_end(count: int) -> None:
    live = LiveStamps()
    stamps = grid()[:count]
    nothing = np.zeros(count, np.int64)
    assert not len(live.place(stamps, stamps, stamps, nothing))
    rest = live.place(stamps[:0], stamps[:0], stamps[:0], nothing[:0], final=True)
    assert rest.times.tolist() == stamps.tolist()


# ---------------------------------------- single late stamps of an even clock


STEP = 5_000_000


def placed(stamps: Ints, lost: Ints | None = None, chunk: int = 1 << 20) -> Ints:
    """Times of a record that arrives in chunks."""
    late = LateStamps(STEP)
    lost = np.zeros(len(stamps), np.int64) if lost is None else lost
    parts = [slice(begin, begin + chunk) for begin in range(0, len(stamps), chunk)]
    rows = [late.place(stamps[part], lost[part]) for part in parts]
    nothing = np.empty(0, np.int64)
    rows.append(late.place(nothing, nothing, final=True))
    steps = np.concatenate([some.steps for some in rows])
    times = np.concatenate([some.times for some in rows])
    np.testing.assert_array_equal(steps[1:], np.maximum(1, np.rint(np.diff(times) / STEP)))
    return times


def even_stamps(count: int = 1000) -> Ints:
    return np.arange(count, dtype=np.int64) * STEP


def test_stamps_that_are_not_late_are_used_as_they_are() -> None:
    """In time, with gaps, single wrong ones, and another rate."""
    even, shake = even_stamps(), np.random.default_rng(1).integers(-STEP // 10, STEP // 10, 1000)
    wrong = (4_000_000_000 * 10**9, 800 * STEP, 0, -(10**18))
    for stamps in (
        even + shake,
        np.delete(even, [100, 200, 201, *range(300, 700)]),
        *(np.where(np.arange(1000) == 500, stamp, even) for stamp in wrong),
        *(np.append(even, even[-1] + np.arange(1, 1001) * step) for step in (2 * STEP, STEP // 2)),
    ):
        np.testing.assert_array_equal(placed(stamps), stamps)


@pytest.mark.few
@pytest.mark.parametrize("delay", [0.4, 0.9, 1.3, 30.0, 150.0])
def test_late_rows_are_placed_where_they_belong(delay: float) -> None:
    """A host that is busy stamps some rows when it is free again, one shortly after the other."""
    stamps = even_stamps()
    free = stamps[500] + round(delay * STEP)
    stamps[500:] = np.maximum(stamps[500:], free + np.arange(500) * 20_000)
    np.testing.assert_allclose(placed(stamps), even_stamps(), atol=STEP * 0.25)


def test_late_rows_behind_a_loss_leave_the_loss() -> None:
    stamps = np.delete(even_stamps(), [500, 501])
    stamps[500] += STEP * 0.9
    np.testing.assert_array_equal(placed(stamps), np.delete(even_stamps(), [500, 501]))


def test_a_known_loss_explains_a_long_step_at_once() -> None:
    stamps, late = np.delete(even_stamps(100), [50]), LateStamps(STEP)
    lost = np.diff(stamps, prepend=-STEP) // STEP - 1
    assert len(late.place(stamps[:60], lost[:60])) == 60
    unknown = LateStamps(STEP)
    assert len(unknown.place(stamps[:60], 0 * lost[:60])) == 50


@given(st.data())
def test_any_stamps_have_a_time_whatever_the_blocks(data: st.DataObject) -> None:
    steps = st.sampled_from(
        [STEP, STEP, STEP, STEP, 2 * STEP, 9 * STEP, STEP // 3, STEP // 99, 0, -STEP, 10**17]
    )
    stamps = np.cumsum(np.array(data.draw(st.lists(steps, max_size=300)), np.int64))
    lost = np.array(
        data.draw(st.lists(st.sampled_from([0, 0, 0, 1, 8]), min_size=300, max_size=300)), np.int64
    )
    lost = lost[: len(stamps)]
    whole = placed(stamps, lost)
    assert len(whole) == len(stamps)
    for chunk in (1, data.draw(st.integers(2, 99))):
        np.testing.assert_array_equal(placed(stamps, lost, chunk), whole)


REAL = [
    ("kiran_stat5min", 1),
    ("kiran_stat5min", 2),
    ("fc_cal_square", 2),
    ("fc_drive_circle", 1),
    ("fc_drive_circle", 2),
    ("sahq_parked", 1),
    ("sahq_drive_circles", 2),
]


@pytest.mark.few
@needs_recordings
@pytest.mark.parametrize(("name", "column"), REAL)
def test_real_stamps_of_hosts_lose_nothing(name: str, column: int) -> None:
    """A sensor at 40 Hz, of which no sample is lost, stamped by drivers and by recorders."""
    lines = gzip.decompress((RECORDINGS / f"{name}.hosttime.csv.gz").read_bytes()).decode().splitlines()[1:]
    stamps = np.array([int(line.split(",")[column].replace(".", "")) for line in lines], np.int64)
    for chunk in (40, 1000):
        session, rate, _ = measure(stamps, chunk=chunk)
        assert (session.samples, session.missing, session.duplicates) == (len(stamps), 0, 0)
        assert (session.restarts, rate) == (0, pytest.approx(40.0, rel=2e-3))


# ---------- the decision which kind of stamps a stream has: one for streams and recordings


CLOCK_NS = 5_000_000 * np.arange(2000, dtype=np.int64)
RNG = np.random.default_rng(4)


STAMPS = {
    "single_row": CLOCK_NS[:1],
    "time_descending": CLOCK_NS[::-1],
    "time_constant": np.zeros(2000, np.int64),
    "time_too_coarse": bunched(CLOCK_NS, 2000.0),
    "time_rate_impossible": np.arange(2000, dtype=np.int64),
    "clock": CLOCK_NS,
    "coarse": bunched(CLOCK_NS, 2.0),
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
