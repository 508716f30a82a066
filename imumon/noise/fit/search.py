"""Search for the model of one channel: which terms and regressors explain its observations.

It goes from the low to the high end of the spectrum, because what moves the mean disturbs every later test, while the
block means, in which it is sought, lie below the reach of filters.

1. *Slow terms* (`slow_terms`), in the block means alone: what moves the mean.

2. *Upper end* (`ModelSearch`): the first description that the bands do not reject counts.

   | tried in this order | its effect on a band |
   |---|---|
   | noise up to half the sampling rate | – |
   | moving average of 2 to 16 samples | (sin(pi f w) / (w sin(pi f)))^2 |
   | quantisation; of counts that are coarser than the noise with 0, 1, 2 ... octaves left out | + c 4 sin^2(pi f) |
   | low-pass, with 0, 1, 2 ... octaves left out | / (1 + c 4 sin^2(pi f)) |

   Any filter looks like a low-pass of first order where it begins to bend the spectrum. Below half the sampling rate
   one octave more than the first that passes is left out: a bend that is too small to be rejected moves N, too. If none
   passes, the least misfit counts, with the error of the model that explains it.

3. *Regressors in doubt*: the likelihoods with and without an exponential or a step that is not certain, and whose
   odds are above `LEAST_ODDS`, are mixed in these odds.
4. *Noise with a time constant* (`timed_search`) is tried again in all observations, for the likelihood above and
   before a filter is tried for the upper end. From even odds on the likelihoods with and without it are mixed.

A choice stays until the data reject it or the record has doubled, so that no description alternates while a record
grows.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import gammaincc

from imumon.model.coefficients import LIMIT_95
from imumon.model.samples import Bools, Floats
from imumon.noise.fit import timed_search
from imumon.noise.fit.hump import KEPT, Band, Hump, at_aliases, band_left_out, line_bands
from imumon.noise.fit.likelihood import EVIDENCE, Alternatives, Grids, Likelihood, Surface, evidence
from imumon.noise.fit.model import (
    GRIDDED,
    NOISE_TERMS,
    QUANTISATION,
    TERMS,
    WHITE,
    NoiseTerm,
    UpperEnd,
    UpperShape,
    total,
)
from imumon.noise.fit.observations import (
    Bands,
    BlockSeries,
    meeting_frequency,
    observed_density,
    spectral_expectations,
    spectral_powers,
)
from imumon.noise.fit.slow_terms import SlowTerms, SlowTermSearch
from imumon.noise.fit.timed_search import Peaks, TimedSurface
from imumon.noise.noise_sums import NoiseSums
from imumon.noise.validity_groups import DITHERED, ROUNDING, ROUNDING_VARIANCE

REJECT_P = 1e-3
"""The bands reject an upper end of the spectrum, and the next one is tried. Unit: probability.

Otherwise: with 0.01 one record in a hundred loses its highest octave by chance; with less, a weak filter is fitted as
B. Origin: nine channels that are fitted a hundred times a day: one wrong rejection a day (`real_effects.py`).
"""
TOLERANCE = 0.01
"""Error of the model in every band that the tests of the upper end allow; also the share that a step may have in a
band of the spectrum that counts. Unit: relative error.

Otherwise: a record of months rejects every model: no sensor follows one to a tenth of a per cent. Chosen: 0.04 dB,
below the ripple of the filters in sensors (`real_effects.py`).
"""
MOST_ERROR = 0.3
"""Beyond it, the model does not describe the channel and no coefficient is stated; N counts as shown with a
relative error of N^2 up to it; and a density that leaves the shape of filters by more is behind none (`_levels`). Unit:
relative error.

Otherwise: coefficients with limits are stated for a vibrating platform. Origin: an error of 30 % in every band makes
limits of N of 15 %: no user calls this a measurement of noise.
"""
WINDOWS = (2, 3, 4, 5, 6, 8, 10, 12, 16)
"""Lengths of a moving average in the sensor that are tried. Unit: samples.

Otherwise: its spectrum is fitted as a low-pass, and octaves are left out that show N. Origin: lengths that sensors
have: VN-100 and ADIS16405 powers of two, others divisors of their rates (`real_effects.py`).
"""
INSTEAD_GAIN = 1.0
"""A walk that noise with a time constant in its place explains better by as much is `indistinct`. Unit: log likelihood.

Otherwise: M of a 36th of the record is measured as K in one record in five. Origin: one parameter more (Akaike 1974);
of a true walk, 3 to 10 % of the records are `indistinct` by it (`markov.py`).
"""


HUM = "a hum hides its noise"
"""Why there is no model where a hum leaves no band of the spectrum."""


@dataclass(frozen=True, slots=True, eq=False)
class ModelChoice:
    """What one fit of a growing record leaves to the next.

    Attributes
    ----------
    samples : length of the record when the upper end was chosen.
    upper_end : description of the upper end, kept until the data reject it or the record has doubled.
    grids, slow_grids : of the whole likelihood and of that of the block means, where the next fit begins to search;
        None: unknown.
    timed : power of noise with a time constant of this fit, which parts of the record have, too.
    band : cycles per sample, frequencies of a hump that is left out, kept as long as the upper end; None: none.
    """

    samples: int
    upper_end: UpperEnd
    grids: Grids | None
    slow_grids: Grids | None
    timed: Mapping[NoiseTerm, float] = field(default_factory=dict)
    band: Band | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """The model of a channel, with the likelihood of its powers.

    Attributes
    ----------
    surface : likelihood of the powers, over both models where a regressor or noise with a time constant is in doubt.
    likelihood : of the model in use.
    slow : what moves the mean.
    excess : (m,) (channel unit)^2, what the coefficients that are left out hold above the noise.
    upper_end : description of the upper end.
    misfit, dof, p_value : of the bands, with the tolerance of the model, and of the single coefficients.
    offset : channel unit, what the series is about.
    choice : for the next fit.
    timed : likelihood with noise with a time constant; None: the data do not ask for it.
    upper_error : relative standard deviation of N^2 between choices of the highest frequency, beyond their statistics.
    levels : least and greatest density at the upper end over that of the model, where no filter explains it; None: one
        does, or it is flat.
    instead : names of the terms that describe the record better in the place of a term that shows.
    may_be_counted : whether the record does not exclude that the samples are differences of an angle in counts.
    hump : what no term explains, and whose band is left out; None: there is none.
    """

    surface: Surface
    likelihood: Likelihood
    slow: SlowTerms
    excess: Floats
    upper_end: UpperEnd
    misfit: float
    dof: float
    p_value: float
    offset: float
    choice: ModelChoice
    timed: TimedSurface | None = None
    upper_error: float = 0.0
    levels: tuple[float, float] | None = None
    instead: Mapping[NoiseTerm, Sequence[str]] = field(default_factory=dict)
    may_be_counted: bool = False
    hump: Hump | None = None

    @property
    def error(self) -> float:
        """Relative error of the model in every band."""
        return self.likelihood.error


class ModelSearch:
    """Search for the model of one channel.

    Parameters
    ----------
    sums, channel : the sums, and the channel in them.
    averaged : the samples are true averages over their interval, else point samples.
    previous : choice of an earlier length of the record; None: there was none.
    whole : look for slow terms and noise with a time constant; see `SlowTermSearch`. A part of a record has that of
        `previous`.
    step : channel unit, least step between two values, 0.0 where there is none.
    counted : the values are differences of an angle in counts of this step, which is coarser than their noise.
    """

    def __init__(
        self,
        sums: NoiseSums,
        channel: int,
        series: BlockSeries,
        *,
        averaged: bool,
        previous: ModelChoice | None = None,
        whole: bool = True,
        step: float = 0.0,
        counted: bool = False,
    ) -> None:
        self._sums, self._channel, self._averaged, self._previous = sums, channel, averaged, previous
        self._step, self._count = step, step if counted else 0.0
        self._known_timed = {} if whole or previous is None else dict(previous.timed)
        self._series, self._whole = series.with_terms(list(self._known_timed)), whole
        self._tried = timed_search.tried_terms(series.samples) if whole else ()
        self._chosen_samples = self._samples = int(series.samples)
        self._meeting = meeting_frequency(series)
        self._at_lines = at_aliases(series, line_bands(sums, channel))
        self._recent = previous is not None and self._samples < 2 * previous.samples
        self._leave_out(previous.band if previous is not None and (self._recent or not whole) else None)

    def _leave_out(self, band: Band | None) -> None:
        """Search for the slow terms without a band of frequencies, and forget what was fitted with others."""
        self._spectral: dict[int, tuple[Bands, Bools]] = {}  # by window, with which of all bands they are
        self._step_power, self._band, previous = 0.0, band, self._previous
        self._is_hidden = band is not None and not self._powers(1).top.size
        if self._is_hidden:
            self._band = band = None
            self._spectral.clear()
        slow_grids = None if previous is None else previous.slow_grids
        search = SlowTermSearch(
            self._series,
            slow_grids,
            whole=self._whole,
            timed=self._known_timed,
            left_out=self._at_lines if band is None else self._at_lines | band.holds(self._series.f),
            spectral=None if band is None else self._powers(1),
        )
        # with the terms that are tried in every fit: to form observations costs more than to expect them
        self._slow = search.result().with_terms(self._tried)
        self._slow_grids = search.surface.grids
        # the block means show B and K already: their grid is a good first one of the whole likelihood
        self._grids = previous.grids if previous is not None and previous.grids else self._slow_grids
        self._step_power = self._slow.step_power(search.surface)
        if self._step_power:
            self._spectral.clear()
        # by upper end and error
        self._fits: dict[tuple[UpperEnd, float], tuple[Likelihood, Surface]] = {}
        self._peaks: dict[tuple[UpperEnd, float], Peaks] = {}

    def may_have(self, name: str) -> bool:
        """Return whether a model without a hump may have a regressor of this name, before the model is searched."""
        terms = (*self._slow.regressors, *self._slow.doubtful)
        return any(regressor.name == name for regressor in terms)

    def result(self) -> Model | str:
        """Return the model, or why there is none."""
        previous = self._previous
        if self._is_hidden:
            return HUM
        if previous is not None and self._recent and self._judged(previous.upper_end)[0] > REJECT_P:
            # of the choice, not of today: else it would never be renewed
            self._chosen_samples = previous.samples
            return self._finished(previous.upper_end)
        if self._whole:
            self._search_hump()
        model = self._described()
        if isinstance(model, str) and self._band is not None:
            # the slow terms beside the band are others than those with which it was found
            self._leave_out(None)
            model = self._described()
        return model

    def _described(self) -> Model | str:
        """Return the model with the first description of the upper end that the bands do not reject."""
        # steps leave out the bands that the hum has left
        if self._band is not None and not self._powers(1).top.size:
            return HUM
        best, least = UpperEnd(), np.inf
        for upper_end in self._candidates():
            p_value, misfit = self._judged(upper_end)
            if p_value > REJECT_P and self._errors_are_independent(upper_end):
                shorter = replace(upper_end, octaves_left_out=upper_end.octaves_left_out + 1)
                if upper_end.octaves_left_out and self._shows_white(shorter):
                    return self._finished(shorter)
                return self._finished(upper_end)
            if misfit < least:
                best, least = upper_end, misfit
        if self._count and not self._errors_are_independent(best):
            return "the record is too short to show noise below its counts"
        return self._finished(best)

    # ------------------------------------------------------------------ candidates

    def _candidates(self) -> Iterator[UpperEnd]:
        """Yield descriptions of the upper end in the order in which they are tried."""
        yield UpperEnd()
        if self._count:
            # neighbouring rounding errors are alike where the angle moves by less than a count: octaves are left out
            candidate = UpperEnd(shape=UpperShape.QUANTISED)
        else:
            window = self._best_window()
            if window > 1:
                yield UpperEnd(window=window)
            yield UpperEnd(shape=UpperShape.QUANTISED)
            candidate = UpperEnd(shape=UpperShape.LOW_PASS)
        # one band more than there are terms: what bends the upper end is a term, too
        while not candidate.octaves_left_out or self._bands(candidate) > len(NOISE_TERMS) + 1:
            yield candidate
            candidate = replace(candidate, octaves_left_out=candidate.octaves_left_out + 1)

    def _best_window(self) -> int:
        """Return the moving average whose shape the highest bands have; 1: none comes close."""
        best, least = 1, np.inf
        for window in (1, *WINDOWS):
            powers = self._powers(window)
            if powers.top.size <= len(NOISE_TERMS):
                break
            rows = np.argsort(-powers.top)[
                :8
            ]  # four octaves: an average bends the highest most, B and K the others
            # white noise behind the average has a constant ratio; its size is free
            ratio = np.log(np.maximum(powers.power[rows], 1e-300) / powers.expected[WHITE][rows])
            weight = 1.0 / (2.0 / powers.dof[rows] + TOLERANCE**2)
            misfit = float(weight @ (ratio - weight @ ratio / weight.sum()) ** 2)
            if misfit < least:
                best, least = window, misfit
        return best

    def _powers(self, window: int, more: Sequence[NoiseTerm] = ()) -> Bands:
        """Return the bands of the spectrum above the frequency at which the blocks end.

        Parameters
        ----------
        more : terms whose expectations are needed beside those of `TERMS`.
        """
        if window not in self._spectral:
            tried = self._tried if window == 1 else []
            terms = (*TERMS, *self._known_timed, *tried)
            powers = spectral_powers(
                self._sums, self._channel, averaged=self._averaged, window=window, terms=terms
            )
            counts = powers.top > self._meeting * (1.0 + 1e-6)
            # steps are regressors of the block means only: a band that they reach is left out
            counts &= self._step_power <= TOLERANCE * powers.power * powers.bend
            if self._band is not None:
                counts &= ~self._band.holds(powers.top)
            self._spectral[window] = powers.take(counts), counts
        powers, counts = self._spectral[window]
        missing = [term for term in more if term not in powers.expected]
        if not missing:
            return powers
        units = spectral_expectations(
            self._sums, self._channel, averaged=self._averaged, window=window, terms=missing
        )
        added = {term: unit[counts] for term, unit in units.items()}
        return replace(powers, expected={**powers.expected, **added})

    def _search_hump(self) -> None:
        """Leave out the band of a hump, and search for the slow terms again without it; see `hump`."""
        if self._band is not None:
            self._leave_out(None)
        if self._powers(1).top.size < KEPT:
            return  # too short: no frequency above the blocks shows N
        bands = self._powers(1).joined(self._slow.bands(self._meeting))
        bands = bands.take(np.argsort(bands.top, kind="stable"))
        band = band_left_out(bands, self._tried, error=TOLERANCE, least=REJECT_P)
        if band is not None:
            self._leave_out(band)

    def _bands(self, upper_end: UpperEnd) -> int:
        """Return the number of bands, of both parts, with some octaves left out."""
        flat = self._fit(UpperEnd())[0].bands
        return int(flat.up_to(upper_end.highest).top.size)

    def _judged(self, upper_end: UpperEnd) -> tuple[float, float]:
        """Return the probability of the misfit of a description, and the misfit over its degrees of freedom.

        The upper end is judged by the spectrum: what moves slowly does not change it. A description whose white noise
        does not show is none: N would be a guess from B.
        """
        if upper_end.octaves_left_out and self._bands(upper_end) <= len(NOISE_TERMS):
            return 0.0, np.inf
        likelihood, surface = self._fit(upper_end)
        if upper_end.octaves_left_out and not _shows(surface):
            return 0.0, np.inf
        spectral = int(self._powers(upper_end.window).up_to(upper_end.highest).top.size)
        rows = spectral if spectral > len(NOISE_TERMS) else None
        tested = replace(likelihood, error=TOLERANCE)
        p_value = tested.p_value(surface, rows)
        if p_value <= REJECT_P and upper_end == UpperEnd():
            # short correlations bend the spectrum, too: a filter is no explanation where another noise is one
            peaks = self._timed_peaks(upper_end)
            if peaks is not None:
                likelihood, surface = self._with_timed_peak(upper_end, peaks)
                tested = replace(likelihood, error=TOLERANCE)
                p_value = tested.p_value(surface, rows)
        misfit, dof = tested.misfit(surface, rows)
        return p_value, misfit / dof

    def _errors_are_independent(self, upper_end: UpperEnd) -> bool:
        """Return whether rounding to counts is quantisation noise up to the highest frequency in use.

        Errors s counts of noise apart have the correlation exp(-2 pi^2 s^2), up to a sign (Widrow and Kollar 2008):
        0.7 % at `DITHERED`. With 0.4 counts, upper limits of N miss in 8 % of records.
        """
        if not self._count or upper_end.shape is not UpperShape.QUANTISED:
            return True
        power, error = self._fit(upper_end)[1].estimate(WHITE)
        # as much as it may be: with few octaves left, N that is low by chance is no reason to state nothing
        most = (power + LIMIT_95 * error) * 2.0**upper_end.octaves_left_out
        return most >= (DITHERED * self._count) ** 2

    def _shows_white(self, upper_end: UpperEnd) -> bool:
        """Return whether the white noise still shows with some octaves left out."""
        return self._bands(upper_end) > len(NOISE_TERMS) and _shows(self._fit(upper_end)[1])

    # ------------------------------------------------------------------ likelihoods

    def _likelihood(
        self,
        upper_end: UpperEnd,
        error: float,
        *,
        with_doubtful: bool = False,
        more: Sequence[NoiseTerm] = (),
    ) -> Likelihood:
        slow = self._slow.with_terms(more) if more else self._slow
        pooled, coefficients = slow.observations(
            upper_end.highest, self._meeting, with_doubtful=with_doubtful
        )
        spectral = self._powers(upper_end.window, more).up_to(upper_end.highest)
        return Likelihood(
            spectral.joined(pooled),
            coefficients,
            upper_end.scored,
            upper_end.low_pass,
            error=error,
            beside=self._known_timed,
        )

    def _observed(self, upper_end: UpperEnd, error: float, more: Sequence[NoiseTerm]) -> Likelihood:
        """Return the likelihood of a description, with expectations of at least some more terms."""
        likelihood = self._fit(upper_end, error)[0]
        present = likelihood.bands.expected
        if all(term in present for term in more):
            return likelihood
        return self._likelihood(upper_end, error, more=more)

    def _fit(self, upper_end: UpperEnd, error: float = 0.0) -> tuple[Likelihood, Surface]:
        """Return likelihood and surface of a description; each is computed once."""
        key = upper_end, error
        if key not in self._fits:
            likelihood = self._likelihood(upper_end, error)
            surface = likelihood.search(self._samples, self._grids)
            self._grids = surface.grids
            self._fits[key] = likelihood, surface
        return self._fits[key]

    def _finished(self, upper_end: UpperEnd) -> Model | str:
        """Return the model with the error that explains its misfit, and with what is in doubt."""
        peaks = self._timed_peaks(upper_end)
        judged = self._fit(upper_end) if peaks is None else self._with_timed_peak(upper_end, peaks)
        error = _error(*judged)
        if error > MOST_ERROR:
            return "no description fits the data"
        if error and peaks is not None:
            # with wider errors, the term may no longer be needed
            peaks = self._timed_peaks(upper_end, error)
        without = self._without_timed(upper_end, error)
        likelihood, surface, slow, timed = without.likelihood, without.mixed, self._slow, None
        grids = surface.grids
        if peaks is not None:
            timed, surface = self._with_timed(upper_end, error, without, peaks)
            slow = slow.with_terms([timed.term])
            likelihood = self._likelihood(upper_end, error, more=[timed.term])
            likelihood = replace(likelihood, beside=surface.beside)
        tested = replace(likelihood, error=TOLERANCE)
        misfit, dof = np.add(tested.misfit(surface), likelihood.slow_misfit(surface)).tolist()
        choice = ModelChoice(
            self._chosen_samples,
            upper_end,
            grids,
            self._slow_grids,
            surface.beside,
            self._band,
        )
        return Model(
            surface,
            likelihood,
            slow,
            slow.excess(surface),
            upper_end,
            misfit,
            dof,
            float(gammaincc(0.5 * dof, 0.5 * misfit)),
            float(self._sums.blocks.offset[self._channel]),
            choice,
            timed,
            self._upper_error(upper_end),
            self._levels(upper_end, surface),
            {} if timed is not None and timed.is_certain else self._instead(upper_end, error, surface),
            self._may_be_counted(upper_end, surface),
            None if self._band is None else self._hump(surface, slow, self._band),
        )

    def _hump(self, surface: Surface, slow: SlowTerms, band: Band) -> Hump:
        """Return what a band that is left out holds above the noise."""
        f, size, density, _ = observed_density(self._sums, self._channel)
        above = band.holds(f) & (f > self._meeting)
        f, size, density = f[above], size[above], density[above]
        noise = total(surface.powers, lambda term: term.density(f, averaged=self._averaged))
        series = slow.series
        left_out = band.holds(series.f) & (series.f <= self._meeting)
        # a coefficient of n blocks of L samples is 1 / (2 n L) wide; its square is 1 / L of a density, as block means
        # see it
        seen = np.sinc(series.f * series.length) ** 2 / series.length
        squares = (slow.squares_over_noise(surface) - 1.0) * slow.noise_variances(surface) / seen
        return Hump(
            band,
            np.concatenate((series.f[left_out], f)),
            np.concatenate((np.full(int(left_out.sum()), 0.5 / series.samples), size)),
            np.concatenate((squares[left_out], density - noise)),
        )

    def _may_be_counted(self, upper_end: UpperEnd, surface: Surface) -> bool:
        """Return whether the record does not exclude that its steps are counts of an angle.

        The rounding of an angle adds twice as much to white noise as that of a rate, and bends its density. A short
        record does not show the bend. Where N^2 is less certain than what the rounding adds, it makes no difference.
        """
        rounding = ROUNDING_VARIANCE * self._step**2
        # a fifth of the standard error is a tenth of the distance from N to its limit
        if upper_end != UpperEnd() or 5.0 * rounding <= surface.estimate(WHITE)[1]:
            return False
        power, error = self._fit(UpperEnd(shape=UpperShape.QUANTISED))[1].estimate(QUANTISATION)
        return power + LIMIT_95 * error >= rounding

    def _without_timed(self, upper_end: UpperEnd, error: float) -> Alternatives:
        """Return the models without noise with a time constant: with and without a regressor in doubt."""
        likelihood, surface = self._fit(upper_end, error)
        if not self._slow.doubtful:
            return Alternatives(likelihood, surface)
        other = self._likelihood(upper_end, error, with_doubtful=True)
        if other.bands.top.size <= len(NOISE_TERMS):
            # the single coefficients of a regressor with a wide spectrum leave too few bands of a short record
            return Alternatives(likelihood, surface)
        return Alternatives(
            likelihood, surface, other, other.search(self._samples, self._grids), self._slow.odds
        )

    def _with_timed(
        self, upper_end: UpperEnd, error: float, without: Alternatives, peaks: Peaks
    ) -> tuple[TimedSurface, Surface]:
        """Return the likelihood with noise with a time constant, and that of both, with and without it."""

        surface = without.mixed
        timed = timed_search.timed_surface(
            lambda more: self._observed(upper_end, error, more), surface, self._samples, peaks
        )
        # the models without the term on a grid that holds those with it, too
        grids = {
            term: np.linspace(0.0, max(grid[-1], timed.surface.grids[term][-1]), grid.size)
            for term, grid in surface.grids.items()
        }
        both = timed_search.mixed_with(without.on(grids), timed)
        return timed, both

    def _upper_error(self, upper_end: UpperEnd) -> float:
        """Return the relative scatter of N^2 between neighbouring choices of the highest frequency.

        Behind a filter of unknown shape N is what the frequencies below it show, and another choice of them shows
        another N. The choices share their data: what the octave between two of them adds explains a scatter of the
        difference of their variances, which is taken off. The choice with an octave more in it is compared although
        it may have been rejected: how far it is off is what the choice beside it may still be off.
        """
        if not (upper_end.low_pass or upper_end.octaves_left_out):
            return 0.0
        powers, errors = [], []
        for octaves in range(max(upper_end.octaves_left_out - 1, 0), upper_end.octaves_left_out + 2):
            other = replace(upper_end, octaves_left_out=octaves)
            if octaves == upper_end.octaves_left_out or self._shows_white(other):
                power, error = self._fit(other)[1].estimate(WHITE)
                powers.append(math.log(power))
                errors.append(error / power)
        apart, by_chance = np.diff(powers) ** 2, np.abs(np.diff(np.square(errors)))
        if not apart.size:
            return errors[0]  # nothing to compare with: as uncertain as by the statistics, once more
        return float(np.sqrt(np.maximum(apart - by_chance, 0.0).mean()))

    def _levels(self, upper_end: UpperEnd, surface: Surface) -> tuple[float, float] | None:
        """Return the least and the greatest density of the upper end over the model, where no filter explains it.

        Behind a filter the density falls ever more steeply towards the highest frequency: it lies above that of a
        low-pass of first order which takes as much there. Noise between white and flicker falls evenly, and lies below.
        """
        if not upper_end.low_pass:
            return None
        bands = self._powers(1, list(surface.powers))
        if bands.top.size < 2:
            return None  # the record is so short that its spectrum has no end
        bands = bands.take(np.argsort(bands.top))
        model = total(surface.powers, lambda term: bands.expected[term])
        passed = np.maximum(bands.power - ROUNDING_VARIANCE * self._step**2, ROUNDING * bands.power) / model
        first_order = 1.0 / (1.0 + (1.0 / passed[-1] - 1.0) * bands.bend / bands.bend[-1])
        # from an octave in use on; where a filter has taken half, its lobes and what is added behind it follow
        upper = bands.top > 0.5 * upper_end.highest
        # filters of simulated and real sensors reach 0.95 of it, noise of this kind 0.65 (`markov.py`)
        slower = upper & (passed > 0.5) & ((1.0 + MOST_ERROR) * passed < first_order)
        if not slower.any() and passed[-1] < 1.0 + MOST_ERROR:
            return None
        # half the sampling rate, which no band shows, is at most as far from the last one as this from the one before
        levels = np.append(passed[upper], passed[-1] ** 2 / passed[-2])
        return float(levels.min()), float(levels.max())

    def _timed_peaks(self, upper_end: UpperEnd, error: float = 0.0) -> Peaks | None:
        """Return the likeliest models with noise with a time constant; None where its odds are below even."""
        if not self._tried:
            return None
        key = upper_end, error
        if key not in self._peaks:
            likelihood = self._observed(upper_end, error, self._tried)
            surface = self._fit(upper_end, error)[1]
            self._peaks[key] = timed_search.peaks(likelihood, surface, self._tried)
        peaks = self._peaks[key]
        return peaks if timed_search.odds_of(peaks.gains) >= 1.0 else None

    def _instead(self, upper_end: UpperEnd, error: float, surface: Surface) -> dict[NoiseTerm, list[str]]:
        """Return the names of the terms that describe the record better in the place of one that shows and grows."""
        shown = [term for term in surface.grids if term.grows and evidence(surface, term) > EVIDENCE]
        if not self._tried or not shown:
            return {}
        likelihood = self._observed(upper_end, error, self._tried)
        surface = self._fit(upper_end, error)[1]
        names = list(dict.fromkeys(tried.name for tried in self._tried))
        gains = {term: timed_search.peaks(likelihood, surface, self._tried, term).gains for term in shown}
        return {term: names for term, gain in gains.items() if gain.max() > INSTEAD_GAIN}

    def _with_timed_peak(self, upper_end: UpperEnd, peaks: Peaks) -> tuple[Likelihood, Surface]:
        """Return likelihood and surface with the likeliest noise with a time constant, whose power is fixed."""
        term, power = peaks.terms[peaks.best], float(peaks.power[peaks.best])
        likelihood = replace(self._observed(upper_end, 0.0, [term]), beside={term: power})
        # one point, the maximum: a misfit asks for no limits
        peak: dict[NoiseTerm, Floats] = {
            gridded: np.sqrt(peaks.powers[gridded][[peaks.best]]) for gridded in GRIDDED
        }
        return likelihood, likelihood.at_values_of(self._fit(upper_end)[1], peak)


def _error(likelihood: Likelihood, surface: Surface) -> float:
    """Return the error of the model that brings the misfit to its expectation; 0.0 where chance explains it."""
    if likelihood.p_value(surface) > REJECT_P:
        return 0.0
    # bisection: the misfit falls as the error grows; twice the most says "more than the most"
    low, high = 0.0, 2.0 * MOST_ERROR
    for _ in range(20):
        middle = 0.5 * (low + high)
        misfit, dof = replace(likelihood, error=middle).misfit(surface)
        low, high = (middle, high) if misfit > dof else (low, middle)
    return high


def _shows(surface: Surface) -> bool:
    """Return whether N^2 is known well at the greatest likelihood."""
    power, error = surface.estimate(WHITE)
    return error < MOST_ERROR * power
