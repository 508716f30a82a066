"""Limits of N, B and K where samples are wrong (outliers, tails, bursts, clipping, rounding, counts), or their stamps.

    python benchmarks/sample_errors.py | python benchmarks/document_tables.py -       102 records a cell, an hour
    python benchmarks/sample_errors.py --only "t(3)" --records 402 --first 1000       other seeds of some cells
    python benchmarks/sample_errors.py --stamps                                       host stamps that jitter

Each record goes through the whole pipeline with guards, three channels a run. Truth, unless the row says another one:
N = 6.1e-5 rad/s/sqrt(Hz), B = 2.4e-5 rad/s, K = 1e-5 rad/s sqrt(Hz), half an hour at 40 Hz, point samples. What a row
counts:

- excused: records that have a caveat about their samples and no grade, or no value; the other columns are without them
- off: records whose 95 % limits miss the truth below and above. Of rounded values, N of the sensor and that of the
  samples as they are differ: the lower limit has to be below the one, the upper limit above the other
- N off by, mean, and the share of samples that is excluded
- caveats: records with one about the samples, of the two most frequent ones

Stamps: ten minutes at 40 Hz, a clock that is 30 ppm fast, three channels a run with the same truth. Jitter is the width
of an even distribution, or the standard deviation of a normal one, in intervals. A row has the share of the losses that
are found, and of steps that are wrong, and the largest error of the interval. N is wrong by half of that error.
"""

from __future__ import annotations

import argparse
import math
import os
import zlib
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the program does

import numpy as np
from document_tables import head, row

import imumon
from imumon.api import Measurement
from imumon.grid.stamp_kinds import StampCandidate, decide
from imumon.model.coefficients import Estimate
from imumon.model.report import Channel
from imumon.noise import synthesise

N, B, K, RATE, LENGTH = 6.1e-5, 2.4e-5, 1e-5, 40.0, 72_000
SIGMA = N * math.sqrt(RATE)
ABOUT_SAMPLES = (
    "outliers",
    "clipped",
    "quantised",
    "misfit",
    "model_misses",
    "correlated",
    "disturbed",
    "gaps",
)
"""Caveats that a row counts; those about the unit and the compensation of an array are in every record."""

Change = Callable[[np.ndarray, np.random.Generator], np.ndarray]


@dataclass(frozen=True)
class Cell:
    """Records of a kind.

    Attributes
    ----------
    change : takes samples (n, 3) of the sensor and a generator, returns those that arrive.
    truth : N, B and K of the sensor.
    white : N of the white noise that `change` does not add; None: all of it.
    largest_n : N of the samples as they are, where it is not that of the sensor.
    rate, length : Hz, and samples of a record.
    averaged : the samples are means over their intervals.
    options : of `imumon.analyse`.
    """

    change: Change
    truth: tuple[float, float, float] = (N, B, K)
    white: float | None = None
    largest_n: float = 0.0
    rate: float = RATE
    length: int = LENGTH
    averaged: bool = False
    options: Mapping[str, Any] | None = None

    def analyse(self, seed: int) -> Measurement:
        """Return the analysis of three channels."""
        rng = np.random.default_rng([48, seed])
        _, b, k = self.truth
        n = [self.truth[0] if self.white is None else self.white] * 3
        clean = synthesise(self.length, self.rate, N=n, B=b, K=k, seed=rng, averaged=self.averaged)
        return imumon.analyse(gyro=self.change(clean, rng), rate_hz=self.rate, **(self.options or {}))


class Tally:
    """Channels of the records of one cell."""

    def __init__(self, truth: tuple[float, float, float], largest_n: float = 0.0) -> None:
        self._lower_truth = truth
        self._upper_truth = (max(largest_n, truth[0]), *truth[1:])
        self._excused = 0
        self._below, self._above, self._caveats = Counter[str](), Counter[str](), Counter[str]()
        self._errors: list[float] = []
        self._excluded: list[float] = []

    def add(self, measurement: Measurement) -> None:
        """Count the channels of a run."""
        report = measurement.report
        graded = report.grade["gyro"].meets is not None
        total = report.session.samples + report.session.missing
        self._excluded.append(
            report.session.excluded_s * (report.device.sample_rate_hz or 0.0) / max(total, 1)
        )
        for axis in "xyz":
            self._add_channel(report.channels[f"gyro/{axis}"], graded=graded)

    def _add_channel(self, channel: Channel, *, graded: bool) -> None:
        caveats = [caveat for caveat in ABOUT_SAMPLES if caveat in channel.caveats]
        self._caveats.update(caveats)
        estimates = {letter: channel.coefficients.get(letter, Estimate()) for letter in "NBK"}
        if (caveats and not graded) or estimates["N"].status == "pending":
            self._excused += 1
            return
        if estimates["N"].value is not None:
            self._errors.append(estimates["N"].value / self._upper_truth[0] - 1.0)
        for letter, lower, upper in zip("NBK", self._lower_truth, self._upper_truth, strict=True):
            part = estimates[letter]
            self._below[letter] += part.low is not None and part.low > lower
            self._above[letter] += part.high is not None and part.high < upper

    def cells(self) -> list[str]:
        """Return the cells of a row behind its name."""
        off = [f"{self._below[letter]}, {self._above[letter]}" for letter in "NBK"]
        error = f"{np.mean(self._errors):+.1%}" if self._errors else "–"
        caveats = ", ".join(f"{name} {count}" for name, count in self._caveats.most_common(2)) or "–"
        return [
            f"{self._excused}",
            *off,
            error,
            f"{np.mean(self._excluded):.2%}",
            caveats,
        ]


COLUMNS = ("excused", "N off", "B off", "K off", "N off by", "excluded", "caveats")


def student(degrees: float) -> Cell:
    """Return white noise with the tails of Student's t and the variance of the sensor."""

    def change(y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        tails = rng.standard_t(degrees, y.shape) * math.sqrt((degrees - 2.0) / degrees)
        return y + SIGMA * tails

    return Cell(change, white=0.0)


def outliers(share: float, least: float, most: float) -> Cell:
    """Return noise of which a share of the samples is off by some standard deviations."""

    def change(y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        hit = rng.random(y.shape) < share
        size = rng.uniform(least, most, int(hit.sum())) * rng.choice([-1.0, 1.0], int(hit.sum()))
        y[hit] += SIGMA * size
        return y

    return Cell(change)


def bursts(axes: int, least_s: float, most_s: float) -> Cell:
    """Return noise that has five times its deviation for a while, once a minute, on some of the axes."""

    def change(y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        for begin in np.flatnonzero(rng.random(LENGTH) < 1.0 / (60.0 * RATE)).tolist():
            part = y[begin : begin + max(round(rng.uniform(least_s, most_s) * RATE), 1), :axes]
            part += math.sqrt(24.0) * SIGMA * rng.standard_normal(part.shape)
        return y

    return Cell(change)


def clipped(limit: float) -> Cell:
    """Return noise in a range of some standard deviations, whose middle is off by up to half of one."""

    def change(y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        return np.clip(y + SIGMA * rng.uniform(-0.5, 0.5, 3), -limit * SIGMA, limit * SIGMA)

    return Cell(change)


def rounded(step: float) -> Cell:
    """Return values in steps of some standard deviations of a sample, at any place between two of them."""

    def change(y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        return np.round((y + step * SIGMA * rng.uniform(0.0, 1.0, 3)) / (step * SIGMA)) * step * SIGMA

    return Cell(change, largest_n=N * math.sqrt(1.0 + step**2 / 12.0))


def counted(ratio: float, kind: str) -> Cell:
    """Return a gyroscope that counts its angle, Q = ratio N sqrt(tau0), at any rate up to that of the earth."""
    white, rate = 1e-6, 100.0
    count = ratio * white / math.sqrt(rate) * math.sqrt(12.0)

    def change(y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        angle = np.cumsum(y + rng.uniform(-7.3e-5, 7.3e-5, 3), axis=0) / rate + count * rng.uniform(
            0.0, 1.0, 3
        )
        counts = np.diff(np.round(angle / count), axis=0, prepend=0.0) * count
        return counts if kind == "increment" else counts * rate

    return Cell(change, (white, 5e-8, 1e-8), rate=rate, length=90_000, averaged=True, options={"kind": kind})


def walking(crossing: float) -> Cell:
    """Return a walk that exceeds the white noise below a frequency, Hz, without B: the guards see knocks in it."""
    return Cell(lambda y, _: y, (N, 0.0, crossing * 2.0 * math.pi * N), length=144_000)


CELLS: dict[str, Cell] = {
    "Gaussian": Cell(lambda y, _: y),
    **{f"t({degrees})": student(degrees) for degrees in (8, 5, 4, 3)},
    "0.1 % of 8 to 20 sigma": outliers(1e-3, 8.0, 20.0),
    "0.1 % of 9 sigma": outliers(1e-3, 9.0, 9.0),
    "0.1 % of 20 sigma": outliers(1e-3, 20.0, 20.0),
    "one in 20,000 of 1,000 sigma": outliers(5e-5, 1000.0, 1000.0),
    "bursts of 5 sigma, 0.1 to 1 s, all axes": bursts(3, 0.1, 1.0),
    "bursts of 5 sigma, 0.1 to 1 s, one axis": bursts(1, 0.1, 1.0),
    "bursts of 5 sigma, 1 to 4 samples": bursts(3, 0.025, 0.1),
    "bursts of 5 sigma, 1 to 10 s": bursts(3, 1.0, 10.0),
    **{f"clipped at {limit:g} sigma": clipped(limit) for limit in (0.5, 0.67, 1.0, 2.0, 3.0, 4.0)},
    **{f"rounded to {step:g} sigma": rounded(step) for step in (1.0, 2.0, 3.0, 4.0, 5.0)},
    **{
        f"counts as {name}, Q / (N√τ₀) = {ratio:g}": counted(ratio, kind)
        for name, kind, ratios in (
            ("rate", "average", (0.2, 0.5, 1.0, 3.0, 5.6, 10.0, 30.0)),
            ("angle", "increment", (0.5, 5.6, 30.0)),
        )
        for ratio in ratios
    },
    **{f"walk, K / (2πN) = {hz:g} Hz": walking(hz) for hz in (0.1, 0.3, 1.0, 3.0)},
}


# Host stamps that jitter, with losses ---------------------------------------------------

STAMPED, DRIFT = 24_000, 3e-5
"""Samples of a record with host stamps, and what their clock gains."""
JITTER = (("even", 0.0), ("even", 0.1), ("even", 0.25), ("normal", 0.04), ("normal", 0.12))
LOSSES = (0.01, 0.07, 0.15, 0.3)


class Placing:
    """What the time base makes of the stamps of some records."""

    def __init__(self) -> None:
        self._off: list[float] = []
        self._found: list[float] = []
        self._wrong: list[float] = []

    def add(self, stamps: np.ndarray, received: np.ndarray) -> None:
        """Count the steps of one record: stamps in ns, and which samples (n,) arrived."""
        decision = decide([StampCandidate(stamps)])
        assert decision.interval is not None
        placed = decision.placer(stamps[:2048]).place(stamps, np.zeros(len(stamps), np.int64), final=True)
        steps, true = placed.steps[1:], np.diff(np.flatnonzero(received))
        self._off.append(abs(decision.interval * RATE * 1e-9 / (1.0 + DRIFT) - 1.0))
        self._found.append(int((steps - 1).sum()) / max(int((true - 1).sum()), 1))
        self._wrong.append(float(np.mean(steps != true)))

    def cells(self) -> list[str]:
        """Return the cells of a row."""
        return [f"{np.mean(self._found):.1%}", f"{np.mean(self._wrong):.2%}", f"{max(self._off):.1e}"]


def add_run(name: str, width: float, share: float, seed: int, placing: Placing, tally: Tally) -> None:
    """Count a run of three channels."""
    rng = np.random.default_rng([round(1000.0 * width), round(1000.0 * share), seed])
    received = rng.random(STAMPED) >= share
    late = rng.uniform(0.0, 1.0, STAMPED) if name == "even" else rng.standard_normal(STAMPED)
    times = np.sort(((np.arange(STAMPED) + width * late) * (1.0 + DRIFT) / RATE * 1e9)[received])
    stamps = times.astype(np.int64)
    values = synthesise(STAMPED, RATE, N=[N] * 3, B=[B] * 3, K=[K] * 3, seed=rng, averaged=False)[received]
    placing.add(stamps, received)
    tally.add(imumon.analyse(gyro=values, time_s=1.7e9 + stamps * 1e-9))


def stamps(first: int, records: int, only: list[str]) -> None:
    """Print the table of host stamps."""
    print(head("stamps", "jitter", "loss", "found", "wrong steps", "interval off", *COLUMNS), flush=True)
    for name, width in JITTER:
        for share in LOSSES:
            if any(part in f"{name} {width:g}" for part in only):
                placing, tally = Placing(), Tally((N, B, K))
                for seed in range(first, first + records // 3):
                    add_run(name, width, share, seed, placing, tally)
                print(
                    row([f"{name} {width:g}", f"{share:.0%}", *placing.cells(), *tally.cells()]), flush=True
                )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--records", type=int, default=102)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--only", default=[""], nargs="+", help="parts of the names of cells")
    parser.add_argument(
        "--stamps", action="store_true", help="host stamps that jitter, in place of wrong samples"
    )
    options = parser.parse_args()
    if options.stamps:
        stamps(options.first, options.records, options.only)
        return
    print(head("sample-errors", "samples", *COLUMNS), flush=True)
    for name, cell in CELLS.items():
        if any(part in name for part in options.only):
            tally = Tally(cell.truth, cell.largest_n)
            for seed in range(options.first, options.first + options.records // 3):
                tally.add(cell.analyse(seed + 10_000 * zlib.crc32(name.encode())))
            print(row([name, *tally.cells()]), flush=True)


if __name__ == "__main__":
    main()
