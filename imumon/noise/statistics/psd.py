"""Power spectral density from half the sampling rate down to one cycle per record, in bounded memory.

A cascade: each stage averages periodograms of 256 samples (Hann window, half overlapped: Welch 1967), and
passes every second sample behind a half-band filter to the next stage. Stage s resolves rate / 2^s /
256, so resolution follows frequency, and memory grows with the logarithm of the record only.
scipy.signal.welch needs the whole record at once and has one resolution for all frequencies; scipy.signal
costs 50 MB.

- A stage uses its first 1024 segments, then one in 2, from 2048 on one in 4 ...: 512 more each time the
  record doubles. A thousand averages give a bin to 3 %; more cost time for little.
- Missing samples are replaced by the mean of their neighbourhood (128 samples); a segment of which more than
  a tenth was replaced does not count. So a gap costs a segment at short periods and none at long ones.
- Density is one-sided: white noise of coefficient N (Allan variance N^2/tau) has density 2 N^2.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imumon.noise.statistics.narrow_bands import NarrowBand, QuietDensity, distinct_bands, find_narrow_bands
from imumon.noise.statistics.spectral_lines import (
    BINS,
    HOP,
    SEGMENT,
    distinct,
    find_lines,
    median_to_mean,
    side_levels,
)
from imumon.report import Line
from imumon.samples import Bools, Floats, Ints

STAGES = 30
"""Most stages: 2^37 samples are five years at 800 Hz. Not critical."""
ALL_SEGMENTS = 1024
"""Segments up to which a stage uses every one; a power of two. Not critical."""
LEAST_VALID = 0.9
"""Share of valid samples in each half of a segment that counts. Not critical."""
LONG_GAP = 1 << 16
"""Samples, longest gap that segments may span; a longer one ends all segments. Not critical."""

TAPS = np.array([-0.0026544081, 0.0082231405, -0.0198700275, 0.042431558, -0.0920067759, 0.3133644193])
"""Outer half of the half-band filter's taps other than the middle one, 0.5: equiripple, 23 taps,
flat to 0.1 % up to 0.18 and down by 59 dB from 0.32 of its input rate."""
_HISTORY = 22
"""Samples before a hop that the filter needs. Sensitivity: halved changes which values appear, doubled 0 %
(operands of the record "ValueError")."""

PASS_BAND = 0.36
"""Share of its rate up to which a stage after the filter is used; the stage above begins at half of it.
Sensitivity: halved 0 %, doubled changes which values appear (index of the record "IndexError")."""
LEAST_AVERAGES = 4
"""Averages from which a stage replaces the one above at low frequencies. Not critical."""
FILTER_BLOCK = 4096
"""Values that are filtered together: they stay in the processor's cache from tap to tap. Not critical."""
BATCH_HOPS = 8
"""Hops that are processed together, because each array operation has a fixed cost. Not critical."""

_WINDOW = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(SEGMENT) / SEGMENT)


@dataclass(frozen=True, slots=True, eq=False)
class PowerSpectrum:
    """Power spectral densities of some channels.

    Attributes
    ----------
    frequency_hz : (k,) Hz, rising.
    density : (k, c) (channel unit)^2/Hz, one-sided; NaN where `averages` is 0.
    averages : (k, c) segments averaged in each value.
    lines : lines of each channel, strongest first.
    bands : narrow bands of each channel, also of weak and broad lines, strongest first.
    quiet : density of each channel at the full rate without its bands; None where there are none.
    white : (c,) channel unit/sqrt(Hz), N from the upper half of the band; NaN if unknown.
    """

    frequency_hz: Floats
    density: Floats
    averages: Ints
    lines: tuple[tuple[Line, ...], ...]
    bands: tuple[tuple[NarrowBand, ...], ...]
    quiet: tuple[QuietDensity | None, ...]
    white: Floats


class _Stage:
    """One rate of the cascade."""

    def __init__(self, channels: int, groups: int) -> None:
        self.power = np.zeros((channels, BINS))
        self.averages = np.zeros(groups, dtype=np.int64)
        self.segments = 0  # used or not
        self.clear()

    def clear(self) -> None:
        """Discard the samples that wait for a segment."""
        self.last: Floats | None = None  # (c, HOP) the hop before
        self.last_share: Floats | None = None  # (g,) valid share of it
        self.history: Floats | None = None  # (c, _HISTORY) inputs before the next hop
        self.half: Floats | None = None  # (c, HOP/2) first half of a hop, if `half_share` is set
        self.half_share: Floats | None = None
        self.waiting: list[tuple[Floats, Floats]] = []  # hops and their valid shares


class SpectrumAccumulator:
    """Cascade of power spectra.

    Parameters
    ----------
    groups : (c,) group of each channel, 0 ... g-1; the channels of a group share their validity.
    rate_hz : Hz, sampling rate.
    """

    def __init__(self, groups: Sequence[int], rate_hz: float) -> None:
        self._groups = np.array(groups, dtype=np.int64)
        self._g = int(self._groups.max()) + 1 if len(groups) else 0
        self._rate = rate_hz
        self._stages: list[_Stage] = []
        self._rows: list[tuple[Floats, Bools | None]] = []  # less than a hop
        self._n = 0
        self._level = np.zeros(len(groups))

    def update(self, values: Floats, valid: Bools | None = None) -> None:
        """Add samples.

        Parameters
        ----------
        values : (n, c) channel unit, finite where valid.
        valid : (n, g); None: all.
        """
        ok = None if valid is None or valid.all() else valid
        self._rows.append((values, ok))
        self._n += len(values)
        if self._n < HOP:
            if ok is not None or len(self._rows) == 1:
                self._rows[-1] = (values.copy(), None if ok is None else ok.copy())
            return
        x = np.concatenate([v.T for v, _ in self._rows], axis=1)
        if any(o is not None for _, o in self._rows):
            ok = self._waiting_valid()
        hops = self._n // HOP
        used = hops * HOP
        self._rows = [(x[:, used:].copy().T, None if ok is None else ok[used:].copy())]
        self._n -= used
        y = x[:, :used].reshape(-1, hops, HOP)
        share = np.ones((hops, self._g))
        if ok is not None and not ok[:used].all():
            y, share = self._filled(y, ok[:used].reshape(hops, HOP, self._g))
        self._level = y[:, -1].mean(axis=1)
        self._feed(0, y, share)

    def skip(self, n: int) -> None:
        """Note that `n` samples are missing."""
        if n > LONG_GAP:
            self.break_()
        elif n > 0:
            blank = np.broadcast_to(self._level, (n, len(self._level)))
            self.update(blank, np.zeros((n, self._g), dtype=bool))

    def break_(self) -> None:
        """Note a gap of unknown length: no segment spans it."""
        self._rows, self._n = [], 0
        self._process_waiting()
        for stage in self._stages:
            stage.clear()

    def _filled(self, y: Floats, ok: Bools) -> tuple[Floats, Floats]:
        """Return hops (c, hops, HOP) and their valid shares (hops, g); the mean of the hop, or the last one
        known, replaces samples without `ok` (hops, HOP, g)."""
        share = ok.mean(axis=1)
        mask = ok[:, :, self._groups].transpose(2, 0, 1)
        count = mask.sum(axis=2)
        mean = np.where(mask, y, 0.0).sum(axis=2) / np.maximum(count, 1)
        for h in range(mean.shape[1]):
            before = self._level if h == 0 else mean[:, h - 1]
            mean[:, h] = np.where(count[:, h] > 0, mean[:, h], before)
        return np.where(mask, y, mean[:, :, None]), share

    def _feed(self, s: int, y: Floats, share: Floats) -> None:
        """Add hops (c, hops, HOP), channel unit, with their valid shares (hops, g) to stage s."""
        if s == len(self._stages):
            self._stages.append(_Stage(len(y), self._g))
        waiting = self._stages[s].waiting
        waiting.append((y, share))
        if sum(len(w) for _, w in waiting) >= BATCH_HOPS:
            self._process(s)

    def _process(self, s: int) -> None:
        """Process the hops that wait at stage s."""
        stage = self._stages[s]
        if not stage.waiting:
            return
        y, share = stage.waiting[0]
        if len(stage.waiting) > 1:
            y = np.concatenate([w for w, _ in stage.waiting], axis=1)
            share = np.concatenate([w for _, w in stage.waiting])
        stage.waiting = []
        self._average(stage, y, share)
        stage.last, stage.last_share = y[:, -1].copy(), share[-1].copy()
        if s + 1 >= STAGES:
            return
        half = _decimated(stage, y.reshape(len(y), -1)).reshape(len(y), -1, HOP // 2)
        if stage.half is not None and stage.half_share is not None:
            half = np.concatenate((stage.half[:, None], half), axis=1)
            share = np.concatenate((stage.half_share[None], share))
        pairs = half.shape[1] // 2
        stage.half_share = None
        if half.shape[1] % 2:
            stage.half, stage.half_share = half[:, -1].copy(), share[-1].copy()
        if pairs:
            whole = half[:, : 2 * pairs].reshape(len(y), pairs, HOP)
            self._feed(s + 1, whole, share[: 2 * pairs].reshape(pairs, 2, -1).mean(axis=1))

    def _process_waiting(self) -> None:
        """Process everything that waits; the averages do not depend on when."""
        for s in range(STAGES):
            if s < len(self._stages):  # which processing may add
                self._process(s)

    def _average(self, stage: _Stage, y: Floats, share: Floats) -> None:
        """Add the segments that these hops complete."""
        first = int(stage.last is None)  # hop that is the second half of a segment
        later = np.arange(first, len(share))
        numbers = stage.segments + later - first
        stage.segments += len(later)
        if stage.segments > ALL_SEGMENTS:
            doublings = np.frexp(numbers / ALL_SEGMENTS)[1]
            strides = np.left_shift(1, np.maximum(0, doublings))
            later = later[numbers % strides == 0]
        if not len(later):
            return
        before = share[later - 1]
        if later[0] == 0 and stage.last_share is not None:
            before[0] = stage.last_share
        whole = np.minimum(before, share[later]) >= LEAST_VALID  # (k, g)
        segments = np.empty((len(y), len(later), SEGMENT))
        segments[:, :, :HOP], segments[:, :, HOP:] = y[:, later - 1], y[:, later]
        if later[0] == 0 and stage.last is not None:
            segments[:, 0, :HOP] = stage.last
        segments -= segments.mean(axis=2, keepdims=True)
        segments *= _WINDOW
        power = np.fft.rfft(segments, axis=2).view(np.float64)
        power *= power
        if whole.all():
            total = power.sum(axis=1)
        else:
            total = np.einsum("ckf,ck->cf", power, whole[:, self._groups].T.astype(np.float64))
        stage.power += total[:, ::2] + total[:, 1::2]
        stage.averages += whole.sum(axis=0)

    def result(self) -> PowerSpectrum:
        """Return density, lines and white level."""
        self._process_waiting()
        stages = self._densities()
        c = len(self._groups)
        if not stages:
            empty = np.zeros((0, c))
            white = np.full(c, np.nan)
            none = ((),) * c
            return PowerSpectrum(np.zeros(0), empty, empty.astype(np.int64), none, none, (None,) * c, white)
        frequency, density, averages = [], [], []
        lines: list[list[Line]] = [[] for _ in self._groups]
        bands: list[list[NarrowBand]] = [[] for _ in self._groups]
        quiet: list[QuietDensity | None] = [None] * c
        rms = np.sqrt(np.nansum(stages[0][1], axis=1) * self._rate / SEGMENT)
        size = np.abs(self._level) + rms
        for s, (rate, power, count) in reversed(list(enumerate(stages))):
            low, high = _band(s, len(stages))
            frequency.append(np.arange(low, high) * rate / SEGMENT)
            density.append(power[:, low:high].T)
            averages.append(np.broadcast_to(count, (high - low, len(count))))
            sides = side_levels(power)
            for i in np.flatnonzero(count >= LEAST_AVERAGES).tolist():
                own, k, band = sides[:, i], int(count[i]), range(low, high)
                lines[i] += find_lines(power[i], own, k, rate, band, self._rate, float(size[i]))
                found, without = find_narrow_bands(power[i], k, rate, band)
                bands[i] += found
                if s == 0:
                    quiet[i] = without
        white = np.array([_white(p, int(k)) for p, k in zip(*stages[0][1:], strict=True)])
        distinct_lines = tuple(distinct(each) for each in lines)
        f, power, count = np.concatenate(frequency), np.concatenate(density), np.concatenate(averages)
        distinct_power = tuple(distinct_bands(each) for each in bands)
        return PowerSpectrum(f, power, count, distinct_lines, distinct_power, tuple(quiet), white)

    def _waiting_valid(self) -> Bools:
        """Return (n, g) which of the samples that wait for a hop are valid."""
        parts = [np.ones((len(v), self._g), dtype=bool) if ok is None else ok for v, ok in self._rows]
        return np.concatenate([np.zeros((0, self._g), dtype=bool), *parts])

    def _densities(self) -> list[tuple[float, Floats, Ints]]:
        """Return rate, Hz, (c, BINS) density and (c,) averages of the stages with enough averages."""
        out = []
        for s, stage in enumerate(self._stages):
            if stage.averages.max() < (LEAST_AVERAGES if s else 1):
                break
            rate = self._rate / 2.0**s
            count = stage.averages[self._groups]
            with np.errstate(invalid="ignore", divide="ignore"):
                power = stage.power * (2.0 / (rate * float(_WINDOW @ _WINDOW))) / count[:, None]
            power[:, 0] *= 0.5
            power[:, -1] *= 0.5
            power[count == 0] = np.nan
            out.append((rate, power, count))
        return out

    def save(self, *, least_s: float = 0.0) -> dict[str, np.ndarray]:
        """Return the state as arrays.

        Parameters
        ----------
        least_s : s; of waiting hops that are shorter, only the mean is saved. They count as missing, which
            costs one or two segments.
        """
        self._process_waiting()
        rows = np.concatenate([np.zeros((0, len(self._groups))), *(v for v, _ in self._rows)])
        out = {"rows": rows, "valid": self._waiting_valid(), "level": self._level.copy()}
        out |= {"stages": np.array(len(self._stages)), "groups": self._groups.copy()}
        out["rate"] = np.array(self._rate)
        for s, stage in enumerate(self._stages):
            for name, value in vars(stage).items():
                if value is not None and name != "waiting":
                    out[f"{s}.{name}"] = np.array(value)
            if stage.half_share is None:
                out.pop(f"{s}.half", None)
            if HOP * 2**s / self._rate < least_s:
                for name in ("last", "half", "history"):
                    if (hop := out.get(f"{s}.{name}")) is not None:
                        hop[:] = hop.mean(axis=1, keepdims=True)
                    if (share := out.get(f"{s}.{name}_share")) is not None:
                        share[:] = 0.0
        return out

    @classmethod
    def restore(cls, saved: Mapping[str, np.ndarray]) -> SpectrumAccumulator:
        """Return an accumulator that continues from a saved state."""
        self = cls(saved["groups"].tolist(), float(saved["rate"]))
        self._rows, self._n = [(saved["rows"], saved["valid"])], len(saved["rows"])
        self._level = saved["level"].copy()
        self._stages = [_Stage(len(self._groups), self._g) for _ in range(int(saved["stages"]))]
        for s, stage in enumerate(self._stages):
            for name in vars(stage):
                if f"{s}.{name}" in saved:
                    value = saved[f"{s}.{name}"]
                    setattr(stage, name, int(value) if name == "segments" else value.copy())
        return self


def _decimated(stage: _Stage, x: Floats) -> Floats:
    """Return (c, n/2) every second sample behind the half-band filter.

    Parameters
    ----------
    x : (c, n) channel unit, n even.
    """
    if stage.history is None:
        stage.history = np.repeat(x[:, :HOP].mean(axis=1, keepdims=True), _HISTORY, axis=1)
    n, last = x.shape[1] // 2, 2 * len(TAPS) - 1
    out = np.empty((len(x), n))
    together = max(1, FILTER_BLOCK // n)
    for start in range(0, len(x), together):
        part = slice(start, start + together)
        z = np.concatenate((stage.history[part], x[part]), axis=1)
        even = np.ascontiguousarray(z[:, ::2])
        total = np.multiply(z[:, last : last + 2 * n : 2], 0.5, out=out[part])
        pair = np.empty_like(total)
        for u, tap in enumerate(TAPS.tolist()):
            np.add(even[:, u : u + n], even[:, last - u : last - u + n], out=pair)
            pair *= tap
            total += pair
    stage.history = x[:, -_HISTORY:].copy()
    return out


def _band(s: int, stages: int) -> tuple[int, int]:
    """Return the range of bins of stage s that are used."""
    high = math.floor(PASS_BAND * SEGMENT) + 1 if s else BINS
    low = 2 if s + 1 == stages else math.floor(0.5 * PASS_BAND * SEGMENT) + 1
    return low, high


def _white(power: Floats, averages: int) -> float:
    """Return N from the median density in the upper half of the band, unit/sqrt(Hz)."""
    if averages < LEAST_AVERAGES:
        return math.nan
    median = float(np.median(power[BINS // 2 : BINS - 3]))
    return math.sqrt(0.5 * median * median_to_mean(averages))
