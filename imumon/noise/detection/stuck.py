"""Repeats: samples that a source sends again instead of measuring.

Two ways a source lies: a sensor is *stuck* (the same sample over and over), or a file is *replayed* in a
loop. Neither adds information, and both ruin every statistic without looking odd. But some sensors repeat
lawfully: a magnetometer that updates at 250 Hz and is read at 800 Hz, a quantised temperature, a constant
channel. So the share of repeats p that is usual here is learned, and a run of r repeats counts as stuck only
when p^r is beyond chance (`CHANCE`), and never before `LEAST` of them.

Loops are found by content-selected fingerprints: a row is chosen by the value of its own hash, so a replay
chooses the same rows again; when several of them in a row were last seen the same number of rows ago, that
number is the period. About five rows a second are chosen (`FINGERPRINTS_HZ`). A loop of a few rows may have
none that is chosen: so `WINDOW` rows on end are taken as they come, at the beginning and every `WINDOW_S`.
The last `REMEMBERED` of both are kept, half an hour, in arrays that never grow.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imumon.samples import Bools, Floats, Ints

CHANCE = 1e-12
LEAST = 5
"""Fewest repeats in a row, or fingerprints at one distance, that may count."""

REMEMBERED, RECENT = 16384, 1024
FINGERPRINTS_HZ = 5.0
SAVED = 1024
"""Fingerprints that a state keeps: a longer loop that runs on is found again within one round."""
WINDOW, WINDOW_S = 64, 20.0
_GOLDEN = 0x9E3779B97F4A7C15
_MASK = (1 << 64) - 1


class RepeatDetector:
    """Finds stuck groups of channels and replayed loops.

    Parameters
    ----------
    groups : group of each channel, 0 ... g-1.
    loops : channels whose rows are fingerprinted for loops.
    rate_hz : Hz, rows a second.

    Attributes
    ----------
    period : rows of the loop that is running, else None.
    """

    def __init__(self, groups: Sequence[int], loops: Sequence[int], rate_hz: float) -> None:
        self._channels = [[c for c, g in enumerate(groups) if g == group] for group in range(max(groups) + 1)]
        self._loops = list(loops)
        # a row is a fingerprint when its hash is below this
        self._select = np.uint64(1 << 64 - max(3, round(math.log2(rate_hz / FINGERPRINTS_HZ))))
        keys = [(_GOLDEN * (2 * c + 3) * (2 * c + 3) | 1) & _MASK for c in range(len(groups))]
        self._keys = np.array(keys, dtype=np.uint64)
        g = len(self._channels) + 1  # the last one is the row of `loops`
        self._every = max(2 * WINDOW, round(WINDOW_S * rate_hz))  # rows from one window to the next
        self._previous = np.zeros(g, dtype=np.uint64)
        self._started = np.zeros(g, dtype=bool)
        self._run = np.zeros(g, dtype=np.int64)
        self._repeats = np.zeros(g)
        self._rows = np.zeros(g)
        self._longest = np.full(g, np.iinfo(np.int64).max, dtype=np.int64)
        self._frames = 0
        self._seen = _Fingerprints()
        self._row = 0
        self._distance = 0
        self._matches = 0
        self.period: int | None = None

    @property
    def stuck(self) -> Bools:
        """(g,) Groups that are stuck now."""
        return np.asarray((self._run >= self._longest)[: len(self._channels)])

    def update(self, values: Floats, valid: Bools) -> tuple[Bools, Bools]:
        """Which rows are stuck, and which replayed.

        Parameters
        ----------
        values : (n, c) channel unit.
        valid : (n, g) rows of each group that were received.

        Returns
        -------
        stuck : (n, g) row repeats the one before it, in a run too long for chance.
        looped : (n,) row belongs to a loop that has been recognised.
        """
        stuck = np.zeros(valid.shape, dtype=bool)
        bits = values.T.view(np.uint64)
        total = np.zeros(len(values), dtype=np.uint64)
        received = np.ones(len(values), dtype=bool)
        for g, channels in enumerate(self._channels):
            mixed = bits[channels[0]] * self._keys[channels[0]]
            for c in channels[1:]:
                mixed += bits[c] * self._keys[c]
            if any(c in self._loops for c in channels):
                total += mixed
                received &= valid[:, g]
            self._stuck(g, mixed, valid[:, g], stuck[:, g])
        looped = np.zeros(len(values), dtype=bool)
        if self._loops:
            fresh = self._stuck(len(self._channels), total, received, np.zeros_like(looped))
            self._looped(total, received, fresh, looped)
        return stuck, looped

    def learn(self, frames: int) -> None:
        """So many frames have passed: now and then take the share of repeats as usual; older rows fade."""
        before, self._frames = self._frames, self._frames + frames
        if self._frames.bit_length() == before.bit_length() and self._frames // 32 == before // 32:
            return
        for g in range(len(self._rows)):
            if self._rows[g] < 8:
                continue
            share = self._repeats[g] / self._rows[g]
            self._longest[g] = _beyond_chance(share)
            if self._rows[g] > 4096:
                self._rows[g] *= 0.5
                self._repeats[g] *= 0.5

    def _stuck(self, g: int, mixed: np.ndarray, valid: Bools, out: Bools) -> Bools:
        """Mark stuck rows of group g in `out`; returns which rows differ from the one before."""
        index = None if valid.all() else np.flatnonzero(valid)
        row = mixed if index is None else mixed[index]
        if not len(row):
            return np.zeros(len(mixed), dtype=bool)
        same = np.empty(len(row), dtype=bool)
        same[1:] = row[1:] == row[:-1]
        same[0] = bool(self._started[g]) and row[0] == self._previous[g]
        self._previous[g], self._started[g] = row[-1], True
        ordinary = len(row)
        repeats = int(np.count_nonzero(same))
        if repeats:
            place = np.arange(1, len(row) + 1)
            since = np.maximum.accumulate(np.where(same, 0, place))
            run = place - since
            run[since == 0] += self._run[g]
            self._run[g] = run[-1]
            bad = run >= self._longest[g]
            if bad.any():
                ordinary -= int(bad.sum())
                repeats -= int(bad.sum())
                if index is None:
                    out[:] = bad
                else:
                    out[index] = bad
        else:
            self._run[g] = 0
        self._rows[g] += ordinary
        self._repeats[g] += repeats
        if index is None:
            return ~same
        fresh = np.zeros(len(mixed), dtype=bool)
        fresh[index] = ~same
        return fresh

    def _looped(self, mixed: np.ndarray, received: Bools, fresh: Bools, out: Bools) -> None:
        """Follow the fingerprints; marks rows of a recognised loop in `out`."""
        wanted, begin = mixed < self._select, self._row
        place = None if received.all() else np.cumsum(received)
        if place is not None:
            wanted |= (begin + place - 1) % self._every < WINDOW
        else:
            for window in range(begin // self._every * self._every, begin + len(mixed), self._every):
                wanted[max(0, window - begin) : max(0, window + WINDOW - begin)] = True
        chosen = np.flatnonzero(fresh & wanted)
        rows = self._row + (chosen + 1 if place is None else place[chosen])
        self._row += int(received.sum())
        before = self._seen.take(mixed[chosen], rows)
        if not (self.period or any(before)):  # nothing comes again: the usual case
            if np.any(mixed[chosen] < self._select):
                self._distance = self._matches = 0
            return
        begin = 0 if self.period else -1
        needed = max(LEAST + 1, int(self._longest[-1]))
        for i, here, last in zip(chosen.tolist(), rows.tolist(), before, strict=True):
            if not last and mixed[i] >= self._select:
                continue  # of a window: that it was not chosen before says nothing
            distance = here - last if last else 0
            if distance and (distance == self._distance or (self.period and distance % self.period == 0)):
                self._matches += 1
            else:
                self._distance, self._matches = distance, int(distance > 0)
                if self.period:
                    out[begin:i] = True
                    self.period, begin = None, -1
            if not self.period and self._matches >= needed:
                self.period, begin = self._distance, i
        if begin >= 0:
            out[begin:] = True

    def save(self) -> dict[str, np.ndarray]:
        """State as arrays."""
        keys, rows = self._seen.last(SAVED)
        return {
            "previous": self._previous.copy(),
            "started": self._started.copy(),
            "run": self._run.copy(),
            "repeats": self._repeats.copy(),
            "rows": self._rows.copy(),
            "longest": self._longest.copy(),
            "seen_key": keys,
            "seen_row": rows,
            "loop": np.array(
                [self._row, self._distance, self._matches, self.period or 0, self._frames], dtype=np.int64
            ),
        }

    def restore(self, saved: dict[str, np.ndarray]) -> None:
        """Continue where `save` left off."""
        self._previous = saved["previous"].astype(np.uint64)
        self._started = saved["started"].astype(bool)
        self._run = saved["run"].astype(np.int64)
        self._repeats = saved["repeats"].astype(np.float64)
        self._rows = saved["rows"].astype(np.float64)
        self._longest = saved["longest"].astype(np.int64)
        self._seen = _Fingerprints()
        self._seen.take(saved["seen_key"].astype(np.uint64), saved["seen_row"].astype(np.int64))
        self._row, self._distance, self._matches = (int(v) for v in saved["loop"][:3])
        self.period = int(saved["loop"][3]) or None
        self._frames = int(saved["loop"][4])


class _Fingerprints:
    """Rows at which fingerprints were seen last.

    The last `RECENT` of them are in a dict, the `REMEMBERED` before in arrays, sorted: of fixed size from the
    start, and a tenth of what a dict of all would take.
    """

    def __init__(self) -> None:
        self._recent: dict[int, int] = {}
        self._keys = np.full(REMEMBERED, _MASK, dtype=np.uint64)
        self._rows = np.zeros(REMEMBERED, dtype=np.int64)  # from 1 on; 0: empty

    def take(self, keys: np.ndarray, rows: Ints) -> list[int]:
        """Remember (n,) fingerprints; the row at which each was seen last, 0: it is new."""
        recent, chosen = self._recent, keys.tolist()
        before: list[int] = self._found(keys)[1].tolist()
        for place, (key, row) in enumerate(zip(chosen, rows.tolist(), strict=True)):
            before[place] = recent.get(key, before[place])
            recent[key] = row
        if len(recent) > RECENT:
            self._settle()
        return before

    def last(self, count: int) -> tuple[np.ndarray, Ints]:
        """The last so many at most, fingerprints and rows, the oldest first."""
        self._settle()
        order = np.argsort(self._rows, kind="stable")[-count:]
        order = order[self._rows[order] > 0]
        return self._keys[order], self._rows[order]

    def _found(self, keys: np.ndarray) -> tuple[Ints, Ints]:
        """Places of fingerprints in the arrays, and their rows; 0 where they are not there."""
        at = np.minimum(np.searchsorted(self._keys, keys), REMEMBERED - 1)
        return at, np.where(self._keys[at] == keys, self._rows[at], 0)

    def _settle(self) -> None:
        """Sort the recent ones in among the others, in the place of the oldest."""
        keys = np.array(list(self._recent), dtype=np.uint64)
        rows = np.array(list(self._recent.values()), dtype=np.int64)
        self._recent.clear()
        at, former = self._found(keys)
        self._rows[at[former > 0]] = -1  # they have come again: the first to go
        keys, rows = np.concatenate((self._keys, keys)), np.concatenate((self._rows, rows))
        stays = np.ones(len(rows), dtype=bool)
        surplus = len(rows) - REMEMBERED
        # a partition would do, but its code is 0.2 MB that nothing else here has in memory
        stays[np.argsort(rows, kind="stable")[:surplus]] = False
        keys, rows = keys[stays], rows[stays]
        order = np.argsort(keys, kind="stable")  # of two sorted parts
        np.take(keys, order, out=self._keys)
        np.take(rows, order, out=self._rows)


def _beyond_chance(share: float) -> int:
    """Length of a run of repeats that chance does not make, when a repeat has this probability.

    >>> _beyond_chance(0.0), _beyond_chance(0.69), _beyond_chance(1.0) > 10**12
    (5, 75, True)
    """
    if share >= 0.999:
        return int(np.iinfo(np.int64).max)
    if share <= 0.0:
        return LEAST
    return max(LEAST, math.ceil(math.log(CHANCE) / math.log(share)))
