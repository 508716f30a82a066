"""Generalised least squares of the noise model to Allan variances, with weights that depend on the model.

The model is linear in powers that cannot be negative, sigma^2 = A p, and the covariance of the estimates
depends on the same p (`covariance`). So: weights from the current p, a non-negative solve, repeated until p
no longer changes. For Gaussian noise this is quasi-likelihood (Wedderburn 1974; McCullagh 1983 for dependent
data), as efficient as maximum likelihood while the variances of the octaves are nearly gamma distributed.

Everything works on a batch of problems: channels, or one channel with different octaves excluded, or with a
term held fixed; all of one record, of true averages or point samples. Non-negative least squares solves every
subset of the free terms and returns the solution with the least misfit among those without a negative power.
Only the 1/tau^2 term may be negative. This is our own code because `scipy.optimize.nnls` solves one problem
at a time, cannot have a signed term, and its import costs 50 MB.

The arrays are small and the rounds many, so that calls cost more than arithmetic: what does not change from
round to round is computed once (`PreparedProblems`).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np

from imumon.noise.fit.covariance import LEFT, PAIRS, RIGHT, TERMS, CovarianceTables, triangle_index
from imumon.samples import Bools, Floats, Ints

T = len(TERMS)
SIGNED = TERMS.index("Q")  # may be negative: the tail of short correlations, see `model_selection`
RAMP = TERMS.index("R")

ROUNDING_VARIANCE = 1e-12
"""1, relative variance added to every octave, so that rounding leaves the covariance positive definite. Not
critical."""

ROUNDING_SHARE = 1e-9
"""1, share by which every relative variance is raised, so that the covariance stays positive definite where a
part of rank one, as of a band, is much larger than the rest. Not critical."""

MAX_ROUNDS = 25
"""Rounds of weighting and solving, at most. Sensitivity: halved 1.5 %, doubled 0.3 % (gyro y time_to B of the
record "clean")."""

CONVERGED = 1e-5
"""1, relative change of the model at which the rounds end. Not critical."""

LEAST_MODEL = 0.01
"""1, share of the positive terms that must remain beside a negative term; with less the negative term is
ignored, because the model would vanish. Not critical."""

START_SHARE = 1e-3
"""1, share of `first_guess` added to a start at which the model of an octave vanishes. Not critical."""

GUESS_FLOOR = 1e-9
"""1, share of `first_guess` that terms begin with which are not free, so that no model vanishes. Not
critical."""

LEAST_LEFT = 0.01
"""1, share of an Allan variance that `first_guess` assumes beside its known part. Not critical."""

RIDGE = 1e-13
"""1, added to the diagonal of the scaled normal equations, so that every subset has a solution. Not
critical."""


@dataclass(frozen=True, slots=True, eq=False)
class FitProblems:
    """A batch of fits over the same octaves.

    Attributes
    ----------
    tables : covariance tables of the record, one for each kind of samples.
    kind : (b,) index of the table of each problem.
    variance : (b, k) unit^2, Allan variances; anything positive where unused.
    thinning : (b, k) 1, sqrt(differences of a full record / differences present).
    used : (b, k) octaves that the fit uses.
    free : (b, 5) terms of the model that are fitted.
    excess : (b,) 1, relative variance that every octave has beyond its statistics, for what the model does
        not describe.
    offset : (b, k) unit^2, part of the Allan variances that is known and not fitted: spectral lines.
    extra : (b, k, k) unit^4, covariance beyond that of the noise: of `offset`, and of outliers.
    changing : (b, k, k) unit^4, covariance to add to `extra` where the lines are not steady.
    lines : (b, k) unit^2, Allan variances of the spectral lines in the samples. `offset` is without those of
        octaves that come from the spectrum, and so is `variance`.
    max_quantisation : (b,) unit^2, largest power of quantisation that the resolution allows; inf: unknown.
    """

    tables: tuple[CovarianceTables, ...]
    kind: Ints
    variance: Floats
    thinning: Floats
    used: Bools
    free: Bools
    excess: Floats
    offset: Floats
    extra: Floats
    changing: Floats
    lines: Floats
    max_quantisation: Floats

    def take(self, index: Ints | Bools | list[int]) -> FitProblems:
        """Return some of the problems, in any order, also repeated."""
        return replace(self, **{name: array[index] for name, array in self._arrays().items()})

    def with_rows_of(self, other: FitProblems, rows: list[int]) -> FitProblems:
        """Return the problems with some rows of others."""
        mixed = {name: array.copy() for name, array in self._arrays().items()}
        for name, array in mixed.items():
            array[rows] = getattr(other, name)[rows]
        return replace(self, **mixed)

    def _arrays(self) -> dict[str, Any]:
        """Return the fields with one row per problem."""
        return {each.name: getattr(self, each.name) for each in fields(self) if each.name != "tables"}

    @property
    def span(self) -> int:
        """Samples, length of the record."""
        return self.tables[0].span

    def with_changing_lines(self, rows: Bools) -> FitProblems:
        """Return the problems with the covariance of lines that change, in some rows."""
        return replace(self, extra=self.extra + np.where(rows[:, None, None], self.changing, 0.0))

    def prepare(self) -> PreparedProblems:
        """Return the parts of the problems that do not depend on the powers."""
        return PreparedProblems(
            self.tables,
            np.concatenate([table.sums[: len(PAIRS)] for table in self.tables]),
            np.equal.outer(self.kind, np.arange(len(self.tables))).astype(np.float64),
            np.stack([table.design for table in self.tables])[self.kind] * self.used[:, :, None],
            self.variance * self.used,
            self.thinning * self.used,
            np.where(self.used, 0.0, 1.0),
            np.where(self.used, ROUNDING_VARIANCE + self.excess[:, None], 1.0),
            self.offset * self.used,
            self.extra * (self.used[:, :, None] & self.used[:, None, :]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class PreparedProblems:
    """The parts of a batch of problems that do not depend on the powers.

    An unused octave has a model and a relative variance of 1, correlates with no other, and its row of the
    design is zero: it contributes to no sum and need not be removed from the arrays.

    Attributes
    ----------
    tables : covariance tables of the record, one for each kind of samples.
    pairs : (10 kinds, t) 1, the triangles of their pairs, one table after the other.
    own : (b, kinds) 1.0 for the kind of each problem, else 0.0.
    design : (b, k, 5) 1, expectation of the Allan variances by terms; zero where unused.
    variance : (b, k) unit^2, Allan variances; zero where unused.
    thinning : (b, k) 1, as in `FitProblems`; zero where unused.
    unused : (b, k) 1.0 where an octave is unused, else 0.0.
    floor : (b, k) 1, relative variance beyond the tables'.
    offset : (b, k) unit^2, as in `FitProblems`; zero where unused.
    extra : (b, k, k) unit^4, as in `FitProblems`; zero where unused.
    """

    tables: tuple[CovarianceTables, ...]
    pairs: Floats
    own: Floats
    design: Floats
    variance: Floats
    thinning: Floats
    unused: Floats
    floor: Floats
    offset: Floats
    extra: Floats

    def take(self, index: Ints | Bools) -> PreparedProblems:
        """Return those of some of the problems, in any order, also repeated."""
        names = ("own", "design", "variance", "thinning", "unused", "floor", "offset", "extra")
        arrays = (getattr(self, name) for name in names)
        return PreparedProblems(self.tables, self.pairs, *(array[index] for array in arrays))

    def model(self, p: Floats) -> Floats:
        """Return (b, k) unit^2, A p + offset at powers p, (b, 5), without a negative term where A p would vanish."""
        known = self.offset + self.unused
        model = (self.design @ p[:, :, None])[:, :, 0] + known
        if p.min(initial=0.0) >= 0.0:
            return np.asarray(model)
        positive = (self.design @ np.maximum(p, 0.0)[:, :, None])[:, :, 0] + known
        return np.where(model > LEAST_MODEL * positive, model, positive)

    def covariance(self, p: Floats, model: Floats) -> Floats:
        """Return (b, k, k) 1, the covariance at powers p, (b, 5), relative to a model, (b, k)."""
        b, k = model.shape
        noise = np.maximum(p, 0.0)  # a negative term is no noise and has no covariance
        products = self.own[:, :, None] * (noise[:, LEFT] * noise[:, RIGHT])[:, None, :]
        triangles = products.reshape(b, -1) @ self.pairs
        relative = triangles[:, triangle_index(k)]
        if noise[:, RAMP].any():
            m = 2.0 ** np.arange(k)
            means = np.concatenate([table.means * (m[:, None] * m) for table in self.tables])
            products = self.own[:, :, None] * (noise[:, RAMP, None] * noise[:, :RAMP])[:, None, :]
            relative += np.tensordot(products.reshape(b, -1), means, 1)
        scale = self.thinning / model
        relative *= scale[:, :, None]
        relative *= scale[:, None, :]
        relative += self.extra / (model[:, :, None] * model[:, None, :])
        diagonal = relative.reshape(b, -1)[:, :: k + 1]
        diagonal += self.floor + ROUNDING_SHARE * diagonal
        return np.asarray(relative)

    def weight(self, p: Floats) -> WeightedProblems:
        """Return the problems weighted for powers p, (b, 5)."""
        model = self.model(p)
        relative = self.covariance(p, model)
        design = self.design / model[:, :, None]
        weighted = np.asarray(np.linalg.solve(relative, design))
        return WeightedProblems(model, relative, design, weighted, design.transpose(0, 2, 1) @ weighted)


@dataclass(frozen=True, slots=True, eq=False)
class WeightedProblems:
    """Weights and normal equations at one p; everything relative to the model at p.

    Attributes
    ----------
    model : (b, k) unit^2, A p.
    relative : (b, k, k) V, relative covariance.
    design : (b, k, 5) A / model.
    weighted : (b, k, 5) V^-1 A.
    normal : (b, 5, 5) A' V^-1 A.
    """

    model: Floats
    relative: Floats
    design: Floats
    weighted: Floats
    normal: Floats


def cube_root_score(ratio: Floats, dof: Floats) -> Floats:
    """Return the standard normal score of chi-square over its expectation (Wilson & Hilferty 1931).

    Unlike the exact quantile it is finite and smooth for any ratio >= 0 and any real degrees of freedom.
    """
    h = 2.0 / (9.0 * dof)
    return np.asarray((np.cbrt(ratio) - (1.0 - h)) / np.sqrt(h))


def misfit(prepared: PreparedProblems, p: Floats) -> tuple[Floats, Ints]:
    """Return chi-square of the residuals and its degrees of freedom.

    The octaves are made normal first (cube roots, each with its own degrees of freedom): at the longest
    averaging times a few squares are all there is, and their sum has a long tail.

    Returns
    -------
    chi2 : (b,) 1
    dof : (b,) used octaves less terms that are not zero; 0 and less: nothing to test.
    """
    model = prepared.model(p)
    relative = prepared.covariance(p, model)
    variance = np.einsum("bii->bi", relative)
    z = np.where(prepared.unused > 0.0, 0.0, cube_root_score(prepared.variance / model, 2.0 / variance))
    z *= np.sqrt(variance)
    chi2 = np.einsum("bi,bi->b", z, np.linalg.solve(relative, z[:, :, None])[:, :, 0])
    return chi2, np.asarray((prepared.unused == 0.0).sum(axis=1) - (p != 0.0).sum(axis=1))


def first_guess(prepared: PreparedProblems, free: Bools) -> Floats:
    """Return (b, 5) powers to begin with: each of N, B, K as large as the lowest octave allows."""
    ratio = np.full(prepared.design.shape, np.inf)
    left = np.maximum(prepared.variance - prepared.offset, LEAST_LEFT * prepared.variance)
    np.divide(left[:, :, None], prepared.design, out=ratio, where=prepared.design > 0.0)
    p = ratio.min(axis=1)
    p[:, 3:] = 0.0
    return np.asarray(np.where(free, p, 0.0) + GUESS_FLOOR * p)


def solve(
    prepared: PreparedProblems,
    free: Bools,
    *,
    start: Floats | None = None,
    held: Floats | None = None,
    rounds: int = MAX_ROUNDS,
) -> Floats:
    """Return the powers that fit best.

    Parameters
    ----------
    free : (b, 5) terms that are fitted.
    start : (b, 5) powers to begin with.
    held : (b, 5) powers of the terms that are not free; default: zero.
    rounds : of weighting and solving, at most.

    Returns
    -------
    (b, 5) unit^2, powers in units of tau0.
    """
    fixed = np.zeros(free.shape) if held is None else np.where(free, 0.0, held)
    p = first_guess(prepared, free) if start is None else start.copy()
    p = p if held is None else np.where(free, p, held)
    vanishes = (((prepared.design @ p[:, :, None])[:, :, 0] <= 0.0) & (prepared.unused == 0.0)).any(axis=1)
    if vanishes.any():
        p[vanishes] += START_SHARE * first_guess(prepared, free)[vanishes]
        p = p if held is None else np.where(free, p, held)
    if len(p):
        _iterate(prepared, p, fixed, free, rounds)
    return p


def _iterate(prepared: PreparedProblems, p: Floats, fixed: Floats, free: Bools, rounds: int) -> None:
    """Weight and solve until the powers p, (b, 5), no longer change; p is overwritten.

    `fixed`, (b, 5), holds the powers of the terms that are not free, and 0.0 for those that are.
    """
    most = int(free.sum(axis=1).max())
    terms = np.argsort(~free, axis=1, kind="stable")[:, :most]  # free terms first
    fitted = np.take_along_axis(free, terms, axis=1)
    design = np.take_along_axis(prepared.design, terms[:, None, :], axis=2)
    target = prepared.variance - prepared.offset - (prepared.design @ fixed[:, :, None])[:, :, 0]
    at, model = p, prepared.model(p)
    rows = np.arange(len(p))  # problems that have not converged
    for _ in range(rounds):
        relative = prepared.covariance(at, model)
        scaled = design / model[:, :, None]
        weighted = np.linalg.solve(relative, scaled).transpose(0, 2, 1)
        right = (weighted @ (target / model)[:, :, None])[:, :, 0]
        solution = _solve_subsets(weighted @ scaled, right, fitted, terms == SIGNED)
        powers = fixed.copy()
        powers[np.arange(len(at))[:, None], terms] += solution
        after = prepared.model(powers)
        fitted_part = after - prepared.offset - prepared.unused
        nonzero = np.asarray((fitted_part > 0.0).any(axis=1) & (after > 0.0).all(axis=1))
        powers = np.where(nonzero[:, None], powers, at)
        moving = nonzero & (np.abs(after / model - 1.0).max(axis=1) > CONVERGED)
        p[rows] = powers
        if not moving.any():
            return
        at, model = powers, after
        if not moving.all():
            rows, prepared, fixed = rows[moving], prepared.take(moving), fixed[moving]
            terms, fitted, design, target = terms[moving], fitted[moving], design[moving], target[moving]
            at, model = at[moving], model[moving]


@lru_cache(maxsize=T)
def _subsets(terms: int) -> tuple[Bools, Floats, Floats]:
    """Return every non-empty subset of f terms.

    Returns
    -------
    inside : (s, f) whether a term is in a subset.
    both : (s, f, f) 1.0 where two terms are.
    ridge : (s, f, f) added to the diagonal, so that each subset has a solution.
    """
    inside = np.array(list(product((False, True), repeat=terms))[1:])
    both = (inside[:, :, None] & inside[:, None, :]).astype(np.float64)
    return inside, both, np.where(inside, RIDGE, 1.0)[:, :, None] * np.eye(terms)


def _solve_subsets(normal: Floats, right: Floats, fitted: Bools, signed: Bools) -> Floats:
    """Return (b, f) the least squares solution without negative powers, from those of all subsets.

    Parameters
    ----------
    normal, right : (b, f, f) and (b, f), normal equations.
    fitted : (b, f) terms that may be in a subset.
    signed : (b, f) terms that may be negative.
    """
    inside, both, ridge = _subsets(right.shape[1])
    diagonal = np.abs(np.einsum("bii->bi", normal))
    scale = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    matrix = (normal / (scale[:, :, None] * scale[:, None, :]))[:, None] * both + ridge
    target = (right / scale)[:, None] * inside
    solutions = np.linalg.solve(matrix, target[..., None])[..., 0]
    gain = np.einsum("bsf,bsf->bs", solutions, target)
    allowed = (((solutions >= 0.0) | signed[:, None]) & (fitted[:, None] | ~inside)).all(axis=2)
    gain = np.where(allowed, gain, -1.0)
    best = gain.argmax(axis=1)
    rows = np.arange(len(solutions))
    return np.asarray(np.where(gain[rows, best, None] >= 0.0, solutions[rows, best], 0.0) / scale)
