"""Fit of N, B and K to an Allan curve: values, limits, status and time to precision.

    sigma^2(tau) = N^2/tau + (2 ln2/pi) B^2 + K^2 tau/3  [+ 3 Q^2/tau^2 quantisation + R^2 tau^2/2 ramp]

by generalised least squares with the exact covariance (`covariance`, `leastsquares`), over the octaves and
terms that describe the channel (`model_selection`), with limits from score tests (`intervals`).

Every call computes point estimates, which are cheap (`results`). It computes limits, selection and times
(`time_to_precision`) again when the record has grown by 2 %; in between, limits move with their value. What
is measured and what only bounded follows the rules in `confidence`. A channel with too little data is
``pending`` with a reason.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import replace

import numpy as np

from imumon.noise.allan import AllanCurve
from imumon.noise.fit.confidence import OCTAVES_FOR_N, ChannelConfidence, confidences
from imumon.noise.fit.covariance import TERMS, tables
from imumon.noise.fit.leastsquares import FitProblems
from imumon.noise.fit.model_selection import select_models
from imumon.noise.fit.narrow_band_offset import (
    QUIET_AVERAGES,
    band_offset,
    kurtosis_covariance,
    with_quiet_octaves,
)
from imumon.noise.fit.restricted_likelihood import BlockMeans
from imumon.noise.fit.results import ChannelFit, channel_fits, pending_fit
from imumon.noise.fit.slow_regressors import without_slow_regressors
from imumon.noise.statistics.narrow_bands import NarrowBand, QuietDensity
from imumon.samples import Floats

PRECISION_N = 0.01
"""1, requested 95 % half-width of N relative to its value, as in datasheets. Changes `time_to` only. Not
critical."""

PRECISION_B = 0.20
"""1, requested 95 % half-width of B relative to its value. Changes `time_to` only. Not critical."""
PRECISION_K = 0.50
"""1, requested 95 % half-width of K relative to its value. Changes `time_to` only. Not critical."""

RENEWAL_GROWTH = 1.02
"""1, growth of the record after which limits are computed again: they shrink by 1 % meanwhile. Not
critical."""

LEAST_VARIANCE = 1e-100
"""(channel unit)^2; below, squares of variances underflow and the channel is constant. Not critical."""

MAX_VARIANCE = 1e100
"""(channel unit)^2; above, squares of variances overflow and the octave is not used. Not critical."""

MAX_STEPS = 2.0
"""1, multiple of the resolution over sqrt(12), the error of one rounding, up to which the curve may show
quantisation: the sensor may round twice. Not critical."""

HIDDEN_SHARE = 0.5
"""1, share of the resolution below which an Allan deviation at tau0 is rounding, not noise. Rounding of
larger noise adds a variance of 1/12 of its square. Not critical."""


class Estimator:
    """Fits of a growing curve; limits are kept until the record has grown enough to change them.

    The limits belong to one record (`AllanCurve.record`). A curve of another record, or of an unknown one, is
    fitted from scratch, so that no limit of one record is returned for another.

    Parameters
    ----------
    averaged : the samples are true averages over their interval (delta angles), else point samples; one value
        for all channels, or (c,) one for each. A curve may consist of the first few of them.
    precision : requested 95 % half-widths by coefficient, for `time_to`; default `PRECISION_N` and so on.
    time_to : compute `time_to`, which doubles the time of a renewal.
    """

    def __init__(
        self,
        *,
        averaged: bool | Sequence[bool],
        precision: dict[str, float] | None = None,
        time_to: bool = True,
    ) -> None:
        self.averaged, self._time_to = averaged, time_to
        self.precision = {"N": PRECISION_N, "B": PRECISION_B, "K": PRECISION_K} | (precision or {})
        self._record: Hashable = None
        self._confidences: dict[int, ChannelConfidence] = {}
        self._sampled: set[int] = set()  # channels whose octaves all come from the samples

    def fit(
        self,
        curve: AllanCurve,
        *,
        renew: bool | None = None,
        resolution: Sequence[float] | None = None,
        bands: Sequence[Sequence[NarrowBand]] | None = None,
        quiet: Sequence[QuietDensity | None] | None = None,
        kurtosis: Sequence[float] | None = None,
        blocks: BlockMeans | None = None,
    ) -> tuple[ChannelFit, ...]:
        """Fit every channel of a curve.

        Parameters
        ----------
        renew : compute limits, selection and times again; default: where the record has grown by 2 %.
        resolution : (c,) channel unit, least step between two values, 0.0 where there is none. Noise smaller
            than half of it shows in the rounding only, and no coefficient is given.
        bands : narrow bands of the spectrum of each channel, which are subtracted from its curve.
        quiet : density of each channel without them, of the same samples; None: where it has none. The shortest
            octaves come from it beside a strong band.
        kurtosis : (c,) 1, excess kurtosis of the samples about slow changes, which widens the limits.
        blocks : means over stretches of the same record, which separate K from a drift; None: K comes from
            the curve alone.
        """
        if curve.record is None or curve.record != self._record:
            self._confidences.clear()
            self._sampled.clear()
        self._record = curve.record
        octaves, count = len(curve.m), curve.valid.size
        if octaves == 0:
            return (pending_fit(0, "no difference yet"),) * count
        flags = [self.averaged] * count if isinstance(self.averaged, bool) else self.averaged[:count]
        problems, reasons = _problems(curve, flags, resolution, bands, kurtosis, blocks)
        spectral = None if bands is None or quiet is None else _with_spectrum(problems, curve, bands, quiet)
        due = []
        for channel, reason in enumerate(reasons):
            known = self._confidences.get(channel)
            current = known is not None and known.span <= curve.span < known.span * RENEWAL_GROWTH
            if reason is not None:
                self._confidences.pop(channel, None)
            elif known is None or renew or (renew is None and not current):
                due.append(channel)
        if spectral is not None:
            self._choose_octaves(problems, spectral, due)
            own = [c for c in range(count) if c not in self._sampled]
            problems = problems.with_rows_of(spectral, own)
        if due:
            self._renew(problems.take(due), due, curve, blocks, spectrum=bands is not None)
        fits = {row: pending_fit(octaves, *reason) for row, reason in enumerate(reasons) if reason}
        if rows := [row for row, reason in enumerate(reasons) if reason is None]:
            known_rows = [self._confidences[row] for row in rows]
            fits |= zip(rows, channel_fits(curve, rows, problems.take(rows), known_rows), strict=True)
        return tuple(fits[row] for row in range(count))

    def _choose_octaves(self, problems: FitProblems, spectral: FitProblems, due: list[int]) -> None:
        """Note the channels where octaves from the spectrum misfit, or exclude more: a resonance has tails."""
        rows = [c for c in due if (problems.variance[c] != spectral.variance[c]).any()]
        if not rows:
            return
        previous = [self._confidences[c].model if c in self._confidences else None for c in rows]
        both = [select_models(each.take(rows), previous) for each in (problems, spectral)]
        for c, sampled, own in zip(rows, *both, strict=True):
            worse = own.used.sum() < sampled.used.sum() or own.changing or not own.passes
            (self._sampled.add if worse else self._sampled.discard)(c)

    def _renew(
        self,
        problems: FitProblems,
        due: list[int],
        curve: AllanCurve,
        blocks: BlockMeans | None,
        *,
        spectrum: bool,
    ) -> None:
        """Compute selection, limits and times of some channels, one problem each."""
        previous = [self._confidences[c].model if c in self._confidences else None for c in due]
        precision = np.array([self.precision[name] for name in TERMS[:3]]) if self._time_to else None
        own = None if blocks is None else blocks.select(due)
        renewed = confidences(problems, previous, curve.span, curve.tau0, precision, own, spectrum=spectrum)
        self._confidences.update(zip(due, renewed, strict=True))


def fit_curve(
    curve: AllanCurve,
    *,
    averaged: bool | Sequence[bool],
    time_to: bool = True,
    bands: Sequence[Sequence[NarrowBand]] | None = None,
    blocks: BlockMeans | None = None,
) -> tuple[ChannelFit, ...]:
    """Fit N, B and K to every channel of a curve, once; see `Estimator`."""
    return Estimator(averaged=averaged, time_to=time_to).fit(curve, bands=bands, blocks=blocks)


def point_estimates(
    curve: AllanCurve,
    *,
    averaged: Sequence[bool],
    resolution: Sequence[float] | None = None,
    bands: Sequence[Sequence[NarrowBand]] | None = None,
) -> Floats:
    """Return N, B and K of every channel without limits, also where they are not significant.

    Returns
    -------
    (c, 3) SI; NaN for a channel with too little data.
    """
    values = np.full((curve.valid.size, 3), np.nan)
    if not len(curve.m):
        return values
    problems, reasons = _problems(curve, averaged[: curve.valid.size], resolution, bands)
    if rows := [row for row, reason in enumerate(reasons) if reason is None]:
        models = select_models(problems.take(rows), [None] * len(rows), spectrum=bands is not None)
        unit = np.sqrt([curve.tau0, 1.0, 1.0 / curve.tau0])
        values[rows] = [np.sqrt(np.maximum(model.p[:3], 0.0)) * unit for model in models]
    return values


def _problems(
    curve: AllanCurve,
    averaged: Sequence[bool],
    resolution: Sequence[float] | None,
    bands: Sequence[Sequence[NarrowBand]] | None = None,
    kurtosis: Sequence[float] | None = None,
    blocks: BlockMeans | None = None,
) -> tuple[FitProblems, list[tuple[str, str | None] | None]]:
    """Return one problem per channel, and why a channel cannot be fitted (text and code)."""
    kinds = sorted(set(averaged))
    table = tuple(tables(curve.span, len(curve.m), averaged=kind) for kind in kinds)
    terms, variance = curve.terms.T, curve.avar.T
    used = (terms > 0) & (variance > LEAST_VARIANCE) & (variance < MAX_VARIANCE)
    thinning = np.sqrt(table[0].full / np.maximum(terms, 1))
    reasons: list[tuple[str, str | None] | None] = []
    for row, octaves in enumerate(used.sum(axis=1).tolist()):
        if not (terms[row] > 0).any():
            reasons.append(("no difference yet", None))
        elif not octaves:
            reasons.append(("the channel is constant", "constant"))
        elif resolution is not None and variance[row, 0] < (HIDDEN_SHARE * resolution[row]) ** 2:
            reasons.append((f"its resolution of {resolution[row]:.3g} hides the noise", "resolution"))
        elif octaves < OCTAVES_FOR_N:
            reasons.append((f"{octaves} octaves, {OCTAVES_FOR_N} are needed", None))
        else:
            reasons.append(None)
    kind = np.array([kinds.index(kind) for kind in averaged])
    free = np.repeat((np.arange(len(TERMS)) < 3)[None], len(used), axis=0)
    variance, excess = np.where(used, variance, 1.0), np.zeros(len(used))
    (offset, lines), (extra, changing) = np.zeros((2, *used.shape)), np.zeros((2, *used.shape, used.shape[1]))
    if blocks is not None:
        slow, added = without_slow_regressors(curve, blocks)
        variance = np.where(used, slow, 1.0)
        extra += added[:, :, None] * np.eye(used.shape[1])
    for row in range(len(used)):
        if bands is not None and len(bands[row]):
            offset[row], more, changing[row] = band_offset(bands[row], curve.m, curve.tau0)
            lines[row] = offset[row]
            extra[row] += more
        if kurtosis is not None and kurtosis[row] > 0.0:
            white = float(variance[row, 0])
            extra[row] += kurtosis_covariance(white, kurtosis[row], int(curve.valid[row]), curve.m)
    quantisation = np.full(len(used), np.inf)
    if resolution is not None:
        quantisation = (MAX_STEPS * np.array(resolution[: len(used)], dtype=np.float64)) ** 2 / 12.0
    parts = (variance, thinning, used, free, excess, offset, extra, changing, lines, quantisation)
    return FitProblems(table, kind, *parts), reasons


def _with_spectrum(
    problems: FitProblems,
    curve: AllanCurve,
    bands: Sequence[Sequence[NarrowBand]],
    quiet: Sequence[QuietDensity | None],
) -> FitProblems:
    """Return the problems with octaves from the spectrum where these have the smaller errors."""
    variance, offset, extra = problems.variance.copy(), problems.offset.copy(), problems.extra.copy()
    for row, density in enumerate(quiet[: len(variance)]):
        if density is not None and density.averages >= QUIET_AVERAGES:
            _, steady, _ = band_offset(bands[row], curve.m, curve.tau0)
            counts = int(curve.valid[row]), curve.span
            variance[row], offset[row], own = with_quiet_octaves(
                bands[row], density, curve.m, variance[row], steady, *counts
            )
            extra[row] += own - steady
    return replace(problems, variance=variance, offset=offset, extra=extra)
