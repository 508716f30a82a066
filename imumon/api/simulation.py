"""Simulation: samples of a sensor at rest whose noise is known, for tests of what analyses them.

>>> simulate(5, 100.0, N=1e-3, seed=1).shape, simulate(5, 100.0, N=[1e-3, 2e-3, 1e-3], seed=1).shape
((5,), (5, 3))
"""

from __future__ import annotations

import math

import numpy as np

from imumon.model.errors import ImumonError
from imumon.model.samples import Floats
from imumon.noise.synthesis import Seed, Strength, markov_noise, synthesise


def simulate(
    n: int,
    rate_hz: float,
    N: Strength = 0.0,
    B: Strength = 0.0,
    K: Strength = 0.0,
    *,
    markov: tuple[float, float] | None = None,
    quantum: float | None = None,
    ramp: float = 0.0,
    temperature: tuple[Floats, float] | None = None,
    bias: Strength = 0.0,
    averaged: bool = True,
    seed: Seed = None,
) -> Floats:
    """Return samples with noise of known coefficients.

    Parameters
    ----------
    n : samples.
    rate_hz : Hz, sample rate.
    N, B, K : unit/sqrt(Hz), unit and unit*sqrt(Hz), for one channel, or one number for each.
    markov : unit and s, standard deviation and time constant of correlated noise.
    quantum : unit, step to which the samples are rounded; None: they are not.
    ramp : unit/s, drift.
    temperature : (n,) degC and unit/degC, temperatures and the slope of the bias against them.
    bias : unit, mean at the start, for one channel, or one number for each.
    averaged : samples are means over their intervals, as of an integrating sensor, else values at instants.
    seed : of the generator, or the generator.

    Returns
    -------
    (n,) of one channel, (n, c) of several.

    Raises
    ------
    ImumonError : a number has no meaning.
    """
    if n < 1:
        raise ImumonError("simulation_invalid", f"n={n!r} is no number of samples", "give at least 1")
    rng = np.random.default_rng(seed)
    strengths = np.broadcast_arrays(*(np.atleast_1d(np.asarray(x, np.float64)) for x in (N, B, K, bias)))
    try:
        white, flicker, walk, _ = strengths
        samples = synthesise(n, rate_hz, white, flicker, walk, rng, averaged=averaged)
    except ValueError as error:
        cure = "give a positive rate_hz, and N, B and K of 0 or more"
        raise ImumonError("simulation_invalid", str(error), cure) from None
    samples += strengths[3]
    if markov is not None:
        sigma, time_constant_s = markov
        if not (sigma >= 0.0 and 0.0 < time_constant_s < math.inf):
            cure = "give the standard deviation and the time constant in s"
            raise ImumonError("simulation_invalid", f"markov={markov!r} is no process", cure)
        for channel in range(samples.shape[1]):
            samples[:, channel] += sigma * markov_noise(n, rate_hz, time_constant_s, rng, averaged=averaged)
    slow = ramp * np.arange(n) / rate_hz
    if temperature is not None:
        degrees = np.asarray(temperature[0], np.float64)
        if degrees.shape != (n,):
            text = f"the temperatures have the shape {degrees.shape}"
            raise ImumonError("simulation_invalid", text, f"give one for each of the {n:,} samples")
        slow = slow + temperature[1] * (degrees - degrees[0])
    samples += slow[:, None]
    if quantum is not None:
        if not 0.0 < quantum < math.inf:
            raise ImumonError(
                "simulation_invalid", f"quantum={quantum!r} is no step", "give the step, or leave it out"
            )
        samples = quantum * np.rint(samples / quantum)
    return samples[:, 0] if len(strengths[0]) == 1 else samples
