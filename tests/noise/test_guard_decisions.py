"""Decisions of the guard: each excludes what it is for."""

from __future__ import annotations

import numpy as np

from imumon.model.samples import Floats
from imumon.noise.detection import Guard
from imumon.noise.detection.stuck import StuckWatch

BOTH = ("gyro",) * 3 + ("accel",) * 3
SIGMA = np.array([4e-4] * 3 + [1e-2] * 3)


def quiet(n: int, seed: int = 1) -> Floats:
    """Return (n, 6) white noise."""
    return np.asarray(SIGMA * np.random.default_rng(seed).standard_normal((n, 6)))


def guarded(values: Floats, rate: float) -> tuple[Guard, np.ndarray]:
    """Return the guard and (n,) the valid samples of the gyroscope."""
    watched, items = Guard(BOTH[: values.shape[1]], rate), []
    for begin in range(0, len(values), 4000):
        items += watched.update(values[begin : begin + 4000])
    return watched, np.concatenate([item.valid[:, 0] for item in items + watched.flush()])


def test_the_guard_begins_once() -> None:
    watched, short = Guard(BOTH, 100.0), Guard(BOTH, 100.0)
    waits = []
    for values in np.split(quiet(800), 8):
        watched.update(values)
        waits.append(watched.pending is not None)
    assert waits == [True] * 3 + [False] * 5
    short.flush()
    assert short.pending is not None  # nothing came
    short.update(quiet(150))
    short.flush()
    assert short.pending is None


def test_a_gap_does_not_change_whether_a_sensor_is_stuck() -> None:
    watch, stuck = StuckWatch([0], 10), np.ones((10, 1), dtype=bool)
    watch.update(stuck, ~stuck, 0)
    assert not watch.stuck
    watch.update(stuck, stuck, 10)
    watch.update(~stuck, ~stuck, 20)
    assert watch.stuck
    watch.update(~stuck, stuck, 30)
    assert watch.changes == [(20, True), (40, False)]


def test_an_outlier_of_both_sensors_at_once_is_a_knock() -> None:
    values = quiet(6000)
    values[3000] += 50.0 * SIGMA * [0, 1, 0, 0, 1, 0]
    watched, valid = guarded(values, 100.0)
    assert list(watched.excluded) == ["knock"]
    assert not valid[2960:3100].any()


def test_a_short_knock_costs_less_than_a_frame_and_its_margins() -> None:
    values = quiet(6000)
    values[3042:3048] += 30.0 * SIGMA
    _, valid = guarded(values, 100.0)
    assert 150 <= (~valid).sum() < 200
