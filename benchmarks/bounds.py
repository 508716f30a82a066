"""Least errors of N, B and K: Cramér-Rao bounds from the covariance of the samples or of block means."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from imumon.noise.power_law import coefficient_variances, sampled_density

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
    exact = (coefficient_variances(n // length) * unit)[:, :low]
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
