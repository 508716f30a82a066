"""What the resolutions of the fit cost: how far limits move when grids, steps and nodes are coarser or finer.

    python benchmarks/resolution.py

Prints, for values about that of each constant of the fit that is a resolution and no decision, by how much limits and
values of N, B and K of 15 channels move, relative to the distance of their limits.
"""

from __future__ import annotations

import importlib
import json
import subprocess
import sys

import numpy as np
from sensitivity import ConstantPatch

RATE_HZ, N = 40.0, 6.1e-5
RECORDS = (
    (72_000, 3e-6, 2.4e-5),
    (72_000, 0.0, 2.4e-5),
    (20_000, 3e-5, 2.4e-5),
    (144_000, 1e-6, 0.0),
    (6_000, 0.0, 2.4e-5),
)
"""Samples, K and B."""
TRIED: dict[str, tuple[float, ...]] = {
    "likelihood.GRID": (10, 16, 40, 80),
    "likelihood.FINE": (2, 4, 32),
    "scoring.SCORING_STEPS": (1, 2, 6),
    "likelihood.DROP": (4.5, 6.0, 13.0),
    "scoring.LEAST_MOVE": (1e-6, 1e-2),
    "likelihood.GRID_FALL": (0.5, 0.9),
}
"""Other values of a constant, by its module of `noise.fit` and its name."""


def measure() -> list[list[float]]:
    """Return low, high and value of N, B and K of three channels of each record, in this process."""
    from imumon.noise import OctaveCascade, fit_curve, synthesise  # after the value of a constant is replaced

    rows: list[list[float]] = []
    for seed, (n, walk, flicker) in enumerate(RECORDS):
        cascade = OctaveCascade(3, tau0=1.0 / RATE_HZ)
        cascade.update(synthesise(n, RATE_HZ, N=[N] * 3, B=flicker, K=walk, seed=seed))
        for fit in fit_curve(cascade.result(), averaged=True):
            for part in (fit.N, fit.B, fit.K):
                assert part.low is not None
                assert part.high is not None
                rows.append([part.low, part.high, part.value or part.high / 2.0])
    return rows


def named(constant: str) -> tuple[str, str]:
    """Return the module and the name of a constant of `TRIED`."""
    module, name = constant.split(".")
    return f"imumon.noise.fit.{module}", name


def measured_with(name: str, factor: float) -> np.ndarray:
    """Return (45, 3) the same with a constant times a factor, in a process that has imported nothing yet."""
    command = [sys.executable, __file__, name, repr(factor)]
    return np.array(json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout))


def main() -> None:
    """Print the table, or the numbers with one constant replaced: its name and the factor of its value."""
    if len(sys.argv) == 3:
        sys.meta_path.insert(0, ConstantPatch(*named(sys.argv[1]), float(sys.argv[2])))
        print(json.dumps(measure()))
        return
    base = np.array(measure())
    widths = base[:, 1:2] - base[:, :1]
    print("| constant | value | tried | limits move by at most, of their distance |\n|---|---|---|---|")
    for name, values in TRIED.items():
        module, constant = named(name)
        usual = getattr(importlib.import_module(module), constant)
        for value in values:
            moved = np.abs(measured_with(name, value / usual) - base) / widths
            print(f"| {name} | {usual:g} | {value:g} | {100.0 * moved.max():.2f} % |", flush=True)


if __name__ == "__main__":
    main()
