"""Study of the time that is promised until B and K are precise enough, on simulated records of known truth.

A record grows by a quarter from one statement to the next. Each statement promises a length: that of the record plus
the time of the report. The true length is that at which the half-width first is as requested. The table shows, for
promises of some age, how many lengths are within a factor of 1.5 of the true one, and by which factor the promise moves
from one statement to the next. A coefficient that is never precise enough in the record does not count.

    python benchmarks/remaining_time.py [--records 36] [--hours 20] [--processes 2]
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
from typing import NamedTuple

import numpy as np

from imumon.coefficients import NOISE, default_precision
from imumon.noise import Estimator, OctaveCascade, synthesise
from imumon.pipeline.convergence import StatementLog

RATE, N, B = 10.0, 6.1e-5, 2.4e-5
WALKS = (3e-7, 1.5e-6)
"""K of the records, SI: the first one hardly shows in a day, the second one does within hours."""
FIRST_S, GROWTH = 100.0, 10.0**0.1
WITHIN = 1.5
AGES = ((0.0, 0.2), (0.2, 0.5), (0.5, 0.8), (0.8, 1.0))
"""Ranges of the length at the promise, as a share of the true one."""
BATCH = 6


class Promise(NamedTuple):
    letter: str
    walk: float
    age: float  # length of the record, as a share of the true one
    ratio: float  # promised length over the true one
    moved: float  # factor to the promise before, 1 or more; NaN: it is the first


def promises(job: tuple[float, int, float]) -> list[Promise]:
    """Return all promises for `BATCH` records of one K."""
    walk, first_seed, longest_s = job
    n, precision = int(RATE * longest_s), default_precision()
    seeds = range(first_seed, first_seed + BATCH)
    columns = [synthesise(n, RATE, [N], [B], [walk], seed=seed, averaged=False) for seed in seeds]
    samples = np.concatenate(columns, axis=1)
    cascade, estimator, convergence = (
        OctaveCascade(BATCH, tau0=1.0 / RATE),
        Estimator(averaged=False),
        StatementLog(BATCH),
    )
    lengths: list[float] = []
    widths: list[dict[tuple[int, str], float]] = []
    times: list[dict[tuple[int, str], float]] = []
    done, length = 0, FIRST_S
    while length <= longest_s:
        cascade.update(samples[done : int(length * RATE)])
        done = int(length * RATE)
        fits = estimator.fit(cascade.result())
        convergence.add(length, fits)
        lengths.append(length)
        widths.append(
            {(c, k): fit.coefficients[k].half_width or math.inf for c, fit in enumerate(fits) for k in NOISE}
        )
        times.append(
            {
                (c, k): seconds
                for c, fit in enumerate(fits)
                for k in NOISE
                if (seconds := fit.time_to[k]) is not None and convergence.is_lasting(c, k)
            }
        )
        length *= GROWTH
    out = []
    for channel in range(BATCH):
        for letter in NOISE:
            key, least = (channel, letter), precision[letter]
            reached = next((k for k, known in enumerate(widths) if known[key] <= least), 0)
            if not reached:
                continue
            before, after = widths[reached - 1][key], widths[reached][key]
            part = math.log(before / least) / math.log(before / after) if math.isfinite(before) else 1.0
            true = lengths[reached - 1] * GROWTH**part
            last = math.nan
            for k in range(reached):
                if key in times[k]:
                    promised = lengths[k] + times[k][key]
                    moved = max(promised / last, last / promised)
                    out.append(Promise(letter, walk, lengths[k] / true, promised / true, moved))
                    last = promised
                else:
                    last = math.nan
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--records", type=int, default=36)
    parser.add_argument("--hours", type=float, default=20.0)
    parser.add_argument("--processes", type=int, default=2)
    words = parser.parse_args()
    jobs = [
        (walk, 1000 * k + seed, 3600.0 * words.hours)
        for k, walk in enumerate(WALKS)
        for seed in range(0, words.records, BATCH)
    ]
    with multiprocessing.get_context("spawn").Pool(words.processes) as pool:
        everything = [promise for part in pool.imap(promises, jobs) for promise in part]
    print(f"{words.records} records for each K; promised length within a factor of {WITHIN} of the true one")
    print(
        "| | K | promises | within, all | "
        + " | ".join(f"{a:g} to {b:g} of the way" for a, b in AGES)
        + " | 95 % move by |"
    )
    print("|---|---|---|---|" + "---|" * (len(AGES) + 1))
    for letter in NOISE:
        for walk in (*WALKS, None):
            rows = [p for p in everything if p.letter == letter and walk in (p.walk, None)]
            if rows:
                print(table_row(letter, walk, rows))


def table_row(letter: str, walk: float | None, rows: list[Promise]) -> str:
    def share(some: list[Promise]) -> str:
        good = sum(1.0 / WITHIN < p.ratio < WITHIN for p in some)
        return f"{100.0 * good / len(some):.0f} % of {len(some)}" if some else "–"

    moves = [p.moved for p in rows if math.isfinite(p.moved)]
    cells = [share([p for p in rows if a <= p.age < b]) for a, b in AGES]
    moved = f"{np.quantile(moves, 0.95):.2f}" if moves else "–"
    shown = "all" if walk is None else f"{walk:g}"
    return f"| {letter} | {shown} | {len(rows)} | {share(rows)} | {' | '.join(cells)} | {moved} |"


if __name__ == "__main__":
    main()
