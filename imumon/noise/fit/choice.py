"""Choice of octaves and terms: what of a curve the model describes, by a rule that does not flicker.

Real sensors are not three-term models. Filters, vibration and quantisation bend the short octaves, a
line some in the middle, a warm-up the long ones; an efficient fit would bend with them. The rule:

1. White, flicker and random walk over all octaves stand unless chi-square says no (p < `REJECTED`).
2. Quantisation and ramp are taken in where their score, given the other terms, exceeds `WANTED` standard
   deviations, which noise of the three kinds alone does once in a thousand records or less, and the fit
   then passes.
3. Still rejected: the cheapest description that passes (p >= `CURED`) is sought. An octave left out costs
   1, a term 2. Octaves are left out from the short end or as a block further on, or both; a block costs one
   less where octaves stay below it, since those are the most precise and agree, and three more where it is
   a single one, on which N would then hang. Of equal cost the one that keeps more wins, then p.
4. Where the shortest octaves are left out, what bent them has a tail: noise correlated over a short time
   adds to N^2/tau a term that falls as 1/tau^2 once tau is longer, quantisation's shape with either
   sign (for a boxcar that is exact). There the 1/tau^2 term is free and may be negative, so that N and its
   limits do not lean on the first octave that happened to pass.
5. Nothing passes at `DEAREST`: the best of it stays, and what is left over counts as an error of the model
   that all octaves have, as large as makes chi-square its expectation. It widens every interval.

The test itself allows a model to be wrong by `TOLERATED`: with 10^9 samples any sensor departs from any
model, and no octave is given up for a part in a thousand; instead rule 5's error takes it in.

A former choice stands while it passes and is given up for a cheaper one only where that is plainly fine
(p >= `REGAINED`), so no octave jumps in and out with every report.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imumon.noise.fit.covariance import TERMS
from imumon.noise.fit.intervals import score
from imumon.noise.fit.leastsquares import Problems, misfit, solve
from imumon.noise.fit.quantiles import chi2_tail
from imumon.samples import Bools, Floats

REJECTED = 1e-3
CURED = 0.1
REGAINED = 0.2
KEPT = 2.0
TOLERATED = 2e-3  # of the Allan variance
DEAREST = 14
AGAIN = 1.2  # growth of a record after which a search in vain is repeated
TERM_COST = 2
LONELY, BESIDE = 3, -1  # what a block costs beyond its octaves
SHORT = 2  # octaves left out at the short end beside a block
STRETCH = 3  # octaves that stay between the two
_ROUNDS = 8
_SEARCH_ROUNDS = 5
_BASE = np.arange(len(TERMS)) < 3
QUANTISATION, RAMP = 3, 4
WANTED = {QUANTISATION: 4.0, RAMP: 3.1}  # the former costs N most of what the shortest octaves know
FEWEST = 5  # octaves that must stay


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """What of a channel's curve is fitted, with what.

    Attributes
    ----------
    used : (k,) octaves that count.
    free : (5,) terms that may be there.
    p : (5,) powers in units of tau0.
    excess : 1, relative variance of the model itself.
    chi2, dof, p_value : of the fit without that excess; None where there is nothing to test.
    cured : whether what is left passes the test.
    sought : samples, length of the record when all descriptions were last tried in vain; 0: never.
    """

    used: Bools
    free: Bools
    p: Floats
    excess: float
    chi2: float | None
    dof: int
    p_value: float | None
    cured: bool
    sought: int = 0


def choose(problem: Problems, former: Choice | None) -> Choice:
    """Choose octaves and terms of one channel.

    Parameters
    ----------
    problem : one problem, all octaves that have data in use.
    former : what was chosen before, on a shorter record.
    """
    everything = problem.used[0]
    if former is not None:
        again = _widened(former.used, everything), former.free
        found = _tried(problem, *again)
        if found.cured:
            return _finished(problem, _regained(problem, found, everything))
        if problem.tables.span < AGAIN * former.sought:
            return _finished(problem, replace(found, sought=former.sought))
    found = _with_terms(problem, _tried(problem, everything, _BASE))
    if not found.cured:
        found = _sought(problem, found)
    return _finished(problem, found if found.cured else replace(found, sought=problem.tables.span))


def _widened(used: Bools, available: Bools) -> Bools:
    """Former choice on a curve that has grown: new octaves count."""
    wide = np.ones(available.size, dtype=bool)
    n = min(used.size, available.size)
    wide[:n] = used[:n]
    return wide & available


def _tried(problem: Problems, used: Bools, free: Bools, start: Floats | None = None) -> Choice:
    """The fit with these octaves and terms."""
    return _all_tried(problem, used[None], free[None], None if start is None else start[None])[0]


def _all_tried(
    problem: Problems, used: Bools, free: Bools, start: Floats | None = None, rounds: int = _ROUNDS
) -> list[Choice]:
    count = len(used)
    batch = replace(
        problem.take(np.zeros(count, dtype=np.int64)),
        used=used,
        free=free,
        excess=np.full(count, TOLERATED**2),
    )
    p = solve(batch, start=start, rounds=rounds)
    chi2, dof = misfit(batch, p)
    choices = []
    for row in range(count):
        tested = bool(dof[row] > 0)
        p_value = chi2_tail(float(chi2[row]), int(dof[row])) if tested else None
        choices.append(
            Choice(
                used[row],
                free[row],
                p[row],
                0.0,
                float(chi2[row]) if tested else None,
                int(dof[row]),
                p_value,
                p_value is None or p_value >= REJECTED,
            )
        )
    return choices


def _scores(problem: Problems, choice: Choice, terms: list[int]) -> list[float]:
    """Scores of terms at zero, given the others."""
    free = choice.free.copy()
    free[terms] = True
    batch = replace(
        problem.take(np.zeros(len(terms), dtype=np.int64)),
        used=np.repeat(choice.used[None], len(terms), axis=0),
        free=np.repeat(choice.free[None], len(terms), axis=0),
    )
    batch.free[np.arange(len(terms)), terms] = True
    start = np.repeat(choice.p[None], len(terms), axis=0)
    z, _ = score(batch, np.array(terms), np.zeros(len(terms)), start)
    return [float(value) for value in z]


def _with_terms(problem: Problems, choice: Choice) -> Choice:
    """The choice with quantisation or ramp where their scores want them and the fit then passes."""
    terms = [term for term in (QUANTISATION, RAMP) if not choice.free[term]]
    if not terms or choice.used.sum() < FEWEST + len(terms):
        return choice
    scores = zip(terms, _scores(problem, choice, terms), strict=True)
    wanted = [term for term, z in scores if (abs(z) if term == QUANTISATION else z) > WANTED[term]]
    for extra in [[term] for term in wanted] + ([wanted] if len(wanted) > 1 else []):
        free = choice.free.copy()
        free[extra] = True
        found = _tried(problem, choice.used, free)
        passes = found.p_value is None or found.p_value >= (REJECTED if choice.cured else CURED)
        if passes and np.all(found.p[extra] != 0.0):
            return found
    return choice


def _regained(problem: Problems, choice: Choice, everything: Bools) -> Choice:
    """The choice with an octave more or a term less, where that is cheaper and plainly fine."""
    found = _with_terms(problem, choice)
    if found is not choice:
        return found
    masks = [choice.used, everything]
    out = np.flatnonzero(everything & ~choice.used)
    for octave in out[[0, -1]] if out.size else ():
        masks.append(choice.used.copy())
        masks[-1][octave] = True
    extras = np.flatnonzero(choice.free & ~_BASE).tolist()
    fewer = [[term for term in extras if term != gone] for gone in extras]
    tries = [(mask, _terms(mask, extra)) for mask in masks for extra in [extras, *fewer]]
    tries = [row for row in tries if _cost(*row) < _cost(choice.used, choice.free)]
    if not tries:
        return choice
    for again in _all_tried(
        problem, np.array([mask for mask, _ in tries]), np.array([free for _, free in tries])
    ):
        if again.p_value is not None and again.p_value >= REGAINED and _unwanted(problem, again, choice.free):
            return again
    return choice


def _unwanted(problem: Problems, choice: Choice, free: Bools) -> bool:
    """Whether the terms that would be given up are not seen."""
    gone = [int(term) for term in np.flatnonzero(free & ~choice.free)]
    return not gone or max(_scores(problem, choice, gone)) < KEPT


def _terms(used: Bools, extra: Sequence[int]) -> Bools:
    """(5,) terms that are free with these octaves."""
    terms = _BASE.copy()
    terms[list(extra)] = True
    terms[QUANTISATION] |= not used[0]
    return terms


def _cost(used: Bools, free: Bools) -> int:
    """What a description costs; see the rules above.

    >>> used = np.array([False, True, True, False, True])
    >>> _cost(used, _terms(used, [])), _cost(used[1:], _terms(used[1:], [RAMP]))
    (1, 2)
    """
    out = np.flatnonzero(~used)
    short = int(np.argmax(used))
    further = out[out > short]
    block = 0 if not further.size else LONELY if further[0] == short + 1 else BESIDE
    return int(out.size + block + TERM_COST * (free.sum() - _terms(used, []).sum()))


def _sought(problem: Problems, rejected: Choice) -> Choice:
    """The cheapest description that passes, or the best of those that do not."""
    best = rejected
    for cost in range(DEAREST + 1):
        used, free = _candidates(problem.used[0], cost)
        if not len(used):
            continue
        found = _all_tried(problem, used, free, rounds=_SEARCH_ROUNDS)
        found = [choice for choice in found if choice.p[RAMP] > 0.0 or not choice.free[RAMP]]
        passed = [choice for choice in found if choice.p_value is not None and choice.p_value >= CURED]
        if passed:
            return max(passed, key=lambda choice: (choice.used.sum(), choice.p_value))
        best = max([best, *found], key=_quality)
    return best


def _quality(choice: Choice) -> float:
    """Larger is better: minus chi-square per degree of freedom."""
    return -np.inf if choice.chi2 is None else -choice.chi2 / choice.dof


def _candidates(available: Bools, cost: int) -> tuple[Bools, Bools]:
    """Octaves and terms of all descriptions of one cost: (n, k) and (n, 5)."""
    octaves = available.size
    used: list[Bools] = []
    free: list[Bools] = []
    for extra in ((), (QUANTISATION,), (RAMP,), (QUANTISATION, RAMP)):
        for left_out in _left_out(octaves, cost - TERM_COST * len(extra)):
            mask = available.copy()
            mask[left_out] = False
            terms = _terms(mask, extra)
            if mask.sum() >= FEWEST - 3 + terms.sum() and _cost(mask, terms) == cost:
                used.append(mask)
                free.append(terms)
    return np.array(used, dtype=bool).reshape(-1, octaves), np.array(free, dtype=bool).reshape(-1, len(TERMS))


def _left_out(octaves: int, cost: int) -> list[list[int]]:
    """Octaves that may be left out at a cost: the shortest ones, a block further on, or both.

    >>> _left_out(5, 1)
    [[0], [2, 3], [3, 4], [0, 4]]
    """
    found = [list(range(cost))] if 0 <= cost <= octaves else []
    for short in range(SHORT + 1):
        for begin in range(short + (STRETCH if short else 1), octaves):
            length = cost - short - (LONELY if begin == 1 else BESIDE)
            if 1 <= length <= octaves - begin:
                found.append([*range(short), *range(begin, begin + length)])
    return found


def _finished(problem: Problems, choice: Choice) -> Choice:
    """The choice with chi-square without tolerance and the model's own error where that is rejected."""
    one = replace(problem, used=choice.used[None], free=choice.free[None])
    p = solve(one, start=choice.p[None])
    chi2, dof = misfit(one, p)
    if dof[0] <= 0:
        return replace(choice, p=p[0], chi2=None, dof=0, p_value=None)
    p_value = chi2_tail(float(chi2[0]), int(dof[0]))
    excess = 0.0
    if p_value < REJECTED:
        low, high = 1e-5, 30.0  # of the Allan variance, one standard deviation
        for _ in range(14):
            excess = low * high
            wide = replace(one, excess=np.array([excess]))
            p = solve(wide, start=p, rounds=_ROUNDS)
            left, _ = misfit(wide, p)
            low, high = (excess**0.5, high) if left[0] > dof[0] else (low, excess**0.5)
        p = solve(wide, start=p)
    return replace(choice, p=p[0], excess=excess, chi2=float(chi2[0]), dof=int(dof[0]), p_value=p_value)
