"""Lost samples reduce the precision but keep all averaging times and do not bend the curve."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.model.samples import Bools, Floats
from imumon.noise.allan import OctaveCascade
from imumon.noise.fit import fit_curve
from imumon.noise.synthesis import synthesise

LENGTH, CHANNELS = 1 << 17, 12


def signal(kind: str) -> Floats:
    """Return (n, c) noise of one kind."""
    white = np.random.default_rng(0).standard_normal((LENGTH, CHANNELS))
    if kind == "flicker":
        return np.asarray(synthesise(LENGTH, 100.0, N=[0.0] * CHANNELS, B=1.0, K=0.0, seed=2))
    return np.asarray(white if kind == "white" else np.cumsum(white, axis=0))


def received(loss: float, run: int) -> Bools:
    """Return (n, 1) the validity when runs of about `run` samples are lost."""
    generator = np.random.default_rng(1)
    ok = np.ones(LENGTH, dtype=bool)
    if run == 1:
        return np.asarray(generator.random((LENGTH, 1)) > loss)
    at = 0
    while at < LENGTH:
        at += int(generator.exponential(run * (1.0 - loss) / loss)) + 1
        lost = int(generator.exponential(run)) + 1
        ok[at : at + lost] = False
        at += lost
    return ok[:, None]


@pytest.mark.parametrize(
    ("kind", "loss", "run"),
    [
        ("white", 0.05, 1),
        ("white", 0.5, 1),
        ("white", 0.1, 100),
        ("flicker", 0.2, 1),
        ("walk", 0.5, 1),
        ("walk", 0.1, 100),
    ],
)
def test_loss_does_not_bend_the_curve(kind: str, loss: float, run: int) -> None:
    values, ok = signal(kind), received(loss, run)
    whole, part = OctaveCascade(CHANNELS, 0.01), OctaveCascade(CHANNELS, 0.01)
    whole.update(values)
    part.update(values, ok)
    expected, curve = whole.result(), part.result()
    assert len(curve.m) == len(expected.m)
    ratio = curve.avar[:13].mean(axis=1) / expected.avar[:13].mean(axis=1)
    enough = curve.terms[:13, 0] > 1000 / curve.m[:13]
    assert np.abs(ratio[enough] - 1.0).max() < (0.1 if loss < 0.5 else 0.15)
    assert np.abs(ratio[4:9] - 1.0).max() < 0.08


@pytest.mark.few
@pytest.mark.parametrize(("loss", "run"), [(0.01, 1), (0.1, 1), (0.3, 1), (0.5, 1), (0.1, 100)])
def test_limits_hold_the_truth_with_missing_samples(loss: float, run: int) -> None:
    """95 % of 12; fewer than 9 once in 500 runs. Loss costs precision, at the upper end of the spectrum first."""
    values = synthesise(LENGTH, 40.0, N=[6.1e-5] * CHANNELS, B=2.4e-5, seed=8)
    whole, part = OctaveCascade(CHANNELS, 1 / 40), OctaveCascade(CHANNELS, 1 / 40)
    whole.update(values)
    part.update(values, received(loss, run))
    complete, fits = (fit_curve(each.result(), averaged=True, time_to=False) for each in (whole, part))
    for name, truth in (("N", 6.1e-5), ("B", 2.4e-5)):
        limits = [(getattr(fit, name).low, getattr(fit, name).high) for fit in fits]
        assert sum(low <= truth <= high for low, high in limits) >= 9, name
        size, one = (
            np.median([getattr(fit, name).high - getattr(fit, name).low for fit in each])
            for each in (fits, complete)
        )
        assert size < (2.0 if loss <= 0.1 else 6.0) * one, name
    assert sum(fit.K.status == "measured" for fit in fits) <= 2


def test_long_holes_cost_the_samples_that_are_missing_and_no_more() -> None:
    """A sixth of an hour in twenty holes of half a minute: they lie in each of the lower segments."""
    values = synthesise(144_000, 40.0, N=[6e-5] * CHANNELS, B=2.4e-5, K=4e-5, seed=5, averaged=False)
    ok = np.ones((144_000, 1), dtype=bool)
    for begin in np.random.default_rng(3).integers(0, 142_800, 20).tolist():
        ok[begin : begin + 1200] = False
    whole, part = OctaveCascade(CHANNELS, 1 / 40), OctaveCascade(CHANNELS, 1 / 40)
    whole.update(values)
    part.update(values, ok)
    complete, fits = (fit_curve(each.result(), averaged=False, time_to=False) for each in (whole, part))
    size, one = (np.median([fit.K.high - fit.K.low for fit in each]) for each in (fits, complete))
    assert size < 1.4 * one
    assert sum("model_misses" in fit.caveats for fit in fits) <= 1
    for name, truth in (("N", 6e-5), ("B", 2.4e-5), ("K", 4e-5)):
        limits = [(getattr(fit, name).low, getattr(fit, name).high) for fit in fits]
        assert sum(low <= truth <= high for low, high in limits) >= 9, name
