"""Selection of the octaves and terms that describe a curve, with hysteresis.

Real sensors are not three-term models. Filters, vibration and quantisation bend the short octaves, a spectral
line bends some in the middle, and a warm-up the long ones. An efficient fit would follow them. The rules:

1. White noise, flicker and random walk over all octaves are accepted unless chi-square rejects them
   (p < `REJECTED_P`).
2. Quantisation and ramp are added where their score, given the other terms, exceeds `QUANTISATION_SCORE` or
   `RAMP_SCORE`, which noise of the three types alone does in at most one record of a thousand, and the fit
   then passes.
3. If the model is still rejected, the cheapest description that passes (p >= `ACCEPTED_P`) is searched. An
   excluded octave costs 1, a term `TERM_COST`. Octaves are excluded from the short end or as a block further
   on, or both. A block costs one less where several octaves remain below it, since those are the most
   precise and agree, and three more where only one remains, because N would depend on it alone. At equal
   cost more octaves win, then the larger p.
4. If the shortest octaves are excluded, the cause of their deviation has a tail: noise correlated over a
   short time adds to N^2/tau a term that falls as 1/tau^2 at longer tau, the shape of quantisation with
   either sign (for a boxcar this is exact). So the 1/tau^2 term is free there and may be negative. N and its
   limits then do not depend on the first octave that passes.
5. If nothing passes up to `MAX_COST`, the best description is kept, and the rest counts as an error of the
   model common to all octaves. Its size makes chi-square equal to its expectation. It widens every interval.

The test allows a relative error of the model of `TOLERATED_ERROR`: with 10^9 samples any sensor departs from
any model, and a part in a thousand excludes no octave. Instead rule 5 includes this error.

An earlier selection is kept while it passes, and is replaced by a cheaper one only where that passes clearly
(p >= `REGAINED_P`), so no octave alternates between reports.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from imumon.noise.fit.covariance import TERMS
from imumon.noise.fit.intervals import score
from imumon.noise.fit.leastsquares import RAMP, SIGNED, FitProblems, misfit, solve
from imumon.samples import Bools, Floats

REJECTED_P = 1e-3
"""1, p-value below which a description is rejected. One record of a thousand that follows the model loses
octaves needlessly. Sensitivity: halved 0 %, doubled 1e+02 % (gyro z time_to K of the record
"temperature")."""

ACCEPTED_P = 0.1
"""1, p-value that a description must reach in a search: the best of many tries passes more easily.
Sensitivity: halved 0 %, doubled 63 % (gyro x drift steady_K high of the record "warm-up")."""

REGAINED_P = 0.2
"""1, p-value that a cheaper description must reach to replace one in use. Above `ACCEPTED_P`, so that the
selection does not alternate. Not critical."""

KEPT_SCORE = 2.0
"""Standard deviations; a term in use is dropped only where its score is below. Below `RAMP_SCORE`, so that
the selection does not alternate. Not critical."""

QUANTISATION_SCORE = 4.0
"""Standard deviations from which on quantisation is added. High, because the term costs N most of what the
shortest octaves contribute. Not critical."""

RAMP_SCORE = 3.1
"""Standard deviations from which on a ramp is added: one false alarm in a thousand records. Not critical."""

TOLERATED_ERROR = 2e-3
"""1, relative error of the modelled Allan variance that is not tested: no sensor follows the model closer.
Not critical."""

MAX_COST = 14
"""Cost up to which descriptions are tried: more would leave fewer octaves than a fit needs. Not critical."""

SEARCH_GROWTH = 1.2
"""1, growth of a record after which a search without result is repeated. It is the most expensive step. Not
critical."""

TERM_COST = 2
"""Excluded octaves that cost as much as a term: it explains several octaves at once. Not critical."""
LONELY_BLOCK_COST = 3
"""Excluded octaves by which a block costs more where a single octave stays below it. Not critical."""
BLOCK_COST = -1
"""Excluded octaves by which a block costs more where several octaves stay below it. Not critical."""
MAX_SHORT = 2
"""Octaves that may be excluded at the short end together with a block. Not critical."""

LEAST_BETWEEN = 3
"""Octaves that must stay between the short end and a block, so that N rests on more than one. Not
critical."""

LEAST_OCTAVES = 5
"""Octaves that must stay for the three terms: two degrees of freedom are left to test. Sensitivity: halved 0
%, doubled changes which values appear (gyro x drift steady_B value of the record "warm-up")."""
FIT_ROUNDS = 8
"""Rounds of weighting and solving for each description. Not critical."""
SEARCH_ROUNDS = 5
"""The same during a search, where only p-values are compared. Sensitivity: halved 63 %, doubled 0 % (gyro x
drift steady_K high of the record "warm-up")."""

LEAST_ERROR = 1e-5
"""1, relative error of the model at which the search of rule 5 begins. Not critical."""

MAX_ERROR = 30.0
"""1, relative error of the model at which the search of rule 5 ends. Not critical."""
ERROR_STEPS = 14
"""Bisections between the two, on a logarithmic scale: 0.1 % of the error. Not critical."""
QUANTISATION = SIGNED
_BASE = np.arange(len(TERMS)) < 3


@dataclass(frozen=True, slots=True, eq=False)
class SelectedModel:
    """Octaves and terms with which the curve of a channel is described, and their fit.

    Attributes
    ----------
    used : (k,) octaves that the fit uses.
    free : (5,) terms that are fitted.
    p : (5,) powers in units of tau0.
    excess : 1, relative variance of the error of the model.
    chi2, dof, p_value : of the fit without that error; None where there is nothing to test.
    passes : whether the fit passes the test.
    searched_span : samples, length of the record at the last search without result; 0: none.
    """

    used: Bools
    free: Bools
    p: Floats
    excess: float
    chi2: float | None
    dof: int
    p_value: float | None
    passes: bool
    searched_span: int = 0


def select_models(problems: FitProblems, previous: Sequence[SelectedModel | None]) -> list[SelectedModel]:
    """Return the octaves and terms of some channels.

    Parameters
    ----------
    problems : one problem per channel, which uses all octaves that have data.
    previous : selection for each on a shorter part of the same record.
    """
    selected: dict[int, SelectedModel] = {}
    known = [(row, model) for row, model in enumerate(previous) if model is not None]
    earlier = [(_extended(model.used, problems.used[row]), model.free) for row, model in known]
    refitted = _fitted(problems.take([row for row, _ in known]), earlier)
    for (row, before), model in zip(known, refitted, strict=True):
        if model.passes:
            selected[row] = model
        elif problems.span < SEARCH_GROWTH * before.searched_span:
            selected[row] = replace(model, searched_span=before.searched_span)
    kept = [row for row, model in selected.items() if model.passes]
    passed = [selected[row] for row in kept]
    for row, model, other in zip(kept, passed, _with_scored_terms(problems.take(kept), passed), strict=True):
        selected[row] = other if other is not model else _cheaper(problems.take([row]), model)
    new = [row for row in range(len(previous)) if row not in selected]
    others = problems.take(new)
    plain = _with_scored_terms(others, _fitted(others, [(used, _BASE) for used in others.used]))
    for row, model in zip(new, plain, strict=True):
        best = model if model.passes else _searched(problems.take([row]), model)
        selected[row] = best if best.passes else replace(best, searched_span=problems.span)
    return _with_error(problems, [selected[row] for row in range(len(previous))])


def with_selection(problems: FitProblems, models: Sequence[SelectedModel]) -> FitProblems:
    """Return the problems with the octaves and terms selected for them."""
    both = zip(models, problems.used, strict=True)
    used = np.array([_extended(model.used, available) for model, available in both])
    free, excess = (np.array([getattr(model, name) for model in models]) for name in ("free", "excess"))
    return replace(problems, used=used, free=free, excess=excess)


def _extended(used: Bools, available: Bools) -> Bools:
    """Return an earlier selection of octaves on a longer curve: new octaves are used."""
    extended = available.copy()
    extended[: used.size] &= used[: available.size]
    return extended


def _fitted(
    problems: FitProblems, descriptions: Sequence[tuple[Bools, Bools]], rounds: int = FIT_ROUNDS
) -> list[SelectedModel]:
    """Return the fit of each problem with its octaves and terms."""
    count = len(descriptions)
    if not count:
        return []
    used = np.array([octaves for octaves, _ in descriptions])
    free = np.array([terms for _, terms in descriptions])
    batch = replace(problems, used=used, free=free, excess=np.full(count, TOLERATED_ERROR**2))
    prepared = batch.prepare()
    p = solve(prepared, free, rounds=rounds)
    chi2, dof = misfit(prepared, p)
    models = []
    for row in range(count):
        statistic, p_value = None, None
        if dof[row] > 0:
            statistic, p_value = float(chi2[row]), float(chdtrc(dof[row], chi2[row]))
        passes = p_value is None or p_value >= REJECTED_P
        fit = used[row], free[row], p[row], 0.0, statistic, int(dof[row]), p_value, passes
        models.append(SelectedModel(*fit))
    return models


def _scores(
    problems: FitProblems, models: Sequence[SelectedModel], candidates: Sequence[tuple[int, int]]
) -> list[float]:
    """Return the scores of terms at zero, given the selected others; candidates are (problem, term)."""
    if not candidates:
        return []
    rows, terms = [row for row, _ in candidates], np.array([term for _, term in candidates])
    free = np.array([models[row].free for row in rows])
    free[np.arange(len(rows)), terms] = True
    batch = replace(problems.take(rows), used=np.array([models[row].used for row in rows]), free=free)
    start = np.array([models[row].p for row in rows])
    z, _ = score(batch.prepare(), free, terms, np.zeros(len(rows)), start)
    return [float(value) for value in z]


def _with_scored_terms(problems: FitProblems, models: Sequence[SelectedModel]) -> list[SelectedModel]:
    """Return the models with quantisation or ramp where their scores are high and the fit then passes."""
    candidates: list[tuple[int, int]] = []
    for row, model in enumerate(models):
        terms = [term for term in (QUANTISATION, RAMP) if not model.free[term]]
        if model.used.sum() >= LEAST_OCTAVES + len(terms):
            candidates += [(row, term) for term in terms]
    added: dict[int, list[int]] = {}
    for (row, term), z in zip(candidates, _scores(problems, models, candidates), strict=True):
        if abs(z) > QUANTISATION_SCORE if term == QUANTISATION else z > RAMP_SCORE:
            added.setdefault(row, []).append(term)
    result = list(models)
    for row, terms in added.items():
        result[row] = _with_terms(problems.take([row]), models[row], terms)
    return result


def _with_terms(problem: FitProblems, model: SelectedModel, terms: list[int]) -> SelectedModel:
    """Return the model with one of the terms, or all of them, where the fit then passes."""
    for extra in [[term] for term in terms] + ([terms] if len(terms) > 1 else []):
        free = model.free.copy()
        free[extra] = True
        fitted = _fitted(problem, [(model.used, free)])[0]
        least = REJECTED_P if model.passes else ACCEPTED_P
        if (fitted.p_value is None or fitted.p_value >= least) and np.all(fitted.p[extra] != 0.0):
            return fitted
    return model


def _cheaper(problem: FitProblems, model: SelectedModel) -> SelectedModel:
    """Return the model with another octave or one term less, where this is cheaper and passes clearly."""
    available = problem.used[0]
    if np.array_equal(model.used, available) and np.array_equal(model.free, _BASE):
        return model
    masks = [model.used, available]
    excluded = np.flatnonzero(available & ~model.used)
    for octave in excluded[[0, -1]] if excluded.size else ():
        masks.append(model.used.copy())
        masks[-1][octave] = True
    extras = np.flatnonzero(model.free & ~_BASE).tolist()
    fewer = [[term for term in extras if term != dropped] for dropped in extras]
    tries = [(mask, _terms(mask, extra)) for mask in masks for extra in [extras, *fewer]]
    tries = [row for row in tries if _cost(*row) < _cost(model.used, model.free)]
    for other in _fitted(problem.take([0] * len(tries)), tries):
        if other.p_value is not None and other.p_value >= REGAINED_P:
            dropped = [(0, int(term)) for term in np.flatnonzero(model.free & ~other.free)]
            if max(_scores(problem, [other], dropped), default=0.0) < KEPT_SCORE:
                return other
    return model


def _terms(used: Bools, extra: Sequence[int]) -> Bools:
    """Return (5,) the terms that are fitted with these octaves."""
    terms = _BASE.copy()
    terms[list(extra)] = True
    terms[QUANTISATION] |= not used[0]
    return terms


def _cost(used: Bools, free: Bools) -> int:
    """Return the cost of a description; see the rules above.

    >>> used = np.array([False, True, True, False, True])
    >>> _cost(used, _terms(used, [])), _cost(used[1:], _terms(used[1:], [RAMP]))
    (1, 2)
    """
    excluded = np.flatnonzero(~used)
    short = int(np.argmax(used))
    further = excluded[excluded > short]
    block = 0 if not further.size else LONELY_BLOCK_COST if further[0] == short + 1 else BLOCK_COST
    return int(excluded.size + block + TERM_COST * (free.sum() - _terms(used, []).sum()))


def _searched(problem: FitProblems, rejected: SelectedModel) -> SelectedModel:
    """Return the cheapest description that passes, or the best of those that do not."""
    best = rejected
    for cost in range(MAX_COST + 1):
        descriptions = _candidates(problem.used[0], cost)
        models = _fitted(problem.take([0] * len(descriptions)), descriptions, SEARCH_ROUNDS)
        models = [model for model in models if model.p[RAMP] > 0.0 or not model.free[RAMP]]
        passed = [model for model in models if model.p_value is not None and model.p_value >= ACCEPTED_P]
        if passed:
            return max(passed, key=lambda model: (model.used.sum(), model.p_value))
        best = min(
            [best, *models], key=lambda model: np.inf if model.chi2 is None else model.chi2 / model.dof
        )
    return best


def _candidates(available: Bools, cost: int) -> list[tuple[Bools, Bools]]:
    """Return the octaves, (k,), and terms, (5,), of all descriptions of one cost."""
    descriptions: list[tuple[Bools, Bools]] = []
    for extra in ((), (QUANTISATION,), (RAMP,), (QUANTISATION, RAMP)):
        for excluded in _exclusions(available.size, cost - TERM_COST * len(extra)):
            mask = available.copy()
            mask[excluded] = False
            terms = _terms(mask, extra)
            if mask.sum() >= LEAST_OCTAVES - 3 + terms.sum() and _cost(mask, terms) == cost:
                descriptions.append((mask, terms))
    return descriptions


def _exclusions(octaves: int, cost: int) -> list[list[int]]:
    """Return the octaves that may be excluded at a cost: the shortest, a block further on, or both.

    >>> _exclusions(5, 1)
    [[0], [2, 3], [3, 4], [0, 4]]
    """
    exclusions = [list(range(cost))] if 0 <= cost <= octaves else []
    for short in range(MAX_SHORT + 1):
        for begin in range(short + (LEAST_BETWEEN if short else 1), octaves):
            length = cost - short - (LONELY_BLOCK_COST if begin == 1 else BLOCK_COST)
            if 1 <= length <= octaves - begin:
                exclusions.append([*range(short), *range(begin, begin + length)])
    return exclusions


def _with_error(problems: FitProblems, models: list[SelectedModel]) -> list[SelectedModel]:
    """Return the models with chi-square without tolerance, and with their error where that rejects them."""
    used, free = (np.array([getattr(model, name) for model in models]) for name in ("used", "free"))
    batch = replace(problems, used=used, free=free)
    prepared = batch.prepare()
    p = solve(prepared, batch.free, start=np.array([model.p for model in models]))
    chi2, dof = misfit(prepared, p)
    result = []
    for row, model in enumerate(models):
        if dof[row] <= 0:
            result.append(replace(model, p=p[row], chi2=None, dof=0, p_value=None))
            continue
        statistic, degrees, powers, excess = float(chi2[row]), int(dof[row]), p[row], 0.0
        p_value = float(chdtrc(degrees, statistic))
        if p_value < REJECTED_P:
            powers, excess = _model_error(batch.take([row]), powers, degrees)
        fit = replace(model, p=powers, excess=excess, chi2=statistic, dof=degrees, p_value=p_value)
        result.append(fit)
    return result


def _model_error(problem: FitProblems, p: Floats, dof: int) -> tuple[Floats, float]:
    """Return the powers, and the relative variance of the model that makes chi-square its expectation."""
    low, high, excess, start = LEAST_ERROR, MAX_ERROR, 0.0, p[None]
    for _ in range(ERROR_STEPS):
        excess = low * high
        prepared = replace(problem, excess=np.array([excess])).prepare()
        start = solve(prepared, problem.free, start=start, rounds=FIT_ROUNDS)
        chi2, _ = misfit(prepared, start)
        low, high = (excess**0.5, high) if chi2[0] > dof else (low, excess**0.5)
    return solve(prepared, problem.free, start=start)[0], excess
