"""Limits of the bias against the temperature: how often they hold the truth, as Markdown.

    python benchmarks/temperature.py [--records 2] | python benchmarks/document_tables.py -

Records of half an hour, 48 sensors each, N = 6.1e-5 rad/s/sqrt(Hz), B = 2.4e-5 rad/s, averages at 40 Hz, with a
drift of 1e-4 rad/s over the record. The bias has a slope of 5e-5 rad/s/degC. The temperature warms up by 10 degC with a
time constant of a fifth of the record, or it rises and returns. Its noise is 0.02 degC. The truth of the bias at the
reference is that of the next record as long, that of the curve its rise from the middle. The last column is the least
ratio of K that any method has: half of the bounds of K by generalised least squares with these columns, and without.
Seeds are 0, 1, 2 ...
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from itertools import product

import numpy as np
from accuracy import share
from bounds import walk_bound
from document_tables import head, row

from imumon.noise import Estimator, OctaveCascade, synthesise
from imumon.noise.blocks import BlockAccumulator
from imumon.noise.fit import ChannelFit
from imumon.report import BiasCurve

N, B, RATE_HZ, LENGTH, SENSORS = 6.1e-5, 2.4e-5, 40.0, 72_000, 48
BLOCKS = 600
SLOPE, OFFSET, DRIFT, COLDEST_DEGC, NOISE_DEGC = 5e-5, 9.8, 1e-4, 20.0, 0.02
TIME = np.arange(LENGTH) / LENGTH
SHAPES = {"warms": 1.0 - np.exp(-TIME / 0.2), "returns": np.sin(np.pi * TIME) ** 2}
SPAN_DEGC = 10.0


def fitted(
    values: np.ndarray, degrees: np.ndarray | None
) -> tuple[tuple[ChannelFit, ...], tuple[BiasCurve, ...]]:
    """Return the fits and the curves of samples (n, c), with a temperature (n,)."""
    cascade = OctaveCascade(values.shape[1], tau0=1.0 / RATE_HZ)
    cascade.update(values)
    curve, estimator, means = cascade.result(), Estimator(averaged=True, time_to=False), None
    if degrees is not None:
        heat = BlockAccumulator([0], 1.0 / RATE_HZ)
        heat.update(degrees[None], None, np.zeros(1))
        blocks = heat.result()
        means = blocks.means[:, 0] + blocks.offset[0]
    fits = estimator.fit(curve, degrees=means)
    assert curve.sums is not None
    return fits, estimator.bias_curves(replace(curve.sums, degrees=means))


def cells(shape: str, k: float, records: int) -> list[str]:
    """Return what the table has of a kind of record."""
    u, half = 2.0 * SHAPES[shape] - 1.0, 0.5 * SPAN_DEGC
    effect = OFFSET + SLOPE * half * u + DRIFT * (TIME - 0.5)
    bias, slope, curve, ratios = [], [], [], []
    for seed in range(records):
        both = synthesise(2 * LENGTH, RATE_HZ, N=[N] * SENSORS, B=B, K=k, seed=seed)
        noise, next_means = both[:LENGTH], OFFSET + both[LENGTH:].mean(axis=0)
        heat = COLDEST_DEGC + half * (1.0 + u)
        heat += NOISE_DEGC * np.random.default_rng((seed, 1)).standard_normal(LENGTH)
        plain, _ = fitted(noise, None)
        fits, curves = fitted(noise + effect[:, None], heat)
        for one, other, each, mean in zip(plain, fits, curves, next_means, strict=True):
            sizes = [[fit.N.size, fit.B.size, fit.K.size] for fit in (one, other)]
            if all(size for size in np.ravel(sizes)):  # a fit that no description suits is pending, by chance
                ratios.append(np.divide(sizes[1], sizes[0]))
            if not each.terms:
                continue
            bias.append(each.terms[0].low <= mean <= each.terms[0].high)
            slope.append(each.terms[1].low <= SLOPE <= each.terms[1].high)
            at, own = np.array(each.degC) - each.degC[len(each.degC) // 2], np.array(each.bias)
            error = own - own[own.size // 2] - SLOPE * at
            curve += (np.abs(error) <= np.array(each.high) - own).tolist()
    column = tuple(u.reshape(BLOCKS, -1).mean(axis=1))
    least = [walk_bound(N, B, k, LENGTH / RATE_HZ, each) for each in ((column,), ())]
    return [
        *(share(np.array(held)) for held in (bias, slope)),
        f"{100.0 * np.mean(curve):.1f}",
        *(f"{ratio:.3f}" for ratio in np.median(ratios, axis=0)),
        f"{np.sqrt(least[0] / least[1]):.3f}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--records", type=int, default=2, help="of each kind, of 48 sensors; default 2")
    records = parser.parse_args().records
    held = ("bias, %", "slope, %", "curve, %")
    ratios = [f"{letter} ratio" for letter in "NBK"] + ["least"]
    print(head("temperature", "temperature", "K", *held, *ratios))
    for shape, k in product(SHAPES, (0.0, 1e-6)):
        print(row([shape, f"{k:g}", *cells(shape, k, records)]), flush=True)


if __name__ == "__main__":
    main()
