"""What real sensors add to white noise, flicker and random walk: the cells of `real_effects`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

N, B = 6.1e-5, 2.4e-5
RATE, LENGTH = 20.0, 180_000
SIGMA = N * math.sqrt(RATE)
TIME = np.arange(LENGTH) / RATE
TOTAL_S = LENGTH / RATE
OFFSET = 0.01
"""rad/s, 37 standard deviations of a sample: mean of records with lost samples, which are zero."""
DEGREES = 25.0 + 3.0 * np.sin(2.0 * np.pi * TIME / 5_000.0) + 2.0 * TIME / TOTAL_S

Change = Callable[[np.ndarray, np.random.Generator], np.ndarray]


@dataclass(frozen=True)
class Effect:
    """One thing that real sensors do.

    Attributes
    ----------
    change : takes samples (n,) and a generator, returns the samples with the effect.
    white : variance that it adds as white noise, in variances of a sample.
    own_white : the same for one record, from its slow part (n,) and the generator; None: `white`.
    valid : takes a generator, returns which samples (n,) arrive; None: all.
    part : begin and end of a part of unknown length that is missing, samples; None: there is none.
    step : resolution, in standard deviations of a sample; 0: none.
    heated : a temperature channel is given.
    settles_s : s, time constant of a warm-up; 0: none.
    pipeline : the whole `Monitor` has to run.
    hidden : the resolution hides the noise, and no value is expected.
    N, B : of the sensor.
    rate, length : Hz, and samples of a record.
    """

    change: Change = lambda y, _: y
    white: float = 0.0
    own_white: Callable[[np.ndarray, np.random.Generator], float] | None = None
    valid: Callable[[np.random.Generator], np.ndarray] | None = None
    part: tuple[int, int] | None = None
    step: float = 0.0
    heated: bool = False
    settles_s: float = 0.0
    pipeline: bool = False
    hidden: bool = False
    N: float = N
    B: float = B
    rate: float = RATE
    length: int = LENGTH


def with_lines(*lines: tuple[float, float]) -> Change:
    """Lines (Hz, standard deviations of a sample) whose frequency wanders by 1 % over a minute."""

    def change(y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        out = y.copy()
        pole = math.exp(-1.0 / 60.0)
        for frequency, size in lines:
            steps = rng.standard_normal(int(TOTAL_S) + 2) * math.sqrt(1.0 - pole * pole)
            steps[0] = rng.standard_normal()
            for at in range(1, len(steps)):
                steps[at] += pole * steps[at - 1]
            wander = np.interp(TIME, np.arange(len(steps)), steps)
            phase = 2.0 * np.pi * np.cumsum(frequency * (1.0 + 0.01 * wander)) / RATE
            out += size * SIGMA * np.sin(phase + rng.uniform(0.0, 2.0 * np.pi))
        return out

    return change


def filtered(response: Callable[[np.ndarray], np.ndarray]) -> Change:
    """Filter of gain 1 at zero frequency; `response` takes cycles per sample."""

    def change(y: np.ndarray, _: np.random.Generator) -> np.ndarray:
        # mirrored, so that the ends do not meet with a step
        whole = np.fft.rfft(np.concatenate((y, y[::-1])))
        return np.fft.irfft(whole * response(np.arange(len(whole)) / (2.0 * len(y))), 2 * len(y))[: len(y)]

    return change


def boxcar(length: int) -> Change:
    def change(y: np.ndarray, _: np.random.Generator) -> np.ndarray:
        total = np.concatenate((np.zeros(1), np.cumsum(np.concatenate((y[: length - 1][::-1], y)))))
        return (total[length:] - total[:-length]) / length

    return change


def low_pass(samples: float) -> Change:
    """First order, time constant in samples."""
    pole = math.exp(-1.0 / samples)
    return filtered(lambda f: (1.0 - pole) / (1.0 - pole * np.exp(-2j * np.pi * f)))


def butterworth(corner: float) -> Change:
    """Second order, corner in cycles per sample, bilinear."""

    def response(f: np.ndarray) -> np.ndarray:
        s = 1j * np.tan(np.pi * np.minimum(f, 0.4999999)) / math.tan(math.pi * corner)
        return np.asarray(1.0 / (1.0 + math.sqrt(2.0) * s + s * s))

    return filtered(response)


def rounded(step: float) -> Effect:
    """Rounding of samples whose offset is anywhere between two values.

    Rounded white noise stays white. Its variance depends on where the slow part lies between two values
    (Widrow & Kollar, Quantization Noise, 2008, chapter 4): with q in standard deviations
    q^2/12 + sum_k (-1)^k (4 + q^2 / (pi k)^2) exp(-2 (pi k / q)^2) cos(2 pi k x / q), less 1.
    """
    q = step * SIGMA

    def change(y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        return q * np.round((y + rng.uniform(0.0, q)) / q)

    def own_white(slow: np.ndarray, rng: np.random.Generator) -> float:
        at, total = slow + rng.uniform(0.0, q), step**2 / 12.0
        mean = np.zeros(len(at))  # of the error, whose square is no variance
        for k in (1, 2, 3):
            least = math.exp(-2.0 * (math.pi * k / step) ** 2)
            angle = 2.0 * np.pi * k * at / q
            total += (-1) ** k * (4.0 + (step / (math.pi * k)) ** 2) * least * float(np.mean(np.cos(angle)))
            mean += (-1) ** k * step / (math.pi * k) * least * np.sin(angle)
        return total - float(np.mean(mean**2))

    return Effect(change, white=step**2 / 12.0, step=step, hidden=step > 2.5, own_white=own_white)


def ramp(size: float) -> Effect:
    """Straight drift, rad/s over the record."""
    return Effect(lambda y, _: y + size * TIME / TOTAL_S)


def warm_up(size: float, constant_s: float) -> Effect:
    return Effect(lambda y, _: y + size * np.exp(-TIME / constant_s), settles_s=constant_s, pipeline=True)


def outliers(share: float, *, contaminated: bool = False) -> Effect:
    """Single samples 8 to 20 sigma away; contaminated: ten times the noise, which is noise then."""

    def change(y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        out, hit = y.copy(), rng.random(len(y)) < share
        count = int(hit.sum())
        if contaminated:
            out[hit] += math.sqrt(99.0) * SIGMA * rng.standard_normal(count)
        else:
            out[hit] += rng.choice([-1.0, 1.0], count) * rng.uniform(8.0, 20.0, count) * SIGMA
        return out

    if not contaminated:
        return Effect(change, pipeline=True)
    return Effect(change, white=99.0 * share, pipeline=True)


def oscillation(least_s: float, most_s: float, *, wanders: bool = False) -> Effect:
    """Slow oscillation of 0.08 standard deviations of a sample, whose period lies between two limits.

    If it wanders, the period is a random walk of 60 s in half an hour, reflected at the limits.
    """

    def change(y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        seconds, width = np.arange(int(TOTAL_S) + 2), most_s - least_s
        period = np.full(len(seconds), rng.uniform(least_s, most_s))
        if wanders:
            walk = period + np.cumsum(60.0 / math.sqrt(1800.0) * rng.standard_normal(len(seconds)))
            period = most_s - width * np.abs(1.0 - np.mod((walk - least_s) / width, 2.0))
        phase = 2.0 * np.pi * np.cumsum(np.interp(TIME, seconds, 1.0 / period)) / RATE
        return y + 0.08 * SIGMA * np.sin(phase + rng.uniform(0.0, 2.0 * np.pi))

    return Effect(change)


def switched() -> Effect:
    """White noise whose variance is 1 or 4 times that of the others by turns, over 5 to 60 s."""

    def great(rng: np.random.Generator) -> np.ndarray:
        out, at, now = np.zeros(LENGTH, dtype=bool), 0, bool(rng.integers(2))
        while at < LENGTH:
            length = round(rng.uniform(5.0, 60.0) * RATE)
            out[at : at + length] = now
            at, now = at + length, not now
        return out

    def change(y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        return y + math.sqrt(3.0) * SIGMA * great(rng) * rng.standard_normal(LENGTH)

    return Effect(change, white=1.5, own_white=lambda _, rng: 3.0 * float(great(rng).mean()))


def loss(share: float) -> Effect:
    """Samples that are lost one by one."""
    return Effect(lambda y, _: y + OFFSET, valid=lambda rng: rng.random(LENGTH) >= share)


def bursts(share: float, length: int) -> Effect:
    """Losses of `length` samples, between which the link is up for exponentially distributed times."""

    def valid(rng: np.random.Generator) -> np.ndarray:
        up = length * (1.0 - share) / share
        out, at = np.ones(LENGTH, dtype=bool), 0
        while (at := at + 1 + round(rng.exponential(up))) < LENGTH:
            out[at : at + length] = False
            at += length
        return out

    return Effect(lambda y, _: y + OFFSET, valid=valid)


def gap(length: int) -> Effect:
    """No samples in the middle, for a known time."""
    return Effect(
        lambda y, _: y + OFFSET, valid=lambda _: np.abs(np.arange(LENGTH) - LENGTH // 2) >= length // 2
    )


def broken(length: int, jump: float) -> Effect:
    """No samples in the middle, for an unknown time; after it the mean is another one, normal, rad/s."""

    def change(y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        return y + OFFSET + jump * rng.standard_normal() * (np.arange(LENGTH) >= LENGTH // 2)

    return Effect(change, part=(LENGTH // 2 - length // 2, LENGTH // 2 + length // 2))


LINES = ((1.3, 0.3), (3.7, 0.6), (5.9, 1.0), (7.1, 0.2))
EFFECTS = {
    "clean": Effect(),
    "clean, temperature known": Effect(heated=True),
    "four lines": Effect(with_lines(*LINES)),
    "one weak line, 0.41 Hz": Effect(with_lines((0.41, 0.15))),
    "one strong line, 6.3 Hz": Effect(with_lines((6.3, 3.0))),
    "moving average of 2": Effect(boxcar(2)),
    "moving average of 3": Effect(boxcar(3)),
    "moving average of 4": Effect(boxcar(4)),
    "moving average of 6": Effect(boxcar(6)),
    "low-pass, 2 samples": Effect(low_pass(2.0)),
    "low-pass, 6 samples": Effect(low_pass(6.0)),
    "Butterworth, 0.1 of the rate": Effect(butterworth(0.1)),
    "rounded to 0.5 sigma": rounded(0.5),
    "rounded to 1 sigma": rounded(1.0),
    "rounded to 2 sigma": rounded(2.0),
    "rounded to 3 sigma": rounded(3.0),
    "ramp of 1e-4 rad/s": ramp(1e-4),
    "ramp of 1e-3 rad/s": ramp(1e-3),
    "temperature, 2e-5 rad/s/K": Effect(lambda y, _: y + 2e-5 * DEGREES, heated=True),
    "temperature, 2e-4 rad/s/K": Effect(lambda y, _: y + 2e-4 * DEGREES, heated=True),
    "oscillation of 300 s": oscillation(300.0, 300.0),
    "oscillation of 240 to 420 s": oscillation(240.0, 420.0),
    "wandering oscillation, 4 to 7 min": oscillation(240.0, 420.0, wanders=True),
    "variance 1 or 4 by turns": switched(),
    "loss of 1 %": loss(0.01),
    "loss of 10 %": loss(0.1),
    "loss of 50 %": loss(0.5),
    "loss of 10 % in bursts of 1 s": bursts(0.1, 20),
    "gap of 10 min": gap(12_000),
    "break of unknown length, another bias": broken(24_000, 1e-3),
    "noisy gyroscope, 1 h at 100 Hz": Effect(
        N=math.radians(0.1), B=math.radians(20.0 / 3600.0), rate=100.0, length=360_000
    ),
    "clean, pipeline": Effect(pipeline=True),
    "lines, pipeline": Effect(with_lines(*LINES), pipeline=True),
    "warm-up 2e-4 rad/s, 20 min": warm_up(2e-4, 1200.0),
    "warm-up 1e-3 rad/s, 20 min": warm_up(1e-3, 1200.0),
    "warm-up 2e-4 rad/s, 1 h": warm_up(2e-4, 3600.0),
    "warm-up 1e-3 rad/s, 1 h": warm_up(1e-3, 3600.0),
    "outliers 0.01 %": outliers(1e-4),
    "outliers 0.1 %": outliers(1e-3),
    "outliers 5 %": outliers(0.05, contaminated=True),
}
