"""Simulated records of known truth, their fits, and the least errors that N, B, K and M can have in them.

A cell is one length, rate and K.
Every record passes `OctaveCascade` as a column, a dozen at a time. Seeds are 0, 1, 2 ... and were never looked at for
choosing anything; the noise of a seed does not depend on K.
"""

from __future__ import annotations

import math
import multiprocessing.pool
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from imumon.noise import AllanCurve, ChannelFit, Estimator, OctaveCascade, synthesise
from imumon.noise.fit.likelihood import grid_mean, quantiles
from imumon.noise.fit.model import GRIDDED, NOISE_TERMS, WHITE
from imumon.noise.power_law import cosine_variances, sampled_density

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
    surface = known.fitted.surface
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


# Cramér-Rao bounds, from the covariance of the samples or of block means ---------------

BLOCKS, LOWEST, POINTS = 4096, 1024, 2000
"""Block means whose lowest coefficients count one by one, number of these, and points of the sum over the others."""


def cramer_rao(n: int, rate: float, N: float, B: float, K: float) -> np.ndarray:
    """Return (3,) the least relative deviations of N, B and K from n point samples of unknown mean.

    The coefficients of the cosine transform of the samples are normal and as good as independent. The lowest ones are
    those of block means; the variance of the others is the density.
    """
    length = max(1, n // BLOCKS)
    low = min(LOWEST, n // length // 2)
    unit = np.array([1.0, length, length**2])[:, None]
    exact = (cosine_variances(n // length) * unit)[:, :low]
    edges = np.unique(np.geomspace(low + 1, n, POINTS).round().astype(np.int64))
    density = sampled_density(0.25 * (edges[:-1] + edges[1:] - 1.0) / n, averaged=False)
    variance, count = np.hstack((exact, density)), np.concatenate((np.ones(low), np.diff(edges)))
    powers = np.array([N**2 * rate, B**2, K**2 / rate])
    share = variance / (powers @ variance)
    information = 0.5 * (share * count) @ share.T
    known = powers > 0.0
    out = np.full(3, np.inf)
    errors = np.sqrt(np.diag(np.linalg.inv(information[np.ix_(known, known)])))
    out[known] = errors / powers[known] / 2.0
    return out


def markov_bound(
    samples: int, rate: float, N: float, B: float, sigma: float, time_s: float
) -> tuple[float, float]:
    """Return the least relative deviations of M and of its time constant from point samples of unknown mean.

    Beside unknown N, B and K = 0, from the periodogram, whose ordinates are independent and exponential (Whittle 1953).
    """
    edges = np.unique(np.geomspace(1, samples // 2, POINTS).round().astype(np.int64))
    f, count = 0.5 * (edges[:-1] + edges[1:]) / samples * rate, np.diff(edges)
    markov = 2.0 * sigma**2 * time_s / (1.0 + (2.0 * np.pi * f * time_s) ** 2)
    by_time = markov * (2.0 / (1.0 + (2.0 * np.pi * f * time_s) ** 2) - 1.0)
    parts = np.stack((markov, by_time, np.full(f.size, N**2), B**2 / (2.0 * np.pi * f), 1.0 / f**2))
    share = parts / (markov + parts[2] + parts[3])
    scale = np.sqrt((share**2) @ count)
    share /= scale[:, None]
    errors = np.sqrt(np.diag(np.linalg.inv((share * count) @ share.T))) / scale
    return float(errors[0] / 2.0), float(errors[1])


def unit_covariances(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (n, n) covariances of means over n neighbouring blocks of unit length, for B = 1 and K = 1.

    From the generalised autocovariance G of the phase (Greenhall 1991), t^2 ln|t| / (2 pi) and |t|^3 / 12, as
    2 G(l) - G(l-1) - G(l+1) at lag l. They have a meaning only in contrasts; their mean is removed.
    """
    lag = np.arange(n + 1.0)
    near = np.abs(np.arange(n)[:, None] - np.arange(n))
    out = []
    for g in (lag**2 * np.log(np.maximum(lag, 1.0)) / (2.0 * np.pi), lag**3 / 12.0):
        by_lag = 2.0 * g[:-1] - g[np.abs(np.arange(n) - 1)] - g[1:]
        out.append((by_lag - by_lag.mean())[near])
    return out[0], out[1]


@lru_cache
def walk_bound(
    N: float,
    B: float,
    K: float,
    length_s: float,
    columns: tuple[tuple[float, ...], ...] = (),
    settles_s: float = 0.0,
) -> float:
    """Return the standard deviation of K^2 by generalised least squares on 600 block means.

    Beside N, B, drift, some columns, and an exponential of unknown size and time constant.

    Parameters
    ----------
    columns : values of the blocks, such as their temperature.
    settles_s : s, time constant of the exponential; 0: there is none.
    """
    blocks = len(columns[0]) if columns else 600
    length = length_s / blocks
    at = (np.arange(blocks) + 0.5) * length
    regressors = [np.ones(blocks), at, *map(np.array, columns)]
    if settles_s:
        regressors += [np.exp(-at / settles_s), at * np.exp(-at / settles_s)]
    free = np.linalg.qr(np.stack(regressors, axis=1), mode="complete")[0][:, len(regressors) :]
    flicker, walk = unit_covariances(blocks)
    parts = [N**2 / length * np.eye(blocks), B**2 * flicker, length * walk]
    parts = [free.T @ part @ free for part in parts]
    inverse = np.linalg.inv(parts[0] + parts[1] + K**2 * parts[2])
    slopes = [inverse @ parts[1], inverse @ parts[2]]
    information = np.array([[0.5 * np.sum(a * b.T) for b in slopes] for a in slopes])
    return float(math.sqrt(np.linalg.inv(information)[1, 1]))
