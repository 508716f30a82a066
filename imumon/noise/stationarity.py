"""Stationarity: does this hour behave like the hours before, or like a saved baseline?

Beside the total, statistics are kept hour by hour. As they age, neighbours of equal length are merged, so
that their number grows with the logarithm of the record. The youngest whole stretch is compared with all
before it: N and B by the logarithm of their ratio against their limits, the bias by the difference of the
means against what the fitted noise does by itself in that time (`Wander`). The same comparison against a
saved report tells whether a sensor in the field has changed.

A change is told when it is beyond chance and large enough to matter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, Literal, Protocol, Self, TypeAlias, TypeVar

import numpy as np

from imumon.noise.wander import Fitted, Wander
from imumon.samples import Bools, Floats

SPAN_S = 3600.0
SIGMA = 5.0
"""Standard errors beyond which a change is told."""
LEAST = {"N": 0.05, "B": 0.5}
"""Relative change below which it does not matter."""

Quantity: TypeAlias = Literal["N", "B", "bias"]


class Mergeable(Protocol):
    """Statistics that can be fed, joined and copied; a merge is a break of unknown length."""

    def update(self, values: Floats, valid: Bools | None = None) -> None: ...
    def skip(self, n: int) -> None: ...
    def break_(self) -> None: ...
    def merge(self, other: Self) -> None: ...
    def copy(self) -> Self: ...


S = TypeVar("S", bound=Mergeable)


@dataclass(slots=True)
class _Stretch(Generic[S]):
    statistics: S
    start: int  # samples on the grid
    spans: int  # how many hours it holds


class Stationarity(Generic[S]):
    """Statistics by the hour.

    Parameters
    ----------
    make : makes empty statistics.
    rate_hz : Hz, sampling rate.
    span_s : s, length of a stretch.
    """

    def __init__(self, make: Callable[[], S], rate_hz: float, span_s: float = SPAN_S) -> None:
        self._make = make
        self._rate = rate_hz
        self._span = round(span_s * rate_hz)
        self._n = 0
        self._stretches = [_Stretch(make(), 0, 1)]

    def __len__(self) -> int:
        return len(self._stretches)

    def update(self, values: Floats, valid: Bools | None = None) -> None:
        """Take samples; see `Mergeable`."""
        begin = 0
        while begin < len(values):
            take = min(len(values) - begin, self._span - self._n % self._span)
            rows = slice(begin, begin + take)
            self._stretches[-1].statistics.update(values[rows], None if valid is None else valid[rows])
            self._advance(take)
            begin += take

    def skip(self, n: int) -> None:
        """`n` samples are missing."""
        while n > 0:
            take = min(n, self._span - self._n % self._span)
            if n > 2 * self._span and self._n % self._span == 0:
                take = n // self._span * self._span  # whole empty hours leave no stretch of their own
                self._n += take
                self._stretches[-1].start = self._n
            else:
                self._stretches[-1].statistics.skip(take)
                self._advance(take)
            n -= take

    def break_(self) -> None:
        """A gap of unknown length."""
        self._stretches[-1].statistics.break_()

    def _advance(self, n: int) -> None:
        self._n += n
        if self._n % self._span == 0:
            self._stretches.append(_Stretch(self._make(), self._n, 1))
            self._join()

    def _join(self) -> None:
        """Merge the older two of three finished stretches of one length, from the youngest on."""
        size = 1
        while True:
            same = [i for i, s in enumerate(self._stretches[:-1]) if s.spans == size]
            if len(same) < 3:
                return
            older, newer = self._stretches[same[0]], self._stretches[same[1]]
            older.statistics.merge(newer.statistics)
            older.spans += newer.spans
            del self._stretches[same[1]]
            size *= 2

    @property
    def recent(self) -> tuple[S, float, float] | None:
        """The last whole hour: statistics, begin and length in s; None before there are two."""
        if len(self._stretches) < 3:
            return None
        last = self._stretches[-2]
        return last.statistics, last.start / self._rate, last.spans * self._span / self._rate

    def before(self) -> tuple[S, float, float] | None:
        """All whole stretches before the last hour, joined: statistics, begin and length in s."""
        if len(self._stretches) < 3:
            return None
        first, *others = self._stretches[:-2]
        joined = first.statistics.copy()
        for stretch in others:
            joined.merge(stretch.statistics)
        length = self._stretches[-2].start - first.start
        return joined, first.start / self._rate, length / self._rate

    @property
    def statistics(self) -> list[S]:
        """Statistics of all stretches, oldest first; to be saved beside `save`."""
        return [s.statistics for s in self._stretches]

    def save(self) -> dict[str, np.ndarray]:
        """Own state as arrays."""
        rows = [[s.start, s.spans] for s in self._stretches]
        return {"n": np.array(self._n, dtype=np.int64), "stretches": np.array(rows, dtype=np.int64)}

    def restore(self, saved: Mapping[str, np.ndarray], statistics: Sequence[S]) -> None:
        """Continue where `save` left off."""
        self._n = int(saved["n"])
        rows = saved["stretches"].tolist()
        self._stretches = [_Stretch(s, *row) for s, row in zip(statistics, rows, strict=True)]


@dataclass(frozen=True, slots=True)
class Estimate:
    """A coefficient as fitted or as read from a saved report.

    Attributes
    ----------
    value : None where it was not measured.
    low, high : its 95 % limits.
    """

    value: float | None
    low: float | None
    high: float | None


@dataclass(frozen=True, slots=True)
class Behaviour:
    """How a channel behaved over a stretch.

    Attributes
    ----------
    N, B : as fitted.
    mean : channel unit; None where unknown.
    wander : its noise; None where unknown.
    length_s : s.
    """

    N: Estimate
    B: Estimate
    mean: float | None
    wander: Wander | None
    length_s: float

    @classmethod
    def of(cls, fit: Fitted, mean: float | None, length_s: float) -> Behaviour:
        """From a fit whose coefficients also have `low`."""
        n, b = (Estimate(k.value, getattr(k, "low", None), k.high) for k in (fit.N, fit.B))
        return cls(n, b, mean, Wander.of(fit), length_s)


@dataclass(frozen=True, slots=True)
class Change:
    """Something that differs.

    Attributes
    ----------
    quantity : "N", "B" or "bias".
    before, now : SI, the two values.
    ratio : now over before; None for the bias.
    sigma : by how many standard errors they differ.
    """

    quantity: Quantity
    before: float
    now: float
    ratio: float | None
    sigma: float


def changes(before: Behaviour, now: Behaviour, apart_s: float | None = 0.0) -> list[Change]:
    """What differs between two stretches beyond chance.

    Parameters
    ----------
    apart_s : s, between the end of the one and the beginning of the other; None: unknown, as for a saved
        baseline; then the bias is not compared: it differs from one switching-on to the next.
    """
    found = []
    pairs: tuple[tuple[Quantity, Estimate, Estimate], ...] = (("N", before.N, now.N), ("B", before.B, now.B))
    for quantity, old, new in pairs:
        change = _ratio(quantity, old, new)
        if change is not None:
            found.append(change)
    if apart_s is not None and before.mean is not None and now.mean is not None:
        # The longer stretch knows best what the noise does in a long time.
        wander = (before if before.length_s >= now.length_s else now).wander
        moved = now.mean - before.mean
        if wander is not None:
            sigma = abs(moved) / max(wander.step(before.length_s, now.length_s, apart_s), 1e-300)
            if sigma > SIGMA:
                found.append(Change("bias", before.mean, now.mean, None, min(sigma, 1e6)))
    return found


def _ratio(quantity: Quantity, old: Estimate, new: Estimate) -> Change | None:
    """A change of a coefficient, compared on a log scale."""
    if old.value is None or new.value is None:
        return None
    errors = []
    for estimate in (old, new):
        value, low, high = estimate.value, estimate.low, estimate.high
        if not value or not low or not high or low <= 0.0:
            return None
        errors.append(math.log(high / low) / (2.0 * 1.96))
    ratio = new.value / old.value
    sigma = abs(math.log(ratio)) / max(math.hypot(*errors), 1e-12)
    if sigma < SIGMA or abs(math.log(ratio)) < math.log1p(LEAST[quantity]):
        return None
    return Change(quantity, old.value, new.value, ratio, sigma)
