"""Lost samples reduce the precision but keep all averaging times and do not bend the curve."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.noise.allan import OctaveCascade
from imumon.noise.fit import fit_curve
from imumon.noise.synthesis import synthesise
from imumon.samples import Bools, Floats

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


@pytest.mark.parametrize("kind", ["white", "flicker", "walk"])
@pytest.mark.parametrize(("loss", "run"), [(0.05, 1), (0.2, 1), (0.5, 1), (0.1, 100)])
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


def test_n_and_b_are_measured_with_half_of_the_samples() -> None:
    values = synthesise(LENGTH * 2, 40.0, N=[6.1e-5] * 6, B=2.4e-5, K=0.0, seed=8)
    ok = np.random.default_rng(2).random((len(values), 1)) > 0.5
    cascade = OctaveCascade(6, 1 / 40)
    cascade.update(values, ok)
    for fit in fit_curve(cascade.result(), averaged=False):
        assert fit.N.value == pytest.approx(6.1e-5, rel=0.03)
        assert fit.B.status == "measured"
        assert fit.B.value == pytest.approx(2.4e-5, rel=0.35)
