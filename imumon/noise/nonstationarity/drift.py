"""Drift: slope of the mean against time and against temperature, with limits that follow from the noise.

The record is kept as at most 128 means over equal stretches; when they are full, neighbours are joined and
stretches double. The slopes of a trend, against time and against temperature, are estimated together
(`restricted_likelihood`), from the end of the warm-up on.

The slopes that decide about a warm-up are fitted by generalised least squares (Aitken 1935) with the
covariance that follows from N, B and K of the channel (`MeanCovariance`), so that a random walk is not called
a drift. A misfit that the noise does not explain widens their errors (residual chi-square over degrees of
freedom if above one: Birge 1932).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imumon.noise.allan import AllanCurve
from imumon.noise.fit.restricted_likelihood import INSEPARABLE, BlockMeans, fit_slow_terms
from imumon.noise.nonstationarity.mean_covariance import MeanCovariance
from imumon.noise.nonstationarity.settling import SettlingFit, fit_settling
from imumon.report import Change
from imumon.samples import Bools, Floats

MEANS = 128
"""Most means that are kept: their covariance is inverted, and twice as many take eight times as long.
Sensitivity: halved changes which values appear, doubled 1.4e+02 % (gyro z drift steady_B value of the record
"temperature")."""
MEAN_S = 1.0
"""s, shortest stretch of a mean. Sensitivity: halved 1.3e+02 %, doubled 1.1e+02 % (accel x drift per_hour of
the record "table")."""
LEAST_SHARE = 0.5
"""Valid share of a stretch from which its mean counts. Sensitivity: halved 1.3 %, doubled 1.6e+02 % (gyro y
drift per_hour of the record "disturbed")."""
LEAST_MEANS = 8
"""Fewest means behind a slope, and on each side of a step. Not critical."""
LIMIT_95 = 1.96
"""Standard errors, half-width of a 95 % interval. Sensitivity: halved 1.1e+02 %, doubled 90 % (gyro y drift
per_hour_low of the record "temperature")."""
SIGNIFICANT_SIGMA = 3.9
"""Standard errors beyond which a slope is significant: 1e-4, because nine channels are tested every second.
Sensitivity: halved 0 %, doubled changes which values appear (gyro x drift steady_N high of the record
"temperature")."""
STEP_SIGMA = 6.0
"""Standard errors of the size of a step against all the noise beyond which it is reported: 128 places are
tested repeatedly. Sensitivity: halved changes which values appear, doubled 0 % (gyro y changes now of the
record "temperature")."""
ABRUPT_SIGMA = 4.0
"""Standard errors of the jump from one mean to the next but one beyond which a step is abrupt: a drift is as
large only over several means. Not critical."""
STEP_WALK = 0.5
"""Share of the fitted K that is noise in a search for a step: a step raises the K that is fitted over it. Not
critical."""
BEYOND_WHITE = 0.1
"""Share of the variance of the means that must exceed white noise for `explained` to have a value. Not
critical."""
HIGHEST_SHARE = 0.1
"""Share of the range of means by which the last one may be below the highest. Not critical."""
LEAST_LEFT = 1e-12
"""Least share of the Allan variance that remains without the temperature, for its logarithm. Not critical."""

_TINY = 1e-300
"""Least divisor. Not critical."""


@dataclass(frozen=True, slots=True)
class Slope:
    """Slope with its standard error.

    Attributes
    ----------
    value, error : channel unit per s, or per degC.
    means : number of means behind it.
    least_error : error from the noise alone; `error` is larger if a line does not fit.
    """

    value: float
    error: float
    means: int
    least_error: float

    @property
    def low(self) -> float:
        """Lower 95 % limit, unit of `value`."""
        return self.value - LIMIT_95 * self.error

    @property
    def high(self) -> float:
        """Upper 95 % limit, unit of `value`."""
        return self.value + LIMIT_95 * self.error

    @property
    def significant(self) -> bool:
        """Whether it is beyond `SIGNIFICANT_SIGMA` standard errors."""
        return abs(self.value) > SIGNIFICANT_SIGMA * self.error


@dataclass(frozen=True, slots=True)
class BiasStep:
    """Sudden change of the mean."""

    at_s: float  # s since the first sample
    change: Change  # means before and after it


@dataclass(frozen=True, slots=True)
class Trend:
    """Slopes of the mean of a channel.

    Attributes
    ----------
    time : channel unit per s.
    temperature : channel unit per degC; None without a temperature, or if it was constant.
    explained : share of the variance of the means beyond white noise that follows the temperature, or None.
    reason : why there is no temperature slope (`restricted_likelihood`), or None.
    covered : degC, least and greatest temperature; None without one.
    begin_s : s since the first sample, from when on the means count.
    """

    time: Slope
    temperature: Slope | None = None
    explained: float | None = None
    reason: str | None = None
    covered: tuple[float, float] | None = None
    begin_s: float = 0.0

    @property
    def separable(self) -> bool:
        """Whether the slope against time is that of a constant temperature, as far as is known."""
        return self.reason != INSEPARABLE


def _explained(means: Floats, effect: Floats, white: float) -> float | None:
    """Return the share of the variance of means (k,) beyond white noise that an effect (k,) explains."""
    total, rest = float(np.var(means)), float(np.var(means - effect))
    if total - white <= BEYOND_WHITE * total:
        return None
    return min(1.0, max(0.0, (total - rest) / (total - white)))


class DriftAccumulator:
    """Means over stretches of the record, and their slopes.

    Parameters
    ----------
    groups : (c,) group of each channel, 0 ... g-1; the channels of a group share their validity.
    rate_hz : Hz, sampling rate.
    temperature : column of the temperature, degC; None: there is none.
    """

    def __init__(self, groups: Sequence[int], rate_hz: float, temperature: int | None = None) -> None:
        self._groups = np.array(groups, dtype=np.int64)
        self._rate = rate_hz
        self._temperature = temperature
        self._width = max(1, round(MEAN_S * rate_hz))
        self._n = 0
        self._offset: Floats | None = None  # (c,) near the values, so that sums lose no digits
        self._sums = np.zeros((MEANS, len(groups)))
        self._counts = np.zeros((MEANS, len(groups)))

    @property
    def elapsed_s(self) -> float:
        """s, length of the grid so far, without gaps of unknown length."""
        return self._n / self._rate

    def update(self, values: Floats, valid: Bools | None = None) -> None:
        """Add samples.

        Parameters
        ----------
        values : (n, c) channel unit, finite where valid.
        valid : (n, g); None: all.
        """
        n = len(values)
        if not n:
            return
        if self._offset is None:
            self._offset = np.where(np.isfinite(values[0]), values[0], 0.0)
        self._join_stretches(n)
        first = self._n // self._width
        bounds = np.arange(first, (self._n + n - 1) // self._width + 2) * self._width - self._n
        bounds[0], bounds[-1] = 0, n
        edges = bounds[:-1]
        d = values - self._offset
        here = slice(first, first + len(edges))
        if valid is None or valid.all():
            self._counts[here] += (bounds[1:] - edges)[:, None]
        else:
            ok = valid[:, self._groups]
            d[~ok] = 0.0
            self._counts[here] += np.add.reduceat(ok, edges, axis=0, dtype=np.float64)
        self._sums[here] += np.add.reduceat(d, edges, axis=0)
        self._n += n

    def skip(self, n: int) -> None:
        """Note that `n` samples are missing."""
        self._join_stretches(n)
        self._n += n

    def _join_stretches(self, n: int) -> None:
        """Double the stretches until `n` more samples fit."""
        while (self._n + n - 1) // self._width >= MEANS:
            for array in (self._sums, self._counts):
                array[: MEANS // 2] = array[::2] + array[1::2]
                array[MEANS // 2 :] = 0.0
            self._width *= 2

    def result(self, noises: Sequence[MeanCovariance | None], begin_s: float = 0.0) -> list[Trend | None]:
        """Return the trend of each channel from a time on; None if its noise is unknown or the record too short.

        N is that of the noise; B and K come from the means, because a drift raises those of a curve.
        """
        out: list[Trend | None] = [None] * len(noises)
        columns = [c for c, noise in enumerate(noises) if noise is not None]
        if not columns or begin_s >= self.elapsed_s:
            return out
        blocks = self.blocks(len(noises), begin_s)
        means, share, degrees = blocks.means[:, columns], blocks.share[:, columns], blocks.temperature
        white = np.array([noise.N**2 for noise in noises if noise is not None])
        flicker = np.array([noise.B**2 for noise in noises if noise is not None])
        terms = fit_slow_terms(means, blocks.length_s, white, flicker, share=share, temperature=degrees)
        covered = self._covered(degrees)
        for number, c in enumerate(columns):
            ok = np.isfinite(means[:, number])
            slopes = [
                Slope(float(value[number]), float(error[number]), int(ok.sum()), float(error[number]))
                if np.isfinite(value[number])
                else None
                for value, error in (
                    (terms.drift, terms.drift_error),
                    (terms.temperature, terms.temperature_error),
                )
            ]
            if slopes[0] is None:
                continue
            explained = None
            if slopes[1] is not None and degrees is not None:
                ok &= np.isfinite(degrees)
                noise = float(white[number]) / blocks.length_s * float(np.mean(1.0 / share[ok, number]))
                explained = _explained(means[ok, number], slopes[1].value * degrees[ok], noise)
            reason = terms.reasons[number] or None
            out[c] = Trend(slopes[0], slopes[1], explained, reason, covered, begin_s)
        return out

    def _covered(self, degrees: Floats | None) -> tuple[float, float] | None:
        """Return the least and the greatest block mean of the temperature, degC; None if there is none."""
        if degrees is None or self._offset is None or not np.isfinite(degrees).any():
            return None
        assert self._temperature is not None
        offset = float(self._offset[self._temperature])
        return offset + float(np.nanmin(degrees)), offset + float(np.nanmax(degrees))

    def without_temperature(self, curve: AllanCurve, trends: Sequence[Trend | None]) -> AllanCurve | None:
        """Return the Allan curve as it would be at a constant temperature.

        At long tau, each variance is scaled by the share of the variance of the means that remains after
        slope times temperature is subtracted. None if no channel follows the temperature significantly.

        Parameters
        ----------
        curve : of the first channels.
        trends : of the channels, from `result`.
        """
        avar = curve.avar.copy()
        changed = False
        for c, trend in enumerate(trends[: avar.shape[1]]):
            if trend is not None and trend.temperature is not None and trend.temperature.significant:
                avar[:, c] *= self._share_without_temperature(c, trend, curve.tau)
                changed = True
        return replace(curve, avar=avar) if changed else None

    def _share_without_temperature(self, c: int, trend: Trend, tau: Floats) -> Floats:
        """Return (k,) the share of the Allan variance at tau, s, that does not follow the temperature."""
        assert self._temperature is not None
        assert trend.temperature is not None
        series = np.full((2, MEANS), np.nan)  # the channel, with and without the effect of the temperature
        at, mean, _ = self._means(c, trend.begin_s)
        series[:, at] = mean
        degrees = np.full(MEANS, np.nan)
        degrees_at, value, _ = self._means(self._temperature)
        degrees[degrees_at] = value
        series[1] -= trend.temperature.value * degrees
        series[0, np.isnan(series[1])] = np.nan
        width, m, times, shares = self._width / self._rate, 1, [], []
        while 3 * m <= len(at):
            steps = series[:, m:] - series[:, :-m]
            ok = np.isfinite(steps[0])
            if ok.sum() >= 2 and (power := np.square(steps[:, ok]).sum(axis=1))[0] > 0.0:
                times.append(m * width)
                shares.append(min(1.0, float(power[1] / power[0])))
            series = 0.5 * (series[:, m:] + series[:, :-m])
            m *= 2
        if not times:
            return np.ones_like(tau)
        share = np.exp(np.interp(np.log(tau), np.log(times), np.log(np.maximum(shares, LEAST_LEFT))))
        # Below the shortest stretch temperature is a ramp, whose share of white noise grows with tau^3.
        return np.where(tau < times[0], 1.0 - (1.0 - shares[0]) * (tau / times[0]) ** 3, share)

    def blocks(self, channels: int, begin_s: float = 0.0) -> BlockMeans:
        """Return the means of the first channels from a time on, s since the first sample."""
        width = self._width / self._rate
        places = slice(min(MEANS, math.ceil(begin_s / width - 0.5)), -(-self._n // self._width))
        counts, sums = self._counts[places], self._sums[places]
        means = np.where(counts >= LEAST_SHARE * self._width, sums / np.maximum(counts, 1.0), np.nan)
        degrees = None if self._temperature is None else means[:, self._temperature]
        share = counts[:, :channels] / self._width
        return BlockMeans(means[:, :channels], share, degrees, width)

    def slope(
        self, c: int, noise: MeanCovariance, begin_s: float = 0.0, end_s: float = math.inf
    ) -> Slope | None:
        """Return the slope of a channel between two times, channel unit per s; None if unknown."""
        at, mean, count = self._means(c, begin_s, end_s)
        if len(at) < LEAST_MEANS:
            return None
        return self._fit_slope(at, mean, count, at * (self._width / self._rate), noise)

    def settling(
        self, columns: Sequence[int], times_s: Sequence[float], begin_s: float = 0.0
    ) -> list[SettlingFit | None]:
        """Return the exponential of a possible time constant along which each channel settles; None if unknown."""
        alike: dict[bytes, list[int]] = {}  # channels by the samples of their stretches
        for c in columns:
            at, _, count = self._means(c, begin_s)
            alike.setdefault(at.tobytes() + count.tobytes(), []).append(c)
        found: dict[int, SettlingFit | None] = {}
        width_s = self._width / self._rate
        for own in alike.values():
            at, _, count = self._means(own[0], begin_s)
            means = np.column_stack([self._means(c, begin_s)[1] for c in own])
            fits = fit_settling(at, means, count / self._width, width_s, np.array(times_s))
            found.update(zip(own, fits, strict=True))
        return [found[c] for c in columns]

    def bias_step(self, c: int, noise: MeanCovariance, begin_s: float = 0.0) -> BiasStep | None:
        """Return the greatest sudden change of a channel's mean beside a slope; None if noise explains it.

        A step between two means is one element of their differences d. With P the inverse covariance of
        these, less the part of the slope, its generalised least-squares size is (P d)_j / P_jj, for all
        places at once.
        """
        at, mean, count = self._means(c, begin_s)
        width = self._width / self._rate
        if len(at) < 2 * LEAST_MEANS:
            return None
        covariance = self._contrasts(at, count, replace(noise, K=STEP_WALK * noise.K))
        try:
            weights = np.linalg.inv(covariance)
        except np.linalg.LinAlgError:
            return None
        jumps, slope = np.diff(mean), np.diff(at * width)
        along = weights @ slope
        weights -= np.outer(along, along) / max(float(slope @ along), _TINY)
        products = weights @ jumps
        own = np.maximum(np.diag(weights), _TINY)
        scores = np.abs(products) / np.sqrt(own)
        j = int(np.argmax(scores))
        misfit = (float(jumps @ products) - float(scores[j]) ** 2) / (len(jumps) - 2)
        sigma = float(scores[j]) / math.sqrt(max(1.0, misfit))
        near = [mean[min(j + b, len(mean) - 1)] - mean[max(j - a, 0)] for a, b in ((0, 1), (1, 1), (0, 2))]
        close = max(abs(float(v)) for v in near) / math.sqrt(float(covariance[j, j]))
        if not (sigma > STEP_SIGMA and close > ABRUPT_SIGMA):
            return None
        offset = 0.0 if self._offset is None else float(self._offset[c])
        before, now = (
            offset + float(np.average(mean[part], weights=count[part]))
            for part in (slice(j + 1), slice(j + 1, None))
        )
        change = Change(
            against="time before", quantity="bias", before=before, now=now, ratio=None, sigma=sigma
        )
        return BiasStep(float(at[j] + 1) * width, change)

    def mean_change(self, c: int, begin_s: float, end_s: float) -> float | None:
        """Return the difference of the means at two times, channel unit; None if unknown."""
        at, mean, _ = self._means(c)
        width = self._width / self._rate
        places = np.searchsorted(
            at, [int(begin_s / width), min(int(end_s / width), (self._n - 1) // self._width)]
        )
        if not len(at) or places[0] >= len(at):
            return None
        return float(mean[min(int(places[1]), len(at) - 1)] - mean[int(places[0])])

    def is_highest(self, c: int) -> bool:
        """Return whether the mean of a channel is now near its highest value."""
        _, mean, _ = self._means(c)
        return len(mean) > 0 and float(mean[-1]) >= float(mean.max() - HIGHEST_SHARE * np.ptp(mean))

    def _means(
        self, c: int, begin_s: float = 0.0, end_s: float = math.inf
    ) -> tuple[np.ndarray, Floats, Floats]:
        """Return the numbers of the stretches that count between two times (s since the first sample), their
        means about the offset, and their samples."""
        count, width = self._counts[:, c], self._width / self._rate
        at = np.flatnonzero((count > 0) & (count >= LEAST_SHARE * self._width))
        at = at[(at * width >= begin_s - 0.5 * width) & ((at + 1) * width <= end_s + 0.5 * width)]
        return at, self._sums[at, c] / count[at], count[at]

    def _fit_slope(
        self, at: np.ndarray, mean: Floats, count: Floats, regressor: Floats, noise: MeanCovariance
    ) -> Slope | None:
        """Return the slope of means (k,) against a regressor (k,), s or degC; None if it is indeterminate.

        The differences of neighbours are fitted: contrasts, whose covariance exists for every noise.
        """
        c = self._contrasts(at, count, noise)
        y, x = np.diff(mean), np.diff(regressor)
        try:
            root = np.linalg.cholesky(c)
        except np.linalg.LinAlgError:
            return None
        white = np.linalg.solve(root, np.stack((y, x), axis=1))
        power = float(white[:, 1] @ white[:, 1])
        if power <= 0.0:
            return None
        value = float(white[:, 1] @ white[:, 0]) / power
        residual = white[:, 0] - value * white[:, 1]
        misfit = max(1.0, float(residual @ residual) / max(1, len(y) - 1))
        return Slope(value, math.sqrt(misfit / power), len(at), math.sqrt(1.0 / power))

    def _contrasts(self, at: np.ndarray, count: Floats, noise: MeanCovariance) -> Floats:
        """Return (k-1, k-1) the covariance of the differences of neighbouring means under the noise."""
        width = self._width / self._rate
        lags = np.asarray(np.arange(int(at[-1] - at[0]) + 1) * width, dtype=np.float64)
        by_lag = noise.covariance(lags, width, width)
        by_lag -= by_lag.mean()  # contrasts do not depend on a constant, but rounding does
        c = by_lag[np.abs(at[:, None] - at[None, :])]
        c[np.diag_indices(len(at))] += noise.N**2 * (self._rate / count - 1.0 / width)
        return np.diff(np.diff(c, axis=0), axis=1)

    def save(self) -> dict[str, np.ndarray]:
        """Return the state as arrays."""
        temperature = -1 if self._temperature is None else self._temperature
        out = {name: getattr(self, f"_{name}").copy() for name in ("groups", "sums", "counts")}
        out["rate"] = np.array(self._rate)
        out["numbers"] = np.array([self._n, self._width, temperature], dtype=np.int64)
        return out if self._offset is None else out | {"offset": self._offset.copy()}

    @classmethod
    def restore(cls, saved: Mapping[str, np.ndarray]) -> DriftAccumulator:
        """Return an accumulator that continues from a saved state."""
        n, width, temperature = (int(v) for v in saved["numbers"])
        self = cls(saved["groups"].tolist(), float(saved["rate"]), None if temperature < 0 else temperature)
        self._n, self._width = n, width
        self._sums, self._counts = saved["sums"].copy(), saved["counts"].copy()
        self._offset = saved["offset"].copy() if "offset" in saved else None
        return self
