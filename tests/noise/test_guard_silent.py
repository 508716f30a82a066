"""Guard: an axis without noise, constant or held for many samples, decides nothing for the others."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.model.samples import Bools, Floats
from imumon.noise.detection import Guard

SENSORS = ("gyro",) * 3 + ("accel",) * 3
SIGMA = np.array([4e-4] * 3 + [1e-2] * 3)
LEVEL = np.array([0.01, 0.0, -0.02, 0.0, 0.1, -9.8])


def quiet(rate: float, scale: float = 1.0) -> Floats:
    """Return (n, 6) ten minutes of white noise about a level."""
    white = np.random.default_rng(1).standard_normal((round(600 * rate), 6))
    return np.asarray(LEVEL + scale * SIGMA * white * np.sqrt(rate / 40.0))


def guarded(values: Floats, rate: float) -> tuple[Guard, Bools]:
    """Return the guard and (n, 2) what it passes."""
    guard, items = Guard(SENSORS, rate), []
    for begin in range(0, len(values), 997):
        items += guard.update(values[begin : begin + 997])
    return guard, np.concatenate([item.valid for item in items + guard.flush()])


@pytest.mark.parametrize("level", [0.0, 0.5])
def test_a_constant_axis_is_no_motion(level: float) -> None:
    """0.5 rad/s would be a turn, if the axis showed that it measures."""
    values = quiet(40.0)
    values[:, 1] = level
    guard, valid = guarded(values, 40.0)
    assert valid.all()
    assert guard.at_rest


@pytest.mark.few
@pytest.mark.parametrize("late", [0, 3], ids=["with the frames", "between them"])
@pytest.mark.parametrize("channel", [1, 5])
@pytest.mark.parametrize(("rate", "scale"), [(10.0, 1.0), (40.0, 1.0), (40.0, 10.0), (200.0, 10.0)])
def test_a_held_axis_is_neither_knock_nor_motion(rate: float, scale: float, channel: int, late: int) -> None:
    """One axis is updated once a second: its steps of any size are its noise."""
    values, period = quiet(rate, scale), round(rate)
    values[:, channel] = np.roll(values[::period, channel].repeat(period), late)
    guard, valid = guarded(values, rate)
    assert valid.mean() > 0.995
    assert guard.at_rest


def test_the_other_axes_still_decide_beside_a_held_one() -> None:
    values = quiet(40.0)
    values[:, 1] = values[::40, 1].repeat(40)
    values[12_000:12_080, 4] += 0.1 * np.random.default_rng(2).standard_normal(80)
    values[18_000:19_200, 0] += 0.05 * np.sin(np.arange(1200) / 40.0)
    guard, valid = guarded(values, 40.0)
    assert not valid[12_000:12_080].any()
    assert not valid[18_040:19_160].any()
    assert (~valid[:, 0]).sum() < 2200
    assert set(guard.excluded) == {"knock", "motion"}


def test_a_coarse_axis_that_repeats_as_often_shows_a_knock() -> None:
    values, step = quiet(40.0), 0.05
    values[:, 5] = np.rint(values[:, 5] / step) * step  # sigma of a fifth of a step: 98 % repeats
    assert np.mean(np.diff(values[:, 5]) == 0.0) > 0.95
    values[12_000:12_040, 5] += 4.0 * step
    _, valid = guarded(values, 40.0)
    assert not valid[12_000:12_040].any()
    assert (~valid[:, 0]).sum() < 200
