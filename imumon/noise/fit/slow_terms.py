"""What moves the mean of one channel and is not noise, found in its block means alone.

The likelihood of the cosine coefficients says how much a term explains, with the best B and K beside it. The strongest
of settling, a step, a bend in the effect of the temperature and an oscillation of few cycles is added, until chance
explains what is left. Of other oscillations a coefficient far above its expectation is left out, with those to which
it leaks: their period wanders. An exponential in doubt counts in proportion to its likelihood.

Block means lie below the upper end of the spectrum, where few filters in sensors reach. In a record of some thousand
samples the blocks are single samples, and a filter shows in them, too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import gammainccinv

from imumon.noise.fit import regressors as columns_of
from imumon.noise.fit.likelihood import GRID, Likelihood, Surface
from imumon.noise.fit.observations import (
    SINGLE,
    BlockSeries,
    Coefficients,
    Powers,
    meeting_frequency,
    pooled_coefficients,
)
from imumon.noise.fit.regressors import Regressor
from imumon.samples import Bools, Floats, Ints

CHANCE = 0.01
"""Probability, over all of a record, that noise alone makes an oscillation, or a misfit: it costs little."""
LEAK = 0.02
"""Share of the noise that the leakage of an oscillation may have in a coefficient that counts."""
OSCILLATION_WIDTHS = (1, 3, 8, 24)
"""Neighbouring coefficients that are tested together: the period of an oscillation may wander."""
MOST_MASKED = 0.5
"""Share of the coefficients from which what is above the noise is no oscillation."""
FEWEST_CYCLES, FEW_CYCLES = 2, 16
"""Cycles in a segment from which an oscillation is one, and up to which regressors describe it."""
SETTLING_CERTAIN = 20.0
"""Twice the log likelihood ratio from which it counts alone: odds of 10^3."""
CERTAIN = 30.0
"""Twice the log likelihood ratio from which a step counts, and an oscillation is reported: 10^-7 by chance, at any of a
thousand places."""
BEND_CHANCE = 0.05
"""Probability that noise alone bends the effect of the temperature: a bend that is kept may hide K."""
MOST_TERMS = 12
"""Terms, and searches for oscillations, in one record: one with more is not at rest."""
SEARCHED = 256
"""Single coefficients in which terms are sought, and which stay single beside a step, whose spectrum falls slowly."""


@dataclass(frozen=True, slots=True, eq=False)
class SlowTerms:
    """What moves the mean of a channel.

    Attributes
    ----------
    series : the block means.
    regressors : the columns, with their scales.
    masked : (m,) coefficients that oscillations hold, left out.
    single : coefficients that stay single.
    settling : an exponential in doubt, with its derivative; empty without one.
    odds : likelihood of this exponential against none.
    no_temperature : why the temperature is no column: "", ``no_temperature``, ``small_range`` or ``collinear``.
    """

    series: BlockSeries
    regressors: list[Regressor]
    masked: Bools
    single: int
    settling: list[Regressor]
    odds: float
    no_temperature: str

    def observations(
        self, highest: float, top: float, *, unsettled: bool = False
    ) -> tuple[Powers, Coefficients]:
        """Return the bands of the block means, and their single coefficients.

        The regression that leaves the bands is one of least squares; its weights weigh the frequencies evenly on a
        logarithmic scale, as flicker would.

        Parameters
        ----------
        highest, top : cycles per sample, up to which coefficients count, and bands.
        unsettled : with the exponential in doubt.
        """
        series = self.series
        X = columns_of.matrix(series, [*self.regressors, *(self.settling if unsettled else ())])
        weighted = X * (series.f * ~self.masked)[:, None]
        beta = np.linalg.lstsq(weighted.T @ X, weighted.T @ series.y, rcond=None)[0]
        pooled = pooled_coefficients(series, series.y - X @ beta, self.masked, self.single, min(top, highest))
        own = series.order[: self.single]
        own = own[~self.masked[own] & (series.f[own] <= highest)]
        return pooled, Coefficients(series.y[own], X[own], series.variance[:, own])

    def excess(self, surface: Surface) -> Floats:
        """Return (m,) (channel unit)^2, what the coefficients that are left out hold above the noise."""
        if not self.masked.any():
            return np.zeros(self.masked.size)
        above = np.maximum(_ratio(self, surface) - 1.0, 0.0)
        return np.where(self.masked, above * (surface.powers @ self.series.variance), 0.0)

    def step_power(self, surface: Surface) -> float:
        """Return the K^2 of a random walk whose spectrum the steps have: the sum of their squares over the time."""
        pairs = zip(surface.beta[surface.best], self.regressors, strict=True)
        sizes = np.array([value * each.scale for value, each in pairs if each.name == "step"])
        return float(sizes @ sizes) / self.series.samples


class _Candidate(NamedTuple):
    """A term that may be added: twice its gain in log likelihood exceeds the threshold.

    `columns` (m, k) are tested together. An oscillation has the number of a coefficient, and its regressors are made
    when it is the strongest.
    """

    threshold: float
    columns: Floats
    regressors: list[Regressor]
    number: int = 0


class SlowTermSearch:
    """Search for the slow terms of one channel.

    Parameters
    ----------
    grids : B and K of an earlier search; None: unknown.
    whole : look for settling and steps; False for parts of a record.
    """

    def __init__(
        self,
        series: BlockSeries,
        grids: tuple[Floats, Floats] | None,
        *,
        whole: bool = True,
    ) -> None:
        self._series, self._whole, self._grids = series, whole, grids
        self._top = meeting_frequency(series)
        heat, reason = columns_of.temperature(series)
        self._bends = columns_of.bends(series, heat) if heat is not None and whole else []
        regressors = [*columns_of.drifts(series), *([] if heat is None else [heat])]
        masked = np.zeros(series.y.size, dtype=bool)
        self.terms = SlowTerms(series, regressors, masked, min(SINGLE, masked.size // 3), [], 0.0, reason)
        self.surface = self._searched()

    def result(self) -> SlowTerms:
        """Return the terms beside which chance explains what is left."""
        for _ in range(MOST_TERMS):
            if not self._add_strongest() and not self._mask_oscillations():
                break
            self.surface = self._searched()
        return self.terms

    def _searched(self) -> Surface:
        """Return the likelihood of the block means with the present terms."""
        self._likelihood = Likelihood(*self.terms.observations(self._top, self._top))
        surface = self._likelihood.search(self._series.samples, self._grids)
        self._grids = surface.B, surface.K
        return surface

    def _add_strongest(self) -> bool:
        """Add the term that explains most; return whether there is one that chance does not explain.

        An exponential that is in doubt is kept beside the terms.
        """
        candidates = [*self._falls(), *self._steps(), *self._waves(), *self._bent()]
        if not candidates:
            return False
        widths = [each.columns.shape[1] for each in candidates]
        columns = np.concatenate([each.columns for each in candidates], axis=1)
        gains = self._gains(columns, np.cumsum([0, *widths[:-1]]))
        beyond = gains - np.array([each.threshold for each in candidates])
        best = candidates[int(np.where(beyond > 0.0, gains, -np.inf).argmax())]
        if not (beyond > 0.0).any():
            self._doubt(candidates, gains)
            return False
        found = best.regressors or self._oscillation(best.number)
        if any((each.name, each.at) == (found[0].name, found[0].at) for each in self.terms.regressors):
            return False
        self._add(found)
        return True

    def _falls(self) -> list[_Candidate]:
        """Return exponentials of several time constants; none where one is among the terms."""
        if not self._whole or any(each.name == "settling" for each in self.terms.regressors):
            return []
        pairs = columns_of.settlings(self._series)
        return [_Candidate(SETTLING_CERTAIN, pair[0].column[:, None], pair) for pair in pairs]

    def _steps(self) -> list[_Candidate]:
        """Return steps at likely places."""
        steps = columns_of.likely_steps(self._series) if self._whole else []
        return [_Candidate(CERTAIN, each.column[:, None], [each]) for each in steps]

    def _bent(self) -> list[_Candidate]:
        """Return what bends the effect of the temperature, together; none where it is among the terms."""
        if not self._bends or any(each.name == self._bends[0].name for each in self.terms.regressors):
            return []
        columns = columns_of.matrix(self._series, self._bends)
        threshold = 2.0 * float(gammainccinv(0.5 * len(self._bends), BEND_CHANCE))  # of a chi-square
        return [_Candidate(threshold, np.linalg.qr(columns)[0], self._bends)]

    def _waves(self) -> list[_Candidate]:
        """Return oscillations of few cycles in the last segment, at the frequencies of its coefficients."""
        series, first = self._series, self._series.y.size - int(self._series.count[-1]) + 1
        own = np.arange(2 * FEWEST_CYCLES - 1, min(2 * FEW_CYCLES, int(series.count[-1]) - 1))
        own = own[(series.f[first + own] <= self._top) & ~self.terms.masked[first + own]]
        columns = columns_of.waves(series, (own + 1).astype(np.float64))
        chance = CHANCE / (series.y.size * len(OSCILLATION_WIDTHS))
        threshold = 2.0 * float(gammainccinv(1.0, chance))
        return [
            _Candidate(threshold, columns[:, 2 * i : 2 * i + 2], [], number)
            for i, number in enumerate(own.tolist())
        ]

    def _doubt(self, candidates: list[_Candidate], gains: Floats) -> None:
        """Keep the most likely exponential beside the terms if it is more likely than none.

        The odds before the data are even, and divided over the time constants that are tried.
        """
        falls = [
            (float(np.exp(0.5 * gain)) / columns_of.SETTLING_SHARES.size, each.regressors)
            for gain, each in zip(gains, candidates, strict=True)
            if each.regressors and each.regressors[0].name == "settling"
        ]
        odds, pair = max(falls, key=lambda fall: fall[0], default=(0.0, []))
        self.terms = replace(self.terms, settling=pair if odds > 1.0 else [], odds=odds)

    def _add(self, found: list[Regressor]) -> None:
        """Add regressors; what looked like an oscillation beside settling or a step is judged again."""
        terms = self.terms
        step, wave = found[0].name == "step", found[0].name in columns_of.OSCILLATION
        self.terms = replace(
            terms,
            regressors=[*terms.regressors, *found],
            masked=terms.masked if wave else np.zeros_like(terms.masked),
            single=min(SEARCHED, terms.masked.size // 3) if step else terms.single,
            settling=[],
        )

    def _gains(self, columns: Floats, starts: Ints) -> Floats:
        """Return twice the gain in log likelihood by columns (m, t) added from each start to the next."""
        series, terms = self._series, self.terms
        own = series.order[: min(SEARCHED, series.y.size // 3)]
        own = own[~terms.masked[own] & (series.f[own] <= self._top)]
        X = columns_of.matrix(series, terms.regressors)
        coefficients = Coefficients(series.y[own], X[own], series.variance[:, own])
        # the likeliest values are among them: beside a large K the likelihood is narrow
        _, b, k = np.sqrt(self.surface.powers)
        B = np.append((b or self.surface.B[-1]) * np.linspace(0.0, 1.0, GRID // 2 - 1), self.surface.B[-1])
        falling = np.append(0.0, np.geomspace(0.01, 1.0, GRID // 2 - 2))
        K = np.append((k or self.surface.K[-1]) * falling, self.surface.K[-1])
        return columns_of.gains(coefficients, self._likelihood.surface(B, K), columns[own], starts)

    def _oscillation(self, number: int) -> list[Regressor]:
        """Return the regressors of the oscillation about a coefficient of the last segment."""
        places = number + 1.0 + np.linspace(-1.0, 1.0, 2 * GRID + 1)
        gains = self._gains(columns_of.waves(self._series, places), 2 * np.arange(places.size))
        return columns_of.oscillation(self._series, float(places[gains.argmax()]))

    def _mask_oscillations(self) -> bool:
        """Leave out the coefficients of oscillations, narrow ones first; return whether there are new ones."""
        series, all_masked = self._series, self.terms.masked.copy()
        counted = (series.f <= self._top) & ~all_masked
        ratio = np.where(counted, _ratio(self.terms, self.surface), 0.0)
        chance = CHANCE / (max(int(counted.sum()), 1) * len(OSCILLATION_WIDTHS))
        for begin, count in zip(series.begin - np.arange(series.begin.size), series.count - 1, strict=True):
            own, masked = ratio[begin : begin + count], all_masked[begin : begin + count]
            for width in OSCILLATION_WIDTHS:
                if width > count:
                    break
                own = np.where(masked, 1.0, own)  # a wider test is of what narrower ones leave
                total = np.convolve(own, np.ones(width), mode="valid")
                threshold = 2.0 * float(gammainccinv(0.5 * width, chance))  # of a chi-square
                for k in np.flatnonzero(total > threshold).tolist():
                    # the leakage of a steady oscillation falls with the square of the distance
                    reach = int(np.sqrt(own[k] / LEAK) / np.pi) if width == 1 else 0
                    masked[max(k - reach - 1, 2 * FEWEST_CYCLES) : k + width + reach + 1] = True
        if all_masked[series.f <= self._top].mean() > MOST_MASKED:
            all_masked[:] = False
        found = bool((all_masked & ~self.terms.masked).any())
        self.terms = replace(self.terms, masked=all_masked)
        return found


def _ratio(terms: SlowTerms, surface: Surface) -> Floats:
    """Return (m,) the squares of all coefficients over their expectation, without what the regressors explain."""
    series = terms.series
    X = columns_of.matrix(series, terms.regressors)
    beta = surface.beta[surface.best]
    return np.asarray((series.y - X @ beta) ** 2 / (surface.powers @ series.variance))
