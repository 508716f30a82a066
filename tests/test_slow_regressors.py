"""A drift or a temperature that the block means show does not change N, B and K of the curve."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.noise.allan import AllanCurve, OctaveCascade
from imumon.noise.fit import Estimator
from imumon.noise.fit.restricted_likelihood import BlockMeans
from imumon.noise.fit.slow_regressors import without_slow_regressors
from imumon.noise.nonstationarity.drift import DriftAccumulator
from imumon.noise.synthesis import synthesise
from imumon.samples import Floats

RATE, N, B = 4.0, 6.1e-5, 2.4e-5
AT_S = np.arange(32_000) / RATE
DEGREES = 25.0 + 3.0 * np.sin(2.0 * np.pi * AT_S / 5000.0)
SLOW = {"ramp": 1e-7 * AT_S, "temperature": 1e-4 * DEGREES, "both": 1e-7 * AT_S + 1e-4 * DEGREES}


def record(values: Floats) -> tuple[AllanCurve, BlockMeans]:
    count = values.shape[1]
    cascade, drift = OctaveCascade(count, tau0=1.0 / RATE), DriftAccumulator([0] * (count + 1), RATE, count)
    cascade.update(values)
    drift.update(np.column_stack((values, DEGREES)))
    return cascade.result(), drift.blocks(count)


@pytest.mark.parametrize("effect", SLOW)
@pytest.mark.parametrize("K", [0.0, 5e-6])
def test_slow_regressors_leave_the_limits_of_the_noise(effect: str, K: float) -> None:
    noise = synthesise(len(AT_S), RATE, N=[N] * 12, B=B, K=K, seed=3, averaged=False)
    clean, slow = (
        Estimator(averaged=False, time_to=False).fit(curve, blocks=blocks)
        for curve, blocks in (record(noise), record(noise + SLOW[effect][:, None]))
    )
    for name, one in (("N", 0.005), ("B", 0.3), ("K", 0.3)):
        highs = np.array([[getattr(fit, name).high for fit in fits] for fits in (clean, slow)], dtype=float)
        assert abs(float(np.median(highs[1] / highs[0])) - 1.0) < one
    held = [fit.B.low <= B <= fit.B.high for fit in slow if fit.B.low is not None and fit.B.high is not None]
    assert sum(held) >= 10


def test_a_curve_without_slow_terms_stays_as_it_is() -> None:
    curve, blocks = record(synthesise(len(AT_S), RATE, N=[N] * 12, B=B, seed=4, averaged=False))
    variance, extra = without_slow_regressors(curve, blocks)
    same = (variance == curve.avar.T).all(axis=1)
    assert same.sum() >= 9
    assert not extra[same].any()
