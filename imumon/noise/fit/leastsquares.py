"""Generalised least squares of the noise model to Allan variances, with weights that the model itself gives.

The model is linear in powers that cannot be negative, sigma^2 = A p, and the covariance of the
estimates depends on the same p (`covariance`). So: weights from the current p, a non-negative solve, again
until it stands. For Gaussian noise this is quasi-likelihood (Wedderburn 1974; McCullagh 1983 of dependent
data), as efficient as maximum likelihood while the octaves' variances are near to gamma distributed.

All of it works on a batch of problems at once: channels, or one channel with different octaves left out, or
with a term held fixed; all of one record, whether its samples are true averages or not. Non-negative means:
every subset of the free terms is solved, and of those without a negative power the one with the least misfit
is the answer. The 1/tau^2 term alone may be negative.

The arrays are small and the rounds many, so that calls cost more than sums: what stays the same from round to
round is worked out once (`SubsetFrame`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np

from imumon.noise.fit.covariance import LEFT, PAIRS, RIGHT, TERMS, Tables, square
from imumon.noise.fit.quantiles import cube_root_score
from imumon.samples import Bools, Floats, Ints

T = len(TERMS)
SIGNED = TERMS.index("Q")  # may be negative: the tail of short correlations, see `choice`
RAMP = TERMS.index("R")
_JITTER = 1e-12  # relative variance added to every octave: rounding
_ROUNDS = 25
_STILL = 1e-5  # relative change of the model at which it stands
_BLOCK = 64  # problems weighed at once: bounds the memory


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

    def frame(self) -> SubsetFrame:
        """What of the problems stays the same whatever their powers."""
        return SubsetFrame(
            self.tables,
            np.concatenate([table.sums[: len(PAIRS)] for table in self.tables]),
            np.equal.outer(self.kind, np.arange(len(self.tables))).astype(np.float64),
            np.stack([table.design for table in self.tables])[self.kind] * self.used[:, :, None],
            self.variance * self.used,
            self.thinning * self.used,
            np.where(self.used, 0.0, 1.0),
            np.where(self.used, _JITTER + self.excess[:, None], 1.0),
        )


@dataclass(frozen=True, slots=True, eq=False)
class SubsetFrame:
    """What of a batch of problems stays the same whatever their powers.

    An octave that is not used has a model, and a variance relative to it, of 1, correlates with no other, and
    its row of the design is zero: so it has no part in any sum, and nothing need be cut out.

    Attributes
    ----------
    tables : covariance tables of the record, one for each kind of samples.
    pairs : (10 kinds, t) 1, the triangles of their pairs, one below the other.
    own : (b, kinds) 1.0 for the kind of each problem, else 0.0.
    design : (b, k, 5) 1, expectation of the Allan variances by terms; zero where they are not used.
    variance : (b, k) unit^2, Allan variances; zero where they are not used.
    thinning : (b, k) 1, as in `Problems`; zero where they are not used.
    idle : (b, k) 1.0 where they are not used, else 0.0.
    floor : (b, k) 1, relative variance beyond the tables'.
    """

    tables: tuple[Tables, ...]
    pairs: Floats
    own: Floats
    design: Floats
    variance: Floats
    thinning: Floats
    idle: Floats
    floor: Floats

    def take(self, index: Ints | Bools | slice) -> SubsetFrame:
        """That of some of the problems, or of one of them more than once."""
        return SubsetFrame(
            self.tables,
            self.pairs,
            self.own[index],
            self.design[index],
            self.variance[index],
            self.thinning[index],
            self.idle[index],
            self.floor[index],
        )

    def model(self, p: Floats) -> Floats:
        """(b, k) unit^2, A p at powers p, (b, 5); without a negative term where that would leave nothing."""
        model = (self.design @ p[:, :, None])[:, :, 0] + self.idle
        if p.min(initial=0.0) >= 0.0:
            return np.asarray(model)
        positive = (self.design @ np.maximum(p, 0.0)[:, :, None])[:, :, 0] + self.idle
        return np.where(model > 0.01 * positive, model, positive)

    def covariance(self, p: Floats, model: Floats) -> Floats:
        """(b, k, k) 1, covariance of the Allan variances at powers p, (b, 5), relative to a model, (b, k)."""
        b, k = model.shape
        noise = np.maximum(p, 0.0)  # what is negative is no noise and has no covariance
        products = self.own[:, :, None] * (noise[:, LEFT] * noise[:, RIGHT])[:, None, :]
        found = products.reshape(b, -1) @ self.pairs
        relative = found[:, square(k)]
        if noise[:, RAMP].any():
            m = 2.0 ** np.arange(k)
            means = np.concatenate([table.means * (m[:, None] * m) for table in self.tables])
            products = self.own[:, :, None] * (noise[:, RAMP, None] * noise[:, :RAMP])[:, None, :]
            relative += np.tensordot(products.reshape(b, -1), means, 1)
        scale = self.thinning / model
        relative *= scale[:, :, None]
        relative *= scale[:, None, :]
        relative.reshape(b, -1)[:, :: k + 1] += self.floor  # the diagonal
        return np.asarray(relative)

    def weigh(self, p: Floats) -> Weighing:
        """Weights of all problems at powers p, (b, 5)."""
        model = self.model(p)
        relative = self.covariance(p, model)
        design = self.design / model[:, :, None]
        weighted = np.asarray(np.linalg.solve(relative, design))
        return Weighing(model, relative, design, weighted, np.asarray(design.transpose(0, 2, 1) @ weighted))


@dataclass(frozen=True, slots=True, eq=False)
class Weighing:
    """What the weights of one p make of the problems; everything relative to the model at p.

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


def blocks(count: int) -> list[slice]:
    """Parts of a batch that are weighed at once."""
    return [slice(begin, begin + _BLOCK) for begin in range(0, count, _BLOCK)]


def misfit(frame: SubsetFrame, p: Floats) -> tuple[Floats, Ints]:
    """Chi-square of what the model leaves, and its degrees of freedom.

    The octaves are made normal first (cube roots, each with its own degrees of freedom): at the longest
    averaging times a few squares are all there is, and their sum has a long tail.

    Returns
    -------
    chi2 : (b,) 1
    dof : (b,) used octaves less terms that are there; 0 and less: nothing to test.
    """
    chi2 = np.empty(len(p))
    for part in blocks(len(p)):
        here = frame.take(part)
        model = here.model(p[part])
        relative = here.covariance(p[part], model)
        variance = np.einsum("bii->bi", relative)
        z = np.where(here.idle > 0.0, 0.0, cube_root_score(here.variance / model, 2.0 / variance))
        z *= np.sqrt(variance)
        chi2[part] = np.einsum("bi,bi->b", z, np.linalg.solve(relative, z[:, :, None])[:, :, 0])
    return chi2, np.asarray((frame.idle == 0.0).sum(axis=1) - (p != 0.0).sum(axis=1))


def first_guess(frame: SubsetFrame, free: Bools) -> Floats:
    """(b, 5) powers to begin with: each of N, B, K as large as the lowest octave allows."""
    ratio = np.full(frame.design.shape, np.inf)
    np.divide(frame.variance[:, :, None], frame.design, out=ratio, where=frame.design > 0.0)
    p = ratio.min(axis=1)
    p[:, 3:] = 0.0
    return np.asarray(np.where(free, p, 0.0) + 1e-9 * p)


def solve(
    frame: SubsetFrame,
    free: Bools,
    *,
    start: Floats | None = None,
    held: Floats | None = None,
    rounds: int = _ROUNDS,
) -> Floats:
    """Powers that fit best.

    Parameters
    ----------
    free : (b, 5) terms that may be there.
    start : (b, 5) powers to begin with.
    held : (b, 5) powers of the terms that are not free; zero without.
    rounds : of weighing and solving, at most.

    Returns
    -------
    (b, 5) unit^2, powers in units of tau0.
    """
    fixed = np.zeros(free.shape) if held is None else np.where(free, 0.0, held)
    p = first_guess(frame, free) if start is None else start.copy()
    p = p if held is None else np.where(free, p, held)
    lost = (((frame.design @ p[:, :, None])[:, :, 0] <= 0.0) & (frame.idle == 0.0)).any(axis=1)
    if lost.any():
        p[lost] += 1e-3 * first_guess(frame, free)[lost]
        p = p if held is None else np.where(free, p, held)
    for part in blocks(len(p)):
        _settle(frame.take(part), p[part], fixed[part], free[part], rounds)
    return p


def _settle(frame: SubsetFrame, p: Floats, fixed: Floats, free: Bools, rounds: int) -> None:
    """Weigh and solve until the powers p, (b, 5), stand, and write them over those to begin with.

    Parameters
    ----------
    fixed : (b, 5) powers of the terms that are not free, 0.0 for those that are.
    free : (b, 5)
    """
    most = int(free.sum(axis=1).max())
    terms = np.argsort(~free, axis=1, kind="stable")[:, :most]  # those that are free first
    there = np.take_along_axis(free, terms, axis=1)
    design = np.take_along_axis(frame.design, terms[:, None, :], axis=2)
    wanted = frame.variance - (frame.design @ fixed[:, :, None])[:, :, 0]
    subsets = _Subsets.of(most)
    at, model = p, frame.model(p)
    open_ = np.arange(len(p))
    for _ in range(rounds):
        relative = frame.covariance(at, model)
        rows = design / model[:, :, None]
        weighted = np.linalg.solve(relative, rows).transpose(0, 2, 1)
        right = (weighted @ (wanted / model)[:, :, None])[:, :, 0]
        found = subsets.solved(weighted @ rows, right, there, terms == SIGNED)
        answer = fixed.copy()
        answer[np.arange(len(at))[:, None], terms] += found
        after = frame.model(answer)
        alive = np.asarray((after > frame.idle).any(axis=1))
        answer = np.where(alive[:, None], answer, at)
        moving = alive & (np.abs(after / model - 1.0).max(axis=1) > _STILL)
        p[open_] = answer
        if not moving.any():
            return
        at, model = answer, after
        if not moving.all():
            open_, frame, fixed = open_[moving], frame.take(moving), fixed[moving]
            terms, there, design, wanted = terms[moving], there[moving], design[moving], wanted[moving]
            at, model = at[moving], model[moving]


@dataclass(frozen=True, slots=True, eq=False)
class _Subsets:
    """Every non-empty subset of f terms.

    Attributes
    ----------
    inside : (s, f) whether a term is in a subset.
    both : (s, f, f) 1.0 where two terms are.
    ridge : (s, f, f) what is added to the diagonal, so that each subset has a solution.
    """

    inside: Bools
    both: Floats
    ridge: Floats

    @classmethod
    @lru_cache(maxsize=T)
    def of(cls, terms: int) -> _Subsets:
        """Those of so many terms."""
        inside = np.array(list(product((False, True), repeat=terms))[1:])
        both = (inside[:, :, None] & inside[:, None, :]).astype(np.float64)
        return cls(inside, both, np.where(inside, 1e-13, 1.0)[:, :, None] * np.eye(terms))

    def solved(self, normal: Floats, right: Floats, there: Bools, signed: Bools) -> Floats:
        """Least squares without negative powers, by solving every subset.

        Parameters
        ----------
        normal, right : (b, f, f) and (b, f), normal equations.
        there : (b, f) terms that may be in a subset.
        signed : (b, f) terms that may be negative.

        Returns
        -------
        (b, f)
        """
        diagonal = np.abs(np.einsum("bii->bi", normal))
        scale = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
        matrix = (normal / (scale[:, :, None] * scale[:, None, :]))[:, None] * self.both + self.ridge
        target = (right / scale)[:, None] * self.inside
        found = np.linalg.solve(matrix, target[..., None])[..., 0]
        gain = np.einsum("bsf,bsf->bs", found, target)
        right_ones = (((found >= 0.0) | signed[:, None]) & (there[:, None] | ~self.inside)).all(axis=2)
        gain = np.where(right_ones, gain, -1.0)
        best = gain.argmax(axis=1)
        rows = np.arange(len(found))
        return np.asarray(np.where(gain[rows, best, None] >= 0.0, found[rows, best], 0.0) / scale)
