"""Guard: which samples are not the sensor's own noise, found on line and cut out.

People bump tables, lines glitch, ranges clip, sensors hang and files are replayed in loops. One sample of +1
rad/s in five hours triples N. The guard keeps samples back for one to two frames (a frame is about a second,
and ten samples where they come slowly; at the very beginning four), has each frame judged (`watch` by the
sensor's own noise, `repeats`, `still`), and passes all samples on in their order, those it cut marked
invalid, with a margin before and after. Nothing is cut silently: every cut has a reason, is counted by
samples and told as a `Disturbance`.

The rules:
- Gyro and accelerometer sit on the same table: what disturbs one cuts both. The magnetometer stands alone.
  Other sensors (temperature, pressure) pass untouched.
- Judging depends on the grid alone: any chunking of the input gives the same cuts.
- Statistics need not wait for the first judgement: until it falls, `first` shows what will be passed then,
  as it came. Nothing that was shown is taken back by it but what is cut.
- This file does not know what is odd; it knows margins, order and accounts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from imumon.noise.detection.baseline import PARTS
from imumon.noise.detection.disturbance import (
    CLIPPED,
    INERTIAL,
    LOOP,
    MAGNETIC,
    REASONS,
    STUCK,
    Codes,
    Disturbance,
    DisturbanceDetector,
    Reason,
    under,
)
from imumon.noise.detection.still import StuckAxisDetector
from imumon.noise.detection.stuck import RepeatDetector
from imumon.samples import Bools, Floats

BEFORE = (1, 5, 5, 5, 5, 0, 5)
AFTER = (1, 10, 10, 10, 5, 5, 10)
"""Margins by reason, in parts (0.1 s)."""

START = 4
"""Frames that are judged together at the beginning: one of them may be disturbed."""


@dataclass(frozen=True, slots=True)
class GuardedSamples:
    """What leaves the guard: a break, or a hole, or samples; apply them in this order.

    Attributes
    ----------
    values : (n, c) channel unit.
    valid : (n, g) received and not cut.
    skipped : missing samples before `values`.
    broken : an unknown length of time, or a new level, lies before it: differences must not span it.
    """

    values: Floats
    valid: Bools
    skipped: int = 0
    broken: bool = False


class Guard:
    """Delay line that marks disturbed samples invalid.

    Parameters
    ----------
    sensors : sensor of each channel ("gyro", "accel", "mag", ...); the groups are the different ones, in the
        order in which they first occur.
    rate_hz : Hz, sampling rate.
    cuts : False: only watch whether the sensor rests; everything passes as it came.

    Attributes
    ----------
    sensors, groups : sensor and group of each channel.
    disturbances : stretches cut so far, a running one included.
    """

    def __init__(self, sensors: Sequence[str], rate_hz: float, *, cuts: bool = True) -> None:
        self.sensors, self._rate, self._cuts = tuple(sensors), rate_hz, cuts
        names = list(dict.fromkeys(sensors))
        self.groups = tuple(names.index(s) for s in sensors)
        self._part = max(1, round(rate_hz / PARTS))
        self._frame = self._part * PARTS
        self._watches = [
            DisturbanceDetector(sensors, kinds, self._frame, rate_hz)
            for kinds in (INERTIAL, ("mag",))
            if any(s in kinds for s in names)
        ]
        watched = self._watches[0].channels if self._watches else []
        self._repeats = RepeatDetector(self.groups, watched, rate_hz)
        everyone = [c for watch in self._watches for c in watch.channels]
        self._still = StuckAxisDetector(everyone, self.groups)
        self._values = np.zeros((len(self.groups), 0)).T  # one channel behind the other
        self._valid = np.zeros((0, len(names)), dtype=bool)
        self._saturated = np.zeros(0, dtype=bool)
        self._codes = np.zeros((0, len(self._watches)), dtype=np.int8)  # of the parts judged
        self._tail = np.zeros((PARTS, len(self._watches)), dtype=np.int8)  # of the parts passed last
        self._index = 0  # place on the grid of the first row held
        self._begun = False
        self._breaks: list[int] = []  # places on the grid before which the record breaks
        self._events: list[Disturbance] = []
        self._counts = np.zeros(len(REASONS) + 1, dtype=np.int64)
        self.disturbances = 0

    @property
    def at_rest(self) -> bool:
        """False while the sensor moves or is handled."""
        return not any(watch.moving for watch in self._watches if watch.inertial)

    @property
    def repeating(self) -> Literal["stuck", "loop"] | None:
        """Whether gyro or accelerometer only send now what they sent before."""
        if not self._watches or not self._watches[0].inertial:
            return None
        watch = self._watches[0]
        if self._repeats.stuck[watch.groups].any() or self._still.stuck[: len(watch.channels)].any():
            return "stuck"
        return "loop" if self._repeats.period is not None else None

    @property
    def excluded(self) -> dict[Reason, int]:
        """Samples cut so far by reason; those of the magnetometer alone are "magnetic"."""
        return {reason: int(n) for reason, n in zip(REASONS, self._counts[1:], strict=True) if n}

    @property
    def excluded_samples(self) -> int:
        """Samples cut from gyro and accelerometer, or of a stream that has neither."""
        inertial = any(watch.inertial for watch in self._watches)
        return int(self._counts[:MAGNETIC].sum() if inertial else self._counts.sum())

    @property
    def held(self) -> int:
        """Samples in the delay line."""
        return len(self._values)

    @property
    def first(self) -> GuardedSamples | None:
        """Before anything has been judged: what came of the samples that will be passed then, else None."""
        if self._begun:
            return None
        shown = slice((START - 1) * self._frame)
        return GuardedSamples(self._values[shown], self._valid[shown])

    def events(self) -> list[Disturbance]:
        """Disturbances that ended since the last call, in order."""
        ended, self._events = self._events, []
        return ended

    def update(
        self, values: Floats, valid: Bools | None = None, saturated: Bools | None = None
    ) -> list[GuardedSamples]:
        """Take samples; give back what has been decided.

        Parameters
        ----------
        values : (n, c) channel unit.
        valid : (n, g) received; None: all.
        saturated : (n,) the sensor said that a range was exceeded; None: it does not say.
        """
        n = len(values)
        flags = np.zeros(n, dtype=bool) if saturated is None else saturated
        given = np.ones((n, self._valid.shape[1]), dtype=bool) if valid is None else valid
        self._values = np.concatenate((self._values.T, values.T), axis=1).T
        self._valid = np.concatenate((self._valid, given))
        self._saturated = np.concatenate((self._saturated, flags))
        self._judge_ready()
        return self._pass(len(self._codes) // PARTS - 1)

    def skip(self, n: int) -> list[GuardedSamples]:
        """`n` samples are missing."""
        fill = -len(self._values) % self._frame
        whole = max(0, n - fill) // self._frame
        if whole < 3:
            return self._missing(n)
        out = self._missing(fill)
        self._judge_ready(min(START, max(1, len(self._values) // self._frame)))
        out += self._pass(len(self._codes) // PARTS)
        self._close()
        out.append(GuardedSamples(self._values, self._valid, skipped=whole * self._frame))
        self._index += whole * self._frame
        for watch in self._watches:
            watch.miss(whole)
        return out + self._missing(n - fill - whole * self._frame)

    def break_(self) -> list[GuardedSamples]:
        """An unknown number of samples is missing."""
        return [*self.flush(), GuardedSamples(self._values, self._valid, broken=True)]

    def flush(self) -> list[GuardedSamples]:
        """Decide now on all that is held back; the grid of frames begins anew behind it."""
        fill = -len(self._values) % self._frame
        out = self._missing(fill)
        self._judge_ready(min(START, max(1, len(self._values) // self._frame)))
        out += self._pass(len(self._codes) // PARTS)
        self._close()
        self._index -= fill
        return _without_last(out, fill)

    def _missing(self, n: int) -> list[GuardedSamples]:
        if n <= 0:
            return []
        values = np.zeros((n, self._values.shape[1]))
        return self.update(values, np.zeros((n, self._valid.shape[1]), dtype=bool))

    def _judge_ready(self, least: int = START) -> None:
        """Judge the frames that are complete; the first ones only together, `least` of them."""
        while (ready := len(self._values) // self._frame - len(self._codes) // PARTS) > 0:
            if self._begun:
                self._judge(min([ready] + [w.reference.next_change for w in self._watches]))
            elif ready >= least:
                self._judge(least)
                self._begun = True
            else:
                return

    def _judge(self, k: int) -> None:
        """Codes for the parts of the next `k` frames."""
        done = len(self._codes) * self._part
        rows = slice(done, done + k * self._frame)
        values, valid, saturated = self._values[rows], self._valid[rows], self._saturated[rows]
        stuck, looped = self._repeats.update(values, valid)
        for f, group in self._still.update(values, valid, k):
            stuck[f * self._frame : (f + 1) * self._frame, group] = True
        codes = np.zeros((k, PARTS, len(self._watches)), dtype=np.int8)
        clean = bool(valid.all()) and not (stuck.any() or looped.any() or saturated.any())
        shape = (k, PARTS, self._part)
        for w, watch in enumerate(self._watches):
            x = values.T[watch.channels].reshape(-1, *shape)
            if clean:
                self._compare(watch, x, None, codes[..., w], done)
                continue
            received = np.asarray(valid[:, watch.groups].all(axis=1), dtype=bool)
            hung = np.asarray(stuck[:, watch.groups].any(axis=1), dtype=bool)
            seen = (received & ~(hung | looped | saturated)).reshape(shape)
            self._compare(watch, x, seen, codes[..., w], done)
            for code, hit in ((CLIPPED, saturated), (STUCK, hung), (LOOP, looped)):
                codes[np.any((hit & received).reshape(shape), axis=2), w] = code
        self._repeats.learn(k)
        self._codes = np.concatenate((self._codes, codes.reshape(-1, len(self._watches))))

    def _compare(
        self, watch: DisturbanceDetector, x: Floats, seen: Bools | None, codes: Codes, done: int
    ) -> None:
        if self._begun:
            self._breaks += watch.compare(x, seen, codes, self._index + done)
        else:
            watch.begin(x, seen, codes)

    def _pass(self, frames: int) -> list[GuardedSamples]:
        """Let the first `frames` frames go, with their cuts and margins."""
        if frames <= 0:
            return []
        parts = frames * PARTS
        n = parts * self._part
        values, valid = self._values[:n], self._valid[:n]
        around = np.concatenate((self._tail, self._codes[: parts + PARTS]))
        if not self._cuts:
            self._breaks = []
        elif around.any():
            cut = np.stack([_dilated(column) for column in around.T], axis=1)[PARTS : PARTS + parts]
            self._cut(values, valid, cut)
        else:
            self._end(self._watches)
        self._tail = self._codes[parts - PARTS : parts]
        self._codes, self._saturated = self._codes[parts:], self._saturated[n:]
        self._values, self._valid = self._values[n:].copy(order="F"), self._valid[n:].copy()
        begin, self._index = self._index, self._index + n
        out, last = [], 0
        for place in [b for b in self._breaks if b < self._index]:
            at = max(0, place - begin)
            if at > last:
                out.append(GuardedSamples(values[last:at], valid[last:at]))
            out.append(GuardedSamples(values[:0], valid[:0], broken=True))
            last = at
        self._breaks = [b for b in self._breaks if b >= self._index]
        out.append(GuardedSamples(values[last:], valid[last:]))
        return out

    def _cut(self, values: Floats, valid: Bools, cut: Codes) -> None:
        """Mark cut rows invalid, count them, and follow the disturbances.

        Parameters
        ----------
        cut : (parts, watches) codes, margins included.
        """
        rows = np.repeat(cut, self._part, axis=0)
        main = np.zeros(len(values), dtype=bool)
        for w, watch in enumerate(self._watches):
            received = np.asarray(valid[:, watch.groups].any(axis=1), dtype=bool)
            hit = received & (rows[:, w] > 0)
            if watch.inertial:
                self._counts[:MAGNETIC] += np.bincount(rows[hit, w], minlength=MAGNETIC)[:MAGNETIC]
                main = hit
            else:
                self._counts[MAGNETIC] += int((hit & ~main).sum())
            valid[np.ix_(np.flatnonzero(rows[:, w]), np.array(watch.groups))] = False
            if not cut[0, w]:
                self._end([watch])
            if not watch.inertial and self._watches[0].inertial and bool(np.any(cut[:, w] == LOOP)):
                continue  # a replay is told once
            edges = np.flatnonzero(np.diff(cut[:, w] > 0, prepend=False, append=False)).tolist()
            for begin, end in zip(edges[::2], edges[1::2], strict=True):
                here = slice(begin * self._part, end * self._part)
                self.disturbances += not watch.open
                span = (self._index + here.start, self._index + here.stop)
                watch.extend(*span, int(cut[begin:end, w].max()), values[here][received[here]])
                if end < len(cut):
                    self._end([watch])

    def _end(self, watches: list[DisturbanceDetector]) -> None:
        self._events += [watch.closed() for watch in watches if watch.open]

    def _close(self) -> None:
        self._end(self._watches)
        self._tail = np.zeros_like(self._tail)

    def save(self) -> dict[str, np.ndarray]:
        """State as arrays; running disturbances and events not yet asked for are not part of it."""
        out = {
            "sensors": np.array(self.sensors),
            "rate": np.array(self._rate),
            "cuts": np.array(self._cuts),
            "values": self._values.copy(),
            "valid": self._valid.copy(),
            "saturated": self._saturated.copy(),
            "codes": self._codes.copy(),
            "tail": self._tail.copy(),
            "counts": self._counts.copy(),
            "numbers": np.array([self._index, self.disturbances, self._begun, *self._breaks], dtype=np.int64),
        }
        for w, watch in enumerate(self._watches):
            out |= {f"watch{w}.{name}": value for name, value in watch.save().items()}
        out |= {f"repeats.{name}": value for name, value in self._repeats.save().items()}
        return out | {f"still.{name}": value for name, value in self._still.save().items()}

    @classmethod
    def restore(cls, saved: Mapping[str, np.ndarray]) -> Guard:
        """Continue where `save` left off."""
        self = cls([str(s) for s in saved["sensors"]], float(saved["rate"]), cuts=bool(saved["cuts"]))
        self._values, self._valid = saved["values"].copy(), saved["valid"].copy()
        self._saturated, self._codes = saved["saturated"].copy(), saved["codes"].copy()
        self._tail, self._counts = saved["tail"].copy(), saved["counts"].copy()
        self._index, self.disturbances, begun, *self._breaks = (int(v) for v in saved["numbers"])
        self._begun = bool(begun)
        for w, watch in enumerate(self._watches):
            watch.restore(under(saved, f"watch{w}."))
        self._repeats.restore(under(saved, "repeats."))
        self._still.restore(under(saved, "still."))
        return self


def _dilated(codes: Codes) -> Codes:
    """Codes of parts with the margins of their reasons; where several reach, the highest."""
    out = codes.copy()
    for code in np.unique(codes[codes > 0]).tolist():
        before, after = BEFORE[code - 1], AFTER[code - 1]
        reach = np.convolve(codes == code, np.ones(before + after + 1))[before : before + len(codes)] > 0.5
        np.maximum(out, np.int8(code), out=out, where=reach)
    return out


def _without_last(pieces: list[GuardedSamples], n: int) -> list[GuardedSamples]:
    """Pieces with their last `n` samples taken away."""
    out: list[GuardedSamples] = []
    for piece in reversed(pieces):
        size = len(piece.values)
        drop = min(n, size)
        n -= drop
        if drop < size or piece.broken or piece.skipped:
            keep = slice(0, size - drop)
            out.append(GuardedSamples(piece.values[keep], piece.valid[keep], piece.skipped, piece.broken))
    return out[::-1]
