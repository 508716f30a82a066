"""Selection of the descriptions of a curve: which octaves and terms the fit uses.

Real sensors are not three-term models. What the spectrum shows as lines is subtracted before the fit
(`narrow_band_offset`), first with the errors of steady lines; where rule 1 then rejects, with those of lines
that change. What remains is described by rules:

1. White noise, flicker and random walk over all octaves are accepted unless chi-square rejects them
   (p < `REJECTED_P`). Quantisation and ramp are added where their score, given the other terms, exceeds
   `QUANTISATION_SCORE` or `RAMP_SCORE`, which noise of the three types alone does in at most one record of a
   thousand, and the fit then passes.
2. If this is rejected, the noise is correlated over a short time: a filter, or a broad resonance. The
   shortest octaves, up to `MAX_SHORT`, are not used. The correlation adds to N^2/tau a term that falls as
   1/tau^2 at longer tau, of either sign (for a boxcar this is exact), so the 1/tau^2 term is free and may be
   negative. A ramp is tried too. The description with the fewest excluded octaves and terms that passes
   clearly (p >= `CLEAR_P`), or else at all, gives the values. Those that pass and cost little more are kept
   beside it, and the limits are the union of theirs: the data do not decide between them. They do where
   chi-square without the tolerance falls by more than `DECISIVE` with one octave fewer, and where the excluded
   octaves are those of a moving average, for which the description is exact. Where chi-square
   exceeds its expectation, the covariance is scaled by the ratio (Birge, Phys. Rev. 40, 1932).
3. If nothing passes, the longest octaves follow no model: temperature, warm-up. Up to `MAX_LONG` of them are
   not used if the rest then passes clearly (p >= `ACCEPTED_CUT_P`). K is then unknown. Where no spectrum is
   known, this may be any block of octaves, because a line bends some in the middle.
4. If still nothing passes, the best description is kept, and the rest counts as an error of the model common
   to all octaves. Its size makes chi-square equal to its expectation. It widens every interval. Above
   `MAX_ERROR` no description fits, and no coefficient is given.

The test allows a relative error of the model of `TOLERATED_ERROR`: with 10^9 samples any sensor departs from
any model.

A description in use is kept while it passes, so no octave alternates between reports.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from imumon.noise.fit.candidate_octaves import (
    BASE,
    LEAST_OCTAVES,
    QUANTISATION,
    candidates_without_block,
    candidates_without_short,
)
from imumon.noise.fit.intervals import score
from imumon.noise.fit.leastsquares import RAMP, FitProblems, misfit, solve
from imumon.samples import Bools, Floats

REJECTED_P = 1e-3
"""1, p-value below which the three terms over all octaves are rejected: one record of a thousand that follows
them. Not critical."""

STEADY_P = 0.05
"""1, p-value from which on lines that changed count as steady again. Above `REJECTED_P`, so that the selection
does not alternate. Not critical."""

CLEAR_P = 0.05
"""1, p-value from which on a description without the shortest octaves passes clearly; it is preferred to one
that only passes. Not critical."""

ACCEPTED_CUT_P = 0.1
"""1, p-value that a description without the longest octaves must reach: there are more of them. Not critical."""

QUANTISATION_SCORE = 4.0
"""Standard deviations from which on quantisation is added. High, because the term costs N most of what the
shortest octaves contribute. Not critical."""

RAMP_SCORE = 3.1
"""Standard deviations from which on a ramp is added: one false alarm in a thousand records. Not critical."""

KEPT_SCORE = 2.0
"""Standard deviations; a term in use is dropped only where its score is below. Below `RAMP_SCORE`, so that
the selection does not alternate. Not critical."""

TOLERATED_ERROR = 1e-2
"""1, relative error of the modelled Allan variance that is not tested: no sensor follows the model closer.
Not critical."""

MAX_LAGS = 1.0
"""1, largest share of N^2/tau that the 1/tau^2 term may have at the shortest octave in use: a correlation over
less than the cluster cannot add more. Not critical."""

KEPT_COST = 1
"""Cost by which a description may exceed that in use to widen its limits: each excluded octave costs 1. At 0, N
behind a low-pass filter is held in 75 % of the records; at 2, limits are up to three times as wide. Not
critical."""

KEPT = 3
"""Descriptions whose limits are united, at most, for the processor time. Not critical."""

DECISIVE, STILL_DECISIVE = 10.0, 5.0
"""1, fall of chi-square with one octave fewer that decides for this description, and that keeps it where it was
decided before: noise alone makes the first in 2 of 1,000 records. At 6, N behind a low-pass filter is held in 0.5 %
fewer records. Not critical."""

AVERAGE_ERROR, STILL_AVERAGE_ERROR, MOST_AVERAGE_ERROR = 0.03, 0.06, 0.15
"""1, relative deviation of the excluded octaves from those of a moving average, beyond the statistics of N, up to
which they count as such; up to which they still do; and the largest with the statistics. Other filters differ by
tens of per cent. Not critical."""

TERM_COST = 2
"""Excluded octaves that cost as much as a term: it explains several octaves at once. Not critical."""

FIT_ROUNDS = 8
"""Rounds of weighting and solving for each description. Not critical."""

LEAST_EXCESS = 1e-8
"""1, relative variance of the model at which the search of rule 4 begins. Not critical."""

MAX_ERROR = 0.3
"""1, relative error of the modelled Allan variance above which no description fits. Not critical."""
ERROR_STEPS = 14
"""Bisections between the two, on a logarithmic scale: 0.1 % of the error. Not critical."""


@dataclass(frozen=True, slots=True, eq=False)
class SelectedModel:
    """Octaves and terms with which the curve of a channel is described, and their fit.

    Attributes
    ----------
    used : (k,) octaves that the fit uses.
    free : (5,) terms that are fitted.
    p : (5,) powers in units of tau0.
    excess : 1, relative variance of the error of the model.
    scale : 1, factor of the covariance, chi-square over its degrees of freedom where that is above 1.
    chi2, dof, p_value : of the fit without that error; None where there is nothing to test.
    passes : whether the fit passes the test.
    fits : whether the error of the model is at most `MAX_ERROR`.
    changing : whether the lines have the errors of lines that change.
    others : descriptions beside this one whose limits count too.
    """

    used: Bools
    free: Bools
    p: Floats
    excess: float
    chi2: float | None
    dof: int
    p_value: float | None
    passes: bool
    fits: bool = True
    scale: float = 1.0
    changing: bool = False
    others: tuple[SelectedModel, ...] = ()

    @property
    def plain(self) -> bool:
        """Whether it uses all octaves up to the last one, and no term beside the three."""
        return bool(self.used[: np.flatnonzero(self.used)[-1]].all() and np.array_equal(self.free, BASE))


def select_models(
    problems: FitProblems, previous: Sequence[SelectedModel | None], *, spectrum: bool = True
) -> list[SelectedModel]:
    """Return the octaves and terms of some channels.

    Parameters
    ----------
    problems : one problem per channel, which uses all octaves that have data.
    previous : selection for each on a shorter part of the same record.
    spectrum : whether the lines are known. Without a spectrum, a block of octaves that a line bends may be
        excluded instead.
    """
    models = _with_all_octaves(problems, previous)
    changing = np.array([_changes(*row) for row in zip(problems.changing, models, previous, strict=True)])
    if changing.any():
        problems, own = problems.with_changing_lines(changing), np.flatnonzero(changing).tolist()
        again = _with_all_octaves(problems.take(own), [previous[row] for row in own])
        models = [again.pop(0) if changes else model for model, changes in zip(models, changing, strict=True)]
    rejected = {row: model for row, model in enumerate(models) if not model.passes}
    for row, found in _searched(problems, rejected, previous, spectrum=spectrum).items():
        models[row] = found
    rows = [(row, each) for row, model in enumerate(models) for each in (model, *model.others)]
    fits = _with_error(problems.take([row for row, _ in rows]), [each for _, each in rows])
    selected: list[SelectedModel] = []
    for model, changes, before in zip(models, changing.tolist(), previous, strict=True):
        group = [replace(fits.pop(0), changing=changes) for _ in range(1 + len(model.others))]
        best, *others = _undecided(group, before)
        selected.append(replace(best, others=tuple(others)))
    return selected


def _undecided(models: list[SelectedModel], previous: SelectedModel | None) -> list[SelectedModel]:
    """Return the models without those that one with fewer octaves decides against."""

    def decides(other: SelectedModel, model: SelectedModel) -> bool:
        if other.chi2 is None or model.chi2 is None:
            return False
        fewer = int(model.used.sum() - other.used.sum())
        least = STILL_DECISIVE if _was_alone(other, previous) else DECISIVE
        alike = np.array_equal(model.free, other.free)
        return fewer > 0 and alike and model.chi2 - other.chi2 > least * fewer

    return [model for model in models if not any(decides(other, model) for other in models)]


def _was_alone(model: SelectedModel, previous: SelectedModel | None) -> bool:
    """Return whether a model, on a shorter part of the record, had no other beside it."""
    if previous is None or previous.others:
        return False
    known = min(previous.used.size, model.used.size)
    return np.array_equal(model.used[:known], previous.used[:known]) and np.array_equal(
        model.free, previous.free
    )


def _with_all_octaves(problems: FitProblems, previous: Sequence[SelectedModel | None]) -> list[SelectedModel]:
    """Return the models of rule 1."""
    base = _fitted(problems, [(used, BASE) for used in problems.used])
    return _with_scored_terms(problems, base, previous)


def _changes(changing: Floats, model: SelectedModel, previous: SelectedModel | None) -> bool:
    """Return whether the lines of a channel are not steady."""
    least = STEADY_P if previous is not None and previous.changing else REJECTED_P
    return bool(changing.any()) and model.p_value is not None and model.p_value < least


def with_selection(problems: FitProblems, models: Sequence[SelectedModel]) -> FitProblems:
    """Return the problems with the octaves and terms selected for them."""
    both = zip(models, problems.used, strict=True)
    used = np.array([_extended(model.used, available) for model, available in both])
    free, excess, changing = (
        np.array([getattr(model, name) for model in models]) for name in ("free", "excess", "changing")
    )
    thinning = problems.thinning * np.sqrt([[model.scale] for model in models])
    problems = problems.with_changing_lines(changing)
    return replace(problems, used=used, free=free, excess=excess, thinning=thinning)


def _extended(used: Bools, available: Bools) -> Bools:
    """Return an earlier selection of octaves on a longer curve: new octaves are used."""
    extended = available.copy()
    extended[: used.size] &= used[: available.size]
    return extended


def _fitted(problems: FitProblems, descriptions: Sequence[tuple[Bools, Bools]]) -> list[SelectedModel]:
    """Return the fit of each problem with its octaves and terms."""
    count = len(descriptions)
    if not count:
        return []
    used = np.array([octaves for octaves, _ in descriptions])
    free = np.array([terms for _, terms in descriptions])
    batch = replace(problems, used=used, free=free, excess=np.full(count, TOLERATED_ERROR**2))
    prepared = batch.prepare()
    p = solve(prepared, free, rounds=FIT_ROUNDS)
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


def _with_scored_terms(
    problems: FitProblems, models: Sequence[SelectedModel], previous: Sequence[SelectedModel | None]
) -> list[SelectedModel]:
    """Return the models with quantisation or ramp where their scores are high and the fit then passes."""
    candidates: list[tuple[int, int]] = []
    for row, model in enumerate(models):
        terms = [term for term in (QUANTISATION, RAMP) if not model.free[term]]
        if model.used.sum() >= LEAST_OCTAVES + len(terms):
            candidates += [(row, term) for term in terms]
    added: dict[int, list[int]] = {}
    for (row, term), z in zip(candidates, _scores(problems, models, candidates), strict=True):
        before = previous[row]
        in_use = before is not None and before.used.all() and before.free[term]
        least = KEPT_SCORE if in_use else QUANTISATION_SCORE if term == QUANTISATION else RAMP_SCORE
        if z > least:
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
        possible = 0.0 <= fitted.p[QUANTISATION] <= problem.max_quantisation[0]
        if (
            possible
            and (fitted.p_value is None or fitted.p_value >= REJECTED_P)
            and np.all(fitted.p[extra] != 0.0)
        ):
            return fitted
    return model


def _searched(
    problems: FitProblems,
    rejected: dict[int, SelectedModel],
    previous: Sequence[SelectedModel | None],
    *,
    spectrum: bool,
) -> dict[int, SelectedModel]:
    """Return the cheapest description that passes with those beside it, or the best that does not, by row."""
    found: dict[int, SelectedModel] = {}
    whole = _fitted_all(problems, {row: candidates_without_short(problems.used[row]) for row in rejected})
    for row, models in whole.items():
        options = (_cheapest(models, problems.used[row], p, previous[row]) for p in (CLEAR_P, REJECTED_P))
        if (best := next(filter(None, options), None)) is not None:
            alone = _is_moving_average(problems, row, best, previous[row])
            found[row] = replace(best, others=()) if alone else best
    left = [row for row in rejected if row not in found]
    cut = _fitted_all(
        problems, {row: candidates_without_block(problems.used[row], only_end=spectrum) for row in left}
    )
    for row in left:
        best = _cheapest(cut[row], problems.used[row], ACCEPTED_CUT_P, previous[row])
        tried = [rejected[row], *whole[row]]
        found[row] = best or min(
            tried, key=lambda model: np.inf if model.chi2 is None else model.chi2 / model.dof
        )
    return found


def _cheapest(
    models: list[SelectedModel], available: Bools, least_p: float, previous: SelectedModel | None
) -> SelectedModel | None:
    """Return the cheapest model with a p-value, with those beside it, or the one in use; None: there is none."""
    passed = [model for model in models if model.p_value is not None and model.p_value >= least_p]
    if not passed:
        return None
    passed.sort(key=lambda model: _cost(model, available))
    most = _cost(passed[0], available) + KEPT_COST
    kept = previous and next((model for model in passed if _same(model, previous, available)), None)
    best = kept or passed[0]
    if _was_alone(best, previous) and any(_nearly_passes(model, best) for model in models):
        return replace(best, passes=True)  # it stays alone while the one that it replaced is not rejected
    others = [model for model in passed if model is not best and _cost(model, available) <= most]
    others.sort(key=lambda model: -(model.p_value or 0.0))
    return replace(best, passes=True, others=tuple(others[: KEPT - 1]))


def _nearly_passes(model: SelectedModel, best: SelectedModel) -> bool:
    """Return whether a model is not rejected that has one octave more than the best one."""
    one_more = int(model.used.sum() - best.used.sum()) == 1 and np.array_equal(model.free, best.free)
    return one_more and model.p_value is not None and model.p_value >= REJECTED_P


def _fitted_all(
    problems: FitProblems, candidates: dict[int, list[tuple[Bools, Bools]]]
) -> dict[int, list[SelectedModel]]:
    """Return the possible fits of the candidates of some rows."""
    rows = [row for row, each in candidates.items() for _ in each]
    fits = _fitted(problems.take(rows), [each for every in candidates.values() for each in every])
    result: dict[int, list[SelectedModel]] = {row: [] for row in candidates}
    for row, fit in zip(rows, fits, strict=True):
        if _is_possible(problems, row, fit):
            result[row].append(fit)
    return result


def _is_possible(problems: FitProblems, row: int, model: SelectedModel) -> bool:
    """Return whether the 1/tau^2 term of a model can be a correlation, and its ramp is not zero."""
    design = problems.tables[problems.kind[row]].design
    first = int(np.argmax(model.used))
    tail = abs(model.p[QUANTISATION]) * design[first, QUANTISATION]
    ramp = bool(model.p[RAMP] > 0.0) or not model.free[RAMP]
    return bool(tail <= MAX_LAGS * model.p[0] * design[first, 0]) and ramp


def _is_moving_average(
    problems: FitProblems, row: int, model: SelectedModel, previous: SelectedModel | None
) -> bool:
    """Return whether the excluded shortest octaves are those of the white noise of a model behind a moving average."""
    short = int(np.argmax(model.used))
    error = STILL_AVERAGE_ERROR if _was_alone(model, previous) else AVERAGE_ERROR
    error += math.sqrt(3.0 * 2.0**short / problems.span)
    if not short or not problems.used[row, :short].all() or model.p[0] <= 0.0 or error > MOST_AVERAGE_ERROR:
        return False
    design, observed = problems.tables[problems.kind[row]].design[:short], problems.variance[row, :short]
    others = problems.offset[row, :short] + design[:, 1:3] @ np.maximum(model.p[1:3], 0.0)
    white = design[:, 0] * model.p[0]
    # the average reduces the others, too: by an unknown share
    low, high = (observed - others) / white * (1.0 - error), observed / white * (1.0 + error)
    for length in range(2, 2**short + 2):  # a longer one bends the first octave in use, too
        expected = np.array([_share_of_average(length, 2**octave) for octave in range(short)])
        if np.all((low <= expected) & (expected <= high)):
            return True
    return False


def _share_of_average(length: int, m: int) -> float:
    """Return the share of white noise's Allan variance at m samples that an average over `length` samples leaves.

    >>> _share_of_average(2, 1), _share_of_average(2, 4)
    (0.25, 0.8125)
    """
    difference = np.repeat((-1.0, 1.0), m) / m
    return float(0.5 * m * np.sum(np.convolve(difference, np.full(length, 1.0 / length)) ** 2))


def _cost(model: SelectedModel, available: Bools) -> int:
    """Return the cost of a description: its excluded octaves, and its ramp."""
    return int((available & ~model.used).sum() + TERM_COST * model.free[RAMP])


def _same(model: SelectedModel, previous: SelectedModel, available: Bools) -> bool:
    """Return whether a model has the octaves and terms of an earlier one."""
    used = _extended(previous.used, available)
    return np.array_equal(model.used, used) and np.array_equal(model.free, previous.free)


def _with_error(problems: FitProblems, models: Sequence[SelectedModel]) -> list[SelectedModel]:
    """Return the models with the error, or the scale, that makes chi-square its expectation."""
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
        statistic, degrees, powers, excess, scale = float(chi2[row]), int(dof[row]), p[row], 0.0, 1.0
        p_value = float(chdtrc(degrees, statistic))
        if p_value < REJECTED_P:
            powers, excess = _model_error(batch.take([row]), powers, degrees)
        elif not model.plain:
            scale = max(1.0, statistic / degrees)
        fit = replace(model, p=powers, excess=excess, scale=scale, fits=excess <= MAX_ERROR**2)
        result.append(replace(fit, chi2=statistic, dof=degrees, p_value=p_value))
    return result


def _model_error(problem: FitProblems, p: Floats, dof: int) -> tuple[Floats, float]:
    """Return the powers, and the relative variance of the model that makes chi-square its expectation."""
    low, high, excess, start = LEAST_EXCESS, 4.0 * MAX_ERROR**2, 0.0, p[None]
    for _ in range(ERROR_STEPS):
        excess = (low * high) ** 0.5
        prepared = replace(problem, excess=np.array([excess])).prepare()
        start = solve(prepared, problem.free, start=start, rounds=FIT_ROUNDS)
        chi2, _ = misfit(prepared, start)
        low, high = (excess, high) if chi2[0] > dof else (low, excess)
    return solve(prepared, problem.free, start=start)[0], excess
