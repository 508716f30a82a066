"""Search for the slow terms of one channel: what moves its mean, sought in the block means alone.

The likelihood of the cosine coefficients says how much a regressor explains with the best B and K beside it. In each
round the strongest of settling, step, bend of the effect of the temperature and oscillation of few cycles becomes a
regressor, if its gain exceeds its threshold and that of noise with a time constant. Without one, the coefficients of
other oscillations are left out: their period wanders, so that no regressor describes them. Last, the lowest
coefficients are left out if they alone make a walk. The search ends when chance explains the rest.

| candidate | counts where | threshold of twice the gain |
|---|---|---|
| settling | once, in whole records | `SETTLING_CERTAIN`; below, by its odds |
| noise with a time constant | once, in whole records, instead of a weaker regressor | even odds |
| step | in whole records | `CERTAIN`; below, by its odds |
| bend of the temperature | once, beside the temperature, in whole records | chi-square, `CHANCE` |
| oscillation of `FEWEST_CYCLES` to `FEW_CYCLES` | last segment | chi-square, `CHANCE` over all places |
| oscillation, left out | everywhere | chi-square, `CHANCE` over all places |
| mean that moves slowly | a walk that shows in the lowest coefficients only, in whole records | `BEYOND_EVIDENCE` |
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.special import gammainccinv

from imumon.model.coefficients import SIGNIFICANT
from imumon.model.samples import Bools, Floats, Ints
from imumon.noise.fit import regressors, timed_search
from imumon.noise.fit.hump import LEAK
from imumon.noise.fit.likelihood import (
    CHANCE,
    EVIDENCE,
    GRID,
    LIMITS,
    Grids,
    Likelihood,
    Surface,
    evidence,
    quantiles,
)
from imumon.noise.fit.model import NoiseTerm, total
from imumon.noise.fit.observations import (
    Bands,
    BlockSeries,
    Cosines,
    meeting_frequency,
    pooled_cosines,
)
from imumon.noise.fit.regressors import COEFFICIENTS_PER_REGRESSOR, SETTLING_TIMES, SINGLE, Regressor

MOST_LEVERAGE = 0.5
"""A coefficient shows noise up to this leverage of the regressors. Unit: of its noise.

Otherwise: the first coefficient, which a drift takes, is zero, and no noise explains that: a hump is sought. Chosen:
more of it is noise than not.
"""
OSCILLATION_WIDTHS = (1, 3, 8, 24)
"""Neighbouring coefficients that are tested together for an oscillation. Unit: coefficients.

Otherwise: with single ones only, an oscillation whose period wanders is fitted as B. Origin: steps of three: between
two of them the test loses little (`real_effects.py`).
"""
FEWEST_CYCLES = 2
"""Oscillations with fewer in a segment are none. A walk that does not show without the coefficients up to here is a
mean that moves slowly, and they are left out; then twice and four times as many, up to half of those that stay single.
Unit: cycles, of two coefficients each.

Otherwise: one cycle looks like a random walk, and K is bounded in most records. A mean that rises and falls once by 20
floors is measured as K in four records of five, and B is too small in one of four; with three cycles, K of three times
the smallest is lost in 15 % of the records, with two in 12 %. Origin: the least that is an oscillation (`markov.py`).
"""
FEW_CYCLES = 16
"""Up to here regressors describe an oscillation, beyond its coefficients are left out. Unit: cycles.

Otherwise: regressors beyond: the phase of an oscillation wanders, and four regressors no longer hold it. See
`real_effects.py`.
"""
LEAST_ODDS = 0.35
"""A regressor is in doubt from here on, and the fits with and without it are mixed by their odds. Unit: odds.

Otherwise: at 1, the walk that a step of five times the floor looks like is measured in one record in ten. Origin:
below, the regressor has less than a quarter of the weight, and hardly moves a limit (`markov.py`).
"""
SETTLING_CERTAIN = 20.0
"""From here on an exponential is a regressor; below, the fits with and without it are mixed by their odds. Unit: twice
the log likelihood ratio.

Otherwise: lower, a walk is called a warm-up in some per cent of records and K is only a bound; higher, the end of a
warm-up stays in the record. Origin: odds of 10^3 for nine time constants (`real_effects.py --only warm-up`).
"""
CERTAIN = 30.0
"""From here on a step is a regressor; below, the fits with and without it are mixed by their odds; and an oscillation
whose coefficients are left out is reported. Unit: twice the log likelihood ratio.

Otherwise: a walk is broken into steps, and K vanishes. Origin: 10^-7 by chance (Wilks 1938), at any of a thousand
places (`real_effects.py`).
"""
MOST_TERMS = 12
"""The search for regressors and oscillations ends after this number of rounds. Unit: rounds.

Otherwise: on a moving platform each round finds another step, and a fit takes seconds. Origin: a record with more
than 12 steps and oscillations is not at rest.
"""
SEARCHED = 256
"""Single coefficients in which regressors are sought, and which stay single beside a regressor with a wide spectrum.
Unit: coefficients.

Otherwise: with 48 a step in a short record looks like a walk, and the bends of a short warm-up look alike. Origin:
1,024 blocks have 341 single coefficients at most; the spectrum of a step falls with the frequency
(`real_effects.py`).
"""
BEYOND_SINGLE = 0.05
"""A regressor has a wide spectrum if more of its power, by the frequency, lies beyond `SINGLE` coefficients. Unit: of
the power of a regressor.

Otherwise: the temperature, its square and its cube, alike in 48 coefficients, are large numbers of opposite sign.
Origin: in 562 blocks a step has 0.4, an exponential 0.33 to 0.0005 from a hundredth to a third of the record, a cycle
0.001 at most.
"""
BEYOND_EVIDENCE = 2.7
"""A walk shows without the lowest coefficients. Unit: twice the log likelihood ratio.

Otherwise: at 1, a mean that moves from one level to another is measured as K in 10 of 100 records instead of 7.
Origin: 5 % by chance (Chernoff 1954) (`markov.py`).
"""
CONSISTENT = 0.7
"""A walk is as large without the lowest coefficients as with them if this quantile of K is above its value. Unit:
probability.

Otherwise: at 0.9, a mean that moves from one level to another is measured as K in 23 of 100 records instead of 7.
Origin: half a standard error: where K is seen without the lowest coefficients, leaving them out costs little
(`markov.py`).
"""

EVEN = np.linspace(0.0, 1.0, GRID // 2 - 1)
FALLING = np.append(0.0, np.geomspace(0.01, 1.0, GRID // 2 - 2))
"""Shares of the likeliest B and K at which regressors are tried; of a term that grows, a regressor leaves any share."""


@dataclass(frozen=True, slots=True, eq=False)
class SlowTerms:
    """What moves the mean of a channel.

    Attributes
    ----------
    series : the block means.
    regressors : in use.
    left_out : (m,) coefficients within humps and lines of the spectrum.
    masked : (m,) all coefficients that do not count: these, and those that oscillations hold.
    doubtful : an exponential in doubt, with its derivative, or a step in doubt; empty without one.
    odds : likelihood of this regressor against none.
    no_temperature : why the temperature is no regressor: "", ``no_temperature``, ``small_range`` or ``collinear``.
    timed : power of a term with a time constant beside B and K; empty without one.
    slowest : numbers of the lowest coefficients, also in `masked`: they hold a mean that moves slowly, and no walk.
    bounds : channel unit in units of tau0, upper limit of each term that the slowest coefficients show; empty without
        them. It holds also if they are no slow change of the mean but a walk.
    """

    series: BlockSeries
    regressors: list[Regressor]
    left_out: Bools
    masked: Bools
    doubtful: list[Regressor]
    odds: float
    no_temperature: str
    slowest: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    bounds: Mapping[NoiseTerm, float] = field(default_factory=dict)
    timed: Mapping[NoiseTerm, float] = field(default_factory=dict)

    def with_terms(self, more: Sequence[NoiseTerm]) -> SlowTerms:
        """Return the same with expectations of some more terms of the noise."""
        return replace(self, series=self.series.with_terms(more))

    def observations(
        self, highest: float, meeting: float, *, with_doubtful: bool = False
    ) -> tuple[Bands, Cosines]:
        """Return the bands of the block means, and their single coefficients.

        The bands hold what a least squares regression leaves. Its weights weigh the frequencies evenly on a logarithmic
        scale, as flicker would: unweighted, the many coefficients of white noise decide on a drift.

        Parameters
        ----------
        highest : cycles per sample, up to which single coefficients count.
        meeting : cycles per sample, up to which the bands of the block means count; the spectrum has those above.
        with_doubtful : with the regressor in doubt.
        """
        series = self.series
        X = regressors.matrix(series, [*self.regressors, *(self.doubtful if with_doubtful else ())])
        single = _single(series, X)
        pooled = pooled_cosines(series, self._residual(X)[0], self.masked, single, min(meeting, highest))
        rows = series.order[:single]
        rows = rows[~self.masked[rows] & (series.f[rows] <= highest)]
        variances = {term: variance[rows] for term, variance in series.variances.items()}
        return pooled, Cosines(series.y[rows], X[rows], variances)

    def _residual(self, X: Floats) -> tuple[Floats, Floats]:
        """Return (m,) the coefficients without a weighted regression on some regressors (m, q), and their leverages.

        See `observations` for the weights. The leverage of a coefficient is the share of its noise that the regression
        takes.
        """
        weighted = X * (self.series.f * ~self.masked)[:, None]
        of_data = np.linalg.lstsq(weighted.T @ X, weighted.T, rcond=None)[0]
        return np.asarray(self.series.y - X @ (of_data @ self.series.y)), np.einsum("mq,qm->m", X, of_data)

    def bands(self, meeting: float) -> Bands:
        """Return bands of all coefficients that count up to a frequency, but of those that the regressors take."""
        residual, leverage = self._residual(regressors.matrix(self.series, self.regressors))
        return pooled_cosines(self.series, residual, self.masked | (leverage > MOST_LEVERAGE), 0, meeting)

    def excess(self, surface: Surface) -> Floats:
        """Return (m,) (channel unit)^2, what the coefficients that oscillations hold have above the noise."""
        held = self.masked & ~self.left_out
        if not held.any():
            return np.zeros(held.size)
        above = np.maximum(self.squares_over_noise(surface) - 1.0, 0.0)
        return np.where(held, above * self.noise_variances(surface), 0.0)

    def noise_variances(self, surface: Surface) -> Floats:
        """Return (m,) (channel unit)^2, the variance of each coefficient by the likeliest noise."""
        return total(surface.powers, lambda term: self.series.variances[term])

    def squares_over_noise(self, surface: Surface) -> Floats:
        """Return (m,) the squares of all coefficients over their expectation, without what the regressors explain."""
        X = regressors.matrix(self.series, self.regressors)
        return np.asarray(
            (self.series.y - X @ surface.beta[surface.best]) ** 2 / self.noise_variances(surface)
        )

    def step_power(self, surface: Surface) -> float:
        """Return the sum of the squares of the steps over the time, (channel unit)^2.

        They have the spectrum of a random walk of this K^2: over (2 pi f)^2.
        """
        pairs = zip(surface.beta[surface.best], self.regressors, strict=True)
        sizes = np.array([value * regressor.scale for value, regressor in pairs if regressor.name == "step"])
        return float(sizes @ sizes) / self.series.samples


def _single(series: BlockSeries, X: Floats) -> int:
    """Return the number of lowest coefficients that stay single beside some regressors (m, q).

    A regression sees the single coefficients only. The spectrum of a step falls slowly, and so does that of a warm-up
    that is short against the record: with few coefficients, regressors of such a shape are alike.
    """
    # a third at most, so that bands remain which hold N in a record of few blocks
    single, more = (min(number, series.y.size // 3) for number in (SINGLE, SEARCHED))
    if not X.size:
        return single
    # by the frequency, as against flicker
    weighted = X[series.order] ** 2 * series.f[series.order][:, None]
    beyond = weighted[single:].sum(axis=0)
    return more if (beyond > BEYOND_SINGLE * weighted.sum(axis=0)).any() else single


class _Candidate(NamedTuple):
    """A slow term that may be added: twice its gain in log likelihood exceeds the threshold.

    `cosines` (m, k) are tested together. An oscillation has the number of a coefficient, and its regressors are built
    only if it is the strongest: they depend on a frequency that is sought then.
    """

    threshold: float
    cosines: Floats
    regressors: list[Regressor]
    number: int = 0


class SlowTermSearch:
    """Search for the slow terms of one channel.

    Parameters
    ----------
    grids : of an earlier search; None: unknown.
    whole : look for settling, steps, bends and noise with a time constant; False for parts of a record: they are too
        short to see them.
    timed : power of noise with a time constant that is known to be there; the series has its variances.
    left_out : (m,) coefficients within humps and lines of the spectrum; None: there are none.
    spectral : bands of the spectrum that show N where the coefficients that are left do not; None: these do.
    """

    def __init__(
        self,
        series: BlockSeries,
        grids: Grids | None,
        *,
        whole: bool = True,
        timed: Mapping[NoiseTerm, float] | None = None,
        left_out: Bools | None = None,
        spectral: Bands | None = None,
    ) -> None:
        self._spectral = spectral
        self._series, self._whole, self._grids = series, whole, grids
        self._top = meeting_frequency(series)
        temperature, reason = regressors.temperature(series)
        self._bends = regressors.bends(series, temperature) if temperature is not None and whole else []
        first = [*regressors.drifts(series), *([] if temperature is None else [temperature])]
        if left_out is None:
            left_out = np.zeros(series.y.size, dtype=bool)
        self.terms = SlowTerms(series, first, left_out, left_out, [], 0.0, reason, timed=timed or {})
        self.surface = self._searched()

    def result(self) -> SlowTerms:
        """Return the terms beside which chance explains what is left."""
        for _ in range(MOST_TERMS):
            if not (self._add_strongest() or self._mask_oscillations() or self._mask_slowest()):
                return self.terms
            self.surface = self._searched()
        return self.terms

    def _searched(self) -> Surface:
        """Return the likelihood of the block means with the present terms."""
        self._likelihood = self._observed(list(self.terms.timed))
        surface = self._likelihood.search(self._series.samples, self._grids)
        self._grids = surface.grids
        return surface

    def _observed(self, more: Sequence[NoiseTerm]) -> Likelihood:
        """Return the likelihood of the block means, with expectations of some more terms."""
        terms = self.terms.with_terms(more)
        pooled, coefficients = terms.observations(self._top, self._top)
        if self._spectral is not None:
            pooled = self._spectral.joined(pooled)
        return Likelihood(pooled, coefficients, beside=self.terms.timed)

    def _add_timed(self, gain: float) -> bool:
        """Add noise with a time constant if it explains more than a gain, twice that in log likelihood; return whether.

        What looks like a regressor, or like oscillations, may be noise of another kind: regressors are sought beside
        it.
        """
        tried = timed_search.tried_terms(self._series.samples)
        if not self._whole or self.terms.timed or not tried:
            return False
        peaks = timed_search.peaks(self._observed(tried), self.surface, tried)
        if timed_search.odds_of(peaks.gains) < 1.0 or 2.0 * float(peaks.gains.max()) <= gain:
            return False
        term, power = peaks.terms[peaks.best], float(peaks.power[peaks.best])
        terms = self.terms.with_terms([term])
        self._series, self.terms = terms.series, replace(terms, timed={term: power}, doubtful=[])
        return True

    def _add_strongest(self) -> bool:
        """Add the term that explains most; return whether there is one that chance does not explain.

        Without one, an exponential or a step that is in doubt is kept beside the terms.
        """
        candidates = [*self._falls(), *self._steps(), *self._waves(), *self._bent()]
        if not candidates:
            return False  # too few coefficients: nothing can be distinguished from B and K
        widths = [candidate.cosines.shape[1] for candidate in candidates]
        cosines = np.concatenate([candidate.cosines for candidate in candidates], axis=1)
        gains = self._gains(cosines, np.cumsum([0, *widths[:-1]]))
        beyond = gains - np.array([candidate.threshold for candidate in candidates])
        best = candidates[int(np.where(beyond > 0.0, gains, -np.inf).argmax())]
        if not (beyond > 0.0).any():
            self._doubt(candidates, gains)
            return False
        if self._add_timed(float(gains.max(where=beyond > 0.0, initial=0.0))):
            return True
        added = best.regressors or self._oscillation(best.number)
        places = {(regressor.name, regressor.place) for regressor in self.terms.regressors}
        if (added[0].name, added[0].place) in places:
            # a regressor that is there already and still gains: rounding, or a step that is none; the search would not
            # end
            return False
        self._add(added)
        return True

    def _falls(self) -> list[_Candidate]:
        """Return exponentials of several time constants; none where one is among the terms."""
        if not self._whole or any(regressor.name == "settling" for regressor in self.terms.regressors):
            return []
        pairs = regressors.settlings(self._series)
        # the derivative is no part of the test: it would let a walk look like an exponential
        return [_Candidate(SETTLING_CERTAIN, pair[0].cosines[:, None], pair) for pair in pairs]

    def _steps(self) -> list[_Candidate]:
        """Return steps at likely places."""
        steps = regressors.likely_steps(self._series) if self._whole else []
        return [_Candidate(CERTAIN, step.cosines[:, None], [step]) for step in steps]

    def _bent(self) -> list[_Candidate]:
        """Return what bends the effect of the temperature, together; none where it is among the terms."""
        if not self._bends or any(
            regressor.name == self._bends[0].name for regressor in self.terms.regressors
        ):
            return []
        cosines = regressors.matrix(self._series, self._bends)
        threshold = _chi_square(len(self._bends), CHANCE)
        # the gains of the regressors of one candidate add up only where these are orthogonal
        return [_Candidate(threshold, np.linalg.qr(cosines)[0], self._bends)]

    def _waves(self) -> list[_Candidate]:
        """Return oscillations of few cycles in the last segment, at the frequencies of its coefficients."""
        series, first = self._series, self._series.y.size - int(self._series.count[-1]) + 1
        numbers = np.arange(2 * FEWEST_CYCLES - 1, min(2 * FEW_CYCLES, int(series.count[-1]) - 1))
        numbers = numbers[(series.f[first + numbers] <= self._top) & ~self.terms.masked[first + numbers]]
        # the regressors are fitted to single coefficients: beyond them, or with few of them, they are nearly the same
        rows = self._searched_rows()
        if rows.size < COEFFICIENTS_PER_REGRESSOR * len(regressors.OSCILLATION):
            return []
        numbers = numbers[np.isin(first + numbers, rows)]
        cosines = regressors.waves(series, (numbers + 1).astype(np.float64))
        threshold = _chi_square(2, CHANCE / (series.y.size * len(OSCILLATION_WIDTHS)))
        return [
            _Candidate(threshold, cosines[:, 2 * i : 2 * i + 2], [], number)
            for i, number in enumerate(numbers.tolist())
        ]

    def _doubt(self, candidates: Sequence[_Candidate], gains: Floats) -> None:
        """Keep the most likely exponential or step beside the terms if its odds are above `LEAST_ODDS`.

        The odds before the data are even, and divided over the time constants, or over the places, that there are.
        """
        chances = {"settling": len(SETTLING_TIMES), "step": self._series.series.size}
        doubtful = [
            (float(np.exp(0.5 * gain)) / chances[candidate.regressors[0].name], candidate.regressors)
            for gain, candidate in zip(gains, candidates, strict=True)
            if candidate.regressors and candidate.regressors[0].name in chances
        ]
        odds, best = max(doubtful, key=lambda pair: pair[0], default=(0.0, []))
        self.terms = replace(self.terms, doubtful=best if odds > LEAST_ODDS else [], odds=odds)

    def _add(self, added: list[Regressor]) -> None:
        """Add regressors; what looked like an oscillation beside settling or a step is judged again."""
        terms = self.terms
        if added[0].name not in regressors.OSCILLATION:
            terms = replace(terms, masked=terms.left_out, slowest=terms.slowest[:0], bounds={})
        # what looked like noise with a time constant may have been the regressor
        self.terms = replace(terms, regressors=[*terms.regressors, *added], doubtful=[], timed={})

    def _gains(self, cosines: Floats, starts: Ints) -> Floats:
        """Return twice the gain in log likelihood by cosines (m, t) of regressors added from each start to the next."""
        series, terms, surface = self._series, self.terms, self.surface
        rows = self._searched_rows()
        rows = rows[~terms.masked[rows] & (series.f[rows] <= self._top)]
        X = regressors.matrix(series, terms.regressors)
        variances = {term: variance[rows] for term, variance in series.variances.items()}
        observed = Cosines(series.y[rows], X[rows], variances)
        # From zero, because a regressor may explain all of B or K, to the end of the grid. The likeliest values are
        # among them: beside a large K the likelihood is narrow, and a grid that misses it calls a walk a warm-up.
        grids: Grids = {
            term: np.append(
                (np.sqrt(surface.powers[term]) or grid[-1]) * (FALLING if term.grows else EVEN), grid[-1]
            )
            for term, grid in surface.grids.items()
        }
        return regressors.gains(observed, self._likelihood.surface(grids), cosines[rows], starts)

    def _searched_rows(self) -> Ints:
        """Return the numbers of the coefficients in which regressors are sought, lowest frequency first.

        A third, as of the coefficients that stay single: the others are the noise that is compared with.
        """
        return self._series.order[: min(SEARCHED, self._series.y.size // 3)]

    def _oscillation(self, number: int) -> list[Regressor]:
        """Return the regressors of the oscillation about a coefficient of the last segment."""
        places = number + 1.0 + np.linspace(-1.0, 1.0, 2 * GRID + 1)
        gains = self._gains(regressors.waves(self._series, places), 2 * np.arange(places.size))
        return regressors.oscillation(self._series, float(places[gains.argmax()]))

    def _mask_oscillations(self) -> bool:
        """Leave out the coefficients of oscillations, narrow ones first; return whether there are new ones."""
        series, masked = self._series, self.terms.masked.copy()
        counted = (series.f <= self._top) & ~masked
        ratio = np.where(counted, self.terms.squares_over_noise(self.surface), 0.0)
        chance = CHANCE / (max(int(counted.sum()), 1) * len(OSCILLATION_WIDTHS))
        for begin, count in zip(series.begin - np.arange(series.begin.size), series.count - 1, strict=True):
            squares, left_out = ratio[begin : begin + count], masked[begin : begin + count]
            for width in OSCILLATION_WIDTHS:
                if width > count:
                    break
                squares = np.where(left_out, 1.0, squares)  # a wider test is of what narrower ones leave
                sums = np.convolve(squares, np.ones(width), mode="valid")
                for k in np.flatnonzero(sums > _chi_square(width, chance)).tolist():
                    # the leakage of a steady oscillation falls with the square of the distance
                    reach = int(np.sqrt(squares[k] / LEAK) / np.pi) if width == 1 else 0
                    # the lowest coefficients are never left out: what is there is a walk, or a regressor describes it
                    left_out[max(k - reach - 1, 2 * FEWEST_CYCLES) : k + width + reach + 1] = True
        free = (series.f <= self._top) & ~self.terms.left_out
        # no oscillation fills half of the spectrum: what is above the noise everywhere is noise of another kind
        if 2 * masked[free].sum() > free.sum():
            masked = self.terms.left_out.copy()
            masked[self.terms.slowest] = True
        if not (masked & ~self.terms.masked).any():
            return False
        if not self._add_timed(0.0):
            self.terms = replace(self.terms, masked=masked)
        return True

    def _mask_slowest(self) -> bool:
        """Leave out the lowest coefficients, or more of them, if a walk shows in them only; return whether it does.

        A walk has power at all frequencies below those of B. A mean that moves once, as by the temperature of a room,
        has it in the lowest coefficients, and would be stated as K, at the cost of B.
        """
        series, terms = self._series, self.terms
        count = 2 * (terms.slowest.size or FEWEST_CYCLES)
        most = min(SINGLE, series.y.size // 3) // 2
        growing = [term for term in self.surface.grids if term.grows]
        shown = any(evidence(self.surface, term) > EVIDENCE for term in growing)
        if not self._whole or count > most or not shown or self._is_described():
            return False
        slowest = series.order[:count]
        masked = terms.masked.copy()
        masked[slowest] = True
        bounds = {
            term: max(terms.bounds.get(term, 0.0), float(quantiles(self.surface, term, LIMITS)[-1]))
            for term in growing
        }
        self.terms = replace(terms, masked=masked, slowest=slowest, bounds=bounds)
        beyond = self._observed(list(terms.timed))
        if not any(_shows_beyond(beyond, self.surface, term) for term in growing):
            return True
        self.terms = terms
        return False

    def _is_described(self) -> bool:
        """Return whether a regressor beside the drifts describes what moves the mean: else its own part is left out."""
        best = self.surface.best
        squares = self.surface.beta[best] ** 2 / self.surface.beta_variances[best]
        names = [regressor.name for regressor in self.terms.regressors]
        return any(
            square > SIGNIFICANT**2 for name, square in zip(names, squares, strict=True) if name != "drift"
        )


def _shows_beyond(beyond: Likelihood, surface: Surface, term: NoiseTerm) -> bool:
    """Return whether a term shows without the lowest coefficients, and may be as large as with them.

    Parameters
    ----------
    beyond : of the observations without them.
    surface : with them.
    """
    grids = {**surface.grids, term: np.linspace(0.0, surface.grids[term][-1], GRID)}
    rest = beyond.at_values_of(surface, grids)
    if evidence(rest, term) <= BEYOND_EVIDENCE:
        return False
    value = quantiles(surface, term, LIMITS)[1]
    return bool(quantiles(rest, term, np.array([CONSISTENT]))[0] > value)


def _chi_square(dof: int, probability: float) -> float:
    """Return what a chi-square variable exceeds with a probability."""
    return 2.0 * float(gammainccinv(0.5 * dof, probability))
