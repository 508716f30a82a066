"""States and decisions of the guard: each transition happens, and each decision excludes what it is for."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.noise.detection import Guard, disturbance, guard
from imumon.noise.detection.disturbance import DisturbanceDetector
from imumon.noise.detection.stuck import StuckWatch
from imumon.samples import Floats

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


# ---------------------------------------------------------------------- the tables of states


def seen_transitions(values: Floats, monkeypatch: pytest.MonkeyPatch) -> set[tuple[object, object]]:
    """Return the states and events of a detector that assesses (frames, 3) noise of a gyroscope, rad/s."""
    seen: set[tuple[object, object]] = set()
    go = DisturbanceDetector._go

    def note(detector: DisturbanceDetector, event: disturbance.DetectorEvent) -> None:
        seen.add((detector.state, event))
        go(detector, event)

    monkeypatch.setattr(DisturbanceDetector, "_go", note)
    guarded(values, 100.0)
    return seen


def record_of(name: str) -> Floats:
    """Return ten minutes of a gyroscope, and what happens from the third minute on."""
    values, rng = quiet(60_000)[:, :3], np.random.default_rng(2)
    later, time_s = values[18_000:], np.arange(42_000) / 100.0
    if name == "noisier axis":  # for good, or for 12 s
        later[:, 0] *= 3.0
    elif name == "noisier for a while":
        later[:1200, 0] *= 3.0
    elif name == "tilt":
        later[:, 1] += 1e-2
    elif name == "motion":
        later[:1500] += 0.05 * np.sin(time_s[:1500, None])
    elif name == "one axis, then all":
        later[:3000, 0] += 3e-3 * rng.standard_normal(3000)
        later[1000:3000] += 0.05 * np.sin(time_s[:2000, None])
    elif name == "slow":
        values += 4e-4 * np.cumsum(0.02 * rng.standard_normal(values.shape), axis=0)
        values += 2e-3 * np.cumsum(rng.standard_normal((600, 3)), axis=0).repeat(100, axis=0)
    return values


RECORDS = ("noisier axis", "noisier for a while", "tilt", "motion", "one axis, then all", "slow")


def test_the_table_of_the_detector_has_the_transitions_that_happen(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = set().union(*(seen_transitions(record_of(name), monkeypatch) for name in RECORDS))
    assert seen == set(disturbance.TRANSITIONS)


@pytest.mark.parametrize("module", [disturbance, guard], ids=["disturbance", "guard"])
def test_the_theory_shows_the_table_of_transitions(module: object) -> None:
    """Each row of the docstring is a row of the table that the code uses, with a method of this name."""
    transitions = module.TRANSITIONS  # type: ignore[attr-defined]
    words = [line.split() for line in (module.__doc__ or "").splitlines()]  # type: ignore[attr-defined]
    names = {state.name for state, _ in transitions}
    rows = [row for row in words if len(row) > 4 and row[0] in names and row[1].isupper()]
    shown = {(row[0], row[1]): row[2] for row in rows}
    assert shown == {(s.name, e.name): target.name for (s, e), target in transitions.items()}
    owner = Guard if module is guard else DisturbanceDetector
    assert all(callable(getattr(owner, row[3])) for row in rows)


def test_the_guard_begins_once() -> None:
    watched = Guard(BOTH, 100.0)
    states = []
    for values in np.split(quiet(800), 8):
        watched.update(values)
        states.append(watched.state)
    assert states == [guard.GuardState.BEGINNING] * 3 + [guard.GuardState.RUNNING] * 5
    short = Guard(BOTH, 100.0)
    short.flush()
    assert short.state is guard.GuardState.BEGINNING  # nothing came
    short.update(quiet(150))
    short.flush()
    assert short.state is guard.GuardState.RUNNING


def test_a_gap_does_not_change_whether_a_sensor_is_stuck() -> None:
    watch, stuck = StuckWatch([0], 10), np.ones((10, 1), dtype=bool)
    watch.update(stuck, ~stuck, 0)
    assert not watch.stuck
    watch.update(stuck, stuck, 10)
    watch.update(~stuck, ~stuck, 20)
    assert watch.stuck
    watch.update(~stuck, stuck, 30)
    assert watch.changes == [(20, True), (40, False)]


# ---------------------------------------------------------------------- what no other test of the guard decides


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


def test_a_little_more_noise_is_no_knock_at_a_high_rate() -> None:
    values = quiet(40_000)
    values[20_000:22_000] *= 1.35
    _, valid = guarded(values, 400.0)
    assert valid.all()


def test_white_motion_of_a_shaker_is_no_rest() -> None:
    assert not guarded(2500.0 * quiet(6000)[:, :3], 100.0)[0].at_rest
