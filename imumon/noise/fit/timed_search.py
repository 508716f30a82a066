"""Search for noise with a time constant beside N, B and K: Gauss–Markov noise (M), and a line that wanders.

Correlated noise with a time constant looks like B over an octave, like K below it and like N above it. Without a term
for it, the likelihood puts its power into B and K and states both with narrow limits. With the term always in the
model, B would be too small where the noise is flicker: its size and its time constant have more room than B. So the
data decide, by odds:

1. *Peaks*. For nine time constants of each kind, from `SHORTEST` samples to a share `LONGEST` of the record, the
   likeliest powers of all terms follow from Fisher's scoring. The gain in log likelihood over the model without the
   term, averaged as a likelihood over all of them and divided by `PENALTY`, are the odds of the term.
2. *Surface*. From even odds on, the likelihood on a grid of B, K and the size of the term is summed over both kinds and
   over time constants about the likeliest one of each (flat prior in log T), so that it holds what the record does not
   show of kind and time constant.
3. *Mixture*. The likelihoods with and without the term count in these odds.

A weak hum that wanders nearly to frequency zero differs from Gauss–Markov noise by its skirts alone. Neither is named
where the record does not show which of them it has, but both count for the limits of B.

K is measured only where it describes the record as well as such a term in its place, which has one parameter more, so
that its likelihood must be e times as great (Akaike 1974). In a record of few time constants M and a walk look alike.

Time constants are on a lattice (`LATTICE`), so that expectations are computed once for all channels and fits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imumon.model.samples import Floats
from imumon.noise.fit.likelihood import (
    DROP,
    GRID,
    GRID_FALL,
    MOST_MOVES,
    Grids,
    Likelihood,
    Squares,
    Surface,
    density_quantiles,
    grid_mean,
    holds,
    mixed,
    near,
)
from imumon.noise.fit.model import TRIED, NoiseTerm, TimedTerm, total

SHORTEST = 10.0
"""Least time constant that is tried. Unit: samples.

Otherwise: with less, the term competes with a filter in the sensor, and N is what neither explains. Origin: below ten
samples, the density is flat down to a tenth of the sampling rate: a low-pass has the same shape (`markov.py`).
"""
LONGEST = 0.1
"""Greatest time constant that is tried. Unit: of the record.

Otherwise: with more, it looks like a random walk, and no record distinguishes the two. Origin: a record of ten time
constants has five independent values (`markov.py`).
"""
TRIED_TIMES = 9
"""Number of time constants whose gains are averaged to the odds of the term. Unit: time constants.

Otherwise: with fewer, a term between two of them loses gain; with more, fits are slow. Chosen: two of them are a
factor of 2.7 apart in 2 h at 40 Hz, and the density of the term is wider (`markov.py`).
"""
PENALTY = 3.0
"""Odds against noise with a time constant before the data. Unit: odds.

Otherwise: at 1, every record of flicker noise has odds above even, and limits of B reach to zero; at 8, half of the
records of 36 time constants count as flicker and walk. Origin: noise without the term has even odds in 1 to 7 % of
records, and odds of 19 in none of 400 (`markov.py`).
"""
CERTAIN_ODDS = 19.0
"""Noise with a time constant shows; below, it is one of several noises that the record does not distinguish. Unit:
odds.

Otherwise: a standard deviation with a lower limit is stated of noise that may be flicker. Origin: 19 to 1 is 95 %, as
of all limits (`markov.py`).
"""
KIND_SHARE = 0.9
"""A kind has a name from this share of the likelihood of both kinds on. Unit: 1.

Otherwise: at 0.88, a hum of a tenth of the noise is measured as M in 5 of 100 records; at 0.95, M of two floors is lost
in 20 of 100 more. Chosen: between them (`markov.py`).
"""
END_SHARE = 0.2
"""A time constant is bounded where its density has fallen to this share at both ends of what was tried. Unit: of
the greatest density.

Otherwise: limits of a time constant are those of the tried ones and not of the data. Chosen: 1.8 standard errors
(`markov.py`).
"""
LATTICE = 16
"""Time constants are rounded to a lattice. Unit: time constants per octave.

Otherwise: expectations are computed again for each channel and fit. Origin: steps of 4 %: below the error of any time
constant.
"""
TIMED_NODES = 7
"""Number of time constants over which the likelihood is summed. Unit: time constants.

Otherwise: with 5, limits of the time constant move by up to a quarter of their distance. Origin: chosen for the time;
they span what has more than 0.2 % of the greatest likelihood.
"""
PEAK_STEPS = 40
"""Most steps of Fisher's scoring in the logarithms of the powers. Unit: steps.

Otherwise: with 25, one gain in twenty is too small by 1.5. Origin: 95 % of gains are within 0.02 of those with 400
steps; the others differ by up to 0.8 from them.
"""
LONGEST_STEP = 1.5
"""Longest step of scoring, a factor of 4.5. Unit: in the logarithm of a power.

Otherwise: a power far from its maximum overshoots, and scoring does not end.
"""
LEAST_TIMED_SHARE = 1e-4
"""Least power that a term has in scoring, where it shows most. Unit: of the noise.

Otherwise: a power that vanishes has no logarithm. Chosen: far below what any record shows.
"""

Observed = Callable[[Sequence[NoiseTerm]], Likelihood]
"""Returns the likelihood whose observations have an expectation of some more terms."""


@dataclass(frozen=True, slots=True, eq=False)
class Peaks:
    """The likeliest model with each of some terms that have a time constant.

    Attributes
    ----------
    terms : the last term of each of t models.
    gains : (t,) gain in log likelihood over the likeliest model without the term.
    powers : (t,) likeliest power of each other term.
    power : (t,) its likeliest power.
    """

    terms: tuple[TimedTerm, ...]
    gains: Floats
    powers: dict[NoiseTerm, Floats]
    power: Floats

    @property
    def best(self) -> int:
        """Number of the likeliest model."""
        return int(self.gains.argmax())

    def likeliest(self, number: int) -> tuple[dict[NoiseTerm, float], float]:
        """Return the likeliest powers of the other terms beside a term, and the root of its own."""
        powers = {term: float(power[number]) for term, power in self.powers.items()}
        return powers, float(np.sqrt(self.power[number]))


def peaks(
    likelihood: Likelihood,
    surface: Surface,
    terms: Sequence[TimedTerm],
    absent: NoiseTerm | None = None,
) -> Peaks:
    """Return the likeliest models with each of some terms that have a time constant.

    Parameters
    ----------
    likelihood : with expectations of the terms.
    surface : without the terms.
    absent : a term of the surface in whose place they are: it is zero.
    """
    terms = tuple(terms)
    others = [term for term in (*likelihood.scored, *surface.grids) if term != absent]
    squares = likelihood.as_squares(surface)
    model = total(surface.powers, lambda term: squares.expected[term])
    # it begins with a tenth of the noise, where it shows most
    begins = 0.1 * min(float((model / squares.expected[term]).min()) for term in terms)
    # the first model has no such term: all gains are against it, in the same way
    start = np.tile([*(surface.powers[term] for term in others), begins], (len(terms) + 1, 1))
    logs, powers = _likeliest(likelihood, surface, squares, others, (None, *terms), model, start, absent)
    # scoring may have ended at another maximum than the grid without the term
    without = max(float(logs[0]), float(surface.log.max()))
    by_term = {term: powers[1:, i] for i, term in enumerate(others)}
    return Peaks(terms, logs[1:] - without, by_term, powers[1:, -1])


def _likeliest(
    likelihood: Likelihood,
    surface: Surface,
    squares: Squares,
    others: Sequence[NoiseTerm],
    terms: Sequence[NoiseTerm | None],
    model: Floats,
    start: Floats,
    absent: NoiseTerm | None,
) -> tuple[Floats, Floats]:
    """Return (m,) the log likelihoods of m models, and (m, p) their likeliest powers, by Fisher's scoring.

    Parameters
    ----------
    others : the p - 1 terms that all models have.
    terms : the last term of each; None: it has none.
    model : (r,) expectation of each square, by which the least power of a term is known.
    start : (m, p) first values.
    absent : a term of the likelihood that is zero; None: there is none.
    """
    units = np.zeros((len(terms), len(others) + 1, model.size))
    units[:, :-1] = [squares.expected[term] for term in others]
    for unit, term in zip(units, terms, strict=True):
        unit[-1] = 0.0 if term is None else squares.expected[term]
    # a power of zero has no logarithm: a ten thousandth of the noise, where it shows most, is zero here
    least = LEAST_TIMED_SHARE * (model / np.maximum(units.max(axis=0), 1e-300)).min(axis=1)
    powers = np.exp(scored_powers(squares, units, np.log(np.maximum(start, 10.0 * least)), np.log(least)))
    number = np.arange(len(terms))
    each: dict[NoiseTerm, Floats] = {
        term: np.where(number == i, powers[:, -1], 0.0) for i, term in enumerate(terms) if term is not None
    }
    by_term = {term: powers[:, i] for i, term in enumerate(others)}
    if absent is not None:
        by_term[absent] = np.zeros(len(terms))
    return likelihood.at_powers(by_term, surface, each), powers


def scored_powers(squares: Squares, units: Floats, log: Floats, least: Floats) -> Floats:
    """Return (m, p) logarithms of the likeliest powers of m models, by Fisher's scoring.

    In logarithms a power stays positive and may vanish. Steps are bounded, and a share of the diagonal of the
    information is added to it (Levenberg), because the information about a power that vanishes does, too.

    Parameters
    ----------
    squares : whose half degrees of freedom may be (m, 1, r), others for each model.
    units : (m, p, r) what each square expects of each term.
    log : (m, p) first values.
    least : (p,) least values.
    """
    for _ in range(PEAK_STEPS):
        parts = np.exp(log)[:, :, None] * units
        model = parts.sum(axis=1)
        share = parts / model[:, None]
        weighted = share * squares.half
        gradient = weighted @ (squares.power / model - 1.0)[:, :, None]
        information = weighted @ share.transpose(0, 2, 1)
        diagonal = np.einsum("mii->mi", information)
        diagonal += 0.05 * diagonal + 1e-6
        steps = np.linalg.solve(information, gradient)[:, :, 0]
        steps = np.minimum(np.maximum(steps, -LONGEST_STEP), LONGEST_STEP)
        before, log = log, np.maximum(log + steps, least)
        if np.abs(log - before).max() < 1e-3:  # a gain is flat at its maximum: it moves by the square
            break
    return log


def lattice(times: Floats) -> list[float]:
    """Return the time constants of the lattice that are nearest to some, each once."""
    steps = np.unique(np.round(np.log2(times) * LATTICE))
    return [float(2.0 ** (step / LATTICE)) for step in steps]


def tried_terms(samples: float) -> tuple[TimedTerm, ...]:
    """Return the terms whose gains make the odds; none in records that are too short."""
    if LONGEST * samples <= SHORTEST:
        return ()
    times = lattice(np.geomspace(SHORTEST, LONGEST * samples, TRIED_TIMES))
    return tuple(kind.with_time(time) for kind in TRIED for time in times)


def odds_of(gains: Floats) -> float:
    """Return the odds of the term: the likelihoods of all time constants, averaged."""
    return float(np.exp(np.minimum(gains, 300.0)).mean()) / PENALTY


@dataclass(frozen=True, slots=True, eq=False)
class TimedSurface:
    """Likelihood with a term that has a time constant.

    Attributes
    ----------
    surface : on a grid of B, K and the size of the term, summed over kinds and time constants.
    term : the likeliest; M where the record does not show that it is another kind. On the grid it is the axis of all.
    terms, weights : (t,) terms that are summed; probability density of each over the logarithm of the time constant.
    odds : of a term of any kind.
    peak : likeliest powers.
    """

    surface: Surface
    term: TimedTerm
    terms: tuple[TimedTerm, ...]
    weights: Floats
    odds: float
    peak: dict[NoiseTerm, float]

    @property
    def is_shown(self) -> bool:
        """Whether there is such noise: its odds exceed `CERTAIN_ODDS`, and the record bounds its time constant."""
        return self.odds > CERTAIN_ODDS and self.is_bounded

    @property
    def is_certain(self) -> bool:
        """Whether it is measured: the record also shows its kind."""
        weights = self.weights * _cells(self.terms)
        return self.is_shown and bool(weights[self._alike].sum() > KIND_SHARE * weights.sum())

    @property
    def is_bounded(self) -> bool:
        """Whether the record bounds the time constant at both ends."""
        weights = self.weights[self._alike]
        return bool(weights[[0, -1]].max() < END_SHARE * weights.max())

    def time_quantiles(self, probabilities: Floats) -> Floats:
        """Return quantiles of the time constant, samples."""
        times, weights = np.array([self.terms[i].time for i in self._alike]), self.weights[self._alike]
        if times.size < 4:
            return np.full(probabilities.size, self.term.time)
        nodes = np.log(times)
        even = np.linspace(nodes[0], nodes[-1], 60)
        # between the nodes, the logarithm of the density is smooth
        log = np.interp(even, nodes, np.log(np.maximum(weights, 1e-12 * weights.max())))
        return np.asarray(np.exp(density_quantiles(even, np.exp(log - log.max()), probabilities)))

    @property
    def _alike(self) -> list[int]:
        """Numbers of the terms of its kind."""
        return next(alike for alike in _kinds(self.terms) if self.term.letter == self.terms[alike[0]].letter)


def timed_surface(observed: Observed, surface: Surface, samples: float, coarse: Peaks) -> TimedSurface:
    """Return the likelihood with a term whose kind and whose time constant are not known."""
    finer_terms = _between(coarse, samples)
    finer_likelihood = observed(finer_terms)
    finer = peaks(finer_likelihood, surface, finer_terms)
    terms = _nodes([*coarse.terms, *finer.terms], np.append(coarse.gains, finer.gains), samples)
    likelihood = observed(terms)
    center = finer.terms[finer.best]
    peak, sigma = finer.likeliest(finer.best)
    grids: Grids = {
        term: np.linspace(0.0, max(2.0 * np.sqrt(peak[term]), 0.6 * grid[-1]), GRID // 2)
        for term, grid in surface.grids.items()
    } | {
        center: np.linspace(0.0, 2.0 * sigma, GRID // 2),
    }
    # first the grid of the likeliest term alone, which is nearly that of all, then of the ends of each kind
    first = finer_likelihood.at_values_of(surface, grids)
    grids = {term: near(first, term, GRID // 2) for term in grids}
    ends = [terms[alike[i]] for alike in _kinds(terms) for i in sorted({0, len(alike) // 2, len(alike) - 1})]
    wider = _summed(_of_each(likelihood, surface, ends, center, grids), ends, grids)
    grids = {term: near(wider, term, GRID // 2) for term in grids}
    for _ in range(MOST_MOVES):
        parts = _of_each(likelihood, surface, terms, center, grids)
        total = _summed(parts, terms, grids)
        if holds(total):
            break
        grids = {term: near(total, term, GRID // 2) for term in total.grids}
    logs = np.stack([part.log for part in parts])
    weights = np.exp(logs - logs.max()) @ total.cells.ravel()
    number = _to_state(finer, terms, weights)
    peak, sigma = finer.likeliest(number)
    term = finer.terms[number]
    averaged = _averaged(total, parts, terms)
    averaged = replace(
        averaged, grids={term if key == center else key: grid for key, grid in total.grids.items()}
    )
    peak[term] = sigma**2
    return TimedSurface(averaged, term, tuple(terms), weights, odds_of(coarse.gains), peak)


def _to_state(finer: Peaks, terms: Sequence[TimedTerm], weights: Floats) -> int:
    """Return the number of the term to state: of a kind that the report states, unless the record shows another."""
    shares = weights * _cells(terms)
    is_other = float(shares @ [not term.is_stated for term in terms]) > KIND_SHARE * shares.sum()
    return max(
        (number for number, term in enumerate(finer.terms) if term.is_stated != is_other),
        key=lambda number: float(finer.gains[number]),
    )


def _kinds(terms: Sequence[TimedTerm]) -> list[list[int]]:
    """Return the numbers of the terms of each kind."""
    numbers: dict[str, list[int]] = {}
    for number, term in enumerate(terms):
        numbers.setdefault(term.letter, []).append(number)
    return list(numbers.values())


def _between(coarse: Peaks, samples: float) -> list[TimedTerm]:
    """Return terms between those that were tried, a factor of up to eight apart, about the likeliest of each kind."""
    terms: list[TimedTerm] = []
    for alike in _kinds(coarse.terms):
        best = coarse.terms[max(alike, key=lambda number: float(coarse.gains[number]))]
        around = best.time * 2.0 ** np.linspace(-1.5, 1.5, 13)
        # somewhat beyond what is tried, so that a time constant at an end is no end of its own likelihood
        around = around[(around >= 0.5 * SHORTEST) & (around <= 2.0 * LONGEST * samples)]
        terms += [best.with_time(time) for time in lattice(around)]
    return terms


def _nodes(terms: Sequence[TimedTerm], gains: Floats, samples: float) -> list[TimedTerm]:
    """Return the terms of each kind over which the likelihood is summed: those that are not negligible, and a step
    beyond.
    """
    nodes: list[TimedTerm] = []
    step = 2.0**0.25  # of the finer ones
    for alike in _kinds(terms):
        within = [terms[i].time for i in alike if gains[i] > gains.max() - GRID_FALL * DROP]
        if within:
            low, high = min(within) / step, min(max(within) * step, LONGEST * samples)
            nodes += [
                terms[alike[0]].with_time(time) for time in lattice(np.geomspace(low, high, TIMED_NODES))
            ]
    return nodes


def _of_each(
    likelihood: Likelihood, surface: Surface, terms: Sequence[TimedTerm], center: TimedTerm, grids: Grids
) -> list[Surface]:
    """Return the likelihoods of t time constants on a grid."""
    return [
        likelihood.at_values_of(
            surface, {(term if key == center else key): grid for key, grid in grids.items()}
        )
        for term in terms
    ]


def _summed(parts: Sequence[Surface], terms: Sequence[TimedTerm], grids: Grids) -> Surface:
    """Return the likelihood summed over time constants; all else is that of the first one."""
    logs = np.stack([part.log for part in parts])
    top = logs.max()
    summed = _cells(terms) @ np.exp(logs - top)
    return replace(parts[0], grids=grids, log=np.log(np.maximum(summed, 1e-300)) + top)


def _averaged(total: Surface, parts: Sequence[Surface], terms: Sequence[TimedTerm]) -> Surface:
    """Return a sum over time constants with the means of what each of them has at a point."""
    share = np.exp(np.stack([part.log for part in parts]) - total.log) * _cells(terms)[:, None]

    def mean(values: Iterable[Floats]) -> Floats:
        """Return (m, ...) the mean of (t, m, ...) values over the time constants."""
        return np.asarray(np.einsum("tm,tm...->m...", share, np.stack(list(values))))

    return replace(
        total,
        scored={term: mean(part.scored[term] for part in parts) for term in total.scored},
        scored_variances={term: mean(part.scored_variances[term] for part in parts) for term in total.scored},
        corner=mean(part.corner for part in parts),
        beta=mean(part.beta for part in parts),
        beta_variances=mean(part.beta_variances for part in parts),
    )


def _cells(terms: Sequence[TimedTerm]) -> Floats:
    """Return (t,) the part of the line of log T that each of t terms has, half of it at both ends of a kind."""
    cells = np.ones(len(terms))
    for alike in _kinds(terms):
        if len(alike) > 1:
            cells[alike] = np.gradient(np.log([terms[number].time for number in alike]))
            cells[[alike[0], alike[-1]]] *= 0.5
    return cells


def mixed_with(without: Surface, timed: TimedSurface) -> Surface:
    """Return the likelihood of B and K with and without the term, mixed in its odds.

    Parameters
    ----------
    without : without the term, on a grid that holds both.
    """
    second = _marginal(timed.surface, without.grids)
    # Both get the same maximum, so that the ratio of their integrals is that of their weights: the odds are those of
    # the models, whatever the width of their likelihoods.
    second = replace(second, log=second.log - second.log.max() + without.log.max())
    both = mixed(without, second, timed.odds * float(without.weights().sum() / second.weights().sum()))
    # what is drawn and tested is the model with the term: it is more likely than the one without
    beside: dict[NoiseTerm, float] = {timed.term: timed.peak[timed.term]}
    return replace(both, likeliest=timed.peak, beside=beside)


def _marginal(inner: Surface, grids: Grids) -> Surface:
    """Return a surface of B, K and another term summed over it, on another grid of B and K."""
    # a density, not a share of a cell
    p = inner.weights().sum(axis=2) / inner.cells[:, :, -1]
    smooth = np.log(np.maximum(p, 1e-300 * p.max()))
    steps = [_cubic(inner.grids[term], grid) for term, grid in grids.items()]
    log = steps[0] @ smooth @ steps[1].T
    outside = [(grid < inner.grids[term][0]) | (grid > inner.grids[term][-1]) for term, grid in grids.items()]
    # not the maximum of `log`: beyond its points, a cubic may have any value
    log[outside[0][:, None] | outside[1][None]] = smooth.max() - 2.0 * DROP

    def everywhere(value: Floats, variance: Floats) -> tuple[Floats, Floats]:
        """Return mean and variance over the whole grid, the same at each point: they hardly depend on B and K."""
        mean, deviation = grid_mean(inner, value, variance)
        shape = (log.size, *np.shape(mean))
        return np.broadcast_to(mean, shape), np.broadcast_to(deviation**2, shape)

    scored = {term: everywhere(inner.scored[term], inner.scored_variances[term]) for term in inner.scored}
    return Surface(
        grids,
        log.ravel(),
        {term: value for term, (value, _) in scored.items()},
        {term: variance for term, (_, variance) in scored.items()},
        np.full(log.size, float(inner.corner[inner.best])),
        *everywhere(inner.beta, inner.beta_variances),
    )


def _cubic(points: Floats, wanted: Floats) -> Floats:
    """Return (w, p) weights that interpolate values at p even points at w others, by cubics through four of them.

    Lagrange's form. The module of scipy for it takes 0.4 s to import, more than all fits of a short record.
    """
    step = points[1] - points[0]
    first = np.clip(np.floor((wanted - points[0]) / step).astype(np.int64) - 1, 0, points.size - 4)
    x = (wanted - points[first]) / step
    weights = np.zeros((wanted.size, points.size))
    for node in range(4):
        others = [other for other in range(4) if other != node]
        factors = [(x - other) / (node - other) for other in others]
        weights[np.arange(wanted.size), first + node] = np.prod(factors, axis=0)
    return weights
