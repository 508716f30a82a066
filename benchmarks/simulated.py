"""Simulated records of known truth, as the sums of their octaves, so that one serves for every K and length.

The Allan variances of a sum of white noise, flicker and random walk are a quadratic form: of every record the
six octave sums (three noises, three mixed) are kept, and every K, and every length that is a beginning of the
record, comes from them. Seeds are 0, 1, 2 ... and were never looked at for choosing anything.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import sys

import numpy as np

from imumon.noise import AllanCurve, OctaveCascade, synthesise
from imumon.noise.fit.covariance import octaves_in

N, B = 6.1e-5, 2.4e-5
LONGEST = 720_000
LENGTHS = (36_000, 144_000, LONGEST)
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def components(seed: int) -> np.ndarray:
    """(3, n) white noise, flicker and walk of unit strength at unit rate."""
    generator = np.random.default_rng([20_260, seed])
    unit = np.eye(3)
    return np.array([synthesise(LONGEST, 1.0, *row, seed=generator, averaged=False).ravel() for row in unit])


def octave_sums(parts: np.ndarray) -> list[np.ndarray]:
    """For each length (k, 6): half the mean products of the second differences of `PAIRS`."""
    phase = np.concatenate([np.zeros((3, 1)), np.cumsum(parts, axis=1)], axis=1)
    found = []
    for n in LENGTHS:
        rows = []
        for j in range(octaves_in(n)):
            m = 1 << j
            s = max(1, m // 8)
            d = (
                phase[:, 2 * m : n + 1 : s] - 2 * phase[:, m : n + 1 - m : s] + phase[:, : n + 1 - 2 * m : s]
            ) / m
            rows.append([0.5 * np.dot(d[a], d[b]) / d.shape[1] for a, b in PAIRS])
        found.append(np.array(rows))
    return found


def sums_of(seed: int) -> list[np.ndarray]:
    return octave_sums(components(seed))


def strengths(K: float, rate: float) -> np.ndarray:
    """(3,) what the unit components are multiplied by."""
    return np.array([N * math.sqrt(rate), B, K / math.sqrt(rate)])


def curves(sums: np.ndarray, n: int, rate: float, K: float) -> AllanCurve:
    """Records as channels of one curve; sums : (r, k, 6)."""
    a = strengths(K, rate)
    factors = np.array([a[i] * a[j] * (1.0 if i == j else 2.0) for i, j in PAIRS])
    avar = (sums @ factors).T
    m = 1 << np.arange(len(avar), dtype=np.int64)
    stride = np.maximum(1, m // 8)
    terms = np.repeat(((n - 2 * m) // stride + 1)[:, None], avar.shape[1], axis=1)
    return AllanCurve(1 / rate, m, avar, terms, n, np.full(avar.shape[1], n), 1)


def check_against_cascade() -> float:
    """Largest relative difference between the sums' Allan variances and the cascade's."""
    parts = components(0)
    values = strengths(1e-6, 40.0) @ parts
    cascade = OctaveCascade(1, tau0=1 / 40.0)
    cascade.update(values[:, None])
    ours = curves(np.array(octave_sums(parts)[2])[None], LONGEST, 40.0, 1e-6)
    return float(np.max(np.abs(ours.avar / cascade.result().avar - 1.0)))


def records(pool: multiprocessing.pool.Pool, count: int, keep: str | None) -> list[np.ndarray]:
    """For each length (count, k, 6) octave sums; `keep` is a file that they are taken from and added to."""
    rows: list[list[np.ndarray]] = []
    if keep and os.path.exists(keep):
        kept = np.load(keep)
        rows = [list(row) for row in zip(*(kept[str(n)] for n in LENGTHS), strict=True)]
    for row in pool.imap(sums_of, range(len(rows), count), chunksize=10):
        rows.append(row)
        if len(rows) % 100 == 0 or len(rows) == count:
            print(f"{len(rows)} of {count} records", file=sys.stderr, flush=True)
            if keep:
                np.savez(keep, **{str(n): np.array([r[at] for r in rows]) for at, n in enumerate(LENGTHS)})
    return [np.array([row[at] for row in rows[:count]]) for at in range(len(LENGTHS))]
