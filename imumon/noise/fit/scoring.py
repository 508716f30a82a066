"""Fisher's scoring: the likeliest powers of some terms in the bands, at all points of a grid.

The likelihood of the bands is that of gamma variables (`likelihood`). Their expectation is linear in the powers, so
that a few steps suffice (McCullagh and Nelder 1989, section 2.5): the information about parameters i and j is
sum nu/2 slope_i slope_j / S^2. Only the corner of a low-pass is not linear.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from imumon.model.samples import Floats
from imumon.noise.fit.model import NoiseTerm
from imumon.noise.fit.normal_equations import inverse_and_log, invertible
from imumon.noise.fit.observations import Bands

SCORING_STEPS = 3
"""Steps of Fisher's scoring for the powers that are profiled, at each point of the grid. Unit: steps.

Otherwise: the first step starts from the median of the upper bands, which holds B and K: N keeps a part of them.
Origin: with 1 step no limit moves by more than 0.03 % of the distance of the limits; the corner of a low-pass, which
is not linear, needs the others.
"""
LEAST_MOVE = 1e-4
"""Scoring ends before `SCORING_STEPS` where no power moves by more. Unit: of a power.

Otherwise: every point of every grid takes all steps, and fits are slow. Origin: in 359 fits of simulated and real
records, the steps beyond moved no number by more than 5e-8 of itself; with 1e-2 no limit of 15 channels moves by 0.01
% of the distance of the limits.
"""


class BandScoring:
    """Scoring at m points of a grid.

    Parameters
    ----------
    dof : (r,) degrees of freedom of the bands.
    scored : terms whose powers are sought.
    gridded : (m,) powers of all other terms.
    floor : (r,) least expectation of each band.
    low_pass : whether the corner of a low-pass of first order is sought, too.

    Attributes
    ----------
    values : (p + terms, m) p parameters that are sought, the corner last; then the powers of the other terms.
    free : p.
    """

    def __init__(
        self,
        bands: Bands,
        dof: Floats,
        scored: Sequence[NoiseTerm],
        gridded: Mapping[NoiseTerm, Floats],
        floor: Floats,
        *,
        low_pass: bool,
    ) -> None:
        self._power, self._half, self._bend = bands.power, 0.5 * dof, bands.bend
        self._floor = floor[:, None]
        # the corner is a power that no band expects anything of
        corner = [np.zeros(bands.power.size)] * low_pass
        units = [bands.expected[term] for term in scored], [bands.expected[term] for term in gridded]
        self._unit = np.stack([*units[0], *corner, *units[1]], axis=1)
        self._low_pass, self.free = low_pass, len(scored) + low_pass
        powers = np.stack(list(gridded.values()))
        self.values = np.concatenate((np.zeros((self.free, powers.shape[1])), powers))
        slopes = self._unit[:, : self.free].T
        weighted = slopes * self._half
        # what sums over the bands take of the inverse of the model, and of its square
        self._of_inverse = np.concatenate((weighted, [self._half * bands.power]))
        pairs = (weighted[:, None] * slopes).reshape(-1, bands.power.size)
        self._of_square = np.concatenate((weighted * bands.power, pairs))
        # one allocation for all steps, with a row of memory for each band
        self._model, self._work = np.empty((2, bands.power.size, powers.shape[1]))

    def ascend(self, least: Floats, moved: int) -> None:
        """Seek the likeliest values from the present ones.

        Parameters
        ----------
        least : (p, 1) least values.
        moved : how many of the parameters are sought; the others stay as they are.
        """
        values = self.values[: self.free]
        for _ in range(SCORING_STEPS):
            gradient, information, _ = self._derivatives()
            step = _step(gradient[:moved], information[:moved, :moved])
            values[:moved] += step
            np.maximum(values, least, out=values)
            if (np.abs(step) <= LEAST_MOVE * values[:moved]).all():
                break

    def likelihood(self) -> tuple[Floats, Floats]:
        """Return (m,) the log likelihood at the present values, and (p, m) the variances of their estimates."""
        information, misfit = self._derivatives()[1:]
        log = misfit + self._half @ np.log(self._model, out=self._model)
        return -log, np.einsum("iim->im", inverse_and_log(information)[0])

    def _derivatives(self) -> tuple[Floats, Floats, Floats]:
        """Return (p, m) the gradient of the log likelihood, (p, p, m) its information, (m,) sum of nu/2 P/S."""
        model = np.matmul(self._unit, self.values, out=self._model)
        if self._low_pass:
            return self._behind_low_pass(model)
        np.maximum(model, self._floor, out=model)
        inverse = np.divide(1.0, model, out=self._work)
        *of_inverse, misfit = self._of_inverse @ inverse
        of_square = self._of_square @ np.square(inverse, out=inverse)
        information = of_square[self.free :].reshape(self.free, self.free, -1)
        return of_square[: self.free] - of_inverse, invertible(information), misfit

    def _behind_low_pass(self, model: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the same of the bands behind a low-pass, without which they are `model`; writes into it."""
        fall = 1.0 / (1.0 + np.multiply.outer(self._bend, self.values[self.free - 1]))
        model *= fall
        slopes = np.stack((self._unit[:, :1] * fall, -model * self._bend[:, None] * fall))
        np.maximum(model, self._floor, out=model)
        weighted = slopes * (self._half[:, None] / model**2)
        gradient = np.einsum("irm,rm->im", weighted, self._power[:, None] - model)
        information = invertible(np.einsum("irm,jrm->ijm", weighted, slopes))
        return gradient, information, (self._half * self._power) @ np.divide(1.0, model, out=self._work)


def _step(gradient: Floats, information: Floats) -> Floats:
    """Return (p, m) the step of scoring for a gradient (p, m) and an information (p, p, m)."""
    if len(gradient) == 1:  # N alone, the usual case
        return np.asarray(gradient / information[0])
    return np.asarray((inverse_and_log(information)[0] * gradient).sum(axis=1))
