"""Welch sums of a stream from half the sampling rate down to a few cycles per record, in bounded memory.

A cascade of levels: each one averages periodograms of 256 samples (Hann window, half overlapped: Welch 1967), and
passes every second sample behind a half-band filter to the next level. Level s resolves rate / 2^s / 256, so that
resolution follows frequency, and memory grows with the logarithm of the record only. The filter keeps a strong line
out of the lower levels (59 dB), which averages over two samples would not.

Missing samples need no model. With w = 1 for a valid sample and 0 for a missing one, both w x and w pass the filters.
A segment transforms w x - mean w, where mean is the sum of w x over the sum of w, and divides by the mean share of w.
White noise of density N^2 then has this density times mean(h^2 w) / mean(h^2) / mean(w)^2 with the window h, whatever
the pattern of the losses, because w x stays white.
Slow noise keeps its density, and its variance within the segment times the relative variance of w is added as white
noise, which is known too. Segments in which w varies much do not count: with few losses every level has segments, with
many only the levels whose samples are sums over several.

Density is one-sided for people (`PowerSpectrum`), two-sided in the fit.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence

import numpy as np

from imumon.noise.spectrum.half_band import decimated_with_shares
from imumon.noise.spectrum.level_sums import (
    FIRST_BIN,
    WINDOW,
    WINDOW_POWER,
    Level,
    LevelSums,
    last_bin,
    sub_bands,
)
from imumon.noise.spectrum.power_spectrum import LEAST_AVERAGES, PowerSpectrum, displayed
from imumon.noise.spectrum.spectral_lines import BINS, HOP, SEGMENT
from imumon.noise.validity_groups import LEAST_SHARE
from imumon.samples import Floats

LEVELS = 38
"""Most levels, and octaves of a window of the Allan curve: 2^37 samples are five years at 800 Hz."""
MOST_VARIATION, MOST_VARIATION_BELOW, BELOW = 0.35, 0.06, 5
"""Relative variance of the share of valid samples within a segment that counts, and the same from level `BELOW` on: so
much of the variance of the slow noise within the segment appears as white noise. Single losses have averaged out on the
lower levels, where slow noise prevails and only long gaps remain."""
LONG_GAP = 1 << 16
"""Samples, longest gap that segments may span; a longer one ends all segments."""

BATCH_HOPS = 8
"""Hops that are processed together, because each array operation has a fixed cost."""


class SpectrumMark:
    """A place in a stream, and the sums of each level over the segments that begin before it."""

    def __init__(self, start: int, place: int) -> None:
        self.start = start  # samples since the last break
        self.place = place  # as given, in the record
        self.sums: dict[int, LevelSums] = {}  # those of the other levels are still growing


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
        self._levels: list[Level] = []
        self._marks: list[SpectrumMark] = []

    @property
    def nbytes(self) -> int:
        """Bytes of state."""
        return sum(
            v.nbytes for level in self._levels for v in vars(level).values() if isinstance(v, np.ndarray)
        )

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
            own = None if valid is None or valid[:, :used].all() else valid[:, :used].copy()
            self._feed(0, x[:, :used].copy(), own)

    def skip(self, n: int) -> None:
        """Note that `n` samples are missing, a multiple of `HOP`."""
        if n > LONG_GAP:
            self.break_()
        elif n >= HOP:
            self._feed(0, np.zeros((len(self._groups), n)), np.zeros((self._g, n)))

    def break_(self) -> None:
        """Note a gap of unknown length: no segment spans it."""
        self._process_waiting()
        for mark in self._marks:
            self._take(mark, range(LEVELS))
        for level in self._levels:
            level.clear()

    def add_mark(self, place: int) -> SpectrumMark:
        """Return a mark at the present place, which the caller may number."""
        mark = SpectrumMark(self._position, place)
        if not mark.start:
            self._take(mark, range(LEVELS))
        self._marks.append(mark)
        return mark

    def drop_mark(self, mark: SpectrumMark) -> None:
        """Forget a mark that is no longer needed."""
        self._marks = [own for own in self._marks if own is not mark]

    def sums(self) -> list[LevelSums]:
        """Return the sums of each level by bin, from `FIRST_BIN` on."""
        self._process_waiting()
        return [
            LevelSums(
                level.power[:, FIRST_BIN : last_bin(s)] / WINDOW_POWER,
                *(getattr(level, name).copy() for name in LevelSums.__slots__[1:]),
            )
            for s, level in enumerate(self._levels)
        ]

    def sums_between(self, begin: SpectrumMark, end: SpectrumMark | None = None) -> list[LevelSums]:
        """Return the sums of each level by sub-band over the segments that begin between two marks; None: now."""
        self._process_waiting()
        out = []
        for s, level in enumerate(self._levels):
            now = level.sub_sums(s)
            last = now if end is None else end.sums.get(s, now)
            out.append(last - begin.sums.get(s, now))
        return out

    def copy(self) -> SpectrumAccumulator:
        """Return an independent accumulator in the same state, without marks."""
        self._process_waiting()
        other = copy.copy(self)
        other._marks, other._levels = [], []
        for level in self._levels:
            new = copy.copy(level)
            for name in LevelSums.__slots__:
                setattr(new, name, getattr(level, name).copy())
            new.waiting = []
            other._levels.append(new)  # what waits for a segment is replaced, never changed
        return other

    def add_sums(self, other: SpectrumAccumulator) -> None:
        """Add the sums of another accumulator of the same groups, whose samples lie before a break."""
        other._process_waiting()
        self._process_waiting()
        while len(self._levels) < len(other._levels):
            self._levels.append(Level(len(self._groups), self._g))
        for own, level in zip(self._levels, other._levels, strict=False):
            for name in LevelSums.__slots__:
                setattr(own, name, getattr(own, name) + getattr(level, name))

    @property
    def _position(self) -> int:
        """Samples since the last break."""
        if not self._levels:
            return 0
        first = self._levels[0]
        waiting = sum(int(x.shape[1]) for x, _ in first.waiting)
        return first.hops * HOP + waiting

    def _take(self, mark: SpectrumMark, levels: range) -> None:
        """Keep the present sums of some levels for a mark."""
        none = np.zeros(self._g, dtype=np.int64)
        for s in levels:
            if s not in mark.sums:
                if s < len(self._levels):
                    mark.sums[s] = self._levels[s].sub_sums(s)
                else:
                    zero = np.zeros((len(self._groups), len(sub_bands(s))))
                    mark.sums[s] = LevelSums(zero, np.zeros(self._g), np.zeros(self._g), none)

    def _feed(self, s: int, x: Floats, share: Floats | None) -> None:
        """Add whole hops (c, n), channel unit, with the shares of valid samples (g, n) to level s."""
        if s == len(self._levels):
            self._levels.append(Level(len(x), self._g))
        waiting = self._levels[s].waiting
        waiting.append((x, share))
        if sum(w.shape[1] for w, _ in waiting) >= BATCH_HOPS * HOP:
            self._process(s)

    def _process(self, s: int) -> None:
        """Process the hops that wait at level s."""
        level = self._levels[s]
        if not level.waiting:
            return
        x, share = _joined(level.waiting, self._g)
        level.waiting = []
        before, share_before = level.last, level.last_share
        self._add_segments(s, x, share)
        level.last = x[:, -HOP:].copy()
        level.last_share = None if share is None else share[:, -HOP:].copy()
        if s + 1 >= LEVELS:
            return
        halves, half_share = decimated_with_shares(before, share_before, x, share)
        if level.half is not None:
            halves, half_share = _joined([(level.half, level.half_share), (halves, half_share)], self._g)
        used = halves.shape[1] // HOP * HOP
        level.half = level.half_share = None
        if used < halves.shape[1]:
            level.half = halves[:, used:].copy()
            level.half_share = None if half_share is None else half_share[:, used:].copy()
        if used:
            self._feed(s + 1, halves[:, :used], None if half_share is None else half_share[:, :used])

    def _process_waiting(self) -> None:
        """Process everything that waits; the sums do not depend on when."""
        for s in range(LEVELS):
            if s < len(self._levels):  # which processing may add
                self._process(s)

    def _add_segments(self, s: int, x: Floats, share: Floats | None) -> None:
        """Add the segments that these hops complete, and take the sums that marks wait for."""
        level, hops = self._levels[s], x.shape[1] // HOP
        first = level.hops - (level.last is not None)  # number of the first of the hops at hand
        level.hops += hops
        if level.last is not None:
            x, share = _joined([(level.last, level.last_share), (x, share)], self._g)
        count = x.shape[1] // HOP - 1
        due = [mark for mark in self._marks if s not in mark.sums]
        # a segment belongs to what follows a mark if it begins at the mark or later
        begins = {mark: -(-mark.start // (HOP << s)) - first for mark in due}
        done = 0
        for mark in sorted(due, key=lambda mark: begins[mark]):
            at = begins[mark]
            if at >= count:
                break
            if at > done:
                self._add(s, x[:, done * HOP : (at + 1) * HOP], _part(share, done, at + 1))
                done = at
            self._take(mark, range(s, s + 1))
        if count > done:
            self._add(s, x[:, done * HOP :], _part(share, done, count + 1))

    def _add(self, s: int, x: Floats, share: Floats | None) -> None:
        """Add the half-overlapped segments of some hops, (c, n HOP), to level s."""
        level = self._levels[s]
        hops = x.reshape(len(x), -1, HOP)
        segments = np.concatenate((hops[:, :-1], hops[:, 1:]), axis=2)
        count = segments.shape[1]
        if share is None:
            segments -= segments.mean(axis=2, keepdims=True)
            weights = None
            level.white += count
            level.averages += count
        else:
            parts = share.reshape(len(share), -1, HOP)
            shares = np.concatenate((parts[:, :-1], parts[:, 1:]), axis=2)
            mean = shares.mean(axis=2)
            enough = mean >= LEAST_SHARE
            safe = np.where(enough, mean, 1.0)
            holes = shares.var(axis=2) / safe**2
            enough &= holes <= (MOST_VARIATION if s < BELOW else MOST_VARIATION_BELOW)
            level.holes = _sum(level.holes, enough * holes)
            level.white = _sum(
                level.white, enough * (shares * WINDOW**2).sum(axis=2) / (WINDOW_POWER * safe**2)
            )
            level.averages += enough.sum(axis=1)
            of = self._groups
            level_of = segments.sum(axis=2) / (safe[of] * SEGMENT)
            segments -= level_of[:, :, None] * shares[of]
            weights = (enough / safe**2)[of]
        segments *= WINDOW
        power = np.fft.rfft(segments, axis=2).view(np.float64)
        power *= power
        both = power[:, :, ::2] + power[:, :, 1::2]
        if weights is not None:
            both *= weights[:, :, None]
        for number in range(count):  # one after the other: the same bits for any chunking
            level.power += both[:, number]

    def result(self) -> PowerSpectrum:
        """Return density, lines and white level."""
        self._process_waiting()
        sums = [(level.power, level.averages[self._groups]) for level in self._levels]
        return displayed(sums, self._rate, len(self._groups))

    def save(self, *, least_s: float = 0.0) -> dict[str, np.ndarray]:
        """Return the state as arrays, with the marks in the order in which they were added.

        Parameters
        ----------
        least_s : s; of waiting hops that are shorter, nothing is saved. They count as missing, which costs one or two
            segments.
        """
        self._process_waiting()
        out = {
            "levels": np.array(len(self._levels)),
            "groups": self._groups.copy(),
            "rate": np.array(self._rate),
        }
        for s, level in enumerate(self._levels):
            short = HOP * 2**s / self._rate < least_s
            for name, value in vars(level).items():
                kept = name in (*LevelSums.__slots__, "hops") or not short
                if value is not None and name not in ("waiting", "power") and kept:
                    out[f"{s}.{name}"] = np.array(value)
            out[f"{s}.power"] = level.power[:, self._kept(s)].copy()
        out["marks"] = np.array([(mark.start, mark.place) for mark in self._marks], dtype=np.int64)
        for number, mark in enumerate(self._marks):
            for s in sorted(mark.sums):
                if s < len(self._levels):
                    sums = mark.sums[s]
                    out[f"mark{number}.{s}.power"] = sums.power
                    out[f"mark{number}.{s}.count"] = np.stack(
                        (sums.white, sums.holes, sums.averages.astype(np.float64))
                    )
            out[f"mark{number}.all"] = np.array(len(mark.sums) == LEVELS)
        return out

    @classmethod
    def restore(cls, saved: Mapping[str, np.ndarray]) -> SpectrumAccumulator:
        """Return an accumulator that continues from a saved state."""
        self = cls(saved["groups"].tolist(), float(saved["rate"]))
        self._levels = [Level(len(self._groups), self._g) for _ in range(int(saved["levels"]))]
        for s, level in enumerate(self._levels):
            power = saved[f"{s}.power"]
            end = last_bin(s) + 1 if s else BINS
            level.power[:, end - power.shape[1] : end] = power
            for name in vars(level):
                if f"{s}.{name}" in saved and name != "power":
                    value = saved[f"{s}.{name}"]
                    setattr(level, name, int(value) if name == "hops" else value.copy())
            if level.last is None:
                self._missing_before(level)
        for number, (start, place) in enumerate(saved["marks"].reshape(-1, 2).tolist()):
            mark = SpectrumMark(start, place)
            for s in range(len(self._levels)):
                if f"mark{number}.{s}.power" in saved:
                    white, holes, averages = saved[f"mark{number}.{s}.count"]
                    power = saved[f"mark{number}.{s}.power"]
                    mark.sums[s] = LevelSums(power, white, holes, averages.astype(np.int64))
            if bool(saved[f"mark{number}.all"]):
                self._take(mark, range(len(self._levels), LEVELS))
            self._marks.append(mark)
        return self

    def _kept(self, s: int) -> slice:
        """Return the bins of a level that are saved: the lower ones only as long as no level below shows them."""
        below = self._levels[s + 1].averages.max() if s + 1 < len(self._levels) else 0
        return slice(FIRST_BIN if below >= LEAST_AVERAGES else 0, last_bin(s) + 1 if s else BINS)

    @property
    def marks(self) -> Sequence[SpectrumMark]:
        """Marks in the order in which they were added."""
        return tuple(self._marks)

    def _missing_before(self, level: Level) -> None:
        """Count what was not saved as missing."""
        if not level.hops:
            return
        c = len(self._groups)
        level.last, level.last_share = np.zeros((c, HOP)), np.zeros((self._g, HOP))
        if level.hops % 2:
            level.half, level.half_share = np.zeros((c, HOP // 2)), np.zeros((self._g, HOP // 2))


def _sum(total: Floats, values: Floats) -> Floats:
    """Return (g,) the total and the values (g, n), added one after the other: the same bits for any chunking."""
    return np.asarray(np.add.accumulate(np.column_stack((total, values)), axis=1)[:, -1])


def _part(share: Floats | None, begin: int, end: int) -> Floats | None:
    """Return the shares of some hops."""
    return None if share is None else share[:, begin * HOP : end * HOP]


def _joined(parts: Sequence[tuple[Floats, Floats | None]], groups: int) -> tuple[Floats, Floats | None]:
    """Return consecutive parts as one."""
    if len(parts) == 1:
        return parts[0]
    x = np.concatenate([own for own, _ in parts], axis=1)
    if all(share is None for _, share in parts):
        return x, None
    ones = [np.ones((groups, own.shape[1])) if share is None else share for own, share in parts]
    return x, np.concatenate(ones, axis=1)
