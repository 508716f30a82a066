"""Noise of a sensor at rest: Allan deviation, N, B and K with honest intervals, live and in a few kilobytes.

Pure mathematics on arrays: no I/O, no clock, no threads; numpy alone. Samples go in, in blocks of any length,
and at any time one may ask. A record of two seconds or of two months is the same five lines:

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

The curve itself, with 95 % limits, what the model says of it and which octaves it rests on:

>>> curve = cascade.result()
>>> for tau, sigma, low, high in list(zip(curve.tau, curve.sigma[:, 0], fit.low, fit.high))[::5]:
...     print(f"{tau:8.3f} s  {sigma:.2e}  [{low:.2e}, {high:.2e}]")
   0.005 s  8.63e-04  [8.58e-04, 8.68e-04]
   0.160 s  1.51e-04  [1.48e-04, 1.54e-04]
   5.120 s  3.21e-05  [2.87e-05, 3.64e-05]
 163.840 s  7.20e-06  [3.77e-06, 2.96e-05]
>>> bool(fit.used.all()), fit.caveats
(True, ())

`averaged` says what a sample is: the true average over its interval (delta angle over its time), or a
point sample. Missing samples are `cascade.update(block, valid)` or `cascade.skip(n)`, a gap of unknown
length is `cascade.break_()`. What is not known is None with a reason, never 0 and never NaN.

| room | what |
|---|---|
| `allan/` | the octave cascade: Allan variance of an endless stream, from several starts |
| `fit/` | `Estimator`: N, B, K from exact covariances, with limits, and the time still needed |
| `grade` | navigation, tactical, industrial or consumer |
| `signal/` | moments, histogram, spectrum and its lines, strip chart |
| `guards/` | knocks, stuck and repeated samples, loops: cut out before they reach a sum |
| `history/` | hour against hour: drift, warm-up, what has changed |
| `groups` | channels that miss the same samples |
| `synthesis` | noise of given N, B, K |
"""

from imumon.noise.allan import AllanCurve, OctaveCascade
from imumon.noise.fit import ChannelFit, Coefficient, Estimator, TimeTo, fit_curve
from imumon.noise.fit.slope_reading import Readings, read_slopes
from imumon.noise.synthesis import NoiseStream, synthesise

__all__ = [
    "AllanCurve",
    "ChannelFit",
    "Coefficient",
    "Estimator",
    "NoiseStream",
    "OctaveCascade",
    "Readings",
    "TimeTo",
    "fit_curve",
    "read_slopes",
    "synthesise",
]
