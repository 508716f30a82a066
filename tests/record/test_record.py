"""Laws of a record: the best stream, counts, sums from the first sample on, gaps, and samples without a number."""

from __future__ import annotations

import gc
import itertools
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from blocks_at_rest import DELTAS, LEVEL, SIGMA, TICK, block, report_of
from hypothesis import Phase, example, given, settings
from hypothesis import strategies as st
from placed import PlacedRecord

from imumon.grid.sample_clock import BREAK, PlacedSamples
from imumon.model.coefficients import Estimate
from imumon.model.errors import RateRequired
from imumon.model.report import Report, SensorGrade, from_json
from imumon.model.report_json import to_json
from imumon.model.samples import ACCEL, GYRO, MAG, Clock, Floats, Ints, SampleBlock, Stream, selected
from imumon.model.units import YEAR
from imumon.noise.fit import ChannelFit, fit_curve
from imumon.noise.fit.statement import pending_fit
from imumon.record import Record, RecordOptions
from imumon.record.convergence import FIRST_DUE_S, MOST_POINTS, StatementLog, next_due_s
from imumon.record.events import EventLog
from imumon.record.gap_fill import LONG_GAP, Break, DenseBlock, LongGap, fill_gaps


def fed(*parts: SampleBlock, rate_hz: float | None = None) -> tuple[Record, Report]:
    """Return a monitor that got these blocks to their end, and its report."""
    monitor = Record(rate_hz=rate_hz)
    for part in parts:
        monitor.feed(part)
    monitor.flush()
    return monitor, report_of(monitor)


def axes(n: int, start: int = 0, count: int = 1) -> SampleBlock:
    """Return samples of the first axes of the gyroscope: each axis more costs as much as all else."""
    whole = block(n, start)
    return replace(whole, stream=replace(DELTAS, channels=GYRO[:count]), values=whole.values[:, :count])


def test_n_is_known_early_and_no_fit_is_older_than_a_tenth_of_the_record() -> None:
    monitor, at, known, oldest = Record(), 0.0, None, 0.0
    for second in range(80):
        monitor.feed(axes(100, 100 * second))
        n = report_of(monitor).channels["gyro/x"].coefficients["N"]
        if n != known:
            at, known = second, n
        if second == 2:
            assert n.value is not None
        assert second - at <= 0.1 * second + 1.0
        oldest = max(oldest, second - at)
    assert oldest >= 5.0  # it is not computed for every report
    stopped = report_of(monitor, "stopped")
    assert stopped.channels["gyro/x"].coefficients["N"] is not known  # the last report includes everything


def test_the_curve_moves_each_minute_and_the_fit_with_each_tenth_of_the_record() -> None:
    record, curves, fits = Record(), [], []
    record.feed(axes(90_000))
    for third in range(13):  # of a minute, from 15 minutes on
        n = report_of(record).channels["gyro/x"]
        curves.append(n.allan)
        fits.append(n.coefficients["N"].value)
        record.feed(axes(2_000, 90_000 + 2_000 * third))
    assert [a is not b for a, b in itertools.pairwise(curves)] == [False, False, True] * 4
    assert [a != b for a, b in itertools.pairwise(fits)] == 5 * [False] + [True] + 5 * [False] + [True]


@pytest.mark.slow
def test_memory_does_not_grow_with_the_record() -> None:
    monitor, n, held = Record(), 100 * 60 * 5, []
    tracemalloc.start()
    try:
        for fives in range(9):
            monitor.feed(block(n, fives * n, seed=fives))
            report_of(monitor)
            gc.collect()
            held.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    # what fits keep, and the working space of a block, are made in the first half hour
    assert held[-1] - max(held[:6]) < 500_000


def test_best_stream_is_characterised_and_counted_alone() -> None:
    poor = block(50, stream=Stream("compensated", GYRO + ACCEL, "$VNYMR", "none"))
    monitor, current = fed(poor, block(500), poor, rate_hz=100.0)
    assert current.device.stream == "deltas"
    assert current.session.samples == 500
    assert [event.code for event in monitor.events() if event.kind == "restart"] == ["other_stream"]


def test_stream_without_clock_and_rate_is_refused() -> None:
    silent, few, slow = replace(DELTAS, clock="none"), Record(), Record()
    with pytest.raises(RateRequired):
        Record().feed(block(500, stream=silent))
    few.feed(block(10, stream=silent))
    with pytest.raises(RateRequired):
        few.flush()
    for second in range(6):
        slow.feed(block(1, second, stream=silent), host_s=1.0 if second else 0.0)
    with pytest.raises(RateRequired):
        slow.feed(block(1, 6, stream=silent), host_s=1.0)


def test_counts_add_up_over_gaps_and_restarts() -> None:
    monitor, current = fed(axes(1000), axes(1000, 1500), axes(1000, 3))  # the sensor was restarted
    assert current.session.samples == 3000
    assert current.session.missing == 500
    assert current.session.gaps == 2
    assert current.session.restarts == 1
    assert current.session.elapsed_s == pytest.approx(35.0)
    events = [(event.kind, event.code) for event in monitor.events()]
    assert ("gap", "") in events
    assert ("restart", "clock_reset") in events


def test_a_grade_change_is_an_event_when_it_lasts() -> None:
    def reported(events: EventLog, lengths: range, flips: int) -> list[str]:
        for k, length in enumerate(lengths):
            meets = "industrial" if k // flips % 2 == 0 else "consumer"
            events.update_grades({"gyro": SensorGrade(meets=meets)}, float(length))
        return [event.text for event in events.drain()]

    assert reported(EventLog(), range(1000, 2000), 20) == ["gyro: industrial, provisional"]
    assert reported(EventLog(), range(1000, 1600), 300) == [
        "gyro: industrial, provisional",
        "gyro: consumer, provisional (before: industrial, provisional)",
    ]
    lost = EventLog()
    for k in range(100):
        grade = SensorGrade(meets=None if k % 2 else "industrial")
        lost.update_grades({"gyro": grade}, 1000.0 + k)
    assert len(lost.drain()) == 1
    again = EventLog()
    again.restored({})
    assert reported(again, range(1000, 1100), 200) == [], "reported before the restart"
    assert reported(again, range(2000, 3000), 500) == [
        "gyro: consumer, provisional (before: industrial, provisional)"
    ]


def test_a_gap_has_a_known_length_if_another_stream_resumes_first() -> None:
    monitor = Record()
    monitor.feed(axes(5000), host_s=0.0)
    other = replace(block(10), stream=replace(DELTAS, kind="compensated", source="VNYMR", clock="none"))
    monitor.feed(other, host_s=7200.0)
    monitor.feed(axes(5000, 5000 + 40 * 7200), host_s=0.1)
    monitor.flush()
    assert report_of(monitor).session.missing == 40 * 7200


def test_saved_record_of_another_stream_is_refused() -> None:
    one = Record()
    one.feed(block(500))
    two = Record()
    two.restore(one.save(), 1.0)
    mismatch = two.feed(block(500, stream=replace(DELTAS, kind="uncompensated")))
    assert mismatch.code == "other_stream"
    assert two.samples == 500


def warmed(minutes: tuple[int, ...], time_s: float, follows: float = 0.0) -> tuple[Record, list[Report]]:
    """Return the monitor of a sensor that heats up by 8 degrees, and its reports after some minutes."""
    stream = replace(DELTAS, channels=(*GYRO, "temperature"))
    monitor, reports, rng = Record(), [], np.random.default_rng(5)
    for minute in range(minutes[-1]):
        at = 600 * minute + np.arange(600)
        cold = np.exp(-at / (10.0 * time_s))
        gyro = LEVEL[:3] + SIGMA[:3] * rng.normal(size=(600, 3))
        gyro[:, 0] += follows * cold**2  # faster than the temperature, which would explain it
        values = np.column_stack((gyro, 30.0 - 8.0 * cold + 0.02 * rng.normal(size=600)))
        monitor.feed(SampleBlock(stream, values, at * 10 * TICK, np.zeros(600, dtype=np.int64)))
        if minute + 1 in minutes:
            reports.append(report_of(monitor))
    return monitor, reports


def test_the_end_of_a_warm_up_without_effect_is_an_event() -> None:
    monitor, (early, late, later) = warmed((3, 20, 130), 600.0)
    for each in (early, late):  # at 20 min a seventh of the rise is still to come
        assert "warming_up" in each.caveats
        assert {"upper_bound", "pending"} >= {
            c.coefficients["K"].status for c in each.channels.values() if c.coefficients
        }
    assert "warming_up" not in {*later.caveats, *later.channels["gyro/x"].caveats}
    assert later.session.warmup_s == 0.0
    (event,) = [event for event in monitor.events() if event.kind == "warmup"]
    assert event.length_s is None


def test_a_warm_up_with_effect_has_its_caveat_until_it_is_excluded() -> None:
    monitor, reports = warmed((3, 12, 20, 40), 200.0, follows=4e-3)
    own = ["warming_up" in each.channels["gyro/x"].caveats for each in reports]
    other = ["warming_up" in each.channels["gyro/y"].caveats for each in reports]
    assert own == other == [True, True, True, False]  # it is the device that warms up
    assert [each.session.warmup_s for each in reports] == [0.0, 0.0, 300.0, 600.0]
    assert [event.length_s for event in monitor.events() if event.kind == "warmup"] == [300.0, 600.0]


def test_moving_sensor_is_never_graded() -> None:
    t = np.arange(12_000) / 100.0
    part = block(12_000)
    part.values[:, 2] += 0.5 * np.sin(2 * np.pi * 0.1 * t) * np.sin(2 * np.pi * 0.013 * t)
    part.values[:, 0] += 0.3 * np.sin(2 * np.pi * 0.4 * t)
    _, current = fed(part)
    assert current.grade["gyro"].meets is None
    assert current.channels["gyro/x"].grade.meets is None
    assert "not_at_rest" in current.caveats


def test_a_constant_axis_is_a_caveat_and_its_sensor_has_no_grade() -> None:
    part = block(6000)
    part.values[:, 1] = 0.0
    monitor, current = fed(part)
    dead, beside = current.channels["gyro/y"], current.channels["gyro/x"]
    assert "constant" in dead.caveats
    assert dead.coefficients["N"].status == "pending"
    assert dead.coefficients["N"].reason_code == "constant"
    assert dead.spectrum.lines == ()
    assert current.grade["gyro"].meets is None
    assert "y never changed" in (current.grade["gyro"].reason or "")
    assert beside.caveats == ()
    assert beside.grade.meets is not None
    assert current.grade["accel"].meets is not None
    events = [event for event in monitor.events() if event.kind == "constant"]
    assert [event.channel for event in events] == ["gyro/y"]


def at_rate(n: int, tick: int, start: int = 0) -> SampleBlock:
    whole = block(n, seed=start + 3)
    return replace(whole, time_ns=start + np.arange(n) * tick)


def test_another_rate_starts_a_new_record() -> None:
    monitor = Record()
    assert monitor.feed(at_rate(2000, TICK)) is None
    mismatch = monitor.feed(at_rate(4000, TICK // 2, 2000 * TICK)) or monitor.flush()
    monitor.flush()
    current = report_of(monitor)
    assert current.device.sample_rate_hz == pytest.approx(200.0)
    assert current.session.duplicates == 0
    assert current.session.samples + current.session.missing == round(current.session.elapsed_s * 200.0)
    assert current.session.samples > 3900
    assert current.session.restarts == 1
    assert mismatch is not None
    assert [event.code for event in monitor.events() if event.kind == "restart"] == ["other_rate"]


def test_a_magnetometer_beside_increments_is_a_point_sample() -> None:
    n = 20_000
    walk = np.cumsum(np.random.default_rng(3).normal(size=n)) * 1e-4
    stream = replace(DELTAS, channels=(*GYRO, *MAG))
    values = np.repeat(walk[:, None], 6, axis=1)
    monitor = Record(RecordOptions(guarded=False), rate_hz=1e9 / TICK)
    monitor.feed(SampleBlock(stream, values, np.arange(n) * TICK, np.zeros(n, dtype=np.int64)))
    channels = report_of(monitor).channels
    gyro, mag = channels["gyro/x"], channels["mag/x"]
    assert gyro.allan.sigma == pytest.approx(mag.allan.sigma)
    # point samples of a walk have 1.5 times the variance of averages at the shortest time
    assert mag.allan.model[0] == pytest.approx(mag.allan.sigma[0], rel=0.01)
    assert (mag.fit, mag.caveats) != (gyro.fit, gyro.caveats)


@pytest.mark.few
@pytest.mark.parametrize("rate", [0.1, 1.0, 100.0, 800.0])
def test_statistics_begin_with_the_first_samples(rate: float) -> None:
    """The first assessment of the guard delays nothing and removes nothing that a report has shown."""
    made = PlacedRecord(GYRO, rate)
    record = made.record
    values = LEVEL[:3] + SIGMA[:3] * np.random.default_rng(1).normal(
        size=(4000 if rate == 800.0 else 1000, 3)
    )
    counts = []
    for row in range(len(values)):
        made.feed(values[row : row + 1], np.ones(1, dtype=np.int64))
        if row in range(1, 60) or row % 100 == 0:
            counts.append(record._shown_sums().moments().channels[0].count)
        if row == 1:
            now = record._shown_sums().moments().channels[0]
            assert (now.count, now.last) == (2, values[1, 0])
            assert now.mean == pytest.approx(values[:2, 0].mean())
        if row == 29:
            assert fit_curve(record._shown_sums().curve(), averaged=True)[0].N.status != "pending"
            assert record._shown_sums().histogram.result()[0] is not None
    assert counts == sorted(counts)
    assert record._shown_sums().moments().channels[0].count == record.samples - record.guard.held
    assert record.guard.held <= 2 * max(10, rate)


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


# ---------------------------------------------------------------- samples without a number


SAMPLES = 3000
INTERVAL_NS = 10_000_000


def reported(values: np.ndarray, clock: Clock, block: int = 50) -> tuple[Report, list[str]]:
    stream = Stream("uncompensated", (*GYRO, *ACCEL, "temperature"), "test", clock)
    monitor = Record(rate_hz=100.0)
    for at in range(0, len(values), block):
        some = values[at : at + block]
        time = (at + np.arange(len(some))) * INTERVAL_NS if clock == "startup" else None
        monitor.feed(SampleBlock(stream, some, time, np.zeros(len(some), np.int64)))
    monitor.flush()
    made = report_of(monitor, "stopped")
    return made, [event.kind for event in monitor.events()]


def noise() -> np.ndarray:
    values = np.random.default_rng(1).normal(0.0, 1e-3, (SAMPLES, 7))
    values[:, 6] += 25.0
    return values


@pytest.mark.few(2)
@pytest.mark.parametrize("clock", ["startup", "none"])
@pytest.mark.parametrize(("bad", "block"), [(np.nan, 50), (np.inf, 50), (1e300, 50), (np.nan, 1)])
def test_a_sample_without_a_number_is_missing(clock: Clock, bad: float, block: int) -> None:
    values = noise()
    bad_rows = np.array([50, 51, 52, 99, 149, 1000, 2345])
    values[bad_rows, [0, 1, 2, 3, 4, 5, 0]] = bad
    made, kinds = reported(values, clock, block)
    assert made.session.samples == SAMPLES - len(bad_rows)
    assert made.session.missing == len(bad_rows)
    assert made.session.excluded_by == {}
    assert all(made.channels[name].coefficients["N"].value for name in (*GYRO, *ACCEL))
    assert kinds.count("garbage") == 1


@pytest.mark.few
@pytest.mark.parametrize("rows", [slice(None), slice(None, None, 7), slice(1500, None)])
def test_a_temperature_without_a_number_is_unknown_there(rows: slice) -> None:
    values = noise()
    values[rows, 6] = np.nan
    made, kinds = reported(values, "startup")
    temperature = made.channels["temperature"]
    known = np.isfinite(values[:, 6])
    assert temperature.count == known.sum()
    assert (temperature.mean is None) == (not known.any())
    assert made.session.samples == SAMPLES
    assert made.channels["gyro/x"].coefficients["N"].value == pytest.approx(1e-4, rel=0.1)
    assert "garbage" not in kinds


# ---------- laws of the convergence: bounded, the same for any chunking, saved with the state; its end is wha


HZ = 100
WITH_CONVERGENCE = RecordOptions(convergence=True)


def fed_in_chunks(samples: SampleBlock, chunk: int, monitor: Record | None = None) -> Record:
    monitor = monitor or Record()
    for start in range(0, len(samples), chunk):
        monitor.feed(selected(samples, slice(start, start + chunk)))
    return monitor


def stated(value: float) -> ChannelFit:
    part = Estimate(value=value, low=0.9 * value, high=1.1 * value, status="measured")
    return replace(pending_fit(0, "too short"), coefficients={"N": part, "B": Estimate(), "K": Estimate()})


def test_the_points_are_bounded_and_each_is_the_last_one_of_its_cell() -> None:
    convergence, lengths = StatementLog(1), np.geomspace(0.01, 1000.0 * YEAR, 5000)
    for number, length in enumerate(lengths.tolist()):
        convergence.add(length, [stated(float(number))])
    part = convergence.of_channel(0)
    assert len(part.elapsed_s) == MOST_POINTS <= 64
    assert part.elapsed_s[-1] == lengths[-1]
    assert part.coefficients["N"].value[-1] == len(lengths) - 1
    assert set(part.coefficients["B"].status) == {"pending"}
    assert "M" not in part.coefficients


def test_the_last_point_is_what_is_stated_now() -> None:
    monitor = fed_in_chunks(axes(30 * HZ, count=2), 777)
    report_of(monitor)
    fed_in_chunks(axes(20 * HZ, 30 * HZ, count=2), 777, monitor)
    for state in ("running", "stopped"):
        for channel in report_of(monitor, state).channels.values():  # type: ignore[arg-type]
            for letter, series in channel.convergence.coefficients.items():
                now = channel.estimates[letter]
                last = (series.value[-1], series.low[-1], series.high[-1], series.status[-1])
                assert last == (now.value, now.low, now.high, now.status)
    assert channel.convergence.elapsed_s == (30.0, 50.0)
    current = report_of(monitor)
    assert from_json(Report, to_json(current)) == current


@pytest.mark.parametrize("chunk", [97, 50_000])
def test_a_record_for_a_document_has_a_point_at_each_doubling_for_any_chunking(chunk: int) -> None:
    monitor = fed_in_chunks(axes(150 * HZ), chunk, Record(WITH_CONVERGENCE))
    monitor.flush()
    ended = report_of(monitor, "stopped").channels["gyro/x"].convergence
    half = fed_in_chunks(axes(120 * HZ), 50_000, Record(WITH_CONVERGENCE))
    half.flush()
    then = report_of(half, "stopped").channels["gyro/x"].convergence
    assert (then.elapsed_s, ended.elapsed_s) == ((60.0, 120.0), (60.0, 120.0, 150.0))
    for letter, series in ended.coefficients.items():
        assert series.status[0] == then.coefficients[letter].status[0]
        assert series.high[0] == pytest.approx(then.coefficients[letter].high[0], rel=1e-12)


def test_the_next_length_is_a_doubling_and_beyond_the_present_one() -> None:
    for length in np.geomspace(1.0, YEAR, 50).tolist():
        due = next_due_s(length)
        assert due == FIRST_DUE_S or length < due <= 2.0 * length
        assert np.log2(due / FIRST_DUE_S) % 1.0 == 0.0


# ---------- a record gives the same result, however its samples are split into blocks


SLOW_HZ = 20.0
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


def disturbed_samples(events: list[tuple[str, int]], repeats: int) -> PlacedSamples:
    """Return samples in units of the noise, magnetometer repeated, with disturbances."""
    x = np.random.default_rng(1).standard_normal((ROWS, 9))
    x[:, 6:] = x[::repeats, 6:].repeat(repeats, axis=0)[:ROWS]
    x[:, 4] = np.rint(x[:, 4])
    steps, saturated = np.ones(ROWS, dtype=np.int64), np.zeros(ROWS, dtype=bool)
    for kind, at in events:
        disturbed(kind, at, x, steps, saturated)
    return PlacedSamples(x * np.array([1e-4] * 3 + [3e-3] * 3 + [1e-3] * 3), steps, saturated)


def results_of(placed: PlacedSamples, edges: list[int]) -> tuple[list[object], list[Floats]]:
    """Return what must be equal, and what must be equal but for rounding."""
    channels = GYRO + ACCEL + MAG
    made = PlacedRecord(channels, SLOW_HZ)
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
    placed = disturbed_samples(events, repeats)
    exact, rounded = results_of(placed, [])
    other, near = results_of(placed, sorted(edges))
    for one, two in zip(exact, other, strict=True):
        assert one == two
    for a, b in zip(rounded, near, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-15)
