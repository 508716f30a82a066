"""Rest and motion: noise of any sensor is rest, and motion of any sensor is motion."""

from __future__ import annotations

import numpy as np
import pytest
import scipy

from imumon.model.samples import Bools, Floats
from imumon.noise.detection import Guard
from imumon.noise.detection.baseline import PARTS, FrameStatistics

GYRO = ("gyro",) * 3
BOTH = GYRO + ("accel",) * 3
LEVEL = np.array([0.01, 0.0, -0.02, 0.0, 0.1, -9.8])


def run(
    values: Floats, rate: float, sensors: tuple[str, ...] = BOTH, received: Bools | None = None
) -> tuple[Guard, Bools]:
    """Return the guard after the record and (n,) the valid samples; `received` is (n, g)."""
    guard, items = Guard(sensors, rate), []
    for at in range(0, len(values), 8000):
        rows = slice(at, at + 8000)
        items += guard.update(values[rows], None if received is None else received[rows])
    return guard, np.concatenate([item.valid[:, 0] for item in items + guard.flush()])


def at_rest(seconds: float, rate: float, gyro: float, accel: float, seed: int = 1) -> Floats:
    """Return (n, 6) white noise of the deviations `gyro`, deg/s, and `accel`, m/s^2, about a level."""
    noise = np.random.default_rng(seed).standard_normal((round(seconds * rate), 6))
    return np.asarray(LEVEL + noise * ([np.radians(gyro)] * 3 + [accel] * 3))


def carried(n: int, rate: float, seed: int) -> Floats:
    """Return (n, 6) rates and accelerations of a hand: noise of 1 Hz and of tremor at 8 Hz."""
    rng = np.random.default_rng(seed)
    slow, drive = np.exp(-2.0 * np.pi / rate), rng.standard_normal((n, 6))
    slow_motion = scipy.signal.lfilter([np.sqrt(1.0 - slow**2)], [1.0, -slow], drive, axis=0)
    tremor = np.sin(2.0 * np.pi * 8.0 * np.arange(n)[:, None] / rate + rng.random(6))
    return np.asarray((slow_motion + 0.1 * tremor) * ([0.1] * 3 + [0.5] * 3))


@pytest.mark.few
@pytest.mark.parametrize(
    ("rate", "deviation"), [(50.0, 0.2), (50.0, 5.0), (100.0, 1.0), (100.0, 2.0), (400.0, 0.2), (400.0, 5.0)]
)
def test_white_noise_of_any_size_is_rest(rate: float, deviation: float) -> None:
    """A deviation of deg/s, and 0.3 m/s^2 beside it: no sample of an hour is excluded."""
    for seed in range(2):
        guard, valid = run(at_rest(3600.0 if rate < 400.0 else 1200.0, rate, deviation, 0.3, seed), rate)
        assert guard.at_rest
        assert valid.all()
        assert guard.rest_changes() == []


@pytest.mark.few
@pytest.mark.parametrize("rate", [100.0, 400.0])
def test_noise_behind_the_filter_of_a_sensor_is_rest(rate: float) -> None:
    """White noise behind a low pass of 20 Hz: neighbouring samples differ by less than those of white noise."""
    pole = np.exp(-2.0 * np.pi * 20.0 / rate)
    white = at_rest(1200.0, rate, 5.0, 0.3)
    guard, valid = run(scipy.signal.lfilter([1.0 - pole], [1.0, -pole], white - LEVEL, axis=0) + LEVEL, rate)
    assert guard.at_rest
    assert valid.all()


@pytest.mark.few
@pytest.mark.parametrize("rate", [7.0, 10.0, 40.0, 100.0, 400.0])
@pytest.mark.parametrize("share", [1.0, 0.6])
def test_white_noise_predicts_the_deviation_of_the_mean(rate: float, share: float) -> None:
    """With and without lost samples, and where a part is a single one; the lesser of two estimates is low."""
    part = max(1, round(rate / PARTS))
    rng = np.random.default_rng(1)
    d = rng.standard_normal((1, 2000, PARTS, part))
    usable = rng.random(d.shape[1:]) < share
    frames = FrameStatistics.of(d * usable, None if share == 1.0 else usable, np.zeros(1))
    assert np.median(frames.white) * np.sqrt(PARTS * part) == pytest.approx(1.0, rel=0.2)


@pytest.mark.few
@pytest.mark.parametrize("rate", [40.0, 100.0, 400.0])
@pytest.mark.parametrize("deviation", [0.02, 1.0])
def test_a_record_that_begins_in_the_hand_is_motion(rate: float, deviation: float) -> None:
    """Both for a quiet sensor and for a noisy one, until it is set down."""
    values = at_rest(120.0, rate, deviation, 0.01 if deviation < 1.0 else 0.1)
    half = len(values) // 2
    values[:half] += carried(half, rate, 1)
    guard, valid = run(values, rate)
    assert valid[: round(55.0 * rate)].mean() < 0.1
    assert valid[round(90.0 * rate) :].all()
    assert guard.at_rest


@pytest.mark.few
@pytest.mark.parametrize(("turn", "deviation"), [(0.3, 0.05), (0.3, 0.2), (2.0, 1.0)])
def test_a_slow_rotation_is_excluded(turn: float, deviation: float) -> None:
    """Of 30 s: the noise of the sensor decides what is slow."""
    rate = 100.0
    values = at_rest(300.0, rate, deviation, 0.02)
    values[12_000:15_000, 2] += np.radians(turn)
    guard, valid = run(values, rate)
    assert valid[12_000:14_400].mean() < 0.05
    assert valid[:11_800].all()
    assert valid[-10_000:].all()
    assert guard.at_rest
    assert "motion" in guard.excluded


@pytest.mark.few
@pytest.mark.parametrize("deviation", [0.05, 1.0])
def test_a_sensor_that_is_picked_up_and_put_back(deviation: float) -> None:
    rate = 100.0
    values = at_rest(300.0, rate, deviation, 0.02)
    values[12_000:14_000] += carried(2000, rate, 2)
    guard, valid = run(values, rate)
    assert not valid[12_100:13_900].any()
    assert valid[:11_900].all()
    assert valid[-10_000:].all()
    assert guard.at_rest


def test_a_shaker_is_not_at_rest() -> None:
    """White noise as rest has, of a size that no sensor has."""
    guard, valid = run(at_rest(60.0, 100.0, 57.0, 0.02), 100.0)
    assert not guard.at_rest
    assert not valid.any()


def test_a_knock_on_a_noisy_sensor_is_excluded() -> None:
    rate = 100.0
    values = at_rest(300.0, rate, 2.0, 0.3)
    values[12_000:12_050] += 20.0 * (values[12_000:12_050] - LEVEL)
    guard, valid = run(values, rate)
    assert not valid[12_000:12_050].any()
    assert (~valid).sum() < 500
    assert [event.kind for event in guard.events()] == ["knock"]
