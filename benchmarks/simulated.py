"""Simulated records of known truth, and their fits: a cell is one length, rate and K.

Every record passes `OctaveCascade` as a column, a dozen at a time. Seeds are 0, 1, 2 ... and were never looked at for
choosing anything; the noise of a seed does not depend on K.
"""

from __future__ import annotations

import math
import multiprocessing.pool
from dataclasses import dataclass

import numpy as np

from imumon.noise import AllanCurve, ChannelFit, Estimator, OctaveCascade, synthesise
from imumon.noise.fit.likelihood import grid_mean, quantiles
from imumon.noise.fit.model import GRIDDED, NOISE_TERMS, WHITE

N, B = 6.1e-5, 2.4e-5
LONGEST = 720_000
BATCH = 12


def components(seed: int, n: int = LONGEST) -> np.ndarray:
    """(3, n) white noise, flicker and walk of unit strength at unit rate."""
    generator = np.random.default_rng([20_260, seed])
    unit = np.eye(3)
    return np.array([synthesise(n, 1.0, *row, seed=generator, averaged=False).ravel() for row in unit])


def strengths(K: float, rate: float) -> np.ndarray:
    """(3,) what the unit components are multiplied by."""
    return np.array([N * math.sqrt(rate), B, K / math.sqrt(rate)])


def curve_of(values: np.ndarray, rate: float) -> AllanCurve:
    """Curve of columns (n, c), with the sums of their noise."""
    cascade = OctaveCascade(values.shape[1], tau0=1.0 / rate)
    cascade.update(values)
    return cascade.result()


def points(estimator: Estimator, channel: int, rate: float) -> np.ndarray:
    """(3,) point estimates in SI, also of what is only bounded; NaN without a fit."""
    known = estimator._known.get(channel)
    if known is None or isinstance(known.fitted, str):
        return np.full(3, math.nan)
    surface = known.fitted.model.surface
    white = max(float(grid_mean(surface, surface.scored[WHITE], surface.scored_variances[WHITE])[0]), 0.0)
    both = [float(quantiles(surface, term, np.array([0.5]))[0]) for term in GRIDDED]
    return np.array([math.sqrt(white / rate), both[0], both[1] * math.sqrt(rate)])


@dataclass
class Cell:
    """Fits of one length, rate and K over all records."""

    duration: str
    n: int
    rate: float
    K: float
    values: np.ndarray  # (r, 3) point estimates in SI
    low: np.ndarray
    high: np.ndarray
    measured: np.ndarray  # (r, 3) bool
    inside: np.ndarray  # (r, k) bool, truth within the limits of sigma
    whole: np.ndarray  # (r,) bool, no octave left out, no caveat


def row_of(fit: ChannelFit, point: np.ndarray, truth: np.ndarray) -> tuple[object, ...]:
    found = (fit.N, fit.B, fit.K)
    return (
        point,
        [c.low if c.low is not None else 0.0 for c in found],
        [c.high if c.high is not None else math.inf for c in found],
        [c.status == "measured" for c in found],
        (fit.low**2 <= truth) & (truth <= fit.high**2),
        bool(fit.used.all()) and not fit.caveats,
    )


def fit_part(job: tuple[list[int], int, float, tuple[float, ...]]) -> dict[float, list[tuple[object, ...]]]:
    """Rows of the records of some seeds, by K."""
    seeds, n, rate, walks = job
    parts, out = [components(seed, n) for seed in seeds], {}
    for K in walks:
        curve = curve_of(np.stack([strengths(K, rate) @ part for part in parts], axis=1), rate)
        estimator = Estimator(averaged=False, time_to=False)
        fits = estimator.fit(curve)
        unit = np.stack([term.allan_variances(curve.m, averaged=False) for term in NOISE_TERMS])
        truth = strengths(K, rate) ** 2 @ unit
        out[K] = [row_of(fit, points(estimator, c, rate), truth) for c, fit in enumerate(fits)]
    return out


def cells(
    pool: multiprocessing.pool.Pool, count: int, duration: str, n: int, rate: float, walks: tuple[float, ...]
) -> list[Cell]:
    """The cells of one length and rate."""
    seeds = [list(range(first, min(first + BATCH, count))) for first in range(0, count, BATCH)]
    found = list(pool.imap(fit_part, [(each, n, rate, walks) for each in seeds]))
    rows = {K: [row for part in found for row in part[K]] for K in walks}
    return [
        Cell(duration, n, rate, K, *(np.array(column) for column in zip(*rows[K], strict=True)))
        for K in walks
    ]
