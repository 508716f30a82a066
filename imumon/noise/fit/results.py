"""Fit of a channel in SI units, and the classical slope readings of its curve.

Point estimates follow every curve. Limits, status and times are those of the last renewal (`confidence`); the
limits move with their value in between.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import gammaincinv

from imumon.noise.allan import AllanCurve
from imumon.noise.fit.candidate_octaves import QUANTISATION
from imumon.noise.fit.confidence import TOO_SHORT, ChannelConfidence
from imumon.noise.fit.covariance import TERMS
from imumon.noise.fit.leastsquares import RAMP, FitProblems, solve
from imumon.noise.fit.model_selection import SelectedModel, with_selection
from imumon.report import Readings, Status, TimeTo
from imumon.samples import Bools, Floats

VIBRATION_SHARE = 0.1
"""1, share of the Allan variance at some tau that lines must have for the caveat ``vibration``: the curve then
bends visibly. Not critical."""

SLOPE_TOLERANCE = 0.2
"""1, difference from the nominal slope of log sigma over log tau up to which a slope is read. Sensitivity:
halved or doubled, it changes which values appear (gyro y readings K of the record "disturbed")."""

WALK = TERMS.index("K")

_FLICKER_FACTOR = math.sqrt(2.0 * math.log(2.0) / math.pi)
"""Sigma / B of flicker. Sensitivity: halved 50 %, doubled 50 % (gyro z readings B of the record "clean")."""
_FEW_EDF = (1.0, 1.02, 1.06, 1.14, 1.24, 1.45, 1.8, 2.4, 3.0, 3.6, 4.7, 6.4, 8.7, 12.2, 18.0)
_FEW_QUANTILE = (
    *(0.001, 0.0048, 0.0077, 0.0142, 0.02, 0.0305, 0.0475, 0.074),
    *(0.103, 0.132, 0.182, 0.245, 0.314, 0.39, 0.472),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedCoefficient:
    """N, B or K in SI with its 95 % limits; `value` is None unless measured."""

    value: float | None = None
    low: float | None = None
    high: float | None = None
    status: Status = "pending"
    reason: str | None = None
    reason_code: str | None = None  # see `imumon.report.Coefficient`


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChannelFit:
    """Fit of one channel.

    Attributes
    ----------
    N, B, K : channel unit times sqrt(s), 1, 1/sqrt(s).
    quantisation : channel unit times s, Q; None unless the data require it.
    ramp : channel unit per s, R; None unless the data require it.
    chi2, dof, p_value : of the misfit; None while there is nothing to test.
    model : (k,) channel unit, fitted Allan deviation; 0.0 where there is no fit.
    used : (k,) octaves that the fit uses.
    low, high : (k,) channel unit, 95 % limits of the Allan deviation; 0.0 where there is no difference.
    edf : (k,) 1, equivalent degrees of freedom; 0.0 where there is no difference.
    time_to : s, still to record until N, B and K are as precise as requested.
    readings : classical slope readings.
    caveats : ``misfit`` (no description passes, or none with the longest octaves), ``vibration`` (lines, or
        shortest octaves above the model), ``correlated`` (shortest octaves below it), ``quantised``, ``ramp``.
    """

    N: FittedCoefficient
    B: FittedCoefficient
    K: FittedCoefficient
    quantisation: float | None = None
    ramp: float | None = None
    chi2: float | None = None
    dof: int | None = None
    p_value: float | None = None
    model: Floats
    used: Bools
    low: Floats
    high: Floats
    edf: Floats
    time_to: TimeTo = field(default_factory=TimeTo)
    readings: Readings = field(default_factory=Readings)
    caveats: tuple[str, ...] = ()


def pending_fit(octaves: int, reason: str, reason_code: str | None = None) -> ChannelFit:
    """Return the fit of a channel with too little data."""
    c, zeros = FittedCoefficient(reason=reason, reason_code=reason_code), np.zeros(octaves)
    return ChannelFit(N=c, B=c, K=c, model=zeros, used=zeros > 0.0, low=zeros, high=zeros, edf=zeros)


def channel_fits(
    curve: AllanCurve, channels: Sequence[int], problems: FitProblems, known: Sequence[ChannelConfidence]
) -> list[ChannelFit]:
    """Return the fits of some channels of a curve.

    Parameters
    ----------
    problems, known : (b) one per channel, in the order of `channels`.
    """
    whole = replace(problems, used=np.ones_like(problems.used), excess=np.zeros(len(known)))
    problems = with_selection(problems, [item.model for item in known])
    used = problems.used
    prepared = problems.prepare()
    p = solve(prepared, problems.free, start=np.array([item.model.p for item in known]))
    positive = p * np.where(np.arange(len(TERMS)) == QUANTISATION, p > 0.0, 1.0)
    every = whole.prepare()  # with the statistics of the octaves alone, not scaled by a misfit
    model = every.model(positive)
    edf = 2.0 / np.einsum("bii->bi", every.covariance(positive, model))
    model = np.where(used, prepared.model(p), model) + problems.lines - problems.offset
    with np.errstate(divide="ignore"):  # too few differences for a limit: it is infinite
        low = 1.0 / np.sqrt(_share_of_expectation(0.975, edf))
        high = 1.0 / np.sqrt(_few_differences_quantile(edf))
    return [
        _channel(
            curve,
            channel,
            problems.take([row]),
            p[row],
            known[row],
            model[row],
            edf[row],
            (low[row], high[row]),
        )
        for row, channel in enumerate(channels)
    ]


def _channel(
    curve: AllanCurve,
    channel: int,
    problem: FitProblems,
    p: Floats,
    known: ChannelConfidence,
    model: Floats,
    edf: Floats,
    limits: tuple[Floats, Floats],
) -> ChannelFit:
    """Return the fit of one channel; `limits` are those of the Allan deviation over its estimate."""
    tau0, used = curve.tau0, problem.used[0]
    unit = np.sqrt(np.array([tau0, 1.0, 1.0 / tau0, tau0**2, 1.0 / tau0**2]))
    present = curve.terms[:, channel] > 0
    sigma = curve.sigma[:, channel]
    low, high = (np.where(present, sigma * limit, 0.0) for limit in limits)
    selected = known.model
    positive = present & (sigma > 0.0)
    caveats = _caveats(problem, present, selected, p)
    quantised = "quantised" in caveats
    return ChannelFit(
        **{name: _coefficient(p, known, term, float(unit[term])) for term, name in enumerate(TERMS[:3])},
        quantisation=float(math.sqrt(p[QUANTISATION]) * unit[QUANTISATION]) if quantised else None,
        ramp=float(math.sqrt(p[RAMP]) * unit[RAMP]) if p[RAMP] > 0.0 else None,
        chi2=selected.chi2,
        dof=selected.dof if selected.chi2 is not None else None,
        p_value=selected.p_value,
        model=np.sqrt(model),
        used=used,
        low=low,
        high=high,
        edf=np.where(present, edf, 0.0),
        time_to=known.time_to,
        readings=read_slopes(curve.tau[positive], sigma[positive]),
        caveats=caveats,
    )


def _coefficient(p: Floats, known: ChannelConfidence, term: int, unit: float) -> FittedCoefficient:
    """Return one coefficient in SI; its limits move with its value since they were computed.

    A value on its own limit is too early to give: the record holds few differences that decide it.
    """
    status, before = known.status[term], known.model.p[term]
    if term == WALK and known.walk is not None:
        p, before = np.where(np.arange(len(p)) == WALK, known.walk, p), known.walk
    if status == "pending":
        return FittedCoefficient(reason=known.reasons[term])
    high = math.sqrt(known.high[term]) * unit
    if status == "upper_bound":
        return FittedCoefficient(low=0.0, high=high, status=status, reason=known.reasons[term])
    ratio = math.sqrt(p[term] / before) if p[term] > 0.0 and before > 0.0 else 1.0
    value = math.sqrt(before) * ratio * unit
    low, high = math.sqrt(known.low[term]) * unit * ratio, high * ratio
    if not low < value < high:
        return FittedCoefficient(reason=TOO_SHORT)
    return FittedCoefficient(value=value, low=low, high=high, status=status)


def _caveats(problem: FitProblems, present: Bools, selected: SelectedModel, p: Floats) -> tuple[str, ...]:
    """Return the caveats of a fit; see `ChannelFit`."""
    used = problem.used[0]
    first, beyond = int(np.argmax(used)), present & ~used
    long, block = bool(beyond[-1]), bool(beyond[np.argmax(used) :].any())
    sampled = problem.variance + problem.lines - problem.offset
    lines = float((problem.lines / sampled)[problem.used].max(initial=0.0))
    holds = {
        "misfit": not selected.passes or not selected.fits or long,
        "vibration": lines > VIBRATION_SHARE or (block and not long) or (first > 0 and p[QUANTISATION] > 0.0),
        "correlated": first > 0 and p[QUANTISATION] <= 0.0,
        "quantised": first == 0 and p[QUANTISATION] > 0.0,
        "ramp": bool(selected.free[RAMP]),
    }
    return tuple(caveat for caveat, true in holds.items() if true)


def _share_of_expectation(probability: float, dof: Floats) -> Floats:
    """Return the chi-square quantile over its expectation, for any positive degrees of freedom."""
    return np.asarray(2.0 * gammaincinv(dof / 2.0, probability) / dof)


def _few_differences_quantile(dof: Floats) -> Floats:
    """Return the 2.5 % quantile of an Allan variance over its expectation, also for few differences.

    Chi-square of the same equivalent degrees of freedom has too long a tail towards zero there. Several
    squares of unequal weights are less often all small than one and a fraction of equal ones. The table is
    the distribution of the squares with their weights, the eigenvalues of the covariance of the differences
    at R = 8, for flicker and random walk (white noise is up to a third narrower); from 18 degrees of freedom
    on it is that of chi-square. It is lowered by a tenth, because the degrees of freedom are fitted too.

    >>> _few_differences_quantile(np.array([1.0, 1.24, 100.0])).round(3)
    array([0.001, 0.02 , 0.742])
    """
    few = np.interp(np.log(dof), np.log(_FEW_EDF), _FEW_QUANTILE)
    return np.asarray(np.where(dof < _FEW_EDF[-1], few, _share_of_expectation(0.025, dof)))


def read_slopes(tau: Floats, sigma: Floats) -> Readings:
    """Return N, B and K read off a curve in the classical way, for comparison with papers and other tools.

    N is the line of slope -1/2 read at 1 s, K the line of slope +1/2 read at 3 s, B the flat part divided by
    sqrt(2 ln 2 / pi) = 0.664 (IEEE Std 952 annex C; the same as in MATLAB's example). Each line goes through
    the octave whose slope to the next is nearest to the nominal one; None where no slope is within
    `SLOPE_TOLERANCE` of it.

    Parameters
    ----------
    tau : (k,) s
    sigma : (k,) channel unit, all positive.

    >>> tau = 2.0 ** np.arange(-5, 16)
    >>> readings = read_slopes(tau, np.sqrt(0.01**2 / tau + (0.664 * 3e-3) ** 2 + 1e-4**2 * tau / 3))
    >>> print(f"{readings.N:.4f} {readings.B:.4f} {readings.K:.2e}")
    0.0100 0.0034 1.04e-04
    """
    if sigma.size < 3:
        return Readings()
    x, y = np.log(tau), np.log(sigma)
    slope = np.diff(y) / np.diff(x)

    def line(nominal: float, at: float) -> float | None:
        nearest = int(np.argmin(np.abs(slope - nominal)))
        if abs(slope[nearest] - nominal) > SLOPE_TOLERANCE:
            return None
        return float(np.exp(y[nearest] + nominal * (math.log(at) - x[nearest])))

    floor = line(0.0, 1.0)
    return Readings(N=line(-0.5, 1.0), B=None if floor is None else floor / _FLICKER_FACTOR, K=line(0.5, 3.0))
