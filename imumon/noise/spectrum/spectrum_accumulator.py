"""Welch sums of a stream from half the sampling rate down to a few cycles per record, in bounded memory.

Model
-----
A cascade of levels: each one averages periodograms of 256 samples (Hann window, half overlapped: Welch, IEEE Trans.
Audio Electroacoust. 15, 1967), and passes every second sample behind a half-band filter to the next level. Level s
resolves rate / 2^s / 256, so that resolution follows frequency, and memory grows with the logarithm of the record only.
The filter keeps a strong line out of the lower levels (59 dB), which averages over two samples would not.

With x the samples of a segment, h the window and F the Fourier transform, a level sums

    P[k] = |F(h (x - mean x))[k]|^2 / sum h^2

whose expectation is the two-sided density at bin k, per cycle per sample of the level: for white noise, its variance.

>>> white = np.random.default_rng(1).standard_normal((1, 400 * HOP))
>>> spectrum = SpectrumAccumulator([0], rate_hz=1.0)
>>> spectrum.update(white)
>>> level = spectrum.sums()[0]
>>> int(level.averages[0]), round(float(level.power.mean()) / int(level.averages[0]), 2)
(399, 1.0)

Density is one-sided for people (`PowerSpectrum`), two-sided in the fit.

Missing samples
---------------
With w = 1 for a valid sample and 0 for a missing one, both w x and w pass the filters. A segment
transforms w x - w c, where c is the likeliest sum of slow waves (`level_sums.SLOW_WAVES`; without missing samples, the
mean alone), and divides by the mean share of w. White noise of density N^2 then has this density times mean(h^2 w) /
mean(h^2) / mean(w)^2, whatever the pattern of the losses, because w x stays white. Of slow noise of density S, a bin k
expects the sum over d of S(k - d) |F(h w)[d]|^2 over sum h^2 and the square of the mean share. Two parts of it matter:

- d near 0, where S is that of the bin: S times the power of h w there. It is 1 for scattered losses, and the inverse of
  the mean share for a hole.
- all other d, from which noise of other frequencies leaks into the bin (`leakage`). For scattered losses their powers
  are alike; for a hole of L samples they fall beyond a distance of 1/L. So `LevelSums.holes` has them by distance.

The slow waves are subtracted because the lowest frequencies of a walk would leak more than its density at the bins in
use.

Segments in which w varies much do not count (`MOST_VARIATION`). Scattered losses average out in the samples of lower
levels, so that these have segments even where level 0 has none.

Parts
-----
A segment belongs to what follows a mark if it begins there or later. A mark keeps the sums of a level from the moment
when the last segment that begins before it has been added (`stretches.parts`).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from imumon.model.samples import Bools, Floats
from imumon.model.saved_state import restorable
from imumon.noise.spectrum.half_band import decimated_with_shares
from imumon.noise.spectrum.level_sums import (
    BINS,
    FIRST_BIN,
    HANN,
    HANN_POWER,
    HOP,
    NEAR,
    SEGMENT,
    SLOW_WAVES,
    WAVES_PRIOR,
    Level,
    LevelSums,
    last_bin,
    sub_bands,
)
from imumon.noise.spectrum.power_spectrum import PowerSpectrum, displayed
from imumon.noise.validity_groups import LEAST_SHARE, ROUNDING

MOST_VARIATION = 0.8
"""A segment with more does not count; where a share p is missing, it is p / (1 - p), so that 44 % may be. Unit:
relative variance of the shares of valid samples within a segment.

Otherwise: at 0.06, a record with a sixth of it in holes has no segments where B shows, and its K is a bound. Origin:
with 40 % of scattered losses, flicker is expected 1.5 % too large at level 0, with 48 % it would be 3 % (`holes.py`).
"""

LEVELS = 38
"""Most levels, and octaves of the Allan curve of a part: 2^37 samples are five years at 800 Hz."""
LONG_GAP = 1 << 16
"""Samples, longest gap that segments may span; a longer one ends all segments. The zeros of a gap pass all levels,
which takes as long as samples would: 0.1 s for these, minutes for a gap of a month."""


TOGETHER = 16
"""Segments that are transformed together at most: their work arrays, 0.3 MB of nine channels, stay in the cache of the
processor; those of 64 take four times as long."""


@restorable
class SpectrumMark:
    """A place in a stream, and the sums of each level over the segments that begin before it.

    Attributes
    ----------
    start : samples of the stream before it, since the last break.
    sums : by level; those of a level that is missing are still growing.
    """

    def __init__(self, start: int) -> None:
        self.start = start
        self.sums: dict[int, LevelSums] = {}


@restorable
class SpectrumAccumulator:
    """Cascade of power spectra.

    Parameters
    ----------
    groups : (c,) group of each channel, 0 ... g-1; the channels of a group share their validity.
    rate_hz : Hz, sampling rate.

    Attributes
    ----------
    marks : places at which parts of the record begin or end.
    """

    def __init__(self, groups: Sequence[int], rate_hz: float) -> None:
        self._groups = np.array(groups, dtype=np.int64)
        self._g = int(self._groups.max()) + 1 if len(groups) else 0
        self._rate = rate_hz
        self._levels: list[Level] = []
        self.marks: list[SpectrumMark] = []

    def update(self, x: Floats, valid: Floats | None = None) -> None:
        """Add consecutive samples.

        Parameters
        ----------
        x : (c, n) channel unit about an offset, 0.0 where missing; n is a multiple of `HOP`, or these samples are the
            last before a break.
        valid : (g, n) 1.0 where valid, 0.0 where missing; None: all.
        """
        used = x.shape[1] // HOP * HOP
        if used:
            share = None if valid is None or valid[:, :used].all() else valid[:, :used]
            self._process(0, x[:, :used], share)

    def skip(self, n: int) -> None:
        """Note that `n` samples are missing, a multiple of `HOP`."""
        if n > LONG_GAP:
            self.break_()
        elif n >= HOP:
            self._process(0, np.zeros((len(self._groups), n)), np.zeros((self._g, n)))

    def break_(self) -> None:
        """Note a gap of unknown length: no segment spans it."""
        for mark in self.marks:  # no later segment begins before them
            self._keep_sums(mark, range(LEVELS))
        for level in self._levels:
            level.clear()

    def sums(self) -> list[LevelSums]:
        """Return the sums of each level by bin, from `FIRST_BIN` on."""
        return [
            LevelSums(
                level.power[:, FIRST_BIN : last_bin(s)] / HANN_POWER,
                level.holes.copy(),
                level.white.copy(),
                level.slow.copy(),
                level.averages.copy(),
            )
            for s, level in enumerate(self._levels)
        ]

    def result(self) -> PowerSpectrum:
        """Return density, lines and white level."""
        sums = [(level.power, level.averages[self._groups]) for level in self._levels]
        return displayed(sums, self._rate, len(self._groups))

    def add_sums(self, other: SpectrumAccumulator) -> None:
        """Add the sums of another accumulator of the same groups, whose samples lie before a break."""
        while len(self._levels) < len(other._levels):
            self._levels.append(Level(len(self._levels), len(self._groups), self._g))
        for ours, theirs in zip(self._levels, other._levels, strict=False):
            for name in LevelSums.__slots__:
                setattr(ours, name, getattr(ours, name) + getattr(theirs, name))

    # --- marks ----------------------------------------------------------------------------------------

    def add_mark(self) -> SpectrumMark:
        """Return a mark at the present place."""
        first = self._levels[0] if self._levels else None
        mark = SpectrumMark(0 if first is None else first.hops * HOP)
        if not mark.start:
            self._keep_sums(mark, range(LEVELS))  # no segment begins before it
        self.marks.append(mark)
        return mark

    def drop_mark(self, mark: SpectrumMark) -> None:
        """Forget a mark that is no longer needed."""
        self.marks = [other for other in self.marks if other is not mark]

    def sums_between(self, begin: SpectrumMark, end: SpectrumMark | None = None) -> list[LevelSums]:
        """Return the sums of each level by sub-band over the segments that begin between two marks; None: now."""
        out = []
        for s, level in enumerate(self._levels):
            now = level.sub_sums(s)
            # of a level that a mark still waits for, all segments so far begin before it
            last = now if end is None else end.sums.get(s, now)
            out.append(last - begin.sums.get(s, now))
        return out

    def _keep_sums(self, mark: SpectrumMark, levels: range) -> None:
        """Keep the present sums of those of some levels that a mark waits for."""
        for s in levels:
            if s in mark.sums:
                continue
            if s < len(self._levels):
                mark.sums[s] = self._levels[s].sub_sums(s)
            else:
                bands, none = sub_bands(s).size, np.zeros(self._g)
                power, holes = np.zeros((len(self._groups), bands)), np.zeros((self._g, bands))
                mark.sums[s] = LevelSums(power, holes, none, none, none.astype(np.int64))

    # --- levels ---------------------------------------------------------------------------------------

    def _process(self, s: int, x: Floats, share: Floats | None) -> None:
        """Add whole hops (c, n), channel unit, with their shares of valid samples (g, n) to level s and those below."""
        if s == len(self._levels):
            self._levels.append(Level(s, len(x), self._g))
        level = self._levels[s]
        before, share_before = level.last, level.last_share
        self._add_segments(s, x, share)
        level.last = x[:, -HOP:].copy()
        level.last_share = None if share is None else share[:, -HOP:].copy()
        if s + 1 >= LEVELS:
            return
        halves, half_share = decimated_with_shares(before, share_before, x, share)
        if level.half is not None:
            halves, half_share = _joined([(level.half, level.half_share), (halves, half_share)], self._g)
        # an odd number of hops gives half a hop of the next level, which waits for its second half
        used = halves.shape[1] // HOP * HOP
        level.half = level.half_share = None
        if used < halves.shape[1]:
            level.half = halves[:, used:].copy()
            level.half_share = None if half_share is None else half_share[:, used:].copy()
        if used:
            self._process(s + 1, halves[:, :used], None if half_share is None else half_share[:, :used])

    def _add_segments(self, s: int, x: Floats, share: Floats | None) -> None:
        """Add the segments that these hops complete, and keep the sums that marks wait for."""
        level, hops = self._levels[s], x.shape[1] // HOP
        first = level.hops - (level.last is not None)  # number of the first of the hops at hand
        level.hops += hops
        if level.last is not None:
            x, share = _joined([(level.last, level.last_share), (x, share)], self._g)
        count = x.shape[1] // HOP - 1
        # number, among those at hand, of the first segment that begins at each mark or later
        begins = [
            (max(-(-mark.start // (HOP << s)) - first, 0), mark) for mark in self.marks if s not in mark.sums
        ]
        cuts = {*range(0, count, TOGETHER), *(begin for begin, _ in begins if begin < count), max(count, 0)}
        for begin, end in pairwise(sorted(cuts)):
            for place, mark in begins:
                if place == begin:
                    self._keep_sums(mark, range(s, s + 1))
            hops_at_hand = slice(begin * HOP, (end + 1) * HOP)
            self._add(s, x[:, hops_at_hand], None if share is None else share[:, hops_at_hand])

    def _add(self, s: int, x: Floats, share: Floats | None) -> None:
        """Add the half-overlapped segments of some hops, (c, n HOP), to level s."""
        level = self._levels[s]
        hops = x.reshape(len(x), -1, HOP)
        segments = np.concatenate((hops[:, :-1], hops[:, 1:]), axis=2)
        count = segments.shape[1]
        weights = waves = None
        if share is None:
            segments -= segments.mean(axis=2, keepdims=True)
            level.white += count
            level.slow += count
            level.averages += count
        else:
            weights, waves = self._add_shares(s, segments, share)
        # the sum so far, then the squares of the segments, which are added one after the other: the same bits for any
        # chunking
        power = np.empty((len(x), count + 1, BINS))
        power[:, 0] = level.power
        _windowed_squares(segments, power[:, 1:])
        if waves is not None:
            # the bins in use are without the slow waves; below them is what people see of the lowest frequencies
            segments += waves
            with_waves = np.empty((len(x), count, BINS))
            _windowed_squares(segments, with_waves)
            power[:, 1:, :FIRST_BIN] = with_waves[:, :, :FIRST_BIN]
        if weights is not None:
            power[:, 1:] *= weights[:, :, None]
        np.add.reduce(power, axis=1, out=level.power)

    def _add_shares(self, s: int, segments: Floats, share: Floats) -> tuple[Floats, Floats | None]:
        """Count segments with missing samples, and subtract the mean of what is there, and slow waves beside holes.

        Parameters
        ----------
        segments : (c, n, SEGMENT) channel unit, 0 where missing; changed in place.
        share : (g, (n + 1) HOP) shares of valid samples.

        Returns
        -------
        weights : (c, n) of their squared transforms: 0 for a segment that does not count.
        waves : (c, n, SEGMENT) channel unit, the slow waves that are subtracted; None: there are none.
        """
        level, of = self._levels[s], self._groups
        hops = share.reshape(len(share), -1, HOP)
        shares = np.concatenate((hops[:, :-1], hops[:, 1:]), axis=2)
        mean = shares.mean(axis=2)
        enough = mean >= LEAST_SHARE
        safe = np.where(enough, mean, 1.0)  # no division by zero in segments that do not count
        variation = shares.var(axis=2) / safe**2
        enough &= variation <= MOST_VARIATION
        self._add_holes(s, shares, enough / safe**2, with_holes=enough & (variation > ROUNDING))
        white = (shares * HANN**2).sum(axis=2) / (HANN_POWER * safe**2)
        level.white = _sum(level.white, enough * white)
        level.averages += enough.sum(axis=1)
        # the mean is subtracted where samples are, so that holes stay zero and add no step
        means = segments.sum(axis=2) / (safe[of] * SEGMENT)
        segments -= means[:, :, None] * shares[of]
        waves = self._slow_waves(segments, shares, enough & (variation > ROUNDING))
        if waves is not None:
            segments -= waves
        return np.asarray((enough / safe**2)[of]), waves

    def _slow_waves(self, segments: Floats, shares: Floats, with_holes: Bools) -> Floats | None:
        """Return the likeliest slow waves of segments (c, n, SEGMENT) with missing samples, where samples are."""
        if not with_holes.any():
            return None
        out = np.zeros_like(segments)
        for group in np.flatnonzero(with_holes.any(axis=1)).tolist():
            rows = np.ix_(np.flatnonzero(self._groups == group), np.flatnonzero(with_holes[group]))
            # a sample of a level is the sum of its share of valid samples, and so is the variance of its noise
            weights = shares[group, rows[1][0], None]
            # the filters overshoot, but no sample counts less than not at all
            known = (SLOW_WAVES * np.maximum(weights, 0.0)) @ SLOW_WAVES.T
            moments = SLOW_WAVES @ segments[rows].transpose(1, 2, 0)
            amplitudes = np.linalg.solve(known + np.diag(WAVES_PRIOR), moments)
            out[rows] = (amplitudes.transpose(0, 2, 1) @ (SLOW_WAVES * weights)).transpose(1, 0, 2)
        return out

    def _add_holes(self, s: int, shares: Floats, weights: Floats, with_holes: Bools) -> None:
        """Add the densities of the shares (g, n, SEGMENT) of segments with missing samples.

        Parameters
        ----------
        weights, with_holes : (g, n) what each segment counts, and whether samples are missing in it.
        """
        level = self._levels[s]
        first = sub_bands(s)
        number = np.diff(first, append=last_bin(s))
        group, segment = np.nonzero(with_holes)
        weight = weights[group, segment] / HANN_POWER
        # the window alone, times the mean share, has nothing at the bins in use
        density = np.abs(np.fft.rfft(shares[group, segment] * HANN, axis=1)[:, : last_bin(s)]) ** 2
        means = np.add.reduceat(density, first, axis=1) / number
        # one segment after the other: the same bits for any chunking
        np.add.at(level.holes, group, means * weight[:, None])
        # on both sides of zero; `leakage` counts the level that scattered losses have at all distances
        near = density[:, 0] + 2.0 * density[:, 1 : NEAR + 1].sum(axis=1)
        scattered = (2 * NEAR + 1) * density[:, FIRST_BIN:].mean(axis=1)
        slow = (weights > 0.0).astype(np.float64)
        slow[group, segment] = np.maximum(near - scattered, 0.0) * weight / SEGMENT
        level.slow = _sum(level.slow, slow)


def _sum(total: Floats, values: Floats) -> Floats:
    """Return (g,) the total and the values (g, n), added one after the other: the same bits for any chunking."""
    return np.asarray(np.add.accumulate(np.column_stack((total, values)), axis=1)[:, -1])


def _windowed_squares(segments: Floats, out: Floats) -> None:
    """Write (c, n, BINS) the squared transforms of segments (c, n, SEGMENT) times the window."""
    # the squares of real and imaginary parts, added: `abs` would take a root of each and square it again
    parts = np.fft.rfft(segments * HANN, axis=2).view(np.float64)
    parts *= parts
    np.add(parts[:, :, ::2], parts[:, :, 1::2], out=out)


def _joined(pieces: Sequence[tuple[Floats, Floats | None]], groups: int) -> tuple[Floats, Floats | None]:
    """Return consecutive samples (c, n) and their shares (g, n) as one piece."""
    if len(pieces) == 1:
        return pieces[0]
    x = np.concatenate([samples for samples, _ in pieces], axis=1)
    if all(share is None for _, share in pieces):
        return x, None
    shares = [np.ones((groups, samples.shape[1])) if share is None else share for samples, share in pieces]
    return x, np.concatenate(shares, axis=1)
