"""Trends: what is too dear to work out for every report, renewed when the record has grown enough.

Slopes by generalised least squares, a mean that still settles, and the comparison with a saved report of the
same sensor.
"""

from __future__ import annotations

from collections.abc import Sequence

from imumon.noise.allan import AllanCurve
from imumon.noise.fit import ChannelFit, fit_curve
from imumon.noise.nonstationarity.change import Behaviour, Change, Estimate, changes
from imumon.noise.nonstationarity.drift import Step, Trend
from imumon.noise.nonstationarity.mean_covariance import MeanCovariance
from imumon.noise.nonstationarity.warmup import lasting
from imumon.pipeline.accumulators import Accumulators
from imumon.report import Coefficient, Report
from imumon.samples import sensor_of

GROWTH = 1.05
LEAST_S = 10.0


class Trends:
    """Drift of each channel of a record, and its noise had the temperature stood still."""

    def __init__(self, record: Accumulators, *, averaged: Sequence[bool]) -> None:
        self._record, self._averaged = record, averaged
        self._due_s, self._begin_s = 0.0, 0.0
        self._found: list[Trend | None] = []
        self._steady: tuple[ChannelFit, ...] = ()
        self._steps: list[Step | None] = []
        self._settling: list[bool] = []

    def renew(self, fits: Sequence[ChannelFit], curve: AllanCurve, *, now: bool) -> None:
        """Work all of it out anew where the record has grown by a twentieth or lost its warm-up, or `now`."""
        elapsed, begin = self._record.elapsed_s, self._record.history.begin_s
        if not now and elapsed < self._due_s and begin == self._begin_s:
            return
        self._due_s, self._begin_s = max(elapsed + LEAST_S, elapsed * GROWTH), begin
        wanders: list[MeanCovariance | None] = [MeanCovariance.of(fit) for fit in fits]
        wanders += [None] * (len(self._record.channels) - len(wanders))
        drift = self._record.history.drift
        self._found = drift.result(wanders)
        self._steps = [None if w is None else drift.step(c, w, begin) for c, w in enumerate(wanders)]
        steady = drift.without_temperature(curve, self._found)
        self._steady = () if steady is None else fit_curve(steady, averaged=self._averaged, time_to=False)
        self._settling = [
            self._may_settle(name, fit) and lasting(drift, c, begin) is not None
            for c, (name, fit) in enumerate(zip(self._record.channels, fits, strict=False))
        ]

    def _may_settle(self, name: str, fit: ChannelFit) -> bool:
        """Whether a warm-up is of any moment in a channel: where the curve has no K, none is mistaken for
        it."""
        lifts = fit.K.value is not None or "ramp" in fit.caveats
        return self._record.guarded and lifts and sensor_of(name) in ("gyro", "accel")

    def settling(self, column: int) -> bool:
        """Whether the mean of a channel plainly settles in what counts, as while a sensor warms up."""
        return column < len(self._settling) and self._settling[column]

    def of(self, column: int) -> Trend | None:
        """Trend of a channel; None while nothing can be said."""
        return self._found[column] if column < len(self._found) else None

    def step(self, column: int) -> Step | None:
        """Sudden change of a channel's mean; None where there is none."""
        return self._steps[column] if column < len(self._steps) else None

    def steady(self, column: int) -> ChannelFit | None:
        """Fit of a channel without the temperature's part; None where it follows no temperature."""
        trend = self.of(column)
        follows = trend is not None and trend.temperature is not None and trend.temperature.significant
        return self._steady[column] if follows and column < len(self._steady) else None


def against_baseline(baseline: Report, name: str, fit: ChannelFit, length_s: float) -> list[Change]:
    """What differs between a saved report and a fit of the same channel now."""
    before = baseline.channels.get(name)
    if before is None or before.N is None or before.B is None:
        return []
    then = Behaviour(_estimate(before.N), _estimate(before.B), before.mean, None, baseline.session.elapsed_s)
    return changes(then, Behaviour.of(fit, None, length_s), None)


def _estimate(saved: Coefficient) -> Estimate:
    return Estimate(saved.value, saved.low, saved.high)
