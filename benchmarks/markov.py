"""What the fit states of noise of another kind than N, B and K, and of Gauss–Markov noise.

    python benchmarks/markov.py                       100 records a cell
    python benchmarks/markov.py --records 24 --only popcorn,markov
    python benchmarks/markov.py --bounds              errors of M and T over their Cramér-Rao bounds

Truth: N = 6.1e-5 rad/s/sqrt(Hz), records of 2 h at 40 Hz, point samples, in most cells with B = 2.4e-5 rad/s. Each cell
adds a noise, in units of the floor 0.664 B. A row counts the records whose 95 % limits miss the truth at either side,
and those in which a coefficient is measured whose truth is zero. The truth of noise that is none of the terms (popcorn,
a step, a cycle) is B as added and K = 0: what is stated must hold it, or be a bound above it.

Two rows have a range for a truth. A telegraph is too weak to be shown beside B in an hour. Where M is stated beside B,
B is what was added; where it is not, B is the least of the curve over 0.664, as everywhere in practice. Noise between
white and flicker beside N has no level: N is that of the white noise, or of both at half the sampling rate.
"""

from __future__ import annotations

import argparse
import os
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the program does

import numpy as np
import scipy.fft
import scipy.signal
from simulated import markov_bound

from imumon.model.coefficients import Estimate
from imumon.noise import ChannelFit, OctaveCascade, fit_curve, synthesise
from imumon.noise.fit.model import TRIED

N, B, RATE, LENGTH = 6.1e-5, 2.4e-5, 40.0, 288_000
FLOOR = 0.664 * B
BATCH = 10

Added = Callable[[np.random.Generator, int], np.ndarray]


def markov(sigma: float, time_s: float) -> Added:
    def added(rng: np.random.Generator, n: int) -> np.ndarray:
        a = np.exp(-1.0 / RATE / time_s)
        drive = sigma * np.sqrt(1.0 - a * a) * rng.standard_normal(n)
        drive[0] = sigma * rng.standard_normal()
        return np.asarray(scipy.signal.lfilter([1.0], [1.0, -a], drive))

    return added


def popcorn(size: float, dwell_s: float) -> Added:
    """Two levels, apart by twice `size`, each held for exponential times."""

    def added(rng: np.random.Generator, n: int) -> np.ndarray:
        changes = rng.random(n) < 1.0 / (dwell_s * RATE)
        return size * np.where((np.cumsum(changes) + rng.integers(2)) % 2, 1.0, -1.0)

    return added


def step(size: float) -> Added:
    return lambda rng, n: size * (np.arange(n) > n * rng.uniform(0.1, 0.9))


def cycle(size: float, period_s: float) -> Added:
    return lambda rng, n: size * np.sin(2.0 * np.pi * (np.arange(n) / RATE / period_s + rng.random()))


def bump(size: float) -> Added:
    """A mean that rises and falls once, as that of a room in which somebody works."""

    def added(rng: np.random.Generator, n: int) -> np.ndarray:
        place, width = rng.uniform(0.25, 0.75), rng.uniform(0.08, 0.2)
        return size * np.exp(-0.5 * ((np.arange(n) / n - place) / width) ** 2)

    return added


def passage(size: float) -> Added:
    """A mean that moves from one level to another, `size` above and below, in a tenth to four tenths of the record."""

    def added(rng: np.random.Generator, n: int) -> np.ndarray:
        place, width = rng.uniform(0.25, 0.75), rng.uniform(0.05, 0.2)
        return size * np.tanh((np.arange(n) / n - place) / width)

    return added


def power_law(exponent: float, size: float) -> Added:
    """Density 1/f^exponent, that of N at `size` Hz."""

    def added(rng: np.random.Generator, n: int) -> np.ndarray:
        k = np.arange(1, 2 * n)
        h = np.concatenate(([1.0], np.cumprod((k - 1.0 + 0.5 * exponent) / k)))
        white = rng.standard_normal(2 * n)
        size_fft = scipy.fft.next_fast_len(4 * n)
        y = scipy.fft.irfft(scipy.fft.rfft(h, size_fft) * scipy.fft.rfft(white, size_fft), size_fft)[
            n : 2 * n
        ]
        return np.asarray(N * np.sqrt(RATE) * (2.0 * np.pi * size / RATE) ** (0.5 * exponent) * y)

    return added


def hum(frequency_hz: float, wander_hz: float, size: float) -> Added:
    """A line, of some standard deviations of the noise, whose frequency wanders over a minute."""

    def added(rng: np.random.Generator, n: int) -> np.ndarray:
        pole = np.exp(-1.0 / 60.0)
        drive = np.sqrt(1.0 - pole * pole) * rng.standard_normal(n // round(RATE) + 2)
        drive[0] = rng.standard_normal()
        slow = scipy.signal.lfilter([1.0], [1.0, -pole], drive)
        steps = frequency_hz + wander_hz * np.interp(np.arange(n) / RATE, np.arange(slow.size), slow)
        return np.asarray(
            size * N * np.sqrt(RATE) * np.sin(2.0 * np.pi * (np.cumsum(steps) / RATE + rng.random()))
        )

    return added


def louder(share: float) -> Added:
    """White noise that makes N larger by a share in the second half."""

    def added(rng: np.random.Generator, n: int) -> np.ndarray:
        more = N * np.sqrt(RATE * ((1.0 + share) ** 2 - 1.0))
        return more * (np.arange(n) >= n // 2) * rng.standard_normal(n)

    return added


def nothing(rng: np.random.Generator, n: int) -> np.ndarray:
    return np.zeros(n)


def least_of_curve(sigma: float, time_s: float, longest_s: float) -> float:
    """Return the least Allan deviation of N, B and M up to a cluster, s, over 0.664."""
    tau = np.geomspace(1.0, longest_s, 1000)
    of_markov = TRIED[0].with_time(time_s).allan_variances(tau, averaged=True)
    return float(np.sqrt((N**2 / tau + FLOOR**2 + sigma**2 * of_markov).min()) / 0.664)


@dataclass(frozen=True)
class Cell:
    name: str
    added: Added = nothing
    N: float = N
    B: float = B
    K: float = 0.0
    M: tuple[float, float] | None = None  # sigma, time constant, s
    length: int = LENGTH
    quantum: float = 0.0
    truth: dict[str, tuple[float, float]] = field(default_factory=dict)  # by letter, if it is a range


def sized(name: str, sigma: float, time_s: float, *, B: float = B) -> Cell:
    return Cell(name, markov(sigma, time_s), B=B, M=(sigma, time_s))


CELLS = (
    Cell("clean", B=0.0),
    Cell("clean B"),
    Cell("clean B, K", K=1.5e-6),
    Cell("clean K", B=0.0, K=3e-6),
    sized("markov 3 floors, 57 s", 3 * FLOOR, 57.0, B=0.0),
    sized("markov 3 floors, 57 s, B", 3 * FLOOR, 57.0),
    sized("markov 10 floors, 57 s, B", 10 * FLOOR, 57.0),
    sized("markov 2 floors, 20 s, B", 2 * FLOOR, 20.0),
    sized("markov 3 floors, 200 s, B", 3 * FLOOR, 200.0),
    sized("markov 3 floors, 1 s, B", 3 * FLOOR, 1.0),
    Cell("popcorn 3 floors, 30 s", popcorn(3 * FLOOR, 30.0)),
    Cell("popcorn 10 floors, 30 s", popcorn(10 * FLOOR, 30.0)),
    Cell("step 5 floors", step(5 * FLOOR)),
    Cell("step 2 floors", step(2 * FLOOR)),
    Cell("cycle of a day, 2 h", cycle(20 * FLOOR, 86_400.0)),
    Cell("cycle of a day, 12 h", cycle(20 * FLOOR, 86_400.0), length=6 * LENGTH),
    Cell("rise and fall of 10 floors", bump(10 * FLOOR)),
    Cell("rise and fall of 20 floors", bump(20 * FLOOR)),
    Cell("rise and fall of 50 floors", bump(50 * FLOOR)),
    Cell("passage of 10 floors", passage(10 * FLOOR)),
    Cell("passage of 30 floors", passage(30 * FLOOR)),
    Cell("clean B, K = 1.7e-6", K=1.7e-6),
    Cell("clean B, K = 2.55e-6", K=2.55e-6),
    Cell("clean B, K = 3e-6", K=3e-6),
    Cell("clean B, K = 1e-5", K=1e-5),
    Cell("clean K, 12 h", K=3e-7, length=6 * LENGTH),
    Cell(
        "1/f^0.5",
        power_law(0.5, 0.1),
        B=0.0,
        truth={"N": (N, N * (1.0 + (0.1 / (0.5 * RATE)) ** 0.5) ** 0.5)},
    ),
    Cell("1/f^0.5 alone, 10 min", power_law(0.5, RATE / np.pi), N=0.0, B=0.0, length=LENGTH // 12),
    Cell("1/f^0.5 alone", power_law(0.5, RATE / np.pi), N=0.0, B=0.0),  # N is the level at half the rate
    Cell("hum 0.03 Hz, 1 sigma, 1 h", hum(0.03, 0.02, 1.0), length=LENGTH // 2),
    Cell("hum 0.03 Hz, 0.3 sigma, 1 h", hum(0.03, 0.02, 0.3), length=LENGTH // 2),
    Cell("hum 0.03 Hz, 0.1 sigma, 1 h", hum(0.03, 0.02, 0.1), length=LENGTH // 2),
    Cell("hum 0.3 Hz, 0.3 sigma, 1 h", hum(0.3, 0.05, 0.3), length=LENGTH // 2),
    Cell("line 0.1 Hz, 2 sigma, 1 h", hum(0.1, 0.001, 2.0), length=LENGTH // 2),
    Cell("slow sine, 0.7 records, 1 h", cycle(FLOOR, 0.7 * 3600.0), length=LENGTH // 2),
    Cell(
        "telegraph 1.5 floors, 30 s, 1 h",
        popcorn(1.5 * FLOOR, 60.0),
        length=LENGTH // 2,
        truth={"B": (B, least_of_curve(1.5 * FLOOR, 30.0, 360.0))},
    ),
    Cell("clean B, K = 1e-6, 1 h", K=1e-6, length=LENGTH // 2),
    Cell("N rises by 20 %, 1 h", louder(0.2), length=LENGTH // 2),
    Cell("white, 20 min", B=0.0, length=LENGTH // 6),
)


def records(cell: Cell, begin: int, count: int) -> np.ndarray:
    out = []
    for k in range(begin, begin + count):
        rng = np.random.default_rng([zlib.crc32(cell.name.encode()), k])
        x = synthesise(cell.length, RATE, N=cell.N, B=cell.B, K=cell.K, seed=rng, averaged=False).ravel()
        out.append(x + cell.added(rng, cell.length))
    return np.stack(out, axis=1)


def counted(cell: Cell, fits: list[ChannelFit]) -> str:
    truths = {"N": N, "B": cell.B, "K": cell.K, "M": cell.M[0] if cell.M else 0.0}
    words = []
    for letter, true in truths.items():
        least, greatest = cell.truth.get(letter, (true, true))
        parts: list[Estimate] = []
        for fit in fits:
            if letter != "M":
                parts.append(fit.coefficients[letter])
            elif fit.markov is not None:
                parts.append(fit.markov.sigma)
        measured = [part for part in parts if part.status == "measured"]
        low = sum(part.low is not None and part.low > greatest for part in parts)
        high = sum(part.high is not None and part.high < least for part in parts)
        invented = "" if true else f" invented {len(measured)}"
        width = np.median([part.high / part.low for part in measured if part.low]) if measured else np.nan
        words.append(
            f"{letter}: {len(measured):3d}/{len(parts):3d} missed {low:2d} {high:2d}{invented} ×÷{width**0.5:.2f}"
        )
    if cell.M:
        times = [fit.markov.time_constant_s for fit in fits if fit.markov is not None]
        low = sum(part.low > cell.M[1] for part in times)
        high = sum(part.high < cell.M[1] for part in times)
        words.append(f"T missed {low} {high}")
    caveats = {
        c: sum(c in fit.caveats for fit in fits)
        for c in ("misfit", "model_misses", "correlated", "not_white", "vibration", "oscillation", "popcorn")
    }
    words.append(" ".join(f"{c} {n}" for c, n in caveats.items() if n))
    return "  ".join(words)


SIZES = (
    (20.0, 2.0, 1),
    (20.0, 10.0, 1),
    (57.0, 3.0, 1),
    (57.0, 10.0, 1),
    (200.0, 3.0, 6),
    (200.0, 10.0, 6),
    (600.0, 3.0, 6),
    (600.0, 10.0, 6),
    (1000.0, 10.0, 6),
)
"""Time constant, s, size in floors, and length of the record in 2 h, of the cells whose errors have a bound."""


def print_bounds(count: int) -> None:
    """Print errors of M and of its time constant beside N and B, over their Cramér-Rao bounds, as Markdown."""
    head = (
        "T, s",
        "M, floors",
        "record, h",
        "bound of M, %",
        "of T, %",
        "measured",
        "M over bound",
        "T",
        "M held",
        "T held",
    )
    print(f"| {' | '.join(head)} |")
    print("|" + "---|" * 10)
    for time_s, floors, lengths in SIZES:
        cell = replace(sized(f"bound {time_s:g} {floors:g}", floors * FLOOR, time_s), length=lengths * LENGTH)
        bounds = markov_bound(cell.length, RATE, N, B, floors * FLOOR, time_s)
        terms = [fit.markov for fit in fits_of(cell, count) if fit.markov is not None]
        cells = [f"{time_s:g} | {floors:g} | {2 * lengths} | {100 * bounds[0]:.1f} | {100 * bounds[1]:.1f}"]
        cells.append(f"{sum(term.sigma.status == 'measured' for term in terms)} of {count}")
        parts = [(term.sigma, term.time_constant_s) for term in terms if term.sigma.status == "measured"]
        truths = floors * FLOOR, time_s
        held = []
        for place in range(2):
            estimates = [both[place] for both in parts]
            errors = [np.log(part.value / truths[place]) for part in estimates if part.value]
            cells.append(f"{np.sqrt(np.mean(np.square(errors))) / bounds[place]:.2f}" if errors else "–")
            held.append(sum((part.low or 0.0) <= truths[place] <= (part.high or 0.0) for part in estimates))
        cells += [f"{number} of {len(parts)}" for number in held]
        print(f"| {' | '.join(cells)} |", flush=True)


def fits_of(cell: Cell, count: int) -> list[ChannelFit]:
    """Return the fits of some records of a cell."""
    fits: list[ChannelFit] = []
    batch = max(1, BATCH * LENGTH // cell.length)
    for begin in range(0, count, batch):
        values = records(cell, begin, min(batch, count - begin))
        cascade = OctaveCascade(values.shape[1], tau0=1.0 / RATE)
        cascade.update(values)
        fits += fit_curve(cascade.result(), averaged=False)
    return fits


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--records", type=int, default=100)
    parser.add_argument("--only", default="")
    parser.add_argument("--bounds", action="store_true", help="errors of M over their Cramér-Rao bounds")
    arguments = parser.parse_args()
    if arguments.bounds:
        print_bounds(arguments.records)
        return
    for cell in CELLS:
        if arguments.only and not any(word in cell.name for word in arguments.only.split(",")):
            continue
        print(f"{cell.name:28s} {counted(cell, fits_of(cell, arguments.records))}", flush=True)


if __name__ == "__main__":
    main()
