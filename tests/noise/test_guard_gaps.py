"""Guard: what is counted over neighbouring frames ends at a gap."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from imumon.model.samples import Floats
from imumon.noise.detection import Guard
from imumon.noise.detection.disturbance import DetectorState, DisturbanceDetector

RATE = 40.0
FRAME = 40
GAPS: dict[str, Callable[[Guard], object]] = {
    "of ten frames": lambda guard: guard.skip(10 * FRAME),
    "of unknown length": lambda guard: guard.break_(),
    "of lost samples": lambda guard: guard.update(
        np.zeros((10 * FRAME, 3)), np.zeros((10 * FRAME, 1), dtype=bool)
    ),
}
gaps = pytest.mark.parametrize("gap", GAPS.values(), ids=list(GAPS))


def gyro(frames: int, deviation: float = 4e-4, seed: int = 1) -> Floats:
    """Return (n, 3) white noise, rad/s."""
    return np.asarray(deviation * np.random.default_rng(seed).standard_normal((frames * FRAME, 3)))


def detector_of(guard: Guard) -> DisturbanceDetector:
    return guard._detectors[0]


@gaps
def test_unusual_frames_on_both_sides_of_a_gap_are_not_counted_together(
    gap: Callable[[Guard], object],
) -> None:
    """Seven unusual frames before it and one behind it would be motion."""
    guard = Guard(("gyro",) * 3, RATE)
    guard.update(np.concatenate((gyro(60), gyro(7, 0.1))))
    gap(guard)
    guard.update(np.concatenate((gyro(1, 0.1), gyro(3, seed=2))))
    assert guard.at_rest
    assert guard.rest_changes() == []


@gaps
def test_candidates_for_a_new_baseline_are_neighbours(gap: Callable[[Guard], object]) -> None:
    """A record that begins in motion: only sixteen frames in a row can be the first rest."""
    guard, hand = Guard(("gyro",) * 3, RATE), 0.05 * np.sin(np.arange(32 * FRAME) / 30.0)
    guard.update(gyro(32) + hand[:, None])
    assert not guard.at_rest
    guard.update(gyro(10, seed=2))
    assert detector_of(guard)._candidates
    gap(guard)
    guard.update(gyro(1, seed=3))
    assert len(detector_of(guard)._candidates) <= 1
    assert (
        detector_of(guard).state is DetectorState.MOVING
    )  # nothing is known that a sensor at rest could be compared with
    guard.update(gyro(20, seed=4))
    assert guard.at_rest


@gaps
def test_a_gap_ends_motion_where_rest_is_known(gap: Callable[[Guard], object]) -> None:
    guard = Guard(("gyro",) * 3, RATE)
    guard.update(np.concatenate((gyro(60), gyro(20, 0.1))))
    assert not guard.at_rest
    gap(guard)
    guard.update(gyro(6, seed=2))
    assert guard.at_rest
    assert [rests for _, rests in guard.rest_changes()] == [False, True]
    gap(guard)
    items = (
        guard.update(gyro(20, 0.1)) + guard.flush()
    )  # motion that goes on behind a gap is excluded all the same
    assert not np.concatenate([item.valid for item in items])[:, 0][6 * FRAME :].any()


def test_a_short_gap_ends_nothing() -> None:
    guard = Guard(("gyro",) * 3, RATE)
    guard.update(np.concatenate((gyro(60), gyro(7, 0.1))))
    guard.skip(2 * FRAME)
    guard.update(gyro(2, 0.1))
    assert not guard.at_rest
