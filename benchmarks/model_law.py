"""Model law: the share of octaves whose 95 % limits do not hold the Allan deviation that the fit states.

    python benchmarks/model_law.py [--records 24] [--only lines,gap] [--recordings DIR]

The curve on the screen is drawn with its limits and with the model. The limits have 95 %, and the model is fitted to
the same samples, so at most 5 % of the octaves may miss it, whatever the sensor does. The cells are those of
`real_effects` by the estimator, with K = 0 and 4.5e-6. Of the recordings every sample counts; without the folder they
are left out. Exit code 1 where more than 5 % of the octaves of a cell miss, by more than two standard errors: octaves
of one record are correlated, so the standard error is that between records.
"""

from __future__ import annotations

import argparse
import math
import os
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from consistency import WARM_UP_S, load
from real_effects import fitted, records_of
from recordings import NAMES, outside_limits
from sensor_effects import EFFECTS
from simulated import BATCH, curve_of

from imumon.noise import ChannelFit, Estimator

WALKS, MOST = (0.0, 4.5e-6), 0.05


def row(name: str, K: str, fits: list[ChannelFit]) -> bool:
    """Print a row of the table; return whether the law holds."""
    counts = np.array([outside_limits(fit) for fit in fits], dtype=float)
    counts = counts[counts[:, 1] > 0.0]
    if not len(counts):
        print(f"| {name} | {K} | – | – | {len(fits)} without a fit |", flush=True)
        return True
    shares = counts[:, 0] / counts[:, 1]
    share = float(counts[:, 0].sum() / counts[:, 1].sum())
    error = float(shares.std()) / math.sqrt(len(shares))
    holds = share - 2.0 * error <= MOST
    worst = int(np.bincount(counts[:, 0].astype(int)).nonzero()[0].max())
    mark = "" if holds else " **!**"
    print(
        f"| {name} | {K} | {100 * share:.1f} ± {100 * error:.1f}{mark} | {worst} | {len(shares)} |",
        flush=True,
    )
    return holds


def simulated(name: str, K: float, count: int) -> list[ChannelFit]:
    found: list[ChannelFit] = []
    for first in range(0, count, BATCH):
        seeds = list(range(first, min(first + BATCH, count)))
        found += fitted(records_of(name, K, seeds), EFFECTS[name])[2]
    return found


def recorded(folder: Path, name: str) -> list[ChannelFit]:
    values, rate = load(folder, name)
    return list(Estimator(averaged=False, time_to=False).fit(curve_of(values, rate)))


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    default = Path(__file__).resolve().parents[2] / "shared" / "recordings"
    parser.add_argument("--records", type=int, default=24, help="records a cell; default 24")
    parser.add_argument("--only", help="parts of the names of effects, with commas")
    parser.add_argument("--recordings", type=Path, default=default)
    words = parser.parse_args()
    only, good = words.only.split(",") if words.only else [""], True
    print("| record | K | octaves outside, % | most of one record | records or axes |\n|---|---|---|---|---|")
    for name, effect in EFFECTS.items():
        if not effect.pipeline and any(part in name for part in only):
            for K in WALKS:
                good &= row(name, f"{K:g}", simulated(name, K, words.records))
    if words.recordings.exists():
        for name in dict.fromkeys((*NAMES, *WARM_UP_S)):
            good &= row(name, "–", recorded(words.recordings, name))
    return int(not good)


if __name__ == "__main__":
    raise SystemExit(main())
