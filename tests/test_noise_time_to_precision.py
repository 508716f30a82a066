"""Laws of the time to a precision: only measured coefficients have one."""

from __future__ import annotations

import numpy as np

from imumon.noise.allan import OctaveCascade
from imumon.noise.fit import fit_curve
from imumon.noise.synthesis import synthesise


def test_an_absent_coefficient_has_no_time() -> None:
    """White noise alone: B and K are bounded at best, and no longer record measures them."""
    values = np.asarray(np.random.default_rng(5).standard_normal((40_000, 40)))
    cascade = OctaveCascade(40, tau0=1 / 40)
    cascade.update(values)
    measured = 0
    for fit in fit_curve(cascade.result(), averaged=False):
        for name in ("B", "K"):
            is_measured = getattr(fit, name).status == "measured"
            measured += is_measured
            assert is_measured or getattr(fit.time_to, name) is None
        assert fit.time_to.N is not None
    assert measured <= 8  # of 80, at 2.5 % each


def test_measured_coefficients_have_a_time() -> None:
    values = synthesise(72_000, 40.0, N=[6.1e-5] * 8, B=2.4e-5, K=0.0, seed=3)
    cascade = OctaveCascade(8, tau0=1 / 40)
    cascade.update(values)
    fits = fit_curve(cascade.result(), averaged=False)
    assert sum(fit.B.status == "measured" and fit.time_to.B is not None for fit in fits) >= 6
