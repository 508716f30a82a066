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

Which samples are noise?
    `detection/`: `guard` (holds samples), `baseline` (at rest), `disturbance`, `outliers`, `stuck`, `exclusions`
How do averages over τ vary?
    `allan/`: `cascade`, `octave` (sums), `curve`
Which density, autocovariance and cosine coefficients have N, B and K?
    `power_law`, and `markov_law` of Gauss–Markov noise
How much power does each frequency have?
    `spectrum/`: `spectrum_accumulator` (levels), `level_sums` (for the fit), `power_spectrum` (for people)
Which bins are lines, of those that the fit masks and of those that the report names?
    `spectrum/spectral_lines`
What do the Welch sums expect of N, B and K?
    `spectrum/expectation`
What do missing samples let leak between frequencies?
    `spectrum/leakage`
How does the mean move?
    `blocks/block_means`
What is known of the noise of a record, or of a part?
    `noise_sums`
Which terms has the noise, and what does each statistic expect of them?
    `fit/model`
Which thresholds lie between data and numbers?
    the constants at the top of each module, with what goes wrong otherwise
What is compared with a model?
    `fit/observations`: bands and coefficients, and the frequency at which the two parts meet
What moves the mean and is not noise?
    `fit/slow_terms` (`SlowTermSearch`); `fit/regressors` (drift, temperature, settling, step, oscillation)
Which oscillations of the mean are real, and no alias of a line?
    `fit/oscillations`
How does the bias follow the temperature?
    `fit/bias_curve`
What is the upper end of the spectrum?
    `fit/search` (`ModelSearch`: filters, quantisation, the error of the model)
How likely are N, B and K, and which are their limits?
    `fit/likelihood`
What does the fit state in SI, with which status and caveats?
    `fit/statement`
Which Allan curve follows, and which limits has the measured one?
    `fit/curve_statement`, from the formulas of `fit/model_curve`
How long until a coefficient is precise enough?
    `fit/time_to_precision`
When is a fit due, and why is a coefficient pending?
    `fit/estimator`
What is known between two places of a record?
    `stretches/parts`; which places: `stretches/sums`
Has the sensor warmed up?
    `stretches/warmup`, decided in `stretches/sums`
How much do N, B and K move within the record?
    `stretches/quarters`
What did each hour and day show?
    `stretches/stretches`
Has N or B changed?
    `stretches/change`: halves, hours, a baseline, days of the history
How are the values distributed?
    `statistics/`: `moments`, `histogram`, `distribution_shape`, `differences` (kurtosis), `envelope` (signal
    view)
How good is the sensor?
    `grading` of `model`; `uncertainty` (what the limits of a fit do not hold)
Which numbers keep a Kalman filter consistent?
    `filter_parameters`; `filter_consistency` (NEES without simulation)
Which channels miss the same samples?
    `validity_groups`
How is an accumulator saved and restored?
    `imumon.model.saved_state`
What does noise of given N, B and K look like?
    `synthesis`
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
