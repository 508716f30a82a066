"""Noise of a sensor at rest: Allan deviation, N, B and K with 95 % limits, live and in bounded memory.

Mathematics on arrays: no I/O, no clock, no threads. Samples are added in blocks of any length, and results
are available at any time. The same five lines serve a record of two seconds and one of two months:

>>> import numpy as np
>>> from imumon.noise import Estimator, OctaveCascade, synthesise
>>> gyro = synthesise(100_000, rate_hz=200.0, N=6.1e-5, B=2.4e-5, seed=1)  # rad/s, true averages
>>> cascade, estimator = OctaveCascade(1, tau0=1 / 200.0), Estimator(averaged=True)
>>> for block in np.split(gyro.reshape(-1, 1), 100):
...     cascade.update(block)
>>> fit = estimator.fit(cascade.result())[0]
>>> f"N = {fit.N.value:.2e} [{fit.N.low:.2e}, {fit.N.high:.2e}] {fit.N.status}"
'N = 6.08e-05 [6.05e-05, 6.11e-05] measured'
>>> f"K < {fit.K.high:.0e} {fit.K.status}"
'K < 8e-06 upper_bound'

The curve with its 95 % limits, the octaves that the fit uses and the caveats:

>>> curve = cascade.result()
>>> for tau, sigma, low, high in list(zip(curve.tau, curve.sigma[:, 0], fit.low, fit.high))[::5]:
...     print(f"{tau:8.3f} s  {sigma:.2e}  [{low:.2e}, {high:.2e}]")
   0.005 s  8.63e-04  [8.58e-04, 8.68e-04]
   0.160 s  1.51e-04  [1.48e-04, 1.54e-04]
   5.120 s  3.21e-05  [2.87e-05, 3.64e-05]
 163.840 s  7.20e-06  [3.85e-06, 2.76e-05]
>>> bool(fit.used.all()), fit.caveats
(True, ())

`averaged` says what a sample is: the true average over its interval (delta angle over its time), or a point
sample. Missing samples are `cascade.update(block, valid)` or `cascade.skip(n)`, a gap of unknown length is
`cascade.break_()`. An unknown value is None with a reason, never 0 and never NaN. A curve of another record
restarts the estimator: it never returns limits of one record for another.

| package | content |
|---|---|
| `allan/` | octave cascade: Allan variance of an endless stream, also since several starts |
| `noise_sums` | what the fit sees of a record, or of a part of it |
| `spectrum/` | Welch sums of the levels, bins that are lines, their expectation |
| `blocks/` | means over blocks that merge in pairs |
| `markov_law` | the same of Gauss–Markov noise of standard deviation 1 |
| `power_law` | density, autocovariance and cosine coefficients of N = B = K = 1 |
| `fit/` | `Estimator`: the likelihood of N, B and K, with limits, and the time to a precision |
| `statistics/` | moments, histogram, envelope |
| `detection/` | disturbances, stuck and repeated samples, excluded before they reach a sum |
| `stretches/` | parts of a record: quarters, hours, days, warm-up, changes |
| `filter_consistency` | predicted consistency (NEES) of a Kalman filter with given noise parameters |
| `filter_parameters` | numbers that keep a Kalman filter consistent |
| `uncertainty` | what the limits of a fit do not hold |
| `validity_groups` | channels that miss the same samples |
| `synthesis` | noise of given N, B, K |
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from imumon.noise.allan import AllanCurve, OctaveCascade
    from imumon.noise.fit import ChannelFit, Estimator, fit_curve, read_slopes
    from imumon.noise.synthesis import NoiseStream, synthesise

__all__ = [
    "AllanCurve",
    "ChannelFit",
    "Estimator",
    "NoiseStream",
    "OctaveCascade",
    "fit_curve",
    "read_slopes",
    "synthesise",
]


def __getattr__(name: str) -> Any:
    """Import the module of a name at its first use: the fit needs scipy, the synthesis of noise does not."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    owner = "allan" if name in ("AllanCurve", "OctaveCascade") else "fit"
    owner = "synthesis" if name in ("NoiseStream", "synthesise") else owner
    return getattr(import_module(f"{__name__}.{owner}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
