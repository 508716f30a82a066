"""Histogram: how the values of each channel are distributed, in bins that adapt to their range.

Bins are equal and lie on a fixed lattice: the width is a power of two (times the step of a quantised channel,
so that every bin holds the same number of levels and no comb appears), the edges are multiples of it. When a
value is outside, pairs of bins are merged until it fits. So counts stay exact, the number of bins stays
bounded, and the result depends on the values alone, not on their order or chunking. numpy.histogram needs all
samples at once.

The verdict is about effect size: with a million samples every real distribution fails a significance test,
but the question is whether a Gaussian model would mislead. Limits are on the Kolmogorov distance
to the Gaussian of the same mean and standard deviation, on skewness and on excess kurtosis, each widened by
its own sampling error: 1.5/sqrt(n) for the distance (a Gaussian exceeds 1.03/sqrt(n) once in a hundred times,
Lilliefors 1967), for the others four standard errors in large samples, sqrt(6/n) and sqrt(24/n) (Fisher
1930).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.special import ndtr

from imumon.samples import Bools, Floats, Ints

HISTOGRAM_BINS = 256
"""Bins of a channel: at least half of them are in use."""
LEARN_SAMPLES = 256
"""Samples from which the step of a quantised channel is read, and below which there is no verdict."""

GAUSSIAN_DISTANCE = 0.025
"""Kolmogorov distance up to which a distribution counts as Gaussian: probabilities are right to 2.5 %."""
GAUSSIAN_SKEWNESS = 0.25
"""Absolute skewness up to which a distribution counts as Gaussian."""
GAUSSIAN_KURTOSIS = 0.5
"""Absolute excess kurtosis up to which a distribution counts as Gaussian."""
DISTANCE_ERROR = 1.5
"""Sampling error of the distance that is allowed, times sqrt(n)."""
MOMENT_ERRORS = 4.0
"""Standard errors of skewness and kurtosis that are allowed, and by which a mode must rise."""
COARSE_STEPS = 1.5
"""Standard deviation, in quantisation steps, below which a channel is called quantised."""
FEW_LEVELS = 8
"""Levels up to which a channel whose step could not be learned counts as quantised, and above which the least
difference may be several steps."""
MODE_HEIGHT = 0.1
"""Share of the highest count by which a mode rises above the valleys beside it."""
MODE_WIDTH = 0.25
"""Width of the smoothing kernel for modes, as a share of the standard deviation."""
LEAST_MODE_WIDTH = 0.5
"""Bins, least width of that kernel."""

LEAST_STEP = 1e-150
"""Channel unit, least quantisation step: its reciprocal and its square are finite."""
ROUNDED_GAP = 1e-9
"""Share of the largest value below which a difference of two values is rounding."""
LATTICE_ERROR = 0.02
"""Steps by which a difference may miss a multiple of the quantisation step."""
LATTICE_ROUNDING = 1e-7
"""The same, in addition, as a share of the multiple."""
MOST_MULTIPLE = 1e6
"""Steps, largest difference with which a step is recognised: beyond, any number is a multiple."""
PRECISE_BITS = 44
"""Bits of a place on the lattice that are exact: a float has 53, and sums of places need some."""

_ARRAYS = ("step", "unit", "exponent", "low", "counts", "started")


@dataclass(frozen=True, slots=True)
class DistributionShape:
    """Distribution of one channel.

    Attributes
    ----------
    start, width : channel unit, lower edge of the first bin and width of each.
    counts : samples in each bin, without empty bins at the ends.
    gaussian : expected counts of a Gaussian with the same mean and deviation.
    is_gaussian : None with fewer than `LEARN_SAMPLES` samples.
    verdict : text, such as ``not Gaussian: heavy tails``.
    modes : channel unit, places of the maxima, highest first.
    distance : Kolmogorov distance to the Gaussian; None without spread.
    skewness, excess_kurtosis : 1; None without spread.
    step : channel unit, quantisation step, or None.
    """

    start: float
    width: float
    counts: tuple[int, ...]
    gaussian: tuple[float, ...]
    is_gaussian: bool | None
    verdict: str
    modes: tuple[float, ...]
    distance: float | None = None
    skewness: float | None = None
    excess_kurtosis: float | None = None
    step: float | None = None

    @property
    def constant(self) -> bool:
        """Whether the channel never changed in `LEARN_SAMPLES` samples or more."""
        return len(self.counts) == 1 and self.counts[0] >= LEARN_SAMPLES


class HistogramAccumulator:
    """Histograms of some channels.

    Parameters
    ----------
    groups : (c,) group of each channel, 0 ... g-1; the channels of a group share their validity.
    """

    def __init__(self, groups: Sequence[int]) -> None:
        self._groups = list(groups)
        c = len(self._groups)
        self._held: list[tuple[Floats, Bools | None]] = []
        self._holding = 0
        self._step = np.zeros(c)  # 0: not quantised
        self._exponent = np.zeros(c, dtype=np.int64)  # width = unit * 2^exponent
        self._unit = np.ones(c)
        self._low = np.zeros(c, dtype=np.int64)  # lattice number of the first bin
        self._counts = np.zeros((c, HISTOGRAM_BINS), dtype=np.int64)
        self._started = np.zeros(c, dtype=bool)

    def update(self, values: Floats, valid: Bools | None = None) -> None:
        """Add samples.

        Parameters
        ----------
        values : (n, c) channel unit, finite where valid.
        valid : (n, g); None: all.
        """
        if self._holding < LEARN_SAMPLES:
            n = min(len(values), LEARN_SAMPLES - self._holding)
            self._held.append((np.array(values[:n]), None if valid is None else np.array(valid[:n])))
            self._holding += n
            if self._holding < LEARN_SAMPLES:
                return
            self._learn()
            values, valid = values[n:], None if valid is None else valid[n:]
        self._add(values, valid)

    def _learn(self) -> None:
        """Estimate the steps from the samples that are held back, and count these."""
        blocks, self._held = self._held, []
        for c, group in enumerate(self._groups):
            x = np.concatenate([v[:, c] if ok is None else v[ok[:, group], c] for v, ok in blocks])
            self._step[c] = quantum(x)
            self._unit[c] = self._step[c] or 1.0
        for values, ok in blocks:
            self._add(values, ok)

    def _add(self, values: Floats, valid: Bools | None) -> None:
        if not len(values):
            return
        groups = np.array(self._groups)
        if valid is None or valid.all():
            self._count(np.arange(len(groups)), np.ascontiguousarray(values.T))
            return
        for group in np.flatnonzero(valid.any(axis=0)).tolist():
            channels = np.flatnonzero(groups == group)
            self._count(channels, np.ascontiguousarray(values[valid[:, group]][:, channels].T))

    def _count(self, channels: Ints, x: Floats) -> None:
        """Count (c, n) values of these channels."""
        if not self._started[channels].all():
            self._fit_range(channels, x.min(axis=1), x.max(axis=1))
        place = self._places(channels, x)
        if place.min() < 0.0 or place.max() >= HISTOGRAM_BINS:
            self._fit_range(channels, x.min(axis=1), x.max(axis=1))
            place = np.clip(self._places(channels, x), 0, HISTOGRAM_BINS - 1)
        bins = place.astype(np.int64)
        # The base of each channel is added as an integer: a rounded sum could cross into the next channel.
        bins += np.arange(len(channels))[:, None] * HISTOGRAM_BINS
        counts = np.bincount(bins.ravel(), minlength=len(channels) * HISTOGRAM_BINS)
        self._counts[channels] += counts.reshape(-1, HISTOGRAM_BINS)

    def _places(self, channels: Ints, x: Floats) -> Floats:
        """Return (c, n) the bin of each value with its fraction; values beyond the bins are outside 0 ... 256."""
        scale = np.ldexp(1.0 / self._unit[channels], -self._exponent[channels])
        # A quantised value belongs in the middle of its level's bin.
        offset = np.ldexp(self._shift(channels), -self._exponent[channels]) - self._low[channels]
        place = x * scale[:, None]
        place += offset[:, None]
        return np.asarray(place, dtype=np.float64)

    def _shift(self, channels: Ints) -> Floats:
        return np.where(self._step[channels] > 0, 0.5, 0.0)

    def _fit_range(self, channels: Ints, low: Floats, high: Floats) -> None:
        """Widen the bins of channels until their least and greatest values (c,), channel unit, fit."""
        low = low / self._unit[channels] + self._shift(channels)
        high = high / self._unit[channels] + self._shift(channels)
        for i, c in enumerate(channels.tolist()):
            if not self._started[c]:
                self._started[c] = True
                # the finest lattice on which places are exact integers in a float
                finest = math.frexp(max(abs(low[i]), abs(high[i]), 1e-30))[1] - PRECISE_BITS
                self._exponent[c] = 0 if self._step[c] else finest
                self._low[c] = math.floor(math.ldexp(low[i], -int(self._exponent[c])))
            while True:
                e = int(self._exponent[c])
                first, last = math.floor(math.ldexp(low[i], -e)), math.floor(math.ldexp(high[i], -e))
                used = np.flatnonzero(self._counts[c])
                if len(used):
                    first = min(first, int(self._low[c] + used[0]))
                    last = max(last, int(self._low[c] + used[-1]))
                if last - first < HISTOGRAM_BINS:
                    self._place(c, first, last)
                    break
                self._merge(c)

    def _place(self, c: int, first: int, last: int) -> None:
        """Shift the bins of a channel so that lattice numbers first ... last are among them."""
        if self._low[c] <= first and last < self._low[c] + HISTOGRAM_BINS:
            return
        low = first - (HISTOGRAM_BINS - 1 - (last - first)) // 2
        moved = np.zeros(HISTOGRAM_BINS, dtype=np.int64)
        used = np.flatnonzero(self._counts[c])
        moved[used + int(self._low[c]) - low] = self._counts[c, used]
        self._counts[c], self._low[c] = moved, low

    def _merge(self, c: int) -> None:
        """Halve the resolution of a channel: pairs on the lattice become one bin."""
        used = np.flatnonzero(self._counts[c])
        numbers = (used + int(self._low[c])) >> 1
        self._exponent[c] += 1
        low = int(numbers[0]) if len(numbers) else int(self._low[c]) >> 1
        merged = np.zeros(HISTOGRAM_BINS, dtype=np.int64)
        np.add.at(merged, numbers - low, self._counts[c, used])
        self._counts[c], self._low[c] = merged, low

    def result(self) -> list[DistributionShape | None]:
        """Return the shape of each channel; None without samples."""
        counted = self
        if self._held:
            counted = HistogramAccumulator(self._groups)
            counted._held = list(self._held)
            counted._learn()
        return [counted._shape(c) for c in range(len(self._groups))]

    def _shape(self, c: int) -> DistributionShape | None:
        used = np.flatnonzero(self._counts[c])
        if not len(used):
            return None
        counts = self._counts[c, used[0] : used[-1] + 1]
        width = math.ldexp(float(self._unit[c]), int(self._exponent[c]))
        step = float(self._step[c]) or None
        start = (int(self._low[c]) + int(used[0])) * width - (0.5 * step if step else 0.0)
        return _assessed(start, width, counts, step or _sparse(counts, width))

    def save(self) -> dict[str, np.ndarray]:
        """Return the state as arrays."""
        out = {name: getattr(self, f"_{name}").copy() for name in _ARRAYS}
        out |= {"holding": np.array(self._holding), "groups": np.array(self._groups)}
        if self._held:
            g = max(self._groups) + 1
            out["held"] = np.concatenate([v for v, _ in self._held])
            out["held_valid"] = np.concatenate(
                [np.ones((len(v), g), dtype=bool) if ok is None else ok for v, ok in self._held]
            )
        return out

    @classmethod
    def restore(cls, saved: Mapping[str, np.ndarray]) -> HistogramAccumulator:
        """Return an accumulator that continues from a saved state."""
        self = cls(saved["groups"].tolist())
        for name in _ARRAYS:
            setattr(self, f"_{name}", saved[name].copy())
        self._holding = int(saved["holding"])
        self._held = [(saved["held"], saved["held_valid"])] if "held" in saved else []
        return self


def quantum(x: Floats) -> float:
    """Return the step of a quantised channel; 0.0 if the values are constant or lie on no lattice.

    Parameters
    ----------
    x : (n,) some values.

    >>> quantum(np.array([0.3, 0.1, 0.7, 0.3])), quantum(np.array([2.0, 2.0]))
    (0.2, 0.0)
    """
    levels = np.unique(x)
    if len(levels) < 2:
        return 0.0
    gaps = np.diff(levels)
    step = float(gaps[gaps > ROUNDED_GAP * np.abs(levels).max()].min(initial=np.inf))
    if not LEAST_STEP < step < math.inf:
        return 0.0
    for divisor in (1, 2, 3):  # the least difference may itself be several steps
        fine = step / divisor
        multiples = gaps / fine
        if np.all(np.abs(multiples - np.rint(multiples)) < LATTICE_ERROR + LATTICE_ROUNDING * multiples) and (
            multiples.max() < MOST_MULTIPLE and (len(levels) > FEW_LEVELS or divisor == 1)
        ):
            # the whole range determines the step better than the least difference
            total = (levels[-1] - levels[0]) / np.rint((levels[-1] - levels[0]) / fine)
            return float(f"{total:.9g}")
    return 0.0


def _sparse(counts: Ints, width: float) -> float | None:
    """Return the step of a channel that was constant while steps were learned: few levels, far apart."""
    levels = np.flatnonzero(counts)
    if not 1 < len(levels) <= FEW_LEVELS:
        return None
    apart = int(np.diff(levels).min())
    return apart * width if apart > 1 else None


def _assessed(start: float, width: float, counts: Ints, step: float | None) -> DistributionShape:
    """Return the shape of the distribution from the counts of equal bins."""
    n = int(counts.sum())
    share = counts / n
    centres = np.asarray(start + width * (np.arange(len(counts)) + 0.5), dtype=np.float64)
    d = np.arange(len(counts)) - float(len(counts) // 2)  # in bins, because powers of tiny units underflow
    middle, mean = float(centres[len(counts) // 2]), float(share @ d)
    d = d - mean
    m2 = float(share @ d**2)
    shape = partial(DistributionShape, start=start, width=width, counts=tuple(counts.tolist()), step=step)
    if n < 2 or m2 <= 0.0:
        return shape(
            gaussian=(float(n),) * len(counts),
            is_gaussian=None,
            verdict="constant" if n >= LEARN_SAMPLES else "too few samples",
            modes=(mean * width + middle,),
        )
    # Grouping into bins adds 1/12 to the variance (Sheppard), unless the bins are the levels themselves.
    grouped = float(step is None or width > 1.5 * step)
    variance = max(m2 - grouped / 12.0, 0.25 * m2)
    skewness = float(share @ d**3) / variance**1.5
    kurtosis = (float(share @ d**4) - grouped * (m2 / 2.0 - 7.0 / 240.0)) / variance**2 - 3.0
    phi = ndtr((np.append(d, d[-1] + 1.0) - 0.5) / math.sqrt(variance))
    distance = float(np.abs(np.cumsum(share) - phi[1:]).max())
    modes = _modes(counts, centres, math.sqrt(variance))
    deviations = _deviations(n, distance, skewness, kurtosis, len(modes))
    coarse = step is not None and math.sqrt(variance) * width < COARSE_STEPS * step
    if coarse and step is not None:
        deviations = [f"quantised: {int(np.count_nonzero(counts))} levels"]
    if n < LEARN_SAMPLES:
        verdict = "too few samples"
    else:
        verdict = f"not Gaussian: {', '.join(deviations)}" if deviations else "Gaussian"
    return shape(
        gaussian=tuple((n * np.diff(phi)).tolist()),
        is_gaussian=None if n < LEARN_SAMPLES else not deviations,
        verdict=verdict,
        modes=modes,
        distance=distance,
        skewness=skewness,
        excess_kurtosis=kurtosis,
    )


def _deviations(n: int, distance: float, skewness: float, kurtosis: float, modes: int) -> list[str]:
    """Return how a distribution differs from a Gaussian, as text."""
    tails = GAUSSIAN_KURTOSIS + MOMENT_ERRORS * math.sqrt(24.0 / n)
    conditions = {
        f"{modes} modes": modes > 1,
        "heavy tails": kurtosis > tails,
        "light tails": kurtosis < -tails and modes == 1,
        "skewed": abs(skewness) > GAUSSIAN_SKEWNESS + MOMENT_ERRORS * math.sqrt(6.0 / n),
    }
    deviations = [text for text, applies in conditions.items() if applies]
    different = distance > GAUSSIAN_DISTANCE + DISTANCE_ERROR / math.sqrt(n)
    return deviations or (["shape"] if different else [])


def _modes(counts: Ints, centres: Floats, sigma: float) -> tuple[float, ...]:
    """Return the maxima of the smoothed counts, highest first.

    A maximum rises above the valleys beside it by `MODE_HEIGHT` of the highest and by `MOMENT_ERRORS`
    standard errors. scipy.signal.find_peaks does the same, but costs the daemon 50 MB.

    Parameters
    ----------
    counts : (k,)
    centres : (k,) channel unit.
    sigma : bins, standard deviation of all samples.
    """
    h = max(MODE_WIDTH * sigma, LEAST_MODE_WIDTH)
    reach = math.ceil(3.0 * h)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / h) ** 2)
    kernel /= kernel.sum()
    smooth = np.convolve(np.pad(counts.astype(np.float64), reach), kernel, mode="valid").tolist()
    error = math.sqrt(float(kernel @ kernel))
    least = MODE_HEIGHT * max(smooth)
    maxima: list[int] = []
    top, bottom, rising = 0, 0, True
    for i, value in enumerate(smooth):
        if rising:
            top = i if value > smooth[top] else top
            if smooth[top] - value > max(least, MOMENT_ERRORS * error * math.sqrt(max(smooth[top], 1.0))):
                maxima.append(top)
                rising, bottom = False, i
        else:
            bottom = i if value < smooth[bottom] else bottom
            if value - smooth[bottom] > max(least, MOMENT_ERRORS * error * math.sqrt(max(value, 1.0))):
                rising, top = True, i
    if rising:
        maxima.append(top)
    maxima.sort(key=lambda i: -smooth[i])
    return tuple(float(centres[i]) for i in maxima)
