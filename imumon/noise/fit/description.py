"""Description of one channel: which observations count, and which terms besides N, B and K explain them.

`slow_terms` finds what moves the mean. Here the upper end is described:

- If the bands reject the noise up to half the sampling rate, a moving average in the sensor is tried, then
  quantisation, then a low-pass of first order with lower and lower highest frequencies: any filter looks like one where
  it begins to bend the spectrum. There one octave more is left out than the first that passes, because the statistics
  hide the rest of the bend.
- Bands of the spectrum that a step reaches do not count.
- Where a description passes only with an error of the model, the size that brings the misfit to its expectation counts
  in every band.

A choice stays until the data reject it or the record has doubled, so that no description alternates.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from scipy.special import gammaincc

from imumon.noise.fit.likelihood import Likelihood, Surface, mixed, rows_up_to
from imumon.noise.fit.observations import BlockSeries, Powers, meeting_frequency, spectral_powers
from imumon.noise.fit.slow_terms import SlowTerms, SlowTermSearch
from imumon.noise.noise_sums import NoiseSums
from imumon.report import NOISE
from imumon.samples import Floats

REJECT_P = 1e-3
"""Probability at which the bands reject a description."""
TOLERANCE = 0.01
"""Relative error of the model in every band that the test of a description allows: no sensor follows one closer. Also
the share of a band that steps may have where it counts."""
MOST_ERROR = 0.3
"""Relative error of the model above which no coefficient is given, and of N^2 up to which octaves are left out."""
WINDOWS = (2, 3, 4, 5, 6, 8, 10, 12, 16)
"""Samples of a moving average that sensors have."""

Grids: TypeAlias = tuple[Floats, Floats]
"""Values of B and of K."""


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """What was chosen, kept from one fit of a growing record to the next until the record has doubled."""

    samples: int  # of the record when it was chosen
    first: int
    window: int
    shape: str
    grids: tuple[Grids | None, Grids | None]  # of the whole likelihood, and of the block means


@dataclass(frozen=True, slots=True, eq=False)
class Description:
    """A channel as it is described.

    Attributes
    ----------
    surface : likelihood of N, B and K.
    likelihood : of the description in use.
    slow : what moves the mean.
    excess : (m,) (channel unit)^2, what the coefficients that are left out hold above the noise.
    first : octaves of frequency that are left out at the upper end.
    window : samples of a moving average in the sensor; 1: none.
    misfit, dof, p_value : of the bands, with the tolerance of the model, and of the single coefficients.
    offset : channel unit, what the series is about.
    choice : for the next fit.
    """

    surface: Surface
    likelihood: Likelihood
    slow: SlowTerms
    excess: Floats
    first: int
    window: int
    misfit: float
    dof: float
    p_value: float
    offset: float
    choice: Choice

    @property
    def error(self) -> float:
        """Relative error of the model in every band."""
        return self.likelihood.error


class Describer:
    """Search for the description of one channel.

    Parameters
    ----------
    sums, column : the sums, and the channel in them.
    averaged : the samples are true averages over their interval, else point samples.
    previous : choice at an earlier length of the record; None: there was none.
    slow_terms : look for settling and steps; False for parts of a record.
    """

    def __init__(
        self,
        sums: NoiseSums,
        column: int,
        series: BlockSeries,
        *,
        averaged: bool,
        previous: Choice | None = None,
        slow_terms: bool = True,
    ) -> None:
        self._sums, self._column, self._averaged, self._previous = sums, column, averaged, previous
        self._grids, slow_grids = (None, None) if previous is None else previous.grids
        search = SlowTermSearch(series, slow_grids, whole=slow_terms)
        self._slow = search.result()
        self._slow_grids = search.surface.B, search.surface.K
        self._grids = self._grids or self._slow_grids
        self._step_power = self._slow.step_power(search.surface)
        self._judged_at = self._samples = int(series.samples)
        self._meeting = meeting_frequency(series)
        self._spectral: dict[int, Powers] = {}
        self._found: dict[tuple[object, ...], tuple[Likelihood, Surface]] = {}

    def describe(self) -> Description | str:
        """Return the description, or why there is none."""
        previous = self._previous
        if previous is not None and self._samples < 2 * previous.samples:
            keep = previous.first, previous.window, previous.shape
            if self._judged(*keep)[0] > REJECT_P:
                self._judged_at = previous.samples
                return self._finish(*keep)
        best, least = (0, 1, ""), np.inf
        for first, window, shape in self._candidates():
            p_value, misfit = self._judged(first, window, shape)
            if p_value > REJECT_P:
                more = first > 0 and self._shows_white(first + 1, window, shape)
                return self._finish(first + more, window, shape)
            if misfit < least:
                best, least = (first, window, shape), misfit
        return self._finish(*best)

    # ------------------------------------------------------------------ candidates

    def _candidates(self) -> Iterator[tuple[int, int, str]]:
        """Yield descriptions in the order in which they are tried: octaves left out, window, shape."""
        yield 0, 1, ""
        window = self._best_window()
        if window > 1:
            yield 0, window, ""
        yield 0, 1, "quantised"
        first = 0
        while first == 0 or self._rows(first) > len(NOISE) + 1:  # the shape is a term, too
            yield first, 1, "filtered"
            first += 1

    def _best_window(self) -> int:
        """Return the moving average whose shape the highest bands have; 1: none comes close."""
        best, least = 1, np.inf
        for window in (1, *WINDOWS):
            powers = self._powers(window)
            if powers.top.size <= len(NOISE):
                break
            rows = np.argsort(-powers.top)[:8]
            ratio = np.log(np.maximum(powers.power[rows], 1e-300) / powers.expected[rows, 0])
            weight = 1.0 / (2.0 / powers.dof[rows] + TOLERANCE**2)
            misfit = float(weight @ (ratio - weight @ ratio / weight.sum()) ** 2)
            if misfit < least:
                best, least = window, misfit
        return best

    def _powers(self, window: int) -> Powers:
        """Return the bands of the spectrum above the frequency at which the blocks end."""
        if window not in self._spectral:
            powers = spectral_powers(self._sums, self._column, averaged=self._averaged, window=window)
            own = powers.top > self._meeting * (1.0 + 1e-6)
            own &= self._step_power * powers.expected[:, 2] <= TOLERANCE * powers.power
            self._spectral[window] = powers.take(own)
        return self._spectral[window]

    def _rows(self, first: int) -> int:
        """Return the number of bands with some octaves left out."""
        return int(rows_up_to(self._search(0, 1, "")[0].powers, _highest(first)).sum())

    def _judged(self, first: int, window: int, shape: str) -> tuple[float, float]:
        """Return the probability of the misfit of a description, and the misfit over its degrees of freedom.

        The upper end is judged by the spectrum: what moves slowly does not change it. A description whose white noise
        does not show is none.
        """
        if first and self._rows(first) <= len(NOISE):
            return 0.0, np.inf
        likelihood, surface = self._search(first, window, shape)
        if first and not _shows(surface):
            return 0.0, np.inf
        tested = replace(likelihood, error=TOLERANCE)
        own = int(rows_up_to(self._powers(window), _highest(first)).sum())
        rows = own if own > len(NOISE) else None
        misfit, dof = tested.misfit(surface, rows)
        return tested.p_value(surface, rows), misfit / dof

    def _shows_white(self, first: int, window: int, shape: str) -> bool:
        """Return whether the white noise still shows with some octaves left out."""
        return self._rows(first) > len(NOISE) and _shows(self._search(first, window, shape)[1])

    # ------------------------------------------------------------------ likelihoods

    def _likelihood(self, first: int, window: int, shape: str, *, unsettled: bool = False) -> Likelihood:
        highest = _highest(first)
        pooled, coefficients = self._slow.observations(highest, self._meeting, unsettled=unsettled)
        spectral = self._powers(window)
        spectral = spectral.take(rows_up_to(spectral, highest))
        powers = Powers(
            *(np.concatenate((getattr(spectral, n), getattr(pooled, n))) for n in Powers.__slots__)
        )
        return Likelihood(powers, coefficients, shape)

    def _search(self, first: int, window: int, shape: str, error: float = 0.0) -> tuple[Likelihood, Surface]:
        key = first, window, shape, error
        if key not in self._found:
            likelihood = replace(self._likelihood(first, window, shape), error=error)
            surface = likelihood.search(self._samples, self._grids)
            self._grids = surface.B, surface.K
            self._found[key] = likelihood, surface
        return self._found[key]

    def _finish(self, first: int, window: int, shape: str) -> Description | str:
        """Return the description with the error of its model, and with settling in doubt."""
        likelihood, surface = self._search(first, window, shape)
        error = _error(likelihood, surface)
        if error > MOST_ERROR:
            return "no description fits the data"
        if error:
            likelihood, surface = self._search(first, window, shape, error)
        if self._slow.settling:
            settled = replace(self._likelihood(first, window, shape, unsettled=True), error=error)
            other = settled.search(self._samples, self._grids)
            surface = _either(likelihood, surface, settled, other, self._slow.odds)
        tested = replace(likelihood, error=TOLERANCE)
        misfit, dof = np.add(tested.misfit(surface), likelihood.slow_misfit(surface)).tolist()
        grids = (surface.B, surface.K), self._slow_grids
        choice = Choice(self._judged_at, first, window, shape, grids)
        return Description(
            surface,
            likelihood,
            self._slow,
            self._slow.excess(surface),
            first,
            window,
            misfit,
            dof,
            float(gammaincc(0.5 * dof, 0.5 * misfit)),
            float(self._sums.blocks.offset[self._column]),
            choice,
        )


def _error(likelihood: Likelihood, surface: Surface) -> float:
    """Return the error of the model that brings the misfit to its expectation; 0.0 where chance explains it."""
    if likelihood.p_value(surface) > REJECT_P:
        return 0.0
    low, high = 0.0, 2.0 * MOST_ERROR
    for _ in range(20):
        middle = 0.5 * (low + high)
        misfit, dof = replace(likelihood, error=middle).misfit(surface)
        low, high = (middle, high) if misfit > dof else (low, middle)
    return high


def _shows(surface: Surface) -> bool:
    """Return whether N^2 is known well at the greatest likelihood."""
    best = surface.best
    return bool(np.sqrt(surface.a_variance[best]) < MOST_ERROR * surface.a[best])


def _highest(first: int) -> float:
    """Return the highest frequency, cycles per sample, with some octaves left out."""
    return 0.5 / 2.0**first


def _either(one: Likelihood, alone: Surface, two: Likelihood, other: Surface, odds: float) -> Surface:
    """Return the likelihood of either of two descriptions on a grid that holds both, at these odds for the second."""
    B, K = (
        np.linspace(min(a[0], b[0]), max(a[-1], b[-1]), a.size)
        for a, b in ((alone.B, other.B), (alone.K, other.K))
    )
    first, second = (each.surface(B, K, float(own.c[own.best])) for each, own in ((one, alone), (two, other)))
    return mixed(first, second, odds * float(np.exp(first.log.max() - second.log.max())))
