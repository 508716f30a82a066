"""Cells: all simulated records of one length and K, fitted, and the least error that their octaves allow."""

from __future__ import annotations

import math
import multiprocessing
from dataclasses import dataclass

import numpy as np
from simulated import curves, strengths

from imumon.noise import Estimator
from imumon.noise.fit.covariance import design, octaves_in, tables
from imumon.noise.fit.leastsquares import FitProblems


@dataclass
class Cell:
    """Fits of one length and K over all records."""

    duration: str
    K: float
    n: int
    rate: float
    values: np.ndarray  # (r, 3) point estimates in SI, zero included
    low: np.ndarray
    high: np.ndarray
    measured: np.ndarray  # (r, 3) bool
    inside: np.ndarray  # (r, k) bool, truth within the limits of sigma
    whole: np.ndarray  # (r,) bool, no octave left out, no caveat


def fit_part(job: tuple[np.ndarray, int, float, float]) -> list[tuple[object, ...]]:
    sums, n, rate, K = job
    curve = curves(sums, n, rate, K)
    estimator = Estimator(averaged=False)
    fits = estimator.fit(curve)
    p = strengths(K, rate) ** 2
    truth = design(len(curve.m), averaged=False)[:, :3] @ p
    unit = np.array([math.sqrt(1 / rate), 1.0, math.sqrt(rate)])
    rows = []
    for channel, fit in enumerate(fits):
        point = np.sqrt(np.maximum(estimator._confidences[channel].model.p[:3], 0.0)) * unit
        found = [getattr(fit, name) for name in "NBK"]
        rows.append(
            (
                point,
                [c.low if c.low is not None else 0.0 for c in found],
                [c.high if c.high is not None else math.inf for c in found],
                [c.status == "measured" for c in found],
                (fit.low**2 <= truth) & (truth <= fit.high**2),
                bool(fit.used.all()) and not fit.caveats,
            )
        )
    return rows


def cell(
    pool: multiprocessing.pool.Pool, sums: np.ndarray, duration: str, n: int, rate: float, K: float
) -> Cell:
    jobs = [(part, n, rate, K) for part in np.array_split(sums, max(1, len(sums) // 25))]
    rows = [row for part in pool.map(fit_part, jobs) for row in part]
    return Cell(duration, K, n, rate, *(np.array(column) for column in zip(*rows, strict=True)))


def bound(n: int, rate: float, K: float) -> np.ndarray:
    """(3,) relative deviations that the best use of the octaves leaves, at the truth."""
    k = octaves_in(n)
    table = tables(n, k, averaged=False)
    ones = np.ones((1, k))
    m = 1 << np.arange(k)
    thinning = np.sqrt(table.full / ((n - 2 * m) // np.maximum(1, m // 8) + 1))[None]
    problems = FitProblems(
        (table,), np.array([0]), ones, thinning, ones > 0, (np.arange(5) < 3)[None], np.zeros(1),
        np.zeros((1, k)), np.zeros((1, k, k)), np.array([np.inf]),
    )  # fmt: skip
    p = np.zeros((1, 5))
    p[0, :3] = strengths(K, rate) ** 2
    information = problems.prepare().weight(p).normal[0, :3, :3]
    return np.sqrt(np.diag(np.linalg.inv(information))) / p[0, :3] / 2.0
