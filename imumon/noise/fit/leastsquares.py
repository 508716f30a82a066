"""Generalised least squares of the noise model to Allan variances, with weights that the model itself gives.

The model is linear in powers that cannot be negative, sigma^2 = A p, and the covariance of the
estimates depends on the same p (`covariance`). So: weights from the current p, a non-negative solve, again
until it stands. For Gaussian noise this is quasi-likelihood (Wedderburn 1974; McCullagh 1983 of dependent
data), as efficient as maximum likelihood while the octaves' variances are near to gamma distributed.

All of it works on a batch of problems at once: channels, or one channel with different octaves left out, or
with a term held fixed; all of one record, whether its samples are true averages or not. Non-negative means:
every subset of the free terms is solved, and of those without a negative power the one with the least misfit
is the answer. The 1/tau^2 term alone may be negative.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from imumon.noise.fit.covariance import TERMS, Tables
from imumon.noise.fit.quantiles import cube_root_score
from imumon.samples import Bools, Floats, Ints

T = len(TERMS)
SIGNED = TERMS.index("Q")  # may be negative: the tail of short correlations, see `choice`
_JITTER = 1e-12  # relative variance added to every octave: rounding
_ROUNDS = 25
_STILL = 1e-5  # relative change of the model at which it stands
_BLOCK = 64  # problems solved at once: bounds the memory


@dataclass(frozen=True, slots=True, eq=False)
class Problems:
    """A batch of fits over the same octaves.

    Attributes
    ----------
    tables : covariance tables of the record, one for each kind of samples.
    kind : (b,) which of them is that of each problem.
    variance : (b, k) unit^2, Allan variances; anything positive where they are not used.
    thinning : (b, k) 1, sqrt(full differences / differences there are).
    used : (b, k) octaves that count.
    free : (b, 5) terms that may be there.
    excess : (b,) 1, relative variance that every octave has beyond its statistics: what the model does
        not describe.
    """

    tables: tuple[Tables, ...]
    kind: Ints
    variance: Floats
    thinning: Floats
    used: Bools
    free: Bools
    excess: Floats

    def take(self, index: Ints | slice) -> Problems:
        """Some of the problems, or one of them more than once."""
        return Problems(
            self.tables,
            self.kind[index],
            self.variance[index],
            self.thinning[index],
            self.used[index],
            self.free[index],
            self.excess[index],
        )

    @property
    def span(self) -> int:
        """Samples, length of the record."""
        return self.tables[0].span

    @property
    def design(self) -> Floats:
        """(b, k, 5) 1, expectation of the Allan variances by terms."""
        return np.stack([table.design for table in self.tables])[self.kind]

    def applied(self, p: Floats) -> Floats:
        """(b, k) unit^2, A p at powers p, (b, 5)."""
        each = [p @ table.design.T for table in self.tables]
        return each[0] if len(each) == 1 else np.stack(each, axis=1)[np.arange(len(p)), self.kind]

    def covariance(self, p: Floats) -> Floats:
        """(b, k, k) unit^4, covariance of the Allan variances at powers p, (b, 5)."""
        found = np.empty((*self.used.shape, self.used.shape[1]))
        for index, table in enumerate(self.tables):
            rows = self.kind == index
            found[rows] = table.covariance(p[rows], self.thinning[rows])
        return found


@dataclass(frozen=True, slots=True, eq=False)
class Weighing:
    """What the weights of one p make of the problems; everything relative to the model at p.

    Attributes
    ----------
    model : (b, k) unit^2, A p.
    design : (b, k, 5) A / model; zero rows where an octave is not used.
    weight : (b, k, k) inverse of the relative covariance of the used octaves, zero elsewhere.
    relative : (b, k, k) relative covariance of all octaves.
    """

    model: Floats
    design: Floats
    weight: Floats
    relative: Floats


def expected(problems: Problems, p: Floats) -> Floats:
    """(b, k) unit^2, the model; without a negative 1/tau^2 term where that would leave nothing."""
    model = problems.applied(p)
    if not np.any(p[:, SIGNED] < 0.0):
        return model
    positive = problems.applied(np.where(np.arange(T) == SIGNED, np.maximum(p, 0.0), p))
    return np.asarray(np.where(model > 0.01 * positive, model, positive))


def weigh(problems: Problems, p: Floats) -> Weighing:
    """Weights of all problems at powers p, (b, 5)."""
    k = problems.used.shape[1]
    model = expected(problems, p)
    noise = np.where((np.arange(T) == SIGNED) & (p < 0.0), 0.0, p)  # what is no noise has no covariance
    relative = problems.covariance(noise) / (model[:, :, None] * model[:, None, :])
    relative[:, np.arange(k), np.arange(k)] += _JITTER + problems.excess[:, None]
    both = problems.used[:, :, None] & problems.used[:, None, :]
    matrix = np.where(both, relative, np.eye(k))
    weight = np.where(both, np.linalg.inv(matrix), 0.0)
    rows = np.where(problems.used[:, :, None], problems.design / model[:, :, None], 0.0)
    return Weighing(model, rows, weight, relative)


def misfit(problems: Problems, p: Floats) -> tuple[Floats, Ints]:
    """Chi-square of what the model leaves, and its degrees of freedom.

    The octaves are made normal first (cube roots, each with its own degrees of freedom): at the longest
    averaging times a few squares are all there is, and their sum has a long tail.

    Returns
    -------
    chi2 : (b,) 1
    dof : (b,) used octaves less terms that are there; 0 and less: nothing to test.
    """
    at = weigh(problems, p)
    k = at.model.shape[1]
    variance = at.relative[:, np.arange(k), np.arange(k)]
    z = np.where(problems.used, cube_root_score(problems.variance / at.model, 2.0 / variance), 0.0)
    z *= np.sqrt(variance)
    chi2 = np.einsum("bi,bij,bj->b", z, at.weight, z)
    return chi2, np.asarray(problems.used.sum(axis=1) - (p != 0.0).sum(axis=1))


def first_guess(problems: Problems) -> Floats:
    """(b, 5) powers to begin with: each of N, B, K as large as the lowest octave allows."""
    ratio = problems.variance[:, :, None] / problems.design
    ratio = np.where(problems.used[:, :, None], ratio, np.inf)
    p = ratio.min(axis=1)
    p[:, 3:] = 0.0
    return np.asarray(np.where(problems.free, p, 0.0) + 1e-9 * p * (np.arange(T) < 3))


def solve(
    problems: Problems, *, start: Floats | None = None, held: Floats | None = None, rounds: int = _ROUNDS
) -> Floats:
    """Powers that fit best.

    Parameters
    ----------
    start : (b, 5) powers to begin with.
    held : (b, 5) powers of the terms that are not free; zero without.
    rounds : of weighing and solving, at most.

    Returns
    -------
    (b, 5) unit^2, powers in units of tau0.
    """
    parts = []
    for begin in range(0, len(problems.variance), _BLOCK):
        part = slice(begin, begin + _BLOCK)
        parts.append(
            _solve(
                problems.take(part),
                None if start is None else start[part],
                None if held is None else held[part],
                rounds,
            )
        )
    return np.concatenate(parts) if parts else np.zeros((0, T))


def _solve(problems: Problems, start: Floats | None, held: Floats | None, rounds: int) -> Floats:
    p = first_guess(problems) if start is None else start
    lost = np.any((problems.applied(p) <= 0.0) & problems.used, axis=1)
    p = np.where(lost[:, None], p + 1e-3 * first_guess(problems), p)
    if held is not None:
        p = np.where(problems.free, p, held)
    fixed = np.zeros_like(p) if held is None else np.where(problems.free, 0.0, held)
    subsets = _subsets(problems.free)
    settled = p.copy()
    open_ = np.arange(len(p))
    for _ in range(rounds):
        part = problems.take(open_)
        at = weigh(part, settled[open_])
        target = np.where(part.used, (part.variance - part.applied(fixed[open_])) / at.model, 0.0)
        weighted = at.weight @ at.design
        normal = at.design.transpose(0, 2, 1) @ weighted
        right = (weighted.transpose(0, 2, 1) @ target[:, :, None])[:, :, 0]
        answer = _nonnegative(normal, right, part.free, subsets) + fixed[open_]
        model = expected(part, answer)
        empty = ~np.any((model > 0.0) & part.used, axis=1)
        answer[empty] = settled[open_][empty]
        model[empty] = at.model[empty]
        moved = np.max(np.where(part.used, np.abs(model / at.model - 1.0), 0.0), axis=1)
        settled[open_] = answer
        open_ = open_[(moved > _STILL) & ~empty]
        if not open_.size:
            break
    return settled


def _subsets(free: Bools) -> Bools:
    """(s, 5) every non-empty subset of the terms that some problem may have."""
    choices = [(False, True) if free[:, term].any() else (False,) for term in range(T)]
    return np.array([subset for subset in product(*choices) if any(subset)], dtype=bool).reshape(-1, T)


def _nonnegative(normal: Floats, right: Floats, free: Bools, subsets: Bools) -> Floats:
    """(b, 5) least squares without negative powers, by solving every subset of the free terms."""
    diagonal = np.abs(np.einsum("bii->bi", normal))
    scale = np.sqrt(np.maximum(diagonal, 1e-24 * diagonal.max(axis=1, keepdims=True) + 1e-280))
    normal = normal / (scale[:, :, None] * scale[:, None, :])
    right = right / scale
    inside = subsets[None, :, :] & free[:, None, :]
    both = inside[:, :, :, None] & inside[:, :, None, :]
    matrix = np.where(both, normal[:, None], 0.0) + np.where(inside, 1e-13, 1.0)[..., None] * np.eye(T)
    target = np.where(inside, right[:, None], 0.0)
    found = np.linalg.solve(matrix, target[..., None])[..., 0]
    gain = np.einsum("bst,bst->bs", found, target)
    gain = np.where(((found >= 0.0) | (np.arange(T) == SIGNED)).all(axis=2), gain, -1.0)
    best = np.argmax(gain, axis=1)
    chosen = found[np.arange(len(found)), best]
    return np.asarray(np.where(gain.max(axis=1)[:, None] >= 0.0, chosen, 0.0) / scale)
