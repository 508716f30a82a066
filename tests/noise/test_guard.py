"""Guard: disturbances are excluded and noise is not, for any chunking; noise of any sensor is rest."""

from __future__ import annotations

import gzip
from collections.abc import Callable

import numpy as np
import pytest
import scipy
from paths import RECORDINGS

from imumon.model.samples import Bools, Floats, SampleBlock
from imumon.model.saved_state import pack
from imumon.noise.allan import OctaveCascade
from imumon.noise.detection import Guard, GuardedSamples
from imumon.noise.detection.disturbance import DetectorState, Disturbance
from imumon.noise.synthesis import synthesise
from imumon.sources.vn100.decoder import Vn100Decoder

GYRO = ("gyro",) * 3
SENSORS = GYRO + ("accel",) * 3 + ("mag",) * 3
SIGMA = np.array([4e-4] * 3 + [1e-2] * 3 + [1e-3] * 3)
LEVEL = np.array([0.01, 0.0, -0.02, 0.0, 0.1, -9.8, 0.2, 0.0, -0.4])


def quiet(seconds: float, rate: float = 40.0, seed: int = 1) -> Floats:
    """Return (n, 9) samples of a sensor at rest: white noise about a level."""
    rng = np.random.default_rng(seed)
    return np.asarray(LEVEL + SIGMA * rng.standard_normal((round(seconds * rate), 9)))


def noisy(seconds: float, rate: float, gyro: float, accel: float, seed: int = 1) -> Floats:
    """Return (n, 6) white noise of the deviations `gyro`, deg/s, and `accel`, m/s^2, about a level."""
    noise = np.random.default_rng(seed).standard_normal((round(seconds * rate), 6))
    return np.asarray(LEVEL[:6] + noise * ([np.radians(gyro)] * 3 + [accel] * 3))


def run_guard(
    guard: Guard, values: Floats, chunk: int = 1000, **kwargs: Bools
) -> tuple[list[GuardedSamples], list[Disturbance]]:
    items = []
    for i in range(0, len(values), chunk):
        items += guard.update(values[i : i + chunk], **{k: v[i : i + chunk] for k, v in kwargs.items()})
    items += guard.flush()
    return items, guard.events()


def excluded(values: Floats, rate: float = 40.0, **kwargs: Bools) -> tuple[Guard, Bools, list[Disturbance]]:
    """Return the guard after the record, (n, g) the samples that remain valid, and the events."""
    guard = Guard(SENSORS[: values.shape[1]], rate)
    items, events = run_guard(guard, values, **kwargs)
    assert np.array_equal(np.concatenate([item.values for item in items]), values)
    return guard, np.concatenate([item.valid for item in items]), events


# --- rest --------------------------------------------------------------------------------------------------


@pytest.mark.few
@pytest.mark.parametrize("rate", [10.0, 40.0, 200.0])
def test_noise_is_not_excluded(rate: float) -> None:
    """White, flicker and random walk: fewer than 1e-4 of the samples excluded, sigma within 0.1 %."""
    seconds = 3600.0 if rate < 100 else 900.0
    values = quiet(seconds, rate)
    slow = synthesise(len(values), rate, N=[6e-5] * 3, B=2.4e-5, K=1e-6, seed=2)
    values[:, :3] += slow[: len(values)]
    values[:, 3] += np.cumsum(np.random.default_rng(3).standard_normal(len(values))) * 1e-4
    guard, valid, events = excluded(values, rate)
    assert (~valid).mean(axis=0).max() < 1e-4
    assert guard.at_rest
    assert len(events) == guard.disturbances <= 1
    remaining = values[valid[:, 0]][:, 0]
    assert abs(remaining.std() / values[:, 0].std() - 1.0) < 1e-3


@pytest.mark.few(2)
@pytest.mark.parametrize("filtered", [False, True])
@pytest.mark.parametrize(
    ("rate", "deviation"), [(50.0, 5.0), (50.0, 0.2), (100.0, 1.0), (100.0, 2.0), (400.0, 0.2), (400.0, 5.0)]
)
def test_noise_of_any_size_is_rest(rate: float, deviation: float, filtered: bool) -> None:
    """A deviation of deg/s, and 0.3 m/s^2 beside it, also behind a low pass of 20 Hz: nothing is excluded."""
    pole = np.exp(-2.0 * np.pi * 20.0 / rate) if filtered else 0.0
    for seed in range(2):
        white = noisy(3600.0 if rate < 400.0 else 1200.0, rate, deviation, 0.3, seed) - LEVEL[:6]
        low = scipy.signal.lfilter([1.0 - pole], [1.0, -pole], white, axis=0)
        guard, valid, _ = excluded(low + LEVEL[:6], rate)
        assert guard.at_rest
        assert valid.all()
        assert guard.rest_changes() == []


@pytest.mark.parametrize(
    ("rate", "axes", "level"),
    [(40.0, [1], 0.0), (40.0, [1], 0.5), (100.0, [4, 5], 0.2), (400.0, [4, 5], 9.80665)],
)
def test_a_constant_axis_neither_moves_nor_is_disturbed_by_rounding(
    rate: float, axes: list[int], level: float
) -> None:
    """0.5 rad/s would be a turn, if the axis showed that it measures."""
    values = quiet(60, rate)[:, :6]
    values[:, axes] = level
    guard, valid, events = excluded(values, rate)
    assert guard.at_rest
    assert valid.all()
    assert events == []


def test_usual_repeats_are_not_stuck() -> None:
    """A magnetometer read faster than it measures, a constant channel, and one of three levels."""
    values = quiet(120, 800.0)
    values[:, 6:9] = values[::3, 6:9].repeat(3, axis=0)[: len(values)]
    guard, valid, _ = excluded(values, 800.0)
    assert valid.all()
    values = quiet(600)
    level = np.linspace(0.0, 4.0, len(values))
    values[:, 6:9] = 0.25
    values[:, 3:6] = np.rint(values[:, 3:6] / 0.02) * 0.02
    values[:, :3] = np.rint(values[:, :3] / 4e-4) * 4e-4
    guard, valid, _ = excluded(values)
    assert valid.mean() > 1 - 1e-4
    assert guard.at_rest
    # a coarse axis whose level is in the middle of a step
    values[:, 1] = 1e-3 * np.rint(level + 0.15 * quiet(600)[:, 1] / SIGMA[1])
    assert "stuck" not in {event.kind for event in excluded(values)[2]}


@pytest.mark.few
@pytest.mark.parametrize("late", [0, 3], ids=["with the frames", "between them"])
@pytest.mark.parametrize("channel", [1, 5])
@pytest.mark.parametrize(("rate", "scale"), [(10.0, 1.0), (40.0, 1.0), (40.0, 10.0), (200.0, 10.0)])
def test_a_held_axis_is_neither_knock_nor_motion(rate: float, scale: float, channel: int, late: int) -> None:
    """One axis is updated once a second: its steps of any size are its noise."""
    values, period = quiet(600, rate)[:, :6], round(rate)
    values = LEVEL[:6] + scale * np.sqrt(rate / 40.0) * (values - LEVEL[:6])
    values[:, channel] = np.roll(values[::period, channel].repeat(period), late)
    guard, valid, _ = excluded(values, rate)
    assert valid.mean() > 0.995
    assert guard.at_rest


def test_the_other_axes_still_decide_beside_a_held_one() -> None:
    values = quiet(600)[:, :6]
    values[:, 1] = values[::40, 1].repeat(40)
    values[12_000:12_080, 4] += 0.1 * np.random.default_rng(2).standard_normal(80)
    values[18_000:19_200, 0] += 0.05 * np.sin(np.arange(1200) / 40.0)
    guard, valid, _ = excluded(values)
    assert not valid[12_000:12_080].any()
    assert not valid[18_040:19_160].any()
    assert (~valid[:, 0]).sum() < 2200
    assert set(guard.excluded) == {"knock", "motion"}


# --- disturbances ------------------------------------------------------------------------------------------


def test_a_single_wrong_sample_is_excluded() -> None:
    values = quiet(300)
    values[6000, 1] += 1.0
    guard, valid, events = excluded(values)
    assert np.argwhere(~valid).tolist() == [[6000, 0]]
    (event,) = events
    assert (event.kind, event.channel, event.start, event.length) == ("glitch", 1, 6000, 1)
    assert event.size == pytest.approx(1.0, abs=0.01)
    assert guard.excluded == {"glitch": 1}
    assert guard.excluded_samples == 1


@pytest.mark.parametrize(
    ("rate", "gyro", "channels", "length", "size", "margins", "most"),
    [
        (40.0, 0.02, [0, 1, 2], 80, 250.0, (10, 20), 200),  # of a usual sensor
        (100.0, 2.0, [0, 1, 2, 3, 4, 5], 50, 20.0, (0, 0), 500),  # of a noisy one
        (100.0, 0.02, [1, 4], 1, 50.0, (40, 99), 300),  # an outlier of both sensors at once
        (100.0, 0.02, [0, 1, 2, 3, 4, 5], 6, 30.0, (42, 0), 199),  # a short one costs less than a frame more
    ],
)
def test_a_knock_is_excluded_with_its_margins(
    rate: float,
    gyro: float,
    channels: list[int],
    length: int,
    size: float,
    margins: tuple[int, int],
    most: int,
) -> None:
    values, begin = noisy(300.0, rate, gyro, 0.3 if gyro > 1.0 else 0.01), 8042
    struck = slice(begin, begin + length)
    values[struck, channels] += size * (values[struck, channels] - LEVEL[channels])
    guard, valid, events = excluded(values, rate)
    assert not valid[begin - margins[0] : begin + length + margins[1]].any()
    assert (~valid[:, 0]).sum() == guard.excluded_samples <= most
    assert [event.kind for event in events] == ["knock"]
    assert guard.at_rest


def test_magnetometer_is_assessed_by_itself() -> None:
    values = quiet(300)
    values[4000:4100, 7] += 0.1
    guard, valid, events = excluded(values)
    assert valid[:, :2].all()
    assert not valid[4000:4100, 2].any()
    assert [e.kind for e in events] == ["magnetic"]
    assert guard.excluded_samples == 0
    assert guard.excluded["magnetic"] >= 100


@pytest.mark.parametrize("axes", [slice(0, 9), slice(1, 2)], ids=["all", "one"])
def test_a_stuck_axis_is_excluded(axes: slice) -> None:
    values = quiet(400)
    values[8000:10400, axes] = values[7999, axes]
    guard, valid, events = excluded(values)
    assert not valid[8080:10400, :2].any()
    assert (~valid[:, 0]).sum() < 2400 + 120
    assert {e.kind for e in events} == {"stuck"}
    assert events[0].size is None
    assert guard.at_rest
    if axes.start:
        assert valid[:, 2].all()
        assert [e.channel for e in events] == [1]
    guard = Guard(SENSORS, 40.0)
    guard.update(values[:9600])
    assert guard.stuck
    guard.update(values[9600:])
    assert not guard.stuck


def test_a_coarse_axis_that_repeats_as_often_shows_a_knock() -> None:
    values, step = quiet(600)[:, :6], 0.05
    values[:, 5] = np.rint(values[:, 5] / step) * step  # sigma of a fifth of a step: 98 % repeats
    assert np.mean(np.diff(values[:, 5]) == 0.0) > 0.95
    values[12_000:12_040, 5] += 4.0 * step
    _, valid, _ = excluded(values)
    assert not valid[12_000:12_040].any()
    assert (~valid[:, 0]).sum() < 200


@pytest.mark.few
@pytest.mark.parametrize("missing", [np.nan, np.inf, -9.8])
def test_a_sample_that_does_not_count_hides_no_knock(missing: float) -> None:
    values = quiet(300)
    values[6000:6100] += 30.0 * SIGMA * np.random.default_rng(2).standard_normal((100, 9))
    valid = np.ones((len(values), 3), dtype=bool)
    valid[6020::40] = False
    values[~valid[:, 0]] = missing
    guard = Guard(SENSORS, 40.0)
    _, events = run_guard(guard, values, valid=valid)
    assert {event.kind for event in events} == {"knock", "magnetic"}
    assert 100 < guard.excluded_samples < 600


def test_a_range_that_is_exceeded_excludes_its_own_sensor_alone() -> None:
    values = quiet(100)
    flags = np.zeros((len(values), 3), dtype=bool)
    flags[2000:2003, 1] = True
    guard, valid, events = excluded(values, saturated=flags)
    assert not valid[2000:2003, 1].any()
    assert valid[:, [0, 2]].all()
    (event,) = events
    assert (event.kind, event.channel in (3, 4, 5)) == ("clipped", True)
    assert guard.excluded["clipped"] == (~valid[:, 1]).sum() == event.length


@pytest.mark.few
@pytest.mark.parametrize("at", [3, 25, 70, 130])
def test_a_record_may_begin_with_a_knock(at: int) -> None:
    values = quiet(60)
    values[at, 1] += 1.0
    _, valid, events = excluded(values)
    assert not valid[at, 0]
    assert (~valid[:, 0]).sum() <= 12
    assert [e.kind for e in events] == ["glitch"]
    values = quiet(60)
    values[10:34, 4] += 0.3
    _, valid, events = excluded(values)
    assert not valid[10:34, :2].any()
    assert valid[100:].all()
    assert [e.kind for e in events] == ["knock"]


# --- motion ------------------------------------------------------------------------------------------------


def drive(seconds: float, rate: float = 40.0, seed: int = 3) -> Floats:
    """Return (n, 9) samples of a driving car: slow turns, rough road."""
    values = quiet(seconds, rate, seed)
    n = len(values)
    rough = np.random.default_rng(seed).standard_normal((n + 40, 9))
    rough = sum(rough[i : i + n] for i in range(40)) / 40**0.5
    values[:, :6] += rough[:, :6] * np.array([0.02] * 3 + [0.3] * 3)
    return values


def carried(n: int, rate: float, seed: int) -> Floats:
    """Return (n, 6) rates and accelerations of a hand: noise of 1 Hz and of tremor at 8 Hz."""
    rng = np.random.default_rng(seed)
    slow, white = np.exp(-2.0 * np.pi / rate), rng.standard_normal((n, 6))
    slow_motion = scipy.signal.lfilter([np.sqrt(1.0 - slow**2)], [1.0, -slow], white, axis=0)
    tremor = np.sin(2.0 * np.pi * 8.0 * np.arange(n)[:, None] / rate + rng.random(6))
    return np.asarray((slow_motion + 0.1 * tremor) * ([0.1] * 3 + [0.5] * 3))


def test_motion_is_excluded_and_rest_after_it_is_not() -> None:
    values = np.concatenate((quiet(60), drive(60), quiet(60, seed=7)))
    guard = Guard(SENSORS, 40.0)
    run_guard(guard, values[: 100 * 40])
    assert not guard.at_rest
    guard, valid, events = excluded(values)
    assert guard.at_rest
    assert not valid[62 * 40 : 118 * 40, :2].any()
    assert valid[: 58 * 40].all()
    assert valid[-45 * 40 :].all()
    assert "motion" in [e.kind for e in events]


def test_a_guard_that_only_detects_excludes_nothing() -> None:
    guard = Guard(SENSORS, 40.0, excludes=False)
    items, events = run_guard(guard, np.concatenate((quiet(60), drive(60))))
    assert all(item.valid.all() and not item.broken for item in items)
    assert events == []
    assert guard.excluded == {}
    assert not guard.at_rest


@pytest.mark.few
@pytest.mark.parametrize("rate", [40.0, 100.0, 400.0])
@pytest.mark.parametrize("deviation", [0.02, 1.0])
def test_a_record_that_begins_in_the_hand_is_motion(rate: float, deviation: float) -> None:
    """Both for a quiet sensor and for a noisy one, until it is set down."""
    values = noisy(120.0, rate, deviation, 0.01 if deviation < 1.0 else 0.1)
    half = len(values) // 2
    values[:half] += carried(half, rate, 1)
    guard, valid, _ = excluded(values, rate)
    assert valid[: round(55.0 * rate), 0].mean() < 0.1
    assert valid[round(90.0 * rate) :].all()
    assert guard.at_rest


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("turn", "deviation"), [(None, 1.0), (0.3, 0.05), (None, 0.05), (0.3, 0.2), (2.0, 1.0)]
)
def test_a_slow_rotation_and_a_hand_are_excluded_and_what_follows_is_not(
    turn: float | None, deviation: float
) -> None:
    """A turn in deg/s of 30 s, or a sensor that is picked up and put back: its noise decides what is slow."""
    values = noisy(300.0, 100.0, deviation, 0.02)
    if turn is None:
        values[12_000:15_000] += carried(3000, 100.0, 2)
    else:
        values[12_000:15_000, 2] += np.radians(turn)
    guard, valid, events = excluded(values, 100.0)
    assert valid[12_100:14_400, 0].mean() <= (0.05 if turn else 0.0)
    assert valid[:11_800].all()
    assert valid[-10_000:].all()
    assert guard.at_rest
    assert "motion" in guard.excluded
    assert "motion" in [event.kind for event in events]


@pytest.mark.parametrize(("gyro", "turn"), [(0.02, 10.0), (57.0, 0.0)], ids=["table", "shaker"])
def test_a_turning_table_and_a_shaker_are_not_at_rest(gyro: float, turn: float) -> None:
    """White noise as rest has, of a size that no sensor has."""
    values = noisy(120.0, 100.0, gyro, 0.02)
    values[:, 2] += np.radians(turn)
    guard, valid, _ = excluded(values, 100.0)
    assert not guard.at_rest
    assert not valid.any()


@pytest.mark.parametrize("what", ["engine", "tilt"])
def test_a_new_noise_or_level_becomes_the_baseline(what: str) -> None:
    """An engine starts and keeps running, or the sensor tilts: rest becomes valid again, behind a break."""
    values = quiet(200)
    if what == "tilt":
        values[4000:, 4] += 0.5
    else:
        values[4000:, 3:6] += 0.1 * np.sin(2 * np.pi * 10.02 * np.arange(4000) / 40.0)[:, None]
    guard = Guard(SENSORS, 40.0)
    items, _ = run_guard(guard, values)
    valid = np.concatenate([item.valid for item in items])
    assert guard.at_rest
    assert valid[-60 * 40 :].all()
    assert sum(item.broken for item in items) == 1
    assert 10 * 40 < (~valid[:, 0]).sum() < (40 if what == "tilt" else 120) * 40


@pytest.mark.few
@pytest.mark.parametrize(
    ("name", "at_rest", "least", "most"),
    [
        ("kiran_stat5min", True, 0.97, 1.0),
        ("sahq_parked", True, 0.99, 1.0),
        ("fc_car_idle", None, 0.3, 0.95),
        ("fc_drive_circle", False, 0.0, 0.15),
        ("fc_cal_square", False, 0.0, 0.05),
        ("sahq_drive_circles", False, 0.0, 0.15),
        ("chase_0513", False, 0.0, 0.1),
    ],
)
def test_real_recordings(name: str, at_rest: bool | None, least: float, most: float) -> None:
    """Rest is not excluded, disturbed rest in part, and motion completely."""
    path = RECORDINGS / f"{name}.vnymr.txt.gz"
    if not path.exists():
        pytest.skip("the recordings are not available")
    decoder = Vn100Decoder()
    items = decoder.feed(gzip.decompress(path.read_bytes())) + decoder.finish()
    values = np.concatenate([item.values for item in items if isinstance(item, SampleBlock)])
    guard, valid, _ = excluded(values, 200.0 if name.startswith("chase") else 40.0)
    assert least <= valid[:, 0].mean() <= most
    if at_rest is not None:
        assert guard.at_rest is at_rest


# --- gaps: what is counted over neighbouring frames ends at one ---------------------------------------------

FRAME = 40
GAPS: dict[str, Callable[[Guard], object]] = {
    "of ten frames": lambda guard: guard.skip(10 * FRAME),
    "of unknown length": lambda guard: guard.break_(),
    "of lost samples": lambda guard: guard.update(
        np.zeros((10 * FRAME, 3)), np.zeros((10 * FRAME, 1), dtype=bool)
    ),
}
gaps = pytest.mark.parametrize("gap", GAPS.values(), ids=list(GAPS))


def frames(count: int, deviation: float = 4e-4, seed: int = 1) -> Floats:
    """Return (n, 3) white noise, rad/s."""
    return np.asarray(deviation * np.random.default_rng(seed).standard_normal((count * FRAME, 3)))


@gaps
def test_unusual_frames_on_both_sides_of_a_gap_are_not_counted_together(
    gap: Callable[[Guard], object],
) -> None:
    """Seven unusual frames before it and one behind it would be motion; a short gap ends nothing."""
    for act, at_rest in ((gap, True), (lambda guard: guard.skip(2 * FRAME), False)):
        guard = Guard(GYRO, 40.0)
        guard.update(np.concatenate((frames(60), frames(7, 0.1))))
        act(guard)
        guard.update(np.concatenate((frames(1, 0.1), frames(3, seed=2))) if at_rest else frames(2, 0.1))
        assert guard.at_rest == at_rest
        assert not at_rest or guard.rest_changes() == []


@gaps
def test_candidates_for_a_new_baseline_are_neighbours(gap: Callable[[Guard], object]) -> None:
    """A record that begins in motion: only sixteen frames in a row can be the first rest."""
    guard, hand = Guard(GYRO, 40.0), 0.05 * np.sin(np.arange(32 * FRAME) / 30.0)
    (detector,) = guard._detectors
    guard.update(frames(32) + hand[:, None])
    assert not guard.at_rest
    guard.update(frames(10, seed=2))
    assert detector._candidates
    gap(guard)
    guard.update(frames(1, seed=3))
    assert len(detector._candidates) <= 1
    assert detector.state is DetectorState.MOVING  # nothing is known that rest could be compared with
    guard.update(frames(20, seed=4))
    assert guard.at_rest


@gaps
def test_a_gap_ends_motion_where_rest_is_known(gap: Callable[[Guard], object]) -> None:
    guard = Guard(GYRO, 40.0)
    guard.update(np.concatenate((frames(60), frames(20, 0.1))))
    assert not guard.at_rest
    gap(guard)
    guard.update(frames(6, seed=2))
    assert guard.at_rest
    assert [rests for _, rests in guard.rest_changes()] == [False, True]
    gap(guard)
    # motion that goes on behind a gap is excluded all the same
    items = guard.update(frames(20, 0.1)) + guard.flush()
    assert not np.concatenate([item.valid for item in items])[:, 0][6 * FRAME :].any()


# --- the stream --------------------------------------------------------------------------------------------


def test_the_guard_begins_once() -> None:
    guard, short, waits = Guard(SENSORS, 100.0), Guard(SENSORS, 100.0), []
    for values in np.split(quiet(8.0, 100.0), 8):
        guard.update(values)
        waits.append(guard.pending is not None)
    assert waits == [True] * 3 + [False] * 5
    short.flush()
    assert short.pending is not None  # nothing came
    short.update(quiet(1.5, 100.0))
    short.flush()
    assert short.pending is None


def test_the_grid_keeps_its_length() -> None:
    """Samples in and missing = samples out and skipped, for any gaps."""
    guard = Guard(SENSORS, 40.0)
    values = quiet(100)
    items = guard.update(values[:777])
    for i, gap in enumerate((1, 3, 39, 40, 123, 5000, 1)):
        items += guard.skip(gap)
        items += guard.update(values[777 + 123 * i : 900 + 123 * i])
    items += guard.break_()
    assert guard.held == 0
    items += guard.update(values[-100:]) + guard.flush()
    out = sum(len(item.values) + item.skipped for item in items)
    assert out == 777 + 7 * 123 + 1 + 3 + 39 + 40 + 123 + 5000 + 1 + 100
    assert sum(int(item.valid[:, 0].sum()) for item in items) == 777 + 7 * 123 + 100
    assert [item.broken for item in items].count(True) == 1


def test_memory_is_bounded() -> None:
    guard = Guard(SENSORS, 40.0)
    values = quiet(3600)
    sizes = []
    for _ in range(4):
        run_guard(guard, values, 4000)
        sizes.append(len(pack(guard)))
    assert max(sizes) < 1_000_000
    assert guard.held == 0


@pytest.mark.slow
def test_the_curve_is_that_of_the_undisturbed_record() -> None:
    """One wrong sample, a knock and a stuck minute in five hours: N within 0.1 %, no bump at long times."""
    rate, n = 40.0, 5 * 3600 * 40
    clean = synthesise(n, rate, N=[6.1e-5] * 3, B=4.8e-6, K=1e-7, seed=11)
    disturbed = clean.copy()
    disturbed[100_000, 0] += 1.0
    disturbed[300_000:300_080, 1] += 0.1
    disturbed[500_000:502_400] = disturbed[500_000]
    sigma = []
    for values, guarded in ((clean, False), (disturbed, True), (disturbed, False)):
        cascade, items = (
            OctaveCascade(3, 1 / rate, groups=(0, 0, 0)),
            [GuardedSamples(values, np.ones((n, 1), bool))],
        )
        for piece in run_guard(Guard(GYRO, rate), values, 8000)[0] if guarded else items:
            cascade.update(piece.values, piece.valid)
        sigma.append(cascade.result().sigma)
    assert np.abs(sigma[1][:4] / sigma[0][:4] - 1).max() < 1e-3
    assert np.abs(sigma[1][:14] / sigma[0][:14] - 1).max() < 0.1
    assert np.abs(sigma[2][0] / sigma[0][0] - 1).max() > 1.0
