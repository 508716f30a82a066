"""Description of one channel: which observations count, and which terms besides N, B and K explain them.

Every decision is one test of the likelihood:

- The upper end. If the bands reject the noise up to half the sampling rate, a moving average in the sensor is tried,
  then quantisation, then a low-pass of first order with lower and lower highest frequencies: any filter looks like one
  where it begins to bend the spectrum. There one octave more is left out than the first that passes, because the
  statistics hide the rest of the bend.
- An error of the model. Where a description passes only with an error of the model, the size that brings the misfit to
  its expectation counts in every band.
- Oscillations. One of few cycles is a regressor, unless settling or a step explains more. Of others, a cosine
  coefficient far above its expectation is left out, with those to which it leaks.
- Settling. An exponential counts in proportion to its likelihood; a step where chance does not explain it.

A choice stays until the data reject it or the record has doubled, so that no description alternates.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammainccinv

from imumon.noise.fit import regressors as columns_of
from imumon.noise.fit.likelihood import Likelihood, Surface, mixed, rows_up_to
from imumon.noise.fit.observations import (
    SINGLE,
    BlockSeries,
    Coefficients,
    Powers,
    meeting_frequency,
    pooled_coefficients,
    spectral_powers,
)
from imumon.noise.fit.regressors import SETTLING_SHARES, Regressor
from imumon.noise.noise_sums import NoiseSums
from imumon.samples import Bools, Floats

REJECT_P = 1e-3
"""Probability at which the bands reject a description."""
TOLERANCE = 0.01
"""Relative error of the model in every band that the test of a description allows: no sensor follows one closer."""
MOST_ERROR = 0.3
"""Error of the model above which no coefficient is given."""
WINDOWS = (2, 3, 4, 5, 6, 8, 10, 12, 16)
"""Samples of a moving average that sensors have."""
N_ERRORS = 2.2
"""Standard errors of N^2 from which N is measured: 1.4 % false detections."""
LARGEST_ERROR = 0.2
"""Relative error of N^2 up to which octaves are left out: with less left, N is hardly known."""
LEAST_ROWS = 4
"""Bands that a description needs: three terms and a test."""
CHANCE = 0.01
"""Probability, over all coefficients of a record, that noise alone makes an oscillation: it costs little."""
LEAK = 0.2
"""Share of the noise that the leakage of an oscillation may have in a coefficient that counts."""
OSCILLATION_WIDTHS = (1, 3, 8, 24)
"""Neighbouring coefficients that are tested together: the period of an oscillation may wander."""
MOST_MASKED = 0.5
"""Share of the coefficients from which what is above the noise is no oscillation."""
FEWEST_CYCLES, FEW_CYCLES = 2, 16
"""Cycles in a segment from which and up to which an oscillation is described by regressors."""
LEAST_CYCLES = 3
"""Cycles in a segment from which an oscillation is one."""
PASSES = 5
"""Searches for oscillations, each beside those found before."""
SETTLING_GATE = 4.0
"""Twice the log likelihood ratio from which an exponential is considered at all."""
SETTLING_PENALTY = 3.0
"""Logarithm of the odds against an exponential, for the choice of its size and its time constant."""
CERTAIN = 1e3
"""Odds from which a description counts alone."""
STEP_EVIDENCE = 30.0
"""Twice the log likelihood ratio of a step: 10^-7 by chance, at any of a thousand places."""
MOST_STEPS = 8
"""Steps that are described: a record with more is not at rest."""
STEP_SINGLE = 256
"""Cosine coefficients that stay single beside a step, whose spectrum falls slowly."""
COARSE = 12
"""Values of B and of K in the search for regressors."""


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """What was chosen, kept from one fit of a growing record to the next until the record has doubled."""

    samples: int  # of the record when it was chosen
    first: int
    window: int
    shape: str
    grids: tuple[Floats, Floats] | None


@dataclass(frozen=True, slots=True, eq=False)
class Description:
    """A channel as it is described.

    Attributes
    ----------
    surface : likelihood of N, B and K.
    likelihood : of the description in use.
    series : coefficients of the block means.
    regressors : columns in use.
    reason : why the temperature is no column: "", ``no_temperature``, ``small_range`` or ``collinear``.
    oscillations : (m,) coefficients that are left out.
    excess : (m,) (channel unit)^2, what they hold above the noise.
    first : octaves of frequency that are left out at the upper end.
    window : samples of a moving average in the sensor; 1: none.
    misfit, dof, p_value : of the bands, with the tolerance of the model.
    settling_odds : likelihood of the exponential against none.
    offset : channel unit, what the series is about.
    choice : for the next fit.
    """

    surface: Surface
    likelihood: Likelihood
    series: BlockSeries
    regressors: list[Regressor]
    reason: str
    oscillations: Bools
    excess: Floats
    first: int
    window: int
    misfit: float
    dof: float
    p_value: float
    settling_odds: float
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
    degrees : (blocks,) degC, temperature; None: there is none.
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
        degrees: Floats | None = None,
        previous: Choice | None = None,
        slow_terms: bool = True,
    ) -> None:
        self._sums, self._column, self._averaged = sums, column, averaged
        self._series, self._previous, self._slow_terms = series, previous, slow_terms
        self._judged_at = self._samples = int(series.count.sum()) * series.length
        self._order = np.argsort(series.f, kind="stable")
        self._single = min(SINGLE, series.y.size // 3)
        heat, self._reason = columns_of.temperature(series, degrees)
        self._regressors = [*columns_of.drifts(series), *([] if heat is None else [heat])]
        self._masked = np.zeros(series.y.size, dtype=bool)
        self._spectral: dict[int, Powers] = {}
        self._found: dict[tuple[object, ...], tuple[Likelihood, Surface]] = {}
        self._calm: set[int] = set()  # surfaces in `_found` beside which there is no oscillation
        self._coarse: dict[int, Surface] = {}  # by a surface in `_found`
        self._columns: dict[tuple[str, ...], tuple[Floats, list[Regressor]]] = {}
        self._grids = None if previous is None else previous.grids

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
        while first == 0 or self._rows(first) > LEAST_ROWS:
            yield first, 1, "filtered"
            first += 1

    def _best_window(self) -> int:
        """Return the moving average whose shape the highest bands have; 1: none comes close."""
        best, least = 1, np.inf
        for window in (1, *WINDOWS):
            powers = self._powers(window)
            if powers.top.size < LEAST_ROWS:
                break
            rows = np.argsort(-powers.top)[:8]
            ratio = np.log(powers.power[rows] / powers.expected[rows, 0])
            weight = 1.0 / (2.0 / powers.dof[rows] + TOLERANCE**2)
            misfit = float(weight @ (ratio - weight @ ratio / weight.sum()) ** 2)
            if misfit < least:
                best, least = window, misfit
        return best

    def _powers(self, window: int) -> Powers:
        """Return the bands of the spectrum above the frequency at which the blocks end."""
        if window not in self._spectral:
            powers = spectral_powers(self._sums, self._column, averaged=self._averaged, window=window)
            self._spectral[window] = powers.take(powers.top > meeting_frequency(self._series) * (1.0 + 1e-6))
        return self._spectral[window]

    def _rows(self, first: int) -> int:
        """Return the number of bands with some octaves left out."""
        return int(rows_up_to(self._all_powers(1, self._regressors), _highest(first)).sum())

    def _judged(self, first: int, window: int, shape: str) -> tuple[float, float]:
        """Return the probability of the misfit of a description, and the misfit over its degrees of freedom.

        The upper end is judged by the spectrum: what moves slowly does not change it. A description whose white noise
        does not show is none.
        """
        if first and self._rows(first) < LEAST_ROWS:
            return 0.0, np.inf
        likelihood, surface = self._without_oscillations(first, window, shape)
        if first and not _shows(surface):
            return 0.0, np.inf
        tested = replace(likelihood, error=TOLERANCE)
        own = int(rows_up_to(self._powers(window), _highest(first)).sum())
        rows = own if own >= LEAST_ROWS else None
        misfit, dof = tested.misfit(surface, rows)
        return tested.p_value(surface, rows), misfit / dof

    def _shows_white(self, first: int, window: int, shape: str) -> bool:
        """Return whether the white noise still shows with some octaves left out."""
        return self._rows(first) >= LEAST_ROWS and _shows(self._search(first, window, shape)[1])

    # ------------------------------------------------------------------ likelihoods

    def _all_powers(self, window: int, regressors: list[Regressor]) -> Powers:
        """Return the bands of the spectrum, and of the block means without what the regressors explain.

        The regression of these weights the frequencies evenly on a logarithmic scale, as flicker would.
        """
        series = self._series
        X = self._X(regressors)
        weighted = X * (series.f * ~self._masked)[:, None]
        beta = np.linalg.lstsq(weighted.T @ X, weighted.T @ series.y, rcond=None)[0]
        residual, top = series.y - X @ beta, meeting_frequency(series)
        parts = self._powers(window), pooled_coefficients(series, residual, self._masked, self._single, top)
        return Powers(*(np.concatenate([getattr(p, n) for p in parts]) for n in Powers.__slots__))

    def _likelihood(self, first: int, window: int, shape: str, regressors: list[Regressor]) -> Likelihood:
        series, highest = self._series, _highest(first)
        powers = self._all_powers(window, regressors)
        single = self._order[: self._single]
        single = single[~self._masked[single] & (series.f[single] <= highest)]
        X = self._X(regressors)
        coefficients = Coefficients(series.y[single], X[single], series.variance[:, single])
        return Likelihood(powers.take(rows_up_to(powers, highest)), coefficients, shape)

    def _search(self, first: int, window: int, shape: str, error: float = 0.0) -> tuple[Likelihood, Surface]:
        key = first, window, shape, error, self._single, len(self._regressors), self._masked.tobytes()
        if key not in self._found:
            likelihood = replace(self._likelihood(first, window, shape, self._regressors), error=error)
            surface = likelihood.search(self._samples, self._grids)
            self._grids = surface.B, surface.K
            self._found[key] = likelihood, surface
        return self._found[key]

    def _X(self, regressors: list[Regressor]) -> Floats:
        """Return (m, q) the columns of some regressors, each of norm one."""
        return self._scaled(regressors)[0]

    def _scaled(self, regressors: list[Regressor]) -> tuple[Floats, list[Regressor]]:
        """Return the columns, and the regressors with their scales."""
        key = tuple(f"{each.name} {each.at}" for each in regressors)
        if key not in self._columns:
            self._columns[key] = columns_of.columns(self._series, regressors)
        return self._columns[key]

    # ------------------------------------------------------------------ the description in use

    def _finish(self, first: int, window: int, shape: str) -> Description | str:
        """Return the description with everything that moves slowly."""
        likelihood, surface = self._without_oscillations(first, window, shape)
        pair, gain = self._best_settling(likelihood, surface)
        for _ in range(MOST_STEPS):
            step, abrupt = self._best_step(likelihood, surface)
            if step is None or abrupt < max(STEP_EVIDENCE, gain):
                break
            self._add([step])
            self._single = min(STEP_SINGLE, self._series.y.size // 3)
            likelihood, surface = self._without_oscillations(first, window, shape)
            pair, gain = self._best_settling(likelihood, surface)
        odds = float(np.exp(np.clip(0.5 * gain - SETTLING_PENALTY, -50.0, 50.0))) if gain else 0.0
        if odds > CERTAIN:
            self._add(pair)
            likelihood, surface = self._without_oscillations(first, window, shape)
        error = self._error(likelihood, surface)
        if error > MOST_ERROR:
            return "no description fits the data"
        if error:
            likelihood, surface = self._search(first, window, shape, error)
        if 1.0 / CERTAIN < odds <= CERTAIN:
            settled = replace(self._likelihood(first, window, shape, [*self._regressors, *pair]), error=error)
            surface = _either(likelihood, surface, settled, settled.search(self._samples), odds)
        tested = replace(likelihood, error=TOLERANCE)
        misfit, dof = tested.misfit(surface)
        columns = self._scaled(self._regressors)[1]
        choice = Choice(self._judged_at, first, window, shape, (surface.B, surface.K))
        return Description(
            surface,
            likelihood,
            self._series,
            columns,
            self._reason,
            self._masked,
            self._excess(surface),
            first,
            window,
            misfit,
            dof,
            tested.p_value(surface),
            odds,
            float(self._sums.blocks.offset[self._column]),
            choice,
        )

    def _add(self, regressors: list[Regressor]) -> None:
        """Add what settles or steps; what looked like oscillations before is judged again beside it."""
        self._regressors = [*self._regressors, *regressors]
        self._masked = np.zeros(self._masked.size, dtype=bool)

    def _ratio(self, surface: Surface) -> Floats:
        """Return (m,) the squares of all coefficients over their expectation, without what the regressors explain."""
        series = self._series
        X = self._X(self._regressors)
        residual = series.y - X @ surface.beta[surface.best]
        return np.asarray(residual**2 / (surface.powers @ series.variance))

    def _excess(self, surface: Surface) -> Floats:
        """Return (m,) (channel unit)^2, what the coefficients that are left out hold above the noise."""
        if not self._masked.any():
            return np.zeros(self._masked.size)
        above = np.maximum(self._ratio(surface) - 1.0, 0.0) * (surface.powers @ self._series.variance)
        return np.where(self._masked, above, 0.0)

    def _without_oscillations(self, first: int, window: int, shape: str) -> tuple[Likelihood, Surface]:
        """Return the likelihood without the coefficients of oscillations."""
        likelihood, surface = self._search(first, window, shape)
        for _ in range(PASSES):
            if id(surface) in self._calm:
                break
            if not self._add_oscillation(likelihood, surface) and not self._mask_oscillations(
                likelihood, surface
            ):
                self._calm.add(id(surface))
                break
            likelihood, surface = self._search(first, window, shape)
        return likelihood, surface

    def _add_oscillation(self, likelihood: Likelihood, surface: Surface) -> bool:
        """Add the strongest oscillation of few cycles as regressors; return whether there is one.

        Its leakage reaches the lowest coefficients, which decide about K: to leave out coefficients is not enough.
        """
        series, begin = self._series, int(self._series.begin[-1]) - (self._series.begin.size - 1)
        own = np.arange(2 * FEWEST_CYCLES - 1, min(2 * FEW_CYCLES, int(series.count[-1]) - 1))
        own = own[(series.f[begin + own] <= likelihood.powers.top.max()) & ~self._masked[begin + own]]
        if not own.size:
            return False
        single = np.sort(self._order[: min(STEP_SINGLE, series.y.size // 3)])
        single = single[~self._masked[single]]
        coefficients = Coefficients(
            series.y[single], self._X(self._regressors)[single], series.variance[:, single]
        )
        waves = columns_of.waves(series, own + 1)[single]
        gains = columns_of.gains(coefficients, self._wide(likelihood, surface), waves, group=2)
        chance = CHANCE / (series.y.size * len(OSCILLATION_WIDTHS))
        if gains.max() < 2.0 * float(gammainccinv(1.0, chance)):
            return False
        slower = max(self._best_settling(likelihood, surface)[1], self._best_step(likelihood, surface)[1])
        if slower > gains.max():
            return False
        moved = self._X(self._regressors) @ surface.beta[surface.best]
        rest = series.without(moved)[series.begin[-1] :]
        pair = columns_of.oscillation(series, rest, 1 + int(own[gains.argmax()]))
        if any(each.name == "oscillation" and each.at == pair[0].at for each in self._regressors):
            return False
        self._regressors = [*self._regressors, *pair]
        return True

    def _mask_oscillations(self, likelihood: Likelihood, surface: Surface) -> bool:
        """Leave out the coefficients of oscillations; return whether there are new ones."""
        series = self._series
        counted = (series.f <= likelihood.powers.top.max()) & ~self._masked
        ratio = np.where(counted, self._ratio(surface), 0.0)
        chance = CHANCE / (max(int(counted.sum()), 1) * len(OSCILLATION_WIDTHS))
        found = False
        for begin, count in zip(series.begin - np.arange(series.begin.size), series.count - 1, strict=True):
            own, masked = ratio[begin : begin + count], self._masked[begin : begin + count]
            for width in OSCILLATION_WIDTHS:
                if width > count:
                    break
                total = np.convolve(own, np.ones(width), mode="valid")
                threshold = 2.0 * float(gammainccinv(0.5 * width, chance))  # of a chi-square
                for k in np.flatnonzero(total > threshold).tolist():
                    # the leakage of a steady oscillation falls with the square of the distance
                    reach = int(np.sqrt(own[k] / LEAK) / np.pi) if width == 1 else 0
                    low = max(k - reach - 1, 2 * LEAST_CYCLES)
                    found |= bool((~masked[low : k + width + reach + 1]).any())
                    masked[low : k + width + reach + 1] = True
        if self._masked.mean() > MOST_MASKED:
            self._masked[:], found = False, False
        return found

    def _error(self, likelihood: Likelihood, surface: Surface) -> float:
        """Return the error of the model that brings the misfit to its expectation; 0.0 where chance explains it."""
        if likelihood.p_value(surface) > REJECT_P:
            return 0.0
        low, high = 0.0, 2.0 * MOST_ERROR
        for _ in range(20):
            middle = 0.5 * (low + high)
            misfit, dof = replace(likelihood, error=middle).misfit(surface)
            low, high = (middle, high) if misfit > dof else (low, middle)
        return high

    # ------------------------------------------------------------------ settling and steps

    def _gains(self, likelihood: Likelihood, surface: Surface, lines: list[Regressor], single: int) -> Floats:
        """Return twice the gain in log likelihood by each of some regressors, with the best B and K beside it.

        Parameters
        ----------
        single : number of cosine coefficients that count.
        """
        own = self._order[:single]
        own = own[~self._masked[own] & (self._series.f[own] <= likelihood.powers.top.max())]
        series = self._series
        coefficients = Coefficients(series.y[own], self._X(self._regressors)[own], series.variance[:, own])
        columns = series.transform(np.stack([line.series for line in lines], axis=1))
        return columns_of.gains(coefficients, self._wide(likelihood, surface), columns[own])

    def _best_settling(self, likelihood: Likelihood, surface: Surface) -> tuple[list[Regressor], float]:
        """Return the most likely exponential and twice its gain; 0.0 where it is not worth a thought."""
        if not self._slow_terms:
            return [], 0.0
        pairs = [columns_of.settling(self._series, share) for share in SETTLING_SHARES]
        gains = self._gains(likelihood, surface, [pair[0] for pair in pairs], self._single)
        best = int(gains.argmax())
        return pairs[best], float(gains[best]) if gains[best] > SETTLING_GATE else 0.0

    def _best_step(self, likelihood: Likelihood, surface: Surface) -> tuple[Regressor | None, float]:
        """Return the most likely step, and twice its gain."""
        steps = columns_of.likely_steps(self._series) if self._slow_terms else []
        if not steps:
            return None, 0.0
        gains = self._gains(likelihood, surface, steps, STEP_SINGLE)
        return steps[int(gains.argmax())], float(gains.max())

    def _wide(self, likelihood: Likelihood, surface: Surface) -> Surface:
        """Return the likelihood on a coarse grid down to B = K = 0, for the search of regressors."""
        if id(surface) not in self._coarse:
            falling = np.concatenate(([0.0], np.geomspace(1e-3, 1.0, COARSE - 1)))
            B, K = surface.B[-1] * np.linspace(0.0, 1.0, COARSE), surface.K[-1] * falling
            self._coarse[id(surface)] = likelihood.surface(B, K, float(surface.c[surface.best]))
        return self._coarse[id(surface)]


def _shows(surface: Surface) -> bool:
    """Return whether N^2 is known well at the greatest likelihood."""
    best = surface.best
    return bool(np.sqrt(surface.a_variance[best]) < LARGEST_ERROR * surface.a[best])


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
