"""Peers: what else finds N, B and K in a record, or the Allan variance in a stream, as their users would."""

from __future__ import annotations

import math
import time

import allantools
import numpy as np
from allantools.realtime import oadev_realtime
from document_tables import head, row
from simulated import B, N, components, strengths

from imumon.noise import OctaveCascade, read_slopes


def matlab_slope(values: np.ndarray, rate: float) -> tuple[float | None, ...]:
    """MATLAB's example: 100 log-spaced m, overlapping, lines of slope where the curve is nearest to it."""
    phase = np.concatenate([[0.0], np.cumsum(values)]) / rate
    m = np.unique(np.ceil(np.logspace(0, math.log10(2 ** int(math.log2(len(values) / 2))), 100)).astype(int))
    tau = m / rate
    sigma = np.array(
        [
            math.sqrt(np.mean((phase[2 * k :] - 2 * phase[k:-k] + phase[: -2 * k]) ** 2) / 2) / (k / rate)
            for k in m
            if 2 * k < len(phase)
        ]
    )
    found = read_slopes(tau[: len(sigma)], sigma)
    return tuple(found.values())


def least_squares(values: np.ndarray, rate: float) -> tuple[float, ...]:
    """allantools.oadev at octaves, and non-negative least squares of relative errors."""
    tau, sigma, _, _ = allantools.oadev(values, rate=rate, data_type="freq", taus="octave")
    rows = (
        np.column_stack([1 / tau, np.full(tau.size, 2 * math.log(2) / math.pi), tau / 3])
        / sigma[:, None] ** 2
    )
    from scipy.optimize import nnls

    return tuple(np.sqrt(nnls(rows, np.ones(tau.size))[0]))


PEERS = {"slope reading (MATLAB's example)": matlab_slope, "allantools + least squares": least_squares}


def peer_errors(count: int, rates: tuple[float, ...] = (40.0, 200.0)) -> dict[str, list[np.ndarray]]:
    """For each peer and rate (count, 3) relative errors of N, B, K; NaN where it reads none."""
    errors: dict[str, list[list[list[float]]]] = {name: [[] for _ in rates] for name in PEERS}
    for seed in range(count):
        parts = components(seed)
        for at, rate in enumerate(rates):
            values = strengths(1e-6, rate) @ parts
            for name, method in PEERS.items():
                found = zip(method(values, rate), (N, B, 1e-6), strict=True)
                errors[name][at].append([math.nan if v is None else v / t - 1 for v, t in found])
    return {name: [np.array(rows) for rows in both] for name, both in errors.items()}


def realtime() -> None:
    """allantools' realtime class and the cascade over the same samples: agreement and speed."""
    values = strengths(1e-6, 40.0) @ components(0)[:, :50_000]
    theirs = oadev_realtime(afs=[1, 2, 4, 8], tau0=1 / 40.0)
    begin = time.perf_counter()
    for x in np.cumsum(values) / 40.0:
        theirs.add_phase(x)
    slow = len(values) / (time.perf_counter() - begin)
    cascade = OctaveCascade(1, tau0=1 / 40.0)
    begin = time.perf_counter()
    for block in np.split(values[:, None], 1250):
        cascade.update(block)
    ours = len(values) / (time.perf_counter() - begin)
    # theirs begins with the first phase given, so it lacks the zero before it
    again = OctaveCascade(1, tau0=1 / 40.0)
    again.update(values[1:, None])
    error = np.max(np.abs(again.result().sigma[:4, 0] / theirs.devs()[:4] - 1.0))
    print(f"\n{head('accuracy-realtime', 'one channel', 'samples a second')}")
    print(row(["allantools' realtime class, four averaging times", f"{1e3 * round(slow / 1e3):,.0f}"]))
    print(row(["the cascade, all octaves, in blocks of 40", f"{1e3 * round(ours / 1e3):,.0f}"]))
    print(row(["largest relative difference for m ≤ 8", f"{error:.0e}"]))
