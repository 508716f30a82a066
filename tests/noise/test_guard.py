"""Guard: disturbances are excluded and noise is not, for any chunking."""

from __future__ import annotations

import gzip

import numpy as np
import pytest
from paths import RECORDINGS

from imumon.model.samples import Bools, Floats, SampleBlock
from imumon.model.saved_state import pack
from imumon.noise.allan import OctaveCascade
from imumon.noise.detection import Guard, GuardedSamples
from imumon.noise.detection.disturbance import Disturbance
from imumon.noise.synthesis import synthesise
from imumon.sources.vn100.decoder import Vn100Decoder

SENSORS = ("gyro",) * 3 + ("accel",) * 3 + ("mag",) * 3
SIGMA = np.array([4e-4] * 3 + [1e-2] * 3 + [1e-3] * 3)
LEVEL = np.array([0.01, 0.0, -0.02, 0.0, 0.1, -9.8, 0.2, 0.0, -0.4])


def quiet(seconds: float, rate: float = 40.0, seed: int = 1) -> Floats:
    """Return (n, 9) samples of a sensor at rest: white noise about a level."""
    rng = np.random.default_rng(seed)
    return np.asarray(LEVEL + SIGMA * rng.standard_normal((round(seconds * rate), 9)))


def run_guard(
    guard: Guard, values: Floats, chunk: int = 1000, **kwargs: Bools
) -> tuple[list[GuardedSamples], list[Disturbance]]:
    items = []
    for i in range(0, len(values), chunk):
        items += guard.update(values[i : i + chunk], **{k: v[i : i + chunk] for k, v in kwargs.items()})
    items += guard.flush()
    return items, guard.events()


def excluded(values: Floats, rate: float = 40.0, **kwargs: Bools) -> tuple[Guard, Bools, list[Disturbance]]:
    """Return the guard after the record, (n, 3) the samples that remain valid, and the events."""
    guard = Guard(SENSORS, rate)
    items, events = run_guard(guard, values, **kwargs)
    assert np.array_equal(np.concatenate([item.values for item in items]), values)
    return guard, np.concatenate([item.valid for item in items]), events


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


def test_a_single_wrong_sample_is_excluded() -> None:
    values = quiet(300)
    values[6000, 1] += 1.0
    guard, valid, events = excluded(values)
    assert np.argwhere(~valid).tolist() == [[6000, 0]]
    (event,) = events
    assert event.kind == "glitch"
    assert event.channel == 1
    assert event.size == pytest.approx(1.0, abs=0.01)
    assert (event.start, event.length) == (6000, 1)
    assert guard.excluded == {"glitch": 1}
    assert guard.excluded_samples == 1


def test_a_knock_is_excluded_with_its_margins() -> None:
    values = quiet(300)
    rng = np.random.default_rng(5)
    values[8000:8080, :3] += 0.1 * rng.standard_normal((80, 3))
    guard, valid, events = excluded(values)
    assert not valid[7990:8100, :2].any()
    assert (~valid[:, 0]).sum() < 5 * 40
    assert [e.kind for e in events] == ["knock"]
    assert guard.at_rest
    assert guard.excluded_samples == (~valid[:, 0]).sum()


def test_magnetometer_is_assessed_by_itself() -> None:
    values = quiet(300)
    values[4000:4100, 7] += 0.1
    guard, valid, events = excluded(values)
    assert valid[:, :2].all()
    assert not valid[4000:4100, 2].any()
    assert [e.kind for e in events] == ["magnetic"]
    assert guard.excluded_samples == 0
    assert guard.excluded["magnetic"] >= 100


def test_a_stuck_sensor_is_excluded() -> None:
    values = quiet(400)
    values[8000:10400] = values[7999]
    guard, valid, events = excluded(values)
    assert not valid[8000:10400].any()
    assert (~valid[:, 0]).sum() < 2400 + 60
    assert {e.kind for e in events} == {"stuck"}
    assert guard.at_rest
    assert events[0].size is None


def test_a_single_stuck_axis_is_excluded() -> None:
    values = quiet(400)
    values[8000:10400, 1] = values[7999, 1]
    guard, valid, events = excluded(values)
    assert not valid[8080:10400, :2].any()
    assert valid[:, 2].all()
    assert (~valid[:, 0]).sum() < 2400 + 120
    assert [(e.kind, e.channel) for e in events] == [("stuck", 1)]
    guard = Guard(SENSORS, 40.0)
    guard.update(values[:9600])
    assert guard.stuck
    guard.update(values[9600:])
    assert not guard.stuck


def test_a_turning_table_is_not_rest() -> None:
    values = quiet(120)
    values[:, 2] += np.radians(10.0)
    guard, valid, _ = excluded(values)
    assert not guard.at_rest
    assert not valid[:, :2].any()


@pytest.mark.few
@pytest.mark.parametrize(("rate", "level"), [(100.0, 0.2), (400.0, 9.80665)])
def test_a_constant_axis_neither_moves_nor_is_disturbed_by_rounding(rate: float, level: float) -> None:
    n = int(60 * rate)
    noise = synthesise(n, rate, N=[1e-4] * 3, seed=3)
    constant = np.tile([0.0, level, level], (n, 1))
    guard = Guard(["gyro"] * 3 + ["accel"] * 3, rate)
    for at in range(0, n, 1000):
        guard.update(np.concatenate((noise[at : at + 1000], constant[at : at + 1000]), axis=1))
    guard.flush()
    assert guard.at_rest
    assert (guard.disturbances, guard.excluded) == (0, {})


def test_usual_repeats_are_not_stuck() -> None:
    """A magnetometer read faster than it measures, a constant channel, and one of three levels."""
    values = quiet(120, 800.0)
    values[:, 6:9] = values[::3, 6:9].repeat(3, axis=0)[: len(values)]
    guard, valid, _ = excluded(values, 800.0)
    assert valid.all()
    values = quiet(600)
    values[:, 6:9] = 0.25
    values[:, 3:6] = np.rint(values[:, 3:6] / 0.02) * 0.02
    values[:, :3] = np.rint(values[:, :3] / 4e-4) * 4e-4
    guard, valid, _ = excluded(values)
    assert valid.mean() > 1 - 1e-4
    assert guard.at_rest


def test_a_coarse_axis_is_not_stuck_where_its_level_is_in_the_middle_of_a_step() -> None:
    values = quiet(600)
    level = np.linspace(0.0, 4.0, len(values))
    values[:, 1] = 1e-3 * np.rint(level + 0.15 * values[:, 1] / SIGMA[1])
    _, _, events = excluded(values)
    assert "stuck" not in {event.kind for event in events}


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


def drive(seconds: float, rate: float = 40.0, seed: int = 3) -> Floats:
    """Return (n, 9) samples of a driving car: slow turns, rough road."""
    values = quiet(seconds, rate, seed)
    rng = np.random.default_rng(seed)
    n = len(values)
    rough = rng.standard_normal((n + 40, 9))
    rough = sum(rough[i : i + n] for i in range(40)) / 40**0.5
    values[:, :6] += rough[:, :6] * np.array([0.02] * 3 + [0.3] * 3)
    return values


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
    values = np.concatenate((quiet(60), drive(60)))
    guard = Guard(SENSORS, 40.0, excludes=False)
    items, events = run_guard(guard, values)
    assert all(item.valid.all() and not item.broken for item in items)
    assert events == []
    assert guard.excluded == {}
    assert not guard.at_rest


def test_a_new_noise_becomes_the_baseline() -> None:
    """An engine starts and keeps running: disturbed rest becomes valid again, behind a break."""
    values = quiet(200)
    t = np.arange(4000) / 40.0
    values[4000:, 3:6] += 0.1 * np.sin(2 * np.pi * 10.02 * t)[:, None]
    guard = Guard(SENSORS, 40.0)
    items, _ = run_guard(guard, values)
    valid = np.concatenate([item.valid for item in items])
    assert guard.at_rest
    assert valid[-60 * 40 :].all()
    assert sum(item.broken for item in items) == 1


def test_a_tilt_breaks_the_record() -> None:
    values = quiet(200)
    values[4000:, 4] += 0.5
    guard = Guard(SENSORS, 40.0)
    items, _ = run_guard(guard, values)
    valid = np.concatenate([item.valid for item in items])
    assert guard.at_rest
    assert sum(item.broken for item in items) == 1
    assert 10 * 40 < (~valid[:, 0]).sum() < 40 * 40


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


def recording(name: str, times: int = 1) -> Floats:
    """Return (n, 9) samples of a recording, repeated `times`."""
    path = RECORDINGS / f"{name}.vnymr.txt.gz"
    if not path.exists():
        pytest.skip("the recordings are not available")
    decoder = Vn100Decoder()
    items = decoder.feed(gzip.decompress(path.read_bytes()) * times) + decoder.finish()
    return np.concatenate([item.values for item in items if isinstance(item, SampleBlock)])


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
    values = recording(name)
    guard, valid, _ = excluded(values, 200.0 if name.startswith("chase") else 40.0)
    assert least <= valid[:, 0].mean() <= most
    if at_rest is not None:
        assert guard.at_rest is at_rest


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
        cascade = OctaveCascade(3, 1 / rate, groups=(0, 0, 0))
        guard = Guard(("gyro",) * 3, rate)
        items = (
            run_guard(guard, values, 8000)[0]
            if guarded
            else [GuardedSamples(values, np.ones((n, 1), dtype=bool))]
        )
        for piece in items:
            cascade.update(piece.values, piece.valid)
        sigma.append(cascade.result().sigma)
    assert np.abs(sigma[1][:4] / sigma[0][:4] - 1).max() < 1e-3
    assert np.abs(sigma[1][:14] / sigma[0][:14] - 1).max() < 0.1
    assert np.abs(sigma[2][0] / sigma[0][0] - 1).max() > 1.0
