"""What the resolutions of the fit cost: how far limits move when grids, steps and nodes are coarser or finer.

    python benchmarks/resolution.py

Prints, for values about that of each rule of `noise.fit.fit_rules` that is a resolution and no decision, by how much
limits and values of N, B and K of 15 channels move, relative to the distance of their limits.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np

from imumon.noise import ChannelFit, OctaveCascade, fit_curve, synthesise
from imumon.noise.fit import fit_rules, likelihood, regressors, scoring, search, time_to_precision

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
    "GRID": (10, 16, 40, 80),
    "FINE": (2, 4, 32),
    "SCORING_STEPS": (1, 2, 6),
    "DROP": (4.5, 6.0, 13.0),
    "HELD_SHARE": (0.5, 0.9),
}
MODULES: tuple[ModuleType, ...] = (fit_rules, likelihood, scoring, search, regressors, time_to_precision)


def fits() -> list[ChannelFit]:
    """Fit three channels of each record."""
    out: list[ChannelFit] = []
    for seed, (n, walk, flicker) in enumerate(RECORDS):
        cascade = OctaveCascade(3, tau0=1.0 / RATE_HZ)
        cascade.update(synthesise(n, RATE_HZ, N=[N] * 3, B=flicker, K=walk, seed=seed))
        out += fit_curve(cascade.result(), averaged=True)
    return out


def numbers(channels: list[ChannelFit]) -> tuple[np.ndarray, np.ndarray]:
    """Return low, high and value of all coefficients, and the distance of the limits of each."""
    values, widths = [], []
    for fit in channels:
        for part in (fit.N, fit.B, fit.K):
            assert part.low is not None
            assert part.high is not None
            values.append((part.low, part.high, part.value or part.high / 2.0))
            widths.append(part.high - part.low)
    return np.array(values), np.array(widths)[:, None]


def replaced(name: str, value: Any) -> None:
    """Give a rule another value in every module that reads it."""
    for module in MODULES:
        if hasattr(module, name):
            setattr(module, name, value)


def main() -> None:
    """Print the table."""
    base, widths = numbers(fits())
    print("| rule | value | tried | limits move by at most, of their distance |\n|---|---|---|---|")
    for name, values in TRIED.items():
        usual = getattr(fit_rules, name)
        for value in values:
            replaced(name, value)
            moved = np.abs(numbers(fits())[0] - base) / widths
            print(f"| {name} | {usual:g} | {value:g} | {100.0 * moved.max():.2f} % |", flush=True)
        replaced(name, usual)


if __name__ == "__main__":
    main()
