"""Warm-up: the part of a record in which the sensor still settles, recognised while it passes and left out.

Nothing waits: statistics start with the first sample. Beside the total, statistics are started anew at a few
candidate times (2, 5, 10, 20, 40 min). When the record is two and a half times as long as a candidate, the
slopes before and behind it are compared: if the mean drifted, and drifts clearly less now, the part before it
was warm-up, and what was started there is shown from then on. After that the next candidate is tried on what
is left. When all are decided, only the one that is shown is kept: memory and time are bounded.

This file does not know what the statistics are; it starts them, feeds them and chooses between them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Generic, Protocol, TypeVar

import numpy as np

from imumon.noise.drift import Drift, Slope
from imumon.noise.wander import Wander
from imumon.samples import Bools, Floats

TIMES_S = (120.0, 300.0, 600.0, 1200.0, 2400.0)
ENOUGH = 2.5
"""A candidate is decided when the record is so many times as long."""
CHANGED = 5.0
"""Standard errors by which the slopes before and behind must differ."""
SETTLED = 0.5
"""The slope behind is at most this share of the one before."""
WARMING_DEGC = 0.5
"""Rise of temperature over the last tenth of the time since the start, at least, that is called warming
up."""


class Accumulator(Protocol):
    """Statistics that can be fed."""

    def update(self, values: Floats, valid: Bools | None = None) -> None: ...
    def skip(self, n: int) -> None: ...
    def break_(self) -> None: ...


A = TypeVar("A", bound=Accumulator)


class Warmup(Generic[A]):
    """Statistics of the whole record, and from each candidate time on, until it is known which to show.

    Parameters
    ----------
    make : makes empty statistics.
    rate_hz : Hz, sampling rate.
    times_s : s, candidate times, rising.

    Attributes
    ----------
    shown : the statistics to show.
    total : those of the whole record while they are kept, else None.
    """

    def __init__(self, make: Callable[[], A], rate_hz: float, times_s: Sequence[float] = TIMES_S) -> None:
        self._make = make
        self._rate = rate_hz
        self._starts = [round(t * rate_hz) for t in times_s]
        self._n = 0
        self._start = 0  # of what is shown
        self._decided = 0  # candidates decided
        self._running: dict[int, A] = {0: make()}

    @property
    def shown(self) -> A:
        return self._running[self._start]

    @property
    def warmup_s(self) -> float:
        """s, length of the recognised warm-up."""
        return self._start / self._rate

    @property
    def decided(self) -> bool:
        """Nothing further can be recognised."""
        return self._decided == len(self._starts)

    @property
    def latest(self) -> A:
        """The youngest statistics that are at least as long as what came before them: freest of a warm-up."""
        return self._running[max(s for s in self._running if s == self._start or self._n >= 2 * s)]

    def update(self, values: Floats, valid: Bools | None = None) -> None:
        """Take samples; see `Accumulator`."""
        begin = 0
        for start in self._starts:
            if self._n < start <= self._n + len(values) - begin:
                cut = begin + start - self._n
                self._pass(values[begin:cut], None if valid is None else valid[begin:cut])
                begin = cut
                self._begin(start)
        self._pass(values[begin:], None if valid is None else valid[begin:])

    def skip(self, n: int) -> None:
        """`n` samples are missing; a candidate time inside begins behind the hole."""
        for statistics in self._running.values():
            statistics.skip(n)
        before, self._n = self._n, self._n + n
        for start in self._starts:
            if before < start <= self._n:
                self._begin(start)

    def break_(self) -> None:
        """A gap of unknown length."""
        for statistics in self._running.values():
            statistics.break_()

    def _pass(self, values: Floats, valid: Bools | None) -> None:
        if len(values):
            for statistics in self._running.values():
                statistics.update(values, valid)
            self._n += len(values)

    def _begin(self, start: int) -> None:
        if start not in self._running and start in self._starts[self._decided :]:
            self._running[start] = self._make()

    def decide(self, drift: Drift, wanders: Mapping[int, Wander | None]) -> bool:
        """See whether candidates can be decided; True when what is shown has changed.

        Parameters
        ----------
        drift : means of the record, fed alongside.
        wanders : noise of the channels that may show a warm-up, best fitted from `latest`.
        """
        changed = False
        while not self.decided and self._n >= ENOUGH * self._starts[self._decided]:
            if (
                any(w is None for w in wanders.values())
                and self._n < 2 * ENOUGH * self._starts[self._decided]
            ):
                break  # the noise is not known yet
            at = self._starts[self._decided]
            self._decided += 1
            begin, middle = self._start / self._rate, at / self._rate
            settled = any(
                settles(drift.slope(c, w, begin, middle), drift.slope(c, w, middle))
                for c, w in wanders.items()
                if w is not None
            )
            if settled and at in self._running:
                self._start, changed = at, True
            else:
                self._running.pop(at, None)
            for start in [s for s in self._running if s < self._start]:
                del self._running[start]
        return changed

    def save(self) -> dict[str, np.ndarray]:
        """Own state as arrays; the statistics are to be saved by `statistics`."""
        return {"numbers": np.array([self._n, self._start, self._decided, *self._running], dtype=np.int64)}

    @property
    def statistics(self) -> dict[int, A]:
        """All that is running, by the sample on the grid at which it was started."""
        return dict(self._running)

    def restore(self, saved: Mapping[str, np.ndarray], statistics: Mapping[int, A]) -> None:
        """Continue where `save` left off."""
        self._n, self._start, self._decided, *starts = (int(v) for v in saved["numbers"])
        self._running = {start: statistics[start] for start in starts}


def settles(before: Slope | None, behind: Slope | None) -> bool:
    """Whether a drift has clearly come to rest between two stretches."""
    if before is None or behind is None:
        return False
    # before, a line need not fit: a sensor that warms up settles along a curve
    error = float(np.hypot(before.least_error, behind.error))
    return abs(before.value - behind.value) > CHANGED * error and abs(behind.value) < SETTLED * abs(
        before.value
    )


def warming(drift: Drift, temperature: int | None) -> bool:
    """Whether the temperature still rises: by `WARMING_DEGC` over the last tenth of the record, one minute at
    least."""
    if temperature is None or drift.elapsed_s < 120.0:
        return False
    span = max(60.0, 0.1 * drift.elapsed_s)
    rise = drift.change(temperature, drift.elapsed_s - span, drift.elapsed_s)
    return rise is not None and rise > WARMING_DEGC
