"""Statement of a fit: what the model of a channel says in SI, with status, reasons and the curve that follows.

A model (`search.Model`) is a likelihood of powers in units of tau0. Three things are stated of it:

- *Coefficients* in SI with 95 % limits and a status. The coefficient of power P is sqrt(P) times tau0 to the power of
  minus the slope of its Allan deviation (`coefficients`): N = sqrt(P tau0), B = sqrt(P), K = sqrt(P / tau0).

  | status | N | B, K |
  |---|---|---|
  | measured | power over standard error exceeds sqrt(`EVIDENCE`) | twice the log likelihood ratio exceeds `EVIDENCE` |
  | its value | root of the mean; a power is nearly log-normal, so are its limits | median; of K given that it shows |
  | its limits | 1.96 standard errors | 2.5 and 97.5 % quantiles |
  | upper_bound | root of mean and 1.96 standard errors | 97.5 % quantile |
  | pending | – | in the first `LEAST_B_K_S` seconds |

  M is measured where its odds exceed `CERTAIN_ODDS` and the record bounds its time constant. Where B, K and M are
  needed together but none of them alone, each is ``indistinct``, with the 97.5 % quantile as its bound; so is K where M
  in its place describes the record better. Where the drawn
  model leaves the limits of the curve (`curve_statement`), those of them that decide it there become bounds.

  Q is measured as N is, at the likeliest point of the grid and with normal limits of its power, or absent.

  Where the record does not show one of B and K, the upper limit of the other, and of N, is the greater one of those
  with it and without it (`likelihood.without`): a flat prior gives zero no share, and takes from the others what it
  counts there.

  A bound is the 97.5 % quantile and not the 95 % one: a flat prior pulls towards zero, and the 95 % quantile is below
  the truth in up to 15 % of records where B just begins to show.

  The variance of N^2 has three parts: that of the likelihood; excess kurtosis g of n independent samples, which adds
  g/n to its relative variance (Fisher 1930), as if N^2 itself varied, and of which a negative one is not credited; and
  the scatter between choices of the highest frequency (`ModelSearch._upper_error`). Where no filter explains the upper
  end, the limits of N hold its levels there (`ModelSearch._levels`), and it has no grade (`NOT_WHITE`).

  Popcorn noise changes no coefficient: the jumps are M, with levels and times beside it (`popcorn`). The distance of
  the levels comes from the likeliest M and not from its median, because shares and times are those of the same series.
- *Regressors*: what moves the mean, as slopes and sizes with their limits.
- *Caveats*: what limits the meaning of the numbers.

What follows for the curve is in `curve_statement`; which oscillations and lines there are, in `oscillations`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import ndtr, ndtri

from imumon.model.coefficients import LIMIT_95, NOISE, NOT_WHITE, SIGNIFICANT, Estimate, MarkovEstimate
from imumon.model.samples import Bools, Floats
from imumon.noise.fit.hump import Hump, line_bands
from imumon.noise.fit.likelihood import (
    CHANCE,
    EVIDENCE,
    LIMITS,
    Surface,
    evidence,
    grid_mean,
    joint_evidence,
    quantiles,
    upper_limit,
    without,
)
from imumon.noise.fit.model import GRIDDED, QUANTISATION, VIBRATION, WHITE, NoiseTerm, WanderingLine
from imumon.noise.fit.model_curve import (
    VISIBLE,
    moved_variances,
)
from imumon.noise.fit.observations import meeting_frequency
from imumon.noise.fit.oscillations import moved, periods
from imumon.noise.fit.popcorn import TwoLevels, two_levels
from imumon.noise.fit.regressors import BENT, COLLINEAR, OSCILLATION
from imumon.noise.fit.search import Model, ModelChoice
from imumon.noise.fit.time_to_precision import seconds_to
from imumon.noise.noise_sums import NoiseSums
from imumon.noise.spectrum.spectral_lines import mains
from imumon.noise.validity_groups import ROUNDING_VARIANCE

LEAST_B_K_S = 10.0
"""B and K are pending before. Unit: s.

Otherwise: a filter, a vibration and the start of a stream look like B and K for some seconds. Chosen: ten periods of
a vibration of 1 Hz (`real_effects.py`).
"""

ROOT_GROWTH = 1.4
"""Power of K with which the root of its evidence grows where it begins to show.

Otherwise: with 1, values near the threshold are a tenth smaller. Origin: a coefficient with R times the expected noise
has the evidence R - 1 - ln R, whose root grows with the power 0.7 of R - 1 from 3 to 6.
"""

NOT_SHOWN = "the record does not show it"
MOVES_SLOWLY = "a mean that moves slowly explains it"
NO_LEVEL = "the noise is not white: the limits hold its levels at the highest frequencies"
TOO_SHORT = "the record is too short"

# ------------------------------------------------------------------------------------------------ what is stated


@dataclass(frozen=True, slots=True, kw_only=True)
class RegressorEstimate:
    """Coefficient of a regressor: what moves the mean and is not noise.

    Attributes
    ----------
    name : ``drift``, ``temperature``, ``temperature_2`` (its square), ``temperature_3``, ``settling`` or
        ``step``; of a bias curve ``degree 0`` and ``degree 1``.
    value, low, high : channel unit, per s of a drift, per degC (its square, its cube) of a temperature; 95 % limits.
    time_constant_s : s, of a settling.
    """

    name: str
    value: float
    low: float
    high: float
    time_constant_s: float | None = None

    @property
    def error(self) -> float:
        """Standard error, in the unit of the value."""
        return (self.high - self.low) / (2.0 * LIMIT_95)

    @property
    def sigma(self) -> float:
        """Standard errors by which it differs from zero; 0.0 where its limits coincide: then nothing is known of it."""
        return abs(self.value) / self.error if self.error > 0.0 else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class StepEstimate:
    """Step of the mean.

    Attributes
    ----------
    before, after : channel unit, mean of the segment before the step, and the same with the step.
    sigma : standard errors of the step.
    """

    before: float
    after: float
    sigma: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChannelFit:
    """Fit of one channel.

    Attributes
    ----------
    coefficients : by letter: N, B and K always; others where the data show them. In SI, without a unit.
    markov : Gauss–Markov noise; None: the data do not ask for it.
    jumps : channel unit and s, the levels of Gauss–Markov noise that is popcorn noise; None: it does not show them.
    chi2, dof, p_value : of the misfit; None while there is nothing to test.
    model : (k,) channel unit, Allan deviation of everything that the fit states; 0.0 where there is no fit.
    shares : (k,) (channel unit)^2, Allan variance of each part of `model`: of each term by its letter, of ``filter``
        (what a filter in the sensor takes, negative), ``lines`` and ``columns`` (what moves the mean).
    noise : (k,) channel unit, Allan deviation of N, B, K and M alone.
    used : (k,) octaves in the range of frequencies that the fit uses.
    low, high : (k,) channel unit, 95 % limits of the Allan deviation; 0.0 where there is no difference.
    edf : (k,) 1, equivalent degrees of freedom; 0.0 where there is no difference.
    time_to : s by letter, still to record until a coefficient is as precise as requested, from the time of the fit on;
        None: it is not measured, hardly known, not reached within a year, or not asked for (`time_to_precision`).
    readings : classical slope readings by letter; None: the curve has none.
    caveats : ``misfit`` (chance explains what the model leaves in less than 1 % of records; limits are wider only
        where the bands alone reject the model, see `search.ModelSearch`), ``model_misses`` (the drawn model leaves the
        limits of the curve), ``vibration`` (lines that bend the curve), ``correlated`` (a filter), ``not_white``
        (neither a filter nor a term explains the upper end), ``quantised``, ``ramp``, ``oscillation``, ``popcorn``
        (Gauss–Markov noise that jumps between two levels), ``unguarded`` (`estimator.UNGUARDED`).
    regressors : what moves the mean, with its limits.
    no_slope : why there is no temperature slope: "", ``no_temperature``, ``small_range`` or ``collinear``.
    explained : share of the variance of the means beyond white noise that follows the temperature; None: unknown.
    step : sudden change of the mean; None: there is none.
    lines_hz : Hz, lines of the spectrum that are no part of the noise.
    hump_hz : Hz, range of frequencies of a hum or a vibration, which is no noise of the sensor; None: there is none.
    hump_mains_hz : Hz, mains and harmonics that fold into this range.
    oscillations_s : s, periods of slow oscillations that are left out.
    highest_hz : Hz, highest frequency in use; None without a fit.
    """

    coefficients: Mapping[str, Estimate]
    markov: MarkovEstimate | None = None
    jumps: TwoLevels | None = None
    chi2: float | None = None
    dof: int | None = None
    p_value: float | None = None
    model: Floats
    noise: Floats
    used: Bools
    low: Floats
    high: Floats
    edf: Floats
    time_to: Mapping[str, float | None] = field(default_factory=lambda: dict.fromkeys(NOISE))
    readings: Mapping[str, float | None] = field(default_factory=lambda: dict.fromkeys(NOISE))
    caveats: tuple[str, ...] = ()
    regressors: tuple[RegressorEstimate, ...] = ()
    no_slope: str = "no_temperature"
    explained: float | None = None
    step: StepEstimate | None = None
    lines_hz: tuple[float, ...] = ()
    hump_hz: tuple[float, float] | None = None
    hump_mains_hz: tuple[float, ...] = ()
    oscillations_s: tuple[float, ...] = ()
    highest_hz: float | None = None
    shares: Mapping[str, Floats] = field(default_factory=dict)

    @property
    def N(self) -> Estimate:
        """White noise, channel unit times sqrt(s)."""
        return self.coefficients["N"]

    @property
    def B(self) -> Estimate:
        """Flicker, channel unit."""
        return self.coefficients["B"]

    @property
    def K(self) -> Estimate:
        """Random walk, channel unit over sqrt(s)."""
        return self.coefficients["K"]

    @property
    def follows_temperature(self) -> bool:
        """Whether the mean follows the temperature significantly."""
        slope = self.regressor("temperature")
        return slope is not None and slope.sigma > SIGNIFICANT

    def regressor(self, name: str) -> RegressorEstimate | None:
        """Return the last regressor of a name; None if it is not in use."""
        return next((regressor for regressor in reversed(self.regressors) if regressor.name == name), None)


def pending_fit(octaves: int, reason: str, reason_code: str | None = None) -> ChannelFit:
    """Return the fit of a channel with too little data."""
    pending = dict.fromkeys(NOISE, Estimate(reason=reason, reason_code=reason_code))
    zeros = np.zeros(octaves)
    return ChannelFit(
        coefficients=pending, model=zeros, noise=zeros, used=zeros > 0.0, low=zeros, high=zeros, edf=zeros
    )


@dataclass(frozen=True, slots=True, eq=False)
class FittedModel:
    """What a model states, whatever the curve, and what is needed of it afterwards.

    The observations, twenty times as large, are not kept until the next fit.

    Attributes
    ----------
    fit : without a curve.
    surface : likelihood of the powers.
    choice : for the next fit.
    error : relative error of the model in every band.
    meeting, highest : cycles per sample, least and highest frequency of the spectrum that counts.
    moved : (2, j) the Allan variance of what the regressors move; see `model_curve.moved_variances`.
    hump : what no term explains, and whose band is left out; None: there is none.
    """

    fit: ChannelFit
    surface: Surface
    choice: ModelChoice
    error: float
    meeting: float
    highest: float
    moved: Floats
    hump: Hump | None


def state_model(
    sums: NoiseSums,
    channel: int,
    model: Model,
    kurtosis: float,
    precision: Mapping[str, float] | None,
    resolution: float = 0.0,
    *,
    counted: bool = False,
) -> FittedModel:
    """Return what the model of a channel states, in SI.

    Parameters
    ----------
    sums : those of the model.
    kurtosis : 1, excess kurtosis of the samples.
    precision : 1, requested relative half-widths by letter; None: no times are wanted.
    resolution : channel unit, least step between two values, 0.0 where there is none.
    counted : the values are differences of an angle in counts coarser than its noise.
    """
    tau0, series = sums.tau0, model.slow.series
    regressors, collinear = _regressors(model, tau0)
    rounding = 0.0 if counted else _rounding(model, resolution)
    coefficients = _coefficients(model, kurtosis / series.samples, series.samples, tau0, rounding)
    if counted:
        of_counts = _of_counts(resolution, model.surface.sensor_powers[WHITE], series.samples)
        coefficients["Q"] = of_counts.scaled(QUANTISATION.coefficient_scale(tau0))
    # a drift that cannot be distinguished from the effect of the temperature is no rate ramp, whether the temperature
    # is a regressor that is correlated with it or a straight line in time
    if not collinear and model.slow.no_temperature != "collinear":
        coefficients |= _rate_ramp(regressors)
    highest = float(model.likelihood.bands.top.max())
    time_to = {} if precision is None else _times_to(model, coefficients, precision, highest, tau0)
    markov = _markov(model, coefficients, tau0)
    single = {
        letter: part for letter, part in coefficients.items() if markov is None or part is not markov.sigma
    }
    jumps = _jumps(model, tau0) if markov is not None and markov.sigma.status == "measured" else None
    hump_hz, periods_s, none = _hump_range(model, tau0), periods(model, tau0), np.zeros(0)
    caveats = {
        "misfit": model.p_value < CHANCE,
        "correlated": model.levels is None and (model.upper_end.window > 1 or model.upper_end.low_pass),
        NOT_WHITE: model.levels is not None,
        "quantised": "Q" in coefficients,
        "oscillation": bool(periods_s),
        "popcorn": jumps is not None,
    }
    fit = ChannelFit(
        coefficients=single,
        markov=markov,
        jumps=jumps,
        chi2=model.misfit,
        dof=round(model.dof),
        p_value=model.p_value,
        model=none,
        noise=none,
        used=none > 0.0,
        low=none,
        high=none,
        edf=none,
        time_to={**dict.fromkeys(NOISE), **time_to},
        caveats=tuple(caveat for caveat, applies in caveats.items() if applies),
        regressors=regressors,
        no_slope="collinear" if collinear else model.slow.no_temperature,
        explained=_explained(model),
        step=_step(model, regressors),
        lines_hz=tuple((line_bands(sums, channel)[:, 0] / tau0).tolist()),
        hump_hz=hump_hz,
        hump_mains_hz=() if hump_hz is None else _mains(*hump_hz, 1.0 / tau0),
        oscillations_s=periods_s,
        highest_hz=highest / tau0,
    )
    return FittedModel(
        fit,
        model.surface,
        model.choice,
        model.error,
        meeting_frequency(series),
        highest,
        moved_variances(series, moved(model)),
        model.hump,
    )


def _hump_range(model: Model, tau0: float) -> tuple[float, float] | None:
    """Return the range of a hump, or of a line that wanders, Hz; None without one."""
    band, timed = model.choice.band, model.timed
    if band is not None:
        return band.low / tau0, band.high / tau0
    if timed is not None and timed.is_certain and isinstance(timed.term, WanderingLine):
        low, high = timed.term.range
        return low / tau0, high / tau0
    return None


def _mains(low: float, high: float, rate: float) -> tuple[float, ...]:
    """Return the mains and harmonics that fold into a range of frequencies, Hz."""
    return mains(0.5 * (low + high), rate, high - low)[0]


def _times_to(
    model: Model,
    coefficients: Mapping[str, Estimate],
    precision: Mapping[str, float],
    highest: float,
    tau0: float,
) -> dict[str, float | None]:
    """Return the seconds still to record until coefficients are as precise as requested."""
    # no half-width: not measured; one of 0 would be a value without an error, which no record gives
    widths = {letter: coefficients[letter].half_width or math.inf for letter in precision}
    samples = model.slow.series.samples
    return seconds_to(model.surface.sensor_powers, widths, samples, tau0, highest, precision)


# ------------------------------------------------------------------------------------------------ coefficients


def _coefficients(
    model: Model, kurtosis_of_mean: float, samples: float, tau0: float, rounding: float
) -> dict[str, Estimate]:
    """Return the coefficients of all terms in SI: N, B and K always, Q where it shows.

    Parameters
    ----------
    kurtosis_of_mean : 1, excess kurtosis over the number of samples, which adds to the relative variance of N^2: the
        powers of independent samples all gain the fourth cumulant of a sum of squares.
    rounding : (channel unit)^2, variance of the errors of rounding.
    """
    surface = model.surface

    def white_power(part: Surface) -> tuple[float, float]:
        """Return the power of white noise, with its error."""
        mean, error = grid_mean(part, part.scored[WHITE], part.scored_variances[WHITE])
        relative = math.hypot(math.sqrt(max(kurtosis_of_mean, 0.0)), model.upper_error)
        return float(mean), math.hypot(float(error), float(mean) * relative)

    mean, error = white_power(surface)
    # N is that of the samples as they are, which is what a filter sees. The limits hold that of the sensor before its
    # rounding, too, which only the lower one shows.
    before, rounded = max(mean - rounding, 0.0), _of_power(mean, error)
    for term in GRIDDED:
        rest = without(surface, term) if evidence(surface, term) <= EVIDENCE else None
        if rest is not None and rounded.high is not None:
            high = _of_power(*white_power(rest)).high
            rounded = replace(rounded, high=max(rounded.high, high or 0.0))
    unrounded = _of_power(before, math.hypot(error, _rounding_error(before, rounding)))
    white = replace(rounded, low=unrounded.low) if unrounded.value else replace(unrounded, high=rounded.high)
    if model.levels is not None and white.low is not None and white.high is not None:
        least, greatest = (math.sqrt(mean * level) for level in model.levels)
        low, high = min(white.low, least), max(white.high, greatest)
        white = replace(white, low=low, high=high, reason=NO_LEVEL, reason_code=NOT_WHITE)
    estimates: dict[NoiseTerm, Estimate] = {WHITE: white}
    if samples * tau0 < LEAST_B_K_S:
        estimates |= dict.fromkeys(GRIDDED, Estimate(reason=TOO_SHORT))
    else:
        estimates |= _correlated(model)
    if QUANTISATION in surface.scored:
        # at the greatest likelihood: beside white noise it hardly depends on B and K
        power, error = surface.estimate(QUANTISATION)
        if power > math.sqrt(EVIDENCE) * error:
            low, high = (math.sqrt(max(power + sign * LIMIT_95 * error, 0.0)) for sign in (-1, 1))
            estimates[QUANTISATION] = Estimate(value=math.sqrt(power), low=low, high=high, status="measured")
    return {term.letter: part.scaled(term.coefficient_scale(tau0)) for term, part in estimates.items()}


def _rounding(model: Model, step: float) -> float:
    """Return the variance that rounding to steps adds to white noise, (channel unit)^2."""
    if QUANTISATION in model.surface.scored:
        return 0.0  # rounding of an angle is quantisation, that of a rate white noise
    # the differences of an angle hold two errors
    return ROUNDING_VARIANCE * step**2 * (2.0 if model.may_be_counted else 1.0)


def _rounding_error(variance: float, rounding: float) -> float:
    """Return the standard deviation of what rounding to steps of q adds to a variance, (channel unit)^2: q^2 / 12.

    With s = sigma / q it is exp(-2 pi^2 s^2) (1 / pi^2 + 4 s^2) q^2 cos(2 pi mean / q), the first harmonic of the error
    (Widrow and Kollar 2008, section 4), for any mean.

    Parameters
    ----------
    variance : sigma^2 of the noise.
    rounding : q^2 / 12; 0.0: the values have no steps. Differences of an angle have twice that, as of a step sqrt(2) q.
    """
    if not rounding:
        return 0.0
    squared_step = rounding / ROUNDING_VARIANCE
    steps = variance / squared_step
    harmonic = math.exp(-2.0 * math.pi**2 * steps) * (1.0 / math.pi**2 + 4.0 * steps)
    return harmonic * squared_step / math.sqrt(2.0)


def _of_counts(count: float, white: float, samples: float) -> Estimate:
    """Return Q of an angle in counts, in units of tau0.

    Where neighbouring errors are alike, their density is no longer that of quantisation, but clusters beyond see the
    variance of a rounding error, count^2 / 12. The angle walks over the counts with s = N / count per sample, by which
    errors are alike over 1 / (2 pi^2 s^2) samples. The square of a rounding error scatters by sqrt(4/5) of its mean.

    Parameters
    ----------
    count : channel unit.
    white : (channel unit)^2, variance of the white noise of a sample.
    """
    value = count * math.sqrt(ROUNDING_VARIANCE)
    independent = max(samples * min(2.0 * math.pi**2 * white / count**2, 1.0), 1.0)
    spread = LIMIT_95 * 0.5 * math.sqrt(0.8 / independent)
    low, high = value * max(1.0 - spread, 0.0), value * (1.0 + spread)
    return Estimate(value=value, low=low, high=high, status="measured")


def given_evidence(value: float, shown: float) -> float:
    """Return a value, corrected for that only records which show a walk state it; 0.0: chance shows as much.

    Of a walk just above nothing, the records show it in which chance makes it large: their median is twice too great.
    The root z of the evidence is nearly normal about an expectation m, and seen only above c, the root of `EVIDENCE`.
    Half of what is seen is above z where Phi(m - z) = Phi(m - c) / 2: that m is too large as often as too small.

    >>> [round(given_evidence(1.0, shown), 2) for shown in (5.0, 7.0, 10.0, 20.0)]
    [0.0, 0.64, 0.92, 1.0]
    """
    if shown > 4.0 * EVIDENCE:
        return value
    root, least = math.sqrt(shown), math.sqrt(EVIDENCE)
    expected = root
    for _ in range(100):  # each step goes a part of the way down; just above c there is no end
        expected = float(root + ndtri(0.5 * ndtr(expected - least)))
        if expected <= 0.0:
            return 0.0
    return value * math.pow(expected / root, 1.0 / ROOT_GROWTH)


def _correlated(model: Model) -> dict[NoiseTerm, Estimate]:
    """Return B and K in units of tau0, and M where it is in the model.

    Each is tested against the others at their likeliest. Those that do not show so are open. Where the open ones are
    needed together, the record does not show which of them it is.
    """
    surface, timed = model.surface, model.timed
    shown: dict[NoiseTerm, bool] = {term: evidence(surface, term) > EVIDENCE for term in GRIDDED}
    limits = _limits_of_gridded(surface, shown)
    for term, bound in model.slow.bounds.items():
        low, value, high = limits[term]
        limits[term] = low, value, max(high, bound)
    open_terms: list[NoiseTerm] = [term for term in GRIDDED if not shown[term]]
    hidden = _may_be_another(model, shown)
    if timed is not None:
        shown[timed.term] = timed.is_certain and timed.term not in hidden
        if not shown[timed.term]:
            open_terms.append(timed.term)
        if timed.term.is_stated:
            limits[timed.term] = tuple(quantiles(timed.surface, timed.term, LIMITS).tolist())
    confused = _confused(model, open_terms) | hidden
    estimates: dict[NoiseTerm, Estimate] = {}
    for term, (low, value, high) in limits.items():
        if term.grows:
            value = given_evidence(value, evidence(surface, term))
        if shown[term] and term not in hidden and low < value < high:
            estimates[term] = Estimate(value=value, low=low, high=high, status="measured")
        elif term in confused:
            estimates[term] = _indistinct(high, confused[term])
        else:
            estimates[term] = _bound(high, MOVES_SLOWLY if term in model.slow.bounds else NOT_SHOWN)
    return estimates


def _may_be_another(model: Model, shown: Mapping[NoiseTerm, bool]) -> dict[NoiseTerm, Sequence[str]]:
    """Return the terms that show and may be something else, with what they may be."""
    hidden: dict[NoiseTerm, Sequence[str]] = {}
    if model.timed is not None and model.timed.is_shown and not model.timed.is_certain:
        hidden[model.timed.term] = [VIBRATION]
    if model.hump is not None and model.hump.reaches_zero:  # below its band, its skirt looks like a walk
        hidden |= {term: [VIBRATION] for term in GRIDDED if term.grows and shown[term]}
    return {**hidden, **model.instead}


def _confused(model: Model, open_terms: Sequence[NoiseTerm]) -> dict[NoiseTerm, Sequence[str]]:
    """Return the names of the terms from which each open one is indistinct; empty where none of them is needed."""
    timed = model.timed
    # with a term in the model that is not measured, something is correlated: its odds are even or better
    together = len(open_terms) > 1 and (
        (timed is not None and not timed.is_certain) or joint_evidence(model.surface, open_terms) > EVIDENCE
    )
    if not together:
        return {}
    return {term: [other.name for other in open_terms if other != term] for term in open_terms}


def _indistinct(high: float, others: Sequence[str]) -> Estimate:
    """Return the bound of a coefficient that the record does not distinguish from others."""
    reason = f"the record does not distinguish it from {' and '.join(others)}"
    return Estimate(low=0.0, high=high, status="indistinct", reason=reason)


def _limits_of_gridded(
    surface: Surface, shown: Mapping[NoiseTerm, bool]
) -> dict[NoiseTerm, tuple[float, float, float]]:
    """Return lower limit, value and upper limit of B and K; the upper one holds also without what does not show."""
    limits: dict[NoiseTerm, tuple[float, float, float]] = {}
    for term, other in zip(GRIDDED, reversed(GRIDDED), strict=True):
        low, value, high = quantiles(surface, term, LIMITS).tolist()
        if not shown[other]:
            high = upper_limit(surface, term, float(LIMITS[-1]), other)
        limits[term] = low, value, high
    return limits


def _markov(model: Model, coefficients: Mapping[str, Estimate], tau0: float) -> MarkovEstimate | None:
    """Return the term that is stated with its time constant, in SI; None where it is not in the model."""
    timed = model.timed
    if timed is None or timed.term.time_letter is None or timed.term.letter not in coefficients:
        return None
    sigma = coefficients[timed.term.letter]
    low, value, high = (time * tau0 for time in timed.time_quantiles(LIMITS).tolist())
    # measured includes that the record bounds its time (`TimedSurface.is_certain`)
    if sigma.status == "measured":
        time = Estimate(value=value, low=low, high=high, status="measured", unit="s")
    else:
        time = Estimate(low=low, high=high, status="indistinct", unit="s", reason=sigma.reason)
    return MarkovEstimate(sigma=sigma, time_constant_s=time)


def _jumps(model: Model, tau0: float) -> TwoLevels | None:
    """Return the levels between which the mean jumps, channel unit, and the time in each, s; None without jumps."""
    assert model.timed is not None
    series, term = model.slow.series, model.timed.term
    steady = series.series - moved(model)
    jumps = two_levels(steady, math.sqrt(model.timed.peak[term]), term.time / series.length)
    if jumps is None:
        return None
    low, high = (model.offset + level for level in jumps.levels)
    below, above = (blocks * series.length * tau0 for blocks in jumps.dwell)
    return TwoLevels((low, high), (below, above))


def _of_power(mean: float, error: float) -> Estimate:
    """Return the coefficient of a power with a normal error."""
    if mean > math.sqrt(EVIDENCE) * error:
        half = math.exp(0.5 * LIMIT_95 * error / mean)  # a variance is nearly log-normal
        value = math.sqrt(mean)
        return Estimate(value=value, low=value / half, high=value * half, status="measured")
    return _bound(math.sqrt(max(mean + LIMIT_95 * error, 0.0)))


def _bound(high: float, reason: str = NOT_SHOWN) -> Estimate:
    return Estimate(low=0.0, high=high, status="upper_bound", reason=reason)


# ------------------------------------------------------------------------------------------------ regressors


def _regressors(model: Model, tau0: float) -> tuple[tuple[RegressorEstimate, ...], bool]:
    """Return the regressors with their coefficients, and whether time and temperature are not separable."""
    mean, error = grid_mean(model.surface, model.surface.beta, model.surface.beta_variances)
    length_s = model.slow.series.length * tau0
    out = []
    for regressor, value, deviation in zip(model.slow.regressors, mean.tolist(), error.tolist(), strict=True):
        if regressor.name == "settling_time" or regressor.name in OSCILLATION:
            continue  # they have no meaning alone: a derivative, and phases
        scale = regressor.scale / length_s if regressor.name == "drift" else regressor.scale
        size, half = value * scale, LIMIT_95 * (deviation * scale)
        settles_s = regressor.place * length_s if regressor.name == "settling" else None
        out.append(
            RegressorEstimate(
                name=regressor.name, value=size, low=size - half, high=size + half, time_constant_s=settles_s
            )
        )
    collinear = _is_collinear(model)
    if collinear:
        out = [regressor for regressor in out if regressor.name != "temperature"]
    return tuple(out), collinear


def _is_collinear(model: Model) -> bool:
    """Return whether the estimates of drift and temperature slope are so correlated that neither means anything.

    Without the bends: beside its square and its cube a slope is always less certain, and its limits say by how much.
    """
    names = [regressor.name for regressor in model.slow.regressors if regressor.name not in BENT]
    if "temperature" not in names:
        return False
    straight = [regressor.name not in BENT for regressor in model.slow.regressors]
    covariance = model.likelihood.covariance(model.surface, straight)
    # the drift that is stated is that of the last segment
    one, two = len(names) - 1 - names[::-1].index("drift"), names.index("temperature")
    return bool(
        abs(covariance[one, two]) > COLLINEAR * math.sqrt(covariance[one, one] * covariance[two, two])
    )


def _step(model: Model, regressors: tuple[RegressorEstimate, ...]) -> StepEstimate | None:
    """Return the first step of a model, with the means before and after it; None without a step."""
    regressor = next((regressor for regressor in regressors if regressor.name == "step"), None)
    if regressor is None:
        return None
    series = model.slow.series
    place = int(next(regressor.place for regressor in model.slow.regressors if regressor.name == "step"))
    segment = int(np.searchsorted(series.begin, place, side="right")) - 1
    begin = int(series.begin[segment])
    before = model.offset + float(series.series[begin:place].mean())
    return StepEstimate(before=before, after=before + regressor.value, sigma=regressor.sigma)


def _rate_ramp(regressors: tuple[RegressorEstimate, ...]) -> dict[str, Estimate]:
    """Return R by its letter where the drift is significant; without it, nothing."""
    drift = next((regressor for regressor in reversed(regressors) if regressor.name == "drift"), None)
    return {"R": _ramp(drift)} if drift is not None and drift.sigma > SIGNIFICANT else {}


def _ramp(drift: RegressorEstimate) -> Estimate:
    """Return R, the size of the drift."""
    low, high = sorted((abs(drift.low), abs(drift.high)))  # a significant drift excludes 0
    return Estimate(value=abs(drift.value), low=low, high=high, status="measured")


def _explained(model: Model) -> float | None:
    """Return the share of the variance of the means beyond white noise that follows the temperature."""
    names = [regressor.name for regressor in model.slow.regressors]
    if "temperature" not in names:
        return None
    number = names.index("temperature")
    regressor, series = model.slow.regressors[number], model.slow.series
    value = float(model.surface.beta[model.surface.best, number])
    variance = float(np.var(series.series))
    rest = float(np.var(series.series - value * regressor.scale * regressor.series))
    white = model.surface.powers[WHITE] * float(series.variances[WHITE].mean())
    if variance - white <= VISIBLE * variance:
        return None  # the means are white noise: there is nothing to explain
    return min(1.0, max(0.0, (variance - rest) / (variance - white)))
