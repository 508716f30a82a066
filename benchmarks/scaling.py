"""How cost and state grow with the length of a record, from 10^4 to 10^8 samples, beside allantools.

    python benchmarks/scaling.py [--most 8] [--plot docs/scaling.svg]

One channel in blocks of 1,000, processor time, the least of some repetitions where a run is short. allantools
works offline on the whole record, `oadev` at all octaves, up to 10^7 samples, and sample by sample with its
realtime class at ten octaves, up to 10^5; what it holds is the record as phase. The state of nine channels is
that of a live run.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from typing import NamedTuple

import allantools
import numpy as np
from cascade import realtime
from figures import Figure, show

from imumon.noise.allan import OctaveCascade
from imumon.noise.statistics.moments import Moments

BLOCK = 1000
SEED = 20240229
GROUPS = (0, 0, 0, 1, 1, 1, 2, 2, 2)
OFFLINE_MOST, MOMENTS_MOST, REALTIME_MOST = 7, 7, 5


class Row(NamedTuple):
    """Processor time, ns a sample, and bytes that are held; None: not tried."""

    n: int
    cascade_ns: float
    with_moments_ns: float | None
    offline_ns: float | None
    realtime_ns: float | None
    state_one: int
    state_nine: int
    offline_bytes: int


def fed(n: int, block: np.ndarray, moments: bool) -> tuple[float, OctaveCascade]:
    """Processor seconds to feed n samples."""
    cascade, running = OctaveCascade(1, 1 / 200), Moments(1, (0,))
    start = time.process_time()
    for _ in range(n // len(block)):
        cascade.update(block)
        if moments:
            running.update(block)
    cascade.result()
    return time.process_time() - start, cascade


def offline(values: np.ndarray) -> float:
    start = time.process_time()
    allantools.oadev(values, rate=200.0, data_type="freq", taus="octave")
    return time.process_time() - start


def row(exponent: int) -> Row:
    n, repeat = 10**exponent, max(1, min(5, 10 ** (7 - exponent)))
    rng = np.random.default_rng(SEED)
    block = 9.8 + 1e-3 * rng.standard_normal((BLOCK, 1))
    runs = [fed(n, block, False) for _ in range(repeat)]
    both = None
    if exponent <= MOMENTS_MOST:
        both = min(fed(n, block, True)[0] for _ in range(repeat)) / n * 1e9
    peer = None
    if exponent <= OFFLINE_MOST:
        record = np.tile(block[:, 0], n // BLOCK)
        peer = min(offline(record) for _ in range(repeat)) / n * 1e9
    live = None
    if exponent <= REALTIME_MOST:
        record = np.tile(block[:, 0], n // BLOCK)
        start = time.process_time()
        realtime(record)
        live = (time.process_time() - start) / n * 1e9
    nine = OctaveCascade(9, 1 / 200, groups=GROUPS)
    nine.skip(n)
    return Row(
        n,
        min(r[0] for r in runs) / n * 1e9,
        both,
        peer,
        live,
        runs[-1][1].nbytes,
        nine.nbytes,
        8 * n,
    )


def plot(rows: list[Row], path: str) -> None:
    import matplotlib

    matplotlib.use("svg")
    matplotlib.rcParams["svg.hashsalt"] = "imumon"
    from matplotlib import pyplot

    n = [row.n for row in rows]
    figure, (cost, state) = pyplot.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
    cost.loglog(n, [row.cascade_ns for row in rows], "o-", label="imumon: octaves")
    done = [row for row in rows if row.with_moments_ns is not None]
    cost.loglog([r.n for r in done], [r.with_moments_ns or 0.0 for r in done], "s-", label="with moments")
    done = [row for row in rows if row.offline_ns is not None]
    cost.loglog([r.n for r in done], [r.offline_ns or 0.0 for r in done], "^--", label="allantools, offline")
    done = [row for row in rows if row.realtime_ns is not None]
    cost.loglog(
        [r.n for r in done], [r.realtime_ns or 0.0 for r in done], "v--", label="allantools, realtime"
    )
    cost.set(
        xlabel="samples n", ylabel="processor time, ns a sample", title="Cost of one channel", ylim=(10, 1e5)
    )
    state.loglog(n, [row.state_nine for row in rows], "o-", label="imumon: octaves of 9 channels")
    state.loglog(n, [row.state_one for row in rows], "s-", label="imumon: octaves of 1 channel")
    state.loglog(n, [row.offline_bytes for row in rows], "^--", label="a record of 1 channel")
    state.set(xlabel="samples n", ylabel="bytes", title="Memory of one and of nine channels")
    for axes in (cost, state):
        axes.grid(True, which="major", alpha=0.3)
        axes.legend(fontsize=8)
    figure.savefig(path, metadata={"Date": None})


def measure(most: int = 7, path: str | None = None) -> Iterator[Figure]:
    """Rows of the table from 10^4 to 10^most samples; the plot, if it is to go somewhere."""
    rows = []
    for exponent in range(4, most + 1):
        found = row(exponent)
        rows.append(found)
        peer = f"allantools {found.offline_ns:.0f} ns, " if found.offline_ns is not None else ""
        peer += f"realtime {found.realtime_ns:,.0f} ns, " if found.realtime_ns is not None else ""
        moments = f"{found.with_moments_ns:.0f}" if found.with_moments_ns is not None else "–"
        yield Figure(
            f"n = 10^{exponent}: a sample (with moments); state of 1 (9)",
            f"{found.cascade_ns:.0f} ({moments}) ns; "
            f"{found.state_one / 1e3:.1f} ({found.state_nine / 1e3:.1f}) kB",
            f"{peer}record {found.offline_bytes / 1e6:g} MB",
        )
    growth = rows[-1].cascade_ns / rows[1].cascade_ns
    yield Figure(f"cost of a sample at n = 10^{most} over that at 10^5", f"{growth:.2f} ×")
    if path is not None:
        plot(rows, path)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--most", type=int, default=7, help="samples at most, as a power of ten; default 7")
    parser.add_argument("--plot", metavar="FILE", help="draw it, SVG")
    words = parser.parse_args()
    show("scaling", measure(words.most, words.plot))
