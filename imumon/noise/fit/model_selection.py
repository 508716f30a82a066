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


def choose(problems: Problems, formers: Sequence[Choice | None]) -> list[Choice]:
    """Choose octaves and terms of some channels.

    Parameters
    ----------
    problems : one problem a channel, all octaves that have data in use.
    formers : what was chosen before for each, on a shorter record.
    """
    found: dict[int, Choice] = {}
    known = [(row, former) for row, former in enumerate(formers) if former is not None]
    again = _tried(
        problems.take(np.array([row for row, _ in known], dtype=np.int64)),
        [(_widened(former.used, problems.used[row]), former.free) for row, former in known],
    )
    stands = [row for (row, _), choice in zip(known, again, strict=True) if choice.cured]
    for (row, former), choice in zip(known, again, strict=True):
        if choice.cured or problems.span < AGAIN * former.sought:
            found[row] = choice if choice.cured else replace(choice, sought=former.sought)
    found |= zip(stands, _regained(_at(problems, stands), [found[row] for row in stands]), strict=True)
    new = [row for row in range(len(formers)) if row not in found]
    fresh = _at(problems, new)
    plain = _with_terms(fresh, _tried(fresh, [(used, _BASE) for used in fresh.used]))
    for row, one, choice in zip(new, range(len(new)), plain, strict=True):
        best = choice if choice.cured else _sought(_at(fresh, [one]), choice)
        found[row] = best if best.cured else replace(best, sought=problems.span)
    return _finished(problems, [found[row] for row in range(len(formers))])


def as_chosen(problems: Problems, choices: Sequence[Choice]) -> Problems:
    """The problems with the octaves and terms that were chosen for them."""
    both = zip(choices, problems.used, strict=True)
    return replace(
        problems,
        used=np.array([_widened(choice.used, available) for choice, available in both]),
        free=np.array([choice.free for choice in choices]),
        excess=np.array([choice.excess for choice in choices]),
    )


def _at(problems: Problems, rows: Sequence[int]) -> Problems:
    return problems.take(np.array(rows, dtype=np.int64))


def _widened(used: Bools, available: Bools) -> Bools:
    """Former choice on a curve that has grown: new octaves count."""
    wide = np.ones(available.size, dtype=bool)
    n = min(used.size, available.size)
    wide[:n] = used[:n]
    return wide & available


def _tried(
    problems: Problems, described: Sequence[tuple[Bools, Bools]], rounds: int = _ROUNDS
) -> list[Choice]:
    """The fit of each problem with its octaves and terms."""
    count = len(described)
    if not count:
        return []
    used = np.array([octaves for octaves, _ in described])
    free = np.array([terms for _, terms in described])
    batch = replace(problems, used=used, free=free, excess=np.full(count, TOLERATED**2))
    frame = batch.frame()
    p = solve(frame, free, rounds=rounds)
    chi2, dof = misfit(frame, p)
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


def _all_tried(
    problem: Problems, described: Sequence[tuple[Bools, Bools]], rounds: int = _ROUNDS
) -> list[Choice]:
    """The fits of one problem with all these octaves and terms."""
    return _tried(_at(problem, [0] * len(described)), described, rounds)


def _scores(problems: Problems, choices: Sequence[Choice], wanted: Sequence[tuple[int, int]]) -> list[float]:
    """Scores of terms at zero, given the others that were chosen; `wanted` are (problem, term)."""
    if not wanted:
        return []
    rows, terms = [row for row, _ in wanted], np.array([term for _, term in wanted])
    free = np.array([choices[row].free for row in rows])
    free[np.arange(len(rows)), terms] = True
    batch = replace(_at(problems, rows), used=np.array([choices[row].used for row in rows]), free=free)
    start = np.array([choices[row].p for row in rows])
    z, _ = score(batch.frame(), free, terms, np.zeros(len(rows)), start)
    return [float(value) for value in z]


def _with_terms(problems: Problems, choices: Sequence[Choice]) -> list[Choice]:
    """The choices with quantisation or ramp where their scores want them and the fit then passes."""
    tested: list[tuple[int, int]] = []
    for row, choice in enumerate(choices):
        terms = [term for term in (QUANTISATION, RAMP) if not choice.free[term]]
        if choice.used.sum() >= FEWEST + len(terms):
            tested += [(row, term) for term in terms]
    wanted: dict[int, list[int]] = {}
    for (row, term), z in zip(tested, _scores(problems, choices, tested), strict=True):
        if (abs(z) if term == QUANTISATION else z) > WANTED[term]:
            wanted.setdefault(row, []).append(term)
    found = list(choices)
    for row, terms in wanted.items():
        found[row] = _with(_at(problems, [row]), choices[row], terms)
    return found


def _with(problem: Problems, choice: Choice, wanted: list[int]) -> Choice:
    """The choice with one of the wanted terms, or all, where the fit then passes."""
    for extra in [[term] for term in wanted] + ([wanted] if len(wanted) > 1 else []):
        free = choice.free.copy()
        free[extra] = True
        found = _tried(problem, [(choice.used, free)])[0]
        passes = found.p_value is None or found.p_value >= (REJECTED if choice.cured else CURED)
        if passes and np.all(found.p[extra] != 0.0):
            return found
    return choice


def _regained(problems: Problems, choices: Sequence[Choice]) -> list[Choice]:
    """The choices with a term more, or else cheaper where that is plainly fine."""
    return [
        again if again is not choice else _cheaper(_at(problems, [row]), choice)
        for row, (choice, again) in enumerate(zip(choices, _with_terms(problems, choices), strict=True))
    ]


def _cheaper(problem: Problems, choice: Choice) -> Choice:
    """The choice with an octave more or a term less, where that is cheaper and plainly fine."""
    everything = problem.used[0]
    if np.array_equal(choice.used, everything) and np.array_equal(choice.free, _BASE):
        return choice
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
    for again in _all_tried(problem, tries):
        if again.p_value is not None and again.p_value >= REGAINED and _unwanted(problem, again, choice.free):
            return again
    return choice


def _unwanted(problem: Problems, choice: Choice, free: Bools) -> bool:
    """Whether the terms that would be given up are not seen."""
    gone = [int(term) for term in np.flatnonzero(free & ~choice.free)]
    return not gone or max(_scores(problem, [choice], [(0, term) for term in gone])) < KEPT


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
        found = _all_tried(problem, _candidates(problem.used[0], cost), rounds=_SEARCH_ROUNDS)
        found = [choice for choice in found if choice.p[RAMP] > 0.0 or not choice.free[RAMP]]
        passed = [choice for choice in found if choice.p_value is not None and choice.p_value >= CURED]
        if passed:
            return max(passed, key=lambda choice: (choice.used.sum(), choice.p_value))
        best = max([best, *found], key=_quality)
    return best


def _quality(choice: Choice) -> float:
    """Larger is better: minus chi-square per degree of freedom."""
    return -np.inf if choice.chi2 is None else -choice.chi2 / choice.dof


def _candidates(available: Bools, cost: int) -> list[tuple[Bools, Bools]]:
    """Octaves, (k,), and terms, (5,), of all descriptions of one cost."""
    found: list[tuple[Bools, Bools]] = []
    for extra in ((), (QUANTISATION,), (RAMP,), (QUANTISATION, RAMP)):
        for left_out in _left_out(available.size, cost - TERM_COST * len(extra)):
            mask = available.copy()
            mask[left_out] = False
            terms = _terms(mask, extra)
            if mask.sum() >= FEWEST - 3 + terms.sum() and _cost(mask, terms) == cost:
                found.append((mask, terms))
    return found


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


def _finished(problems: Problems, choices: list[Choice]) -> list[Choice]:
    """The choices with chi-square without tolerance and the model's own error where that is rejected."""
    all_ = replace(
        problems,
        used=np.array([choice.used for choice in choices]),
        free=np.array([choice.free for choice in choices]),
    )
    frame = all_.frame()
    p = solve(frame, all_.free, start=np.array([choice.p for choice in choices]))
    chi2, dof = misfit(frame, p)
    finished = []
    for row, choice in enumerate(choices):
        if dof[row] <= 0:
            finished.append(replace(choice, p=p[row], chi2=None, dof=0, p_value=None))
            continue
        p_value, powers, excess = chi2_tail(float(chi2[row]), int(dof[row])), p[row], 0.0
        if p_value < REJECTED:
            powers, excess = _excused(_at(all_, [row]), p[row], int(dof[row]))
        finished.append(
            replace(
                choice,
                p=powers,
                excess=excess,
                chi2=float(chi2[row]),
                dof=int(dof[row]),
                p_value=p_value,
            )
        )
    return finished


def _excused(one: Problems, p: Floats, dof: int) -> tuple[Floats, float]:
    """Powers, and the relative variance of the model that makes chi-square its expectation."""
    low, high, excess, start = 1e-5, 30.0, 0.0, p[None]  # of the Allan variance, one standard deviation
    for _ in range(14):
        excess = low * high
        wide = replace(one, excess=np.array([excess])).frame()
        start = solve(wide, one.free, start=start, rounds=_ROUNDS)
        left, _ = misfit(wide, start)
        low, high = (excess**0.5, high) if left[0] > dof else (low, excess**0.5)
    return solve(wide, one.free, start=start)[0], excess
