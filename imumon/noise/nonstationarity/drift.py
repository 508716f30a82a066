"""Drift: slope of the mean against time and against temperature, with limits that know the noise.

The record is kept as at most 128 means over equal stretches; when they are full, neighbours join and
stretches double. When asked, slopes are fitted to the means by generalised least squares (Aitken 1935) with
the covariance that the channel's own N, B and K give them (`MeanCovariance`), so that a random walk is not called a
drift. What the noise does not explain either widens the limits (residual chi-square over degrees of freedom,
where above one: Birge 1932).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imumon.noise.allan import AllanCurve
from imumon.noise.nonstationarity.mean_covariance import MeanCovariance
from imumon.noise.nonstationarity.settling import SettlingFit, decay
from imumon.samples import Bools, Floats

NODES = 128
NODE_S = 1.0
LEAST_SHARE = 0.5
"""Valid share of a stretch that counts."""
LEAST_NODES = 8
LIMIT = 1.96
SIGNIFICANT = 3.9
"""Standard errors beyond which a slope is told: 1e-4, for it is asked for nine channels every second."""
STEP, ABRUPT = 6.0, 4.0
"""Standard errors beyond which a step is told: of its size against all the noise, and of the jump from one
mean to the next but one."""
LEAST_SPAN_DEGC = 0.3
"""Range of temperature below which nothing is said about its effect."""
HOUR = 3600.0


@dataclass(frozen=True, slots=True)
class Slope:
    """A slope with its standard error.

    Attributes
    ----------
    value, error : channel unit per s, or per degC.
    nodes : means behind it.
    least_error : the error that the noise alone makes; `error` is larger where a line does not fit.
    """

    value: float
    error: float
    nodes: int
    least_error: float

    @property
    def low(self) -> float:
        """Lower 95 % limit, unit of `value`."""
        return self.value - LIMIT * self.error

    @property
    def high(self) -> float:
        """Upper 95 % limit, unit of `value`."""
        return self.value + LIMIT * self.error

    @property
    def significant(self) -> bool:
        """Whether it is beyond `SIGNIFICANT` standard errors."""
        return abs(self.value) > SIGNIFICANT * self.error


@dataclass(frozen=True, slots=True)
class Step:
    """A sudden change of the mean.

    Attributes
    ----------
    at_s : s since the first sample.
    before, behind : channel unit, means on both sides.
    sigma : by how many standard errors they differ.
    """

    at_s: float
    before: float
    behind: float
    sigma: float


@dataclass(frozen=True, slots=True)
class Trend:
    """How the mean of a channel moves.

    Attributes
    ----------
    time : channel unit per s.
    temperature : channel unit per degC; None without a temperature, or when it stood still.
    explained : share of the variance of the means beyond white noise that follows the temperature; None
        likewise.
    """

    time: Slope
    temperature: Slope | None = None
    explained: float | None = None


class Drift:
    """Means over stretches of the record, and their slopes.

    Parameters
    ----------
    groups : group of each channel, 0 ... g-1: validity is told by group.
    rate_hz : Hz, sampling rate.
    temperature : channel that is the temperature, degC, or None.
    """

    def __init__(self, groups: Sequence[int], rate_hz: float, temperature: int | None = None) -> None:
        self._groups = np.array(groups, dtype=np.int64)
        self._rate = rate_hz
        self._temperature = temperature
        self._width = max(1, round(NODE_S * rate_hz))
        self._n = 0
        self._offset: Floats | None = None  # (c,) near the values, so that sums lose no digits
        self._sums = np.zeros((NODES, len(groups)))
        self._counts = np.zeros((NODES, len(groups)))

    @property
    def elapsed_s(self) -> float:
        """s, length of the grid so far, but for gaps of unknown length."""
        return self._n / self._rate

    def update(self, values: Floats, valid: Bools | None = None) -> None:
        """Take samples.

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
        self._make_room(n)
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
        """`n` samples are missing."""
        self._make_room(n)
        self._n += n

    def break_(self) -> None:
        """A gap of unknown length: time goes on as if there were none."""

    def _make_room(self, n: int) -> None:
        while (self._n + n - 1) // self._width >= NODES:
            for array in (self._sums, self._counts):
                array[: NODES // 2] = array[::2] + array[1::2]
                array[NODES // 2 :] = 0.0
            self._width *= 2

    def result(self, wanders: Sequence[MeanCovariance | None]) -> list[Trend | None]:
        """Trend of each channel; None where the noise is not known yet or the record too short."""
        return [None if w is None else self._trend(c, w) for c, w in enumerate(wanders)]

    def _trend(self, c: int, wander: MeanCovariance) -> Trend | None:
        time = self.slope(c, wander)
        if time is None or self._temperature is None or c == self._temperature:
            return None if time is None else Trend(time)
        at, mean, count = self._nodes(c)
        warm = self._nodes(self._temperature)
        both, mine, other = np.intersect1d(at, warm[0], assume_unique=True, return_indices=True)
        degrees = warm[1][other]
        if len(both) < LEAST_NODES or np.ptp(degrees) < LEAST_SPAN_DEGC:
            return Trend(time)
        slope = self._fitted(both, mean[mine], count[mine], degrees, wander)
        if slope is None:
            return Trend(time)
        total = float(np.var(mean[mine]))
        white = wander.N**2 * self._rate * float(np.mean(1.0 / count[mine]))
        rest = float(np.var(mean[mine] - slope.value * degrees))
        beyond = total - white
        explained = min(1.0, max(0.0, (total - rest) / beyond)) if beyond > 0.1 * total else None
        return Trend(time, slope, explained)

    def without_temperature(self, curve: AllanCurve, trends: Sequence[Trend | None]) -> AllanCurve | None:
        """The Allan curve as it would be if the temperature had stood still.

        At long tau, where temperature acts, each variance is scaled by what is left of the variance of the
        means kept here, once slope times temperature is subtracted. None where no channel follows the
        temperature significantly.

        Parameters
        ----------
        curve : of the first channels.
        trends : of the channels, from `result`.
        """
        avar = curve.avar.copy()
        changed = False
        for c, trend in enumerate(trends[: avar.shape[1]]):
            if trend is not None and trend.temperature is not None and trend.temperature.significant:
                avar[:, c] *= self._left(c, trend.temperature.value, curve.tau)
                changed = True
        return replace(curve, avar=avar) if changed else None

    def _left(self, c: int, slope: float, tau: Floats) -> Floats:
        """(k,) Share of the Allan variance at tau, s, that does not follow the temperature."""
        assert self._temperature is not None
        series = np.full((2, NODES), np.nan)  # the channel, and the channel less what follows the temperature
        at, mean, _ = self._nodes(c)
        series[:, at] = mean
        degrees = np.full(NODES, np.nan)
        warm, value, _ = self._nodes(self._temperature)
        degrees[warm] = value
        series[1] -= slope * degrees
        series[0, np.isnan(series[1])] = np.nan
        width, m, known, left = self._width / self._rate, 1, [], []
        while 3 * m <= len(at):
            steps = series[:, m:] - series[:, :-m]
            ok = np.isfinite(steps[0])
            if ok.sum() >= 2 and (power := np.square(steps[:, ok]).sum(axis=1))[0] > 0.0:
                known.append(m * width)
                left.append(min(1.0, float(power[1] / power[0])))
            series = 0.5 * (series[:, m:] + series[:, :-m])
            m *= 2
        if not known:
            return np.ones_like(tau)
        share = np.exp(np.interp(np.log(tau), np.log(known), np.log(np.maximum(left, 1e-12))))
        # Below the shortest stretch temperature is a ramp, whose share of white noise grows with tau^3.
        return np.where(tau < known[0], 1.0 - (1.0 - left[0]) * (tau / known[0]) ** 3, share)

    def slope(
        self, c: int, wander: MeanCovariance, begin_s: float = 0.0, end_s: float = math.inf
    ) -> Slope | None:
        """Slope of a channel over part of the record, channel unit per s; None where too little is known.

        Parameters
        ----------
        begin_s, end_s : s since the first sample; whole stretches inside are used.
        """
        at, mean, count = self._nodes(c)
        width = self._width / self._rate
        inside = (at * width >= begin_s - 0.5 * width) & ((at + 1) * width <= end_s + 0.5 * width)
        at, mean, count = at[inside], mean[inside], count[inside]
        if len(at) < LEAST_NODES:
            return None
        return self._fitted(at, mean, count, at * width, wander)

    def decay(self, c: int, times_s: Sequence[float], begin_s: float = 0.0) -> SettlingFit | None:
        """The exponential along which a channel settles from a time on; None where too little is known.

        Parameters
        ----------
        times_s : s, time constants in question.
        begin_s : s since the first sample; whole stretches behind it are used.
        """
        at, mean, count = self._nodes(c)
        inside = at * self._width / self._rate >= begin_s - 0.5 * self._width / self._rate
        at, mean, share = at[inside], mean[inside], count[inside] / self._width
        return decay(at, mean, share, self._width / self._rate, np.array(times_s))

    def step(self, c: int, wander: MeanCovariance, begin_s: float = 0.0) -> Step | None:
        """The greatest sudden change of a channel's mean beside a slope; None where noise explains it.

        A step between two means is one element of their differences. So with P the inverse covariance of
        these, the slope's part taken off, its generalised least-squares size is (P d)_j / P_jj, for all
        places at once. What drifts may look like a step from afar: so it must also be seen close by. A step
        raises the K that is fitted over it: half of that is taken.

        Parameters
        ----------
        begin_s : s since the first sample; from there on.
        """
        at, mean, count = self._nodes(c)
        width = self._width / self._rate
        inside = at * width >= begin_s - 0.5 * width
        at, mean, count = at[inside], mean[inside], count[inside]
        if len(at) < 2 * LEAST_NODES:
            return None
        noise = self._contrasts(at, count, replace(wander, K=0.5 * wander.K))
        try:
            weights = np.linalg.inv(noise)
        except np.linalg.LinAlgError:
            return None
        jumps, slope = np.diff(mean), np.diff(at * width)
        along = weights @ slope
        weights -= np.outer(along, along) / max(float(slope @ along), 1e-300)
        pulls = weights @ jumps
        own = np.maximum(np.diag(weights), 1e-300)
        scores = np.abs(pulls) / np.sqrt(own)
        j = int(np.argmax(scores))
        misfit = (float(jumps @ pulls) - float(scores[j]) ** 2) / (len(jumps) - 2)
        sigma = float(scores[j]) / math.sqrt(max(1.0, misfit))
        near = [mean[min(j + b, len(mean) - 1)] - mean[max(j - a, 0)] for a, b in ((0, 1), (1, 1), (0, 2))]
        close = max(abs(float(v)) for v in near) / math.sqrt(float(noise[j, j]))
        if not (sigma > STEP and close > ABRUPT):
            return None
        offset = 0.0 if self._offset is None else float(self._offset[c])
        sides = [
            float(np.average(mean[part], weights=count[part])) for part in (slice(j + 1), slice(j + 1, None))
        ]
        return Step(float(at[j] + 1) * width, offset + sides[0], offset + sides[1], sigma)

    def change(self, c: int, begin_s: float, end_s: float) -> float | None:
        """How far a channel moved between two times, by the stretches they fall into; None where one is
        empty."""
        at, mean, _ = self._nodes(c)
        width = self._width / self._rate
        places = np.searchsorted(
            at, [int(begin_s / width), min(int(end_s / width), (self._n - 1) // self._width)]
        )
        if not len(at) or places[0] >= len(at):
            return None
        return float(mean[min(int(places[1]), len(at) - 1)] - mean[int(places[0])])

    def highest(self, c: int) -> bool:
        """Whether the mean of a channel is at its highest now, but for a tenth of its range."""
        _, mean, _ = self._nodes(c)
        return len(mean) > 0 and float(mean[-1]) >= float(mean.max() - 0.1 * np.ptp(mean))

    def _nodes(self, c: int) -> tuple[np.ndarray, Floats, Floats]:
        """Numbers of the stretches that count, their means about the offset, and their samples."""
        count = self._counts[:, c]
        length = np.clip(self._n - np.arange(NODES) * self._width, 0, self._width)
        at = np.flatnonzero((count > 0) & (count >= LEAST_SHARE * self._width) & (length > 0))
        return at, self._sums[at, c] / count[at], count[at]

    def _fitted(
        self, at: np.ndarray, mean: Floats, count: Floats, regressor: Floats, wander: MeanCovariance
    ) -> Slope | None:
        """Slope of means against a regressor.

        Works on the differences of neighbours: contrasts, whose covariance exists for every noise.

        Parameters
        ----------
        at : (k,) number of each stretch.
        mean, count : (k,) channel unit; valid samples behind it.
        regressor : (k,) s or degC.
        """
        c = self._contrasts(at, count, wander)
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

    def _contrasts(self, at: np.ndarray, count: Floats, wander: MeanCovariance) -> Floats:
        """(k-1, k-1) Covariance that the noise gives the differences of neighbouring means."""
        width = self._width / self._rate
        lags = np.asarray(np.arange(int(at[-1] - at[0]) + 1) * width, dtype=np.float64)
        by_lag = wander.covariance(lags, width, width)
        by_lag -= by_lag.mean()  # contrasts do not see a constant, but rounding does
        c = by_lag[np.abs(at[:, None] - at[None, :])]
        c[np.diag_indices(len(at))] += wander.N**2 * (self._rate / count - 1.0 / width)
        c = c[1:] - c[:-1]
        return np.asarray(c[:, 1:] - c[:, :-1], dtype=np.float64)

    def save(self) -> dict[str, np.ndarray]:
        """State as arrays."""
        out = {
            "groups": self._groups.copy(),
            "rate": np.array(self._rate),
            "sums": self._sums.copy(),
            "counts": self._counts.copy(),
            "numbers": np.array(
                [self._n, self._width, -1 if self._temperature is None else self._temperature], dtype=np.int64
            ),
        }
        return out if self._offset is None else out | {"offset": self._offset.copy()}

    @classmethod
    def restore(cls, saved: Mapping[str, np.ndarray]) -> Drift:
        """Continue where `save` left off."""
        n, width, temperature = (int(v) for v in saved["numbers"])
        self = cls(saved["groups"].tolist(), float(saved["rate"]), None if temperature < 0 else temperature)
        self._n, self._width = n, width
        self._sums, self._counts = saved["sums"].copy(), saved["counts"].copy()
        self._offset = saved["offset"].copy() if "offset" in saved else None
        return self
