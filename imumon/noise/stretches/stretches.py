"""Stretches of a record: every hour and day alone, for the history.

A record of months hides what happens in it: its N is the mean over all of its time. The history therefore keeps the
noise of each stretch alone. N and B show in an hour, K in a day; so there are stretches of two lengths, and none is
computed from the other one. They begin at multiples of their length on the grid of the record. A stretch
without samples, as in a long gap, is left out.
"""

from __future__ import annotations

from dataclasses import dataclass

from imumon.model.saved_state import restorable
from imumon.noise.noise_sums import NoiseSums
from imumon.noise.statistics.moments import Moments
from imumon.noise.stretches.parts import Parts

LENGTHS_S = (3600, 86400)
"""s, lengths of the stretches; the longer one is a multiple of the shorter one."""


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """One stretch, finished or in progress.

    Attributes
    ----------
    length_s : s, its full length, one of `LENGTHS_S`.
    start, end : samples of the grid before it, and before what follows it.
    sums : of the noise of its channels with a curve.
    moments : moments of all channels.
    """

    length_s: int
    start: int
    end: int
    sums: NoiseSums
    moments: Moments


@restorable
class Stretches:
    """The stretches in progress of one record.

    Parameters
    ----------
    parts : of the record.
    rate_hz : Hz, sampling rate.

    Attributes
    ----------
    starts : marked place at which the stretch in progress of each length begins, as in `LENGTHS_S`.
    """

    def __init__(self, parts: Parts, rate_hz: float) -> None:
        self._parts = parts
        shortest = max(1, round(LENGTHS_S[0] * rate_hz))
        # multiples of the shorter one, so that a day ends where its last hour does, whatever the rate
        self._samples = [shortest * (length // LENGTHS_S[0]) for length in LENGTHS_S]
        self.starts = [parts.mark(finer=True)] * len(LENGTHS_S)

    @property
    def next_end(self) -> int:
        """Samples of the grid at which the shortest stretch in progress ends."""
        return (self.starts[0] // self._samples[0] + 1) * self._samples[0]

    def close_due(self) -> list[Stretch]:
        """End the stretches whose end the record has reached, and return them, shorter ones first."""
        position, finished = self._parts.position, []
        for number, samples in enumerate(self._samples):
            if position // samples == self.starts[number] // samples:
                continue
            if (stretch := self.in_progress(number)) is not None:
                finished.append(stretch)
            self.starts[number] = self._parts.mark(finer=True)
        return finished

    def in_progress(self, number: int) -> Stretch | None:
        """Return the stretch in progress of ``LENGTHS_S[number]``; None without a sample in it."""
        start = self.starts[number]
        moments = self._parts.moments(start)
        if not any(channel.count for channel in moments.result().channels):
            return None
        sums = self._parts.finer_sums(start)
        return Stretch(LENGTHS_S[number], start, self._parts.position, sums, moments)
