"""Accuracy of N, B and K against the truth and the Cramer-Rao bound, with peers beside it, as Markdown.

    python benchmarks/accuracy.py            100 records a cell, a few minutes
    python benchmarks/accuracy.py --full     2,000 records a cell

Truth: N = 6.1e-5 rad/s/sqrt(Hz), B = 2.4e-5 rad/s, point samples, `simulated`. Every figure has its standard error;
what is beyond its goal by more than two of them is marked.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import os
import sys
import time
from collections.abc import Iterator

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the program does

import allantools
import numpy as np
from allantools.realtime import oadev_realtime
from document_tables import Figure, head, row, seconds
from markov import FLOOR, markov
from real_effects import LEGEND, table
from scipy.optimize import nnls
from simulated import BATCH, LONGEST, B, Cell, N, cells, components, cramer_rao, curve_of, strengths

from imumon.noise import ChannelFit, Estimator, OctaveCascade, read_slopes
from imumon.noise.fit.model import NOISE_TERMS
from imumon.noise.fit.model_curve import degrees_of_freedom

DURATIONS = {"15 min": (36_000, 40.0), "1 h": (144_000, 40.0), "5 h": (LONGEST, 40.0)}
WALKS = (1e-7, 3e-7, 1e-6, 3e-6)
PEER_CELLS = {("5 h", 40.0), ("1 h", 200.0)}
"""Cells with a goal, and beside which the peers work; K = 1e-6."""


# Peers: what else finds N, B and K in a record, or the Allan variance in a stream ------


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


# Tables --------------------------------------------------------------------------


def say(title: str, text: str) -> None:
    """A section's heading and its first paragraph."""
    print(f"\n## {title}\n\n{text}\n")


def share(hits: np.ndarray) -> str:
    """Percentage with its standard error."""
    if not hits.size:
        return "–"
    mean = float(np.mean(hits))
    return f"{100 * mean:.1f} ± {100 * math.sqrt(max(mean * (1 - mean), 1 / hits.size) / hits.size):.1f}"


def within(hits: np.ndarray, low: float, high: float) -> str:
    if not hits.size:
        return "–"
    mean = float(np.mean(hits))
    error = math.sqrt(max(mean * (1 - mean), 1 / hits.size) / hits.size)
    return share(hits) + ("" if low - 2 * error <= mean <= high + 2 * error else " **!**")


def root_mean_square(error: np.ndarray) -> tuple[float, float]:
    """Of relative errors, with its standard error; records without a value are left out."""
    error = error[np.isfinite(error)]
    rmse = math.sqrt(np.mean(error**2))
    return rmse, float(np.std(error**2)) / (2 * rmse * math.sqrt(len(error)))


def accuracy_table(found: list[Cell]) -> None:
    say(
        "Point estimates",
        "Root mean square error in %, with its standard error, and CRB, the Cramér–Rao bound on every sample."
        " What is only bounded counts with the median of its likelihood. Goals: N and B within 1.03 of CRB,"
        " K within 33 % (5 h, K = 1e-6).",
    )
    print(head("accuracy-points", "record", "K", "N", "CRB N", "B", "CRB B", "K", "CRB K"))
    for c in found:
        least = 100 * cramer_rao(c.n, c.rate, N, B, c.K)
        columns = []
        for term, truth in enumerate((N, B, c.K)):
            rmse, spread = root_mean_square(c.values[:, term] / truth - 1.0)
            goal = (
                goal_of(term, float(least[term]), c.duration) if (c.duration, c.rate) in PEER_CELLS else None
            )
            missed = goal is not None and 100 * (rmse - 2 * spread) > goal
            columns += [
                f"{100 * rmse:.3g} ± {100 * spread:.1g}{' **!**' if missed else ''}",
                f"{least[term]:.3g}",
            ]
        print(row([f"{c.duration} at {c.rate:.0f} Hz", f"{c.K:.0e}", *columns]))


def goal_of(term: int, least: float, duration: str) -> float | None:
    """Greatest error of N, B or K, %; None: there is no goal."""
    return 1.03 * least if term < 2 else 33.0 if duration == "5 h" else None


def coverage_table(found: list[Cell]) -> None:
    say(
        "Limits",
        "Share of all records, in %, whose limits hold the truth, whether measured or bounded; goal 93–97 "
        "for the columns N, B and K. K's bound holds: of those records alone in which K is only bounded, a "
        "selection by its estimate.",
    )
    columns = ("record", "K", "N", "B", "K", "K measured", "K's bound holds")
    print(head("accuracy-limits", *columns, "sigma, worst and best octave", "nothing left out"))
    for c in found:
        held = (c.low <= [N, B, c.K]) & (np.array([N, B, c.K]) <= c.high)
        bounded = ~c.measured[:, 2]
        order = np.argsort(c.inside.mean(axis=0))
        octaves = (within(c.inside[:, order[at]], 0.93, 0.97) for at in (0, -1))
        print(
            row(
                [
                    f"{c.duration} at {c.rate:.0f} Hz",
                    f"{c.K:.0e}",
                    *(within(held[:, term], 0.93, 0.97) for term in range(3)),
                    share(c.measured[:, 2]),
                    share(held[bounded, 2]),
                    " / ".join(octaves),
                    share(c.whole),
                ]
            )
        )


# Cascade -------------------------------------------------------------------------


def edf(n: int, m: int, stride: int, kind: int) -> float:
    """Equivalent degrees of freedom of an octave, from the covariance of its differences, exactly."""
    terms = (n - 2 * m) // stride + 1
    lag = np.abs(np.arange(-terms - 2 * m // stride, terms + 2 * m // stride + 1)) * float(stride)
    phase = (-0.5 * lag, lag**2 * np.log(np.maximum(lag, 1.0)), lag**3)[kind]
    size, apart = 2 * terms - 1, m // stride
    r = sum(
        w * phase[1 + 2 * apart + k * apart : 1 + 2 * apart + k * apart + size]
        for k, w in zip(range(-2, 3), (1, -4, 6, -4, 1), strict=True)
    )
    count = terms - np.abs(np.arange(-(terms - 1), terms))
    return float(terms**2 * r[terms - 1] ** 2 / np.sum(count * r**2))


def edf_table() -> None:
    say(
        "Equivalent degrees of freedom",
        "Relative to the fully overlapping estimator, exact, for clusters of 64 samples; goal ≥ 98, 99, 99."
        " Octaves up to m = 8 are fully overlapping: 100 %. In brackets those that the limits of the curve are"
        " computed with.",
    )
    print(head("accuracy-edf", "T/τ", "white", "flicker", "random walk"))
    for ratio in (4, 8, 32, 128, 512):
        n, cells_of_ratio = ratio * 64, []
        for kind in range(3):
            full = edf(n, 64, 1, kind)
            alone = {NOISE_TERMS[kind]: 1.0}
            stated = degrees_of_freedom(np.array([64]), np.array([(n - 128) // 8 + 1]), n, alone)[0]
            cells_of_ratio.append(f"{100 * edf(n, 64, 8, kind) / full:.2f} % ({100 * stated / full:.0f} %)")
        print(row([ratio, *cells_of_ratio]))


# Peers ---------------------------------------------------------------------------


def peer_table(found: list[Cell], count: int) -> None:
    say(
        "Beside peers",
        f"Bias / root mean square error in %, K = 1e-6, {count} records. Where a slope reading has no K"
        " or B the record is left out, to its advantage.",
    )
    print(head("accuracy-peers", "method", "5 h at 40 Hz: N", "B", "K", "1 h at 200 Hz: N", "B", "K"))
    errors = peer_errors(count)
    ours = [c for c in found if c.K == 1e-6 and (c.duration, c.rate) in PEER_CELLS]
    errors["**imumon**"] = [c.values[:count] / [N, B, 1e-6] - 1 for c in sorted(ours, key=lambda c: c.rate)]
    for name, both in errors.items():
        columns = [
            f"{100 * np.nanmean(e[:, t]):+.2g} / {100 * root_mean_square(e[:, t])[0]:.2g}"
            for e in both
            for t in range(3)
        ]
        print(row([name, *columns]))


def measure(count: int, peers: int) -> Iterator[Figure]:
    """Records of five hours at 40 Hz, K = 1e-6: errors beside peers and the bound, and limits that hold."""
    with multiprocessing.Pool(2) as pool:
        ours = cells(pool, count, "5 h", LONGEST, 40.0, (1e-6,))[0]
    bounds = 100 * cramer_rao(LONGEST, 40.0, N, B, 1e-6)
    errors = peer_errors(peers, (40.0,))
    held = (ours.low <= [N, B, 1e-6]) & (np.array([N, B, 1e-6]) <= ours.high)
    for term, (name, truth) in enumerate(zip("NBK", (N, B, 1e-6), strict=True)):
        rmse, spread = root_mean_square(ours.values[:, term] / truth - 1.0)
        least = float(bounds[term])
        goal = 33.0 if name == "K" else 1.03 * least
        beside = [
            f"{peer.split()[0]} {100 * root_mean_square(both[0][:, term])[0]:.2g}"
            for peer, both in errors.items()
        ]
        yield Figure(
            f"rms error of {name}, 5 h at 40 Hz, {count} records",
            f"{100 * rmse:.3g} ± {100 * spread:.1g} %",
            ", ".join([*beside, f"Cramér–Rao {least:.3g}"]) + f" % ({peers} records)",
            f"≤ {goal:.3g} %",
            100 * (rmse - 2 * spread) <= goal,
        )
        share_held = float(held[:, term].mean())
        unsure = 2 * math.sqrt(max(share_held * (1 - share_held), 1 / count) / count)
        yield Figure(
            f"95 % limits of {name} that hold the truth",
            f"{share(held[:, term])} %",
            "the others give none",
            "93–97 %",
            0.93 - unsure <= share_held <= 0.97 + unsure,
        )


# Disturbances --------------------------------------------------------------------


def disturbed(count: int) -> None:
    say(
        "Disturbances",
        f"5 h at 40 Hz, K = 1e-7, {count} records each, by the estimator alone, without the guards"
        " that exclude disturbances. B is near within twice its own limits, flagged by a caveat;"
        " worst are the farthest N and the farthest B that carries no caveat.",
    )
    columns = ("N within 1 %", "B near or flagged", "flagged", "worst N", "worst B unflagged")
    print(head("accuracy-disturbances", "disturbance", *columns))
    lost = np.random.default_rng(7).random(LONGEST) >= 0.005
    found: dict[str, list[ChannelFit]] = {}
    for first in range(0, count, BATCH):
        seeds = range(first, min(first + BATCH, count))
        values = np.column_stack([strengths(1e-7, 40.0) @ components(seed) for seed in seeds])
        for name, (data, valid, hole) in cases(values, lost).items():
            cascade, half = OctaveCascade(values.shape[1], tau0=1 / 40.0), LONGEST // 2
            cascade.update(data[:half], None if valid is None else valid[:half])
            cascade.skip(hole)
            cascade.update(data[half + hole :], None if valid is None else valid[half + hole :])
            found.setdefault(name, []).extend(Estimator(averaged=False, time_to=False).fit(cascade.result()))
    for name, fits in found.items():
        print(row([name, *judged(fits)]))


Case = tuple[np.ndarray, np.ndarray | None, int]
"""Samples, which of them are valid, and samples that are missing in the middle."""


def cases(values: np.ndarray, lost: np.ndarray) -> dict[str, Case]:
    t = np.arange(LONGEST)[:, None] / 40.0
    stuck = values.copy()
    stuck[200_000:202_400] = stuck[200_000]
    return {
        "none": (values, None, 0),
        "vibration line 0.37 Hz, 3e-4 rad/s": (values + 3e-4 * np.sin(2 * np.pi * 0.37 * t), None, 0),
        "warm-up 1e-4 rad/s, 20 min": (values + 1e-4 * np.exp(-t / 1200.0), None, 0),
        "0.5 % lost": (values, lost[:, None], 0),
        "10 min hole": (values, None, 24_000),
        "stuck 60 s": (stuck, None, 0),
    }


def judged(fits: list[ChannelFit]) -> list[str]:
    error_n = np.array([(f.N.value or math.nan) / N - 1 for f in fits])
    flagged = np.array([bool(f.caveats) for f in fits])
    good, worst = [], 0.0
    for fit, told in zip(fits, flagged, strict=True):
        value, high, low = fit.B.value, fit.B.high or math.inf, fit.B.low or 0.0
        near = value is None or abs(value - B) <= 2 * (high - low)
        good.append(near or told)
        if not told and value is not None and abs(value / B - 1) > abs(worst):
            worst = value / B - 1
    return [
        share(np.abs(error_n) <= 0.01),
        share(np.array(good)),
        share(flagged),
        f"{100 * error_n[np.nanargmax(np.abs(error_n))]:+.2f} %",
        f"{100 * worst:+.0f} %",
    ]


def speed() -> None:
    values = np.column_stack([strengths(1e-6, 40.0) @ components(seed) for seed in range(9)])
    curve, known = curve_of(values, 40.0), Estimator(averaged=False)
    known.fit(curve)
    slow = markov(3.0 * FLOOR, 57.0)
    added = np.column_stack([slow(np.random.default_rng(seed), len(values)) for seed in range(9)])
    correlated = curve_of(values + added, 40.0)
    work = (
        lambda: Estimator(averaged=False).fit(curve),
        lambda: Estimator(averaged=False).fit(correlated),
        lambda: known.fit(curve, renew=True),
        lambda: known.fit(curve),
    )
    times = [1e3 * seconds(each, 7, 1) / values.shape[1] for each in work]
    say("Cost", "Processor time of a fit per channel, 5 h at 40 Hz.")
    print(head("accuracy-cost", "fit", "ms", "goal"))
    names = (
        "first",
        "first, with Gauss–Markov noise",
        "again",
        "between two fits, with the curve of the moment",
    )
    for name, spent, goal in zip(names, times, (5, 20, 5, ""), strict=True):
        print(row([name, f"{spent:.1f}", goal]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="2,000 records a cell")
    parser.add_argument("--records", type=int, help="records a cell")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--no-effects", action="store_true", help="without the table of `real_effects`")
    options = parser.parse_args()
    count = options.records or (2000 if options.full else 100)
    command = "python benchmarks/accuracy.py" + (" --full" if count == 2000 else f" --records {count}")
    print(
        f"# Accuracy\n\n{head('accuracy-run', 'command', 'records a cell')}\n{row([f'`{command}`', count])}"
    )
    edf_table()
    with multiprocessing.Pool(options.processes) as pool:
        found: list[Cell] = []
        for duration, (n, rate) in DURATIONS.items():
            found += cells(pool, count, duration, n, rate, WALKS)
            print(duration, file=sys.stderr, flush=True)
        found += cells(pool, count, "1 h", LONGEST, 200.0, (1e-6,))
        none = cells(pool, count, "5 h", LONGEST, 40.0, (0.0,))[0]
        accuracy_table([c for c in found if c.K == 1e-6])
        coverage_table(found)
        seen = next(c for c in found if c.duration == "5 h" and c.K == 1e-7)
        holds = (seen.high[:, 2] >= 1e-7)[~seen.measured[:, 2]]
        print(f"\n{head('accuracy-walks', '5 h at 40 Hz', 'share, %', 'goal, %')}")
        print(row(["K = 0: falsely measured", share(none.measured[:, 2]), "≤ 3"]))
        print(row(["K = 1e-7: declared a bound", share(~seen.measured[:, 2]), "≥ 95"]))
        print(row(["K = 1e-7: the bound holds", share(holds), "93–97"]))
        peer_table(found, min(count, 100 if options.full else 20))
        realtime()
        disturbed(min(count, 48 if options.full else 8))
        speed()
        if not options.no_effects:
            say("Effects of real sensors", LEGEND)
            table(pool, count, min(count, 400))


if __name__ == "__main__":
    main()
