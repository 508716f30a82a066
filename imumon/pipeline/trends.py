"""Trends: results that are too expensive for every report, recomputed when the record has grown enough.

Slopes by generalised least squares, means that still settle, and the comparison with a saved report of the
same sensor.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imumon.noise.allan import AllanCurve
from imumon.noise.fit import ChannelFit, fit_curve
from imumon.noise.fit.estimator import point_estimates
from imumon.noise.nonstationarity.drift import Trend
from imumon.noise.nonstationarity.mean_covariance import MeanCovariance
from imumon.noise.nonstationarity.warmup import find_settling, still_wanders_less
from imumon.noise.statistics.narrow_bands import NarrowBand
from imumon.pipeline.accumulators import Accumulators
from imumon.report import Change
from imumon.samples import Floats

TREND_GROWTH = 1.05
"""Growth of the record, as a factor, after which trends are recomputed: a slope over the whole record hardly
changes in less, and inverting 128 by 128 matrices costs milliseconds a channel. Not critical."""
TREND_PAUSE_S = 10.0
"""s, shortest pause between two computations. Not critical."""


class Trends:
    """Drift of each channel of a record, and its noise at a constant temperature."""

    def __init__(self, record: Accumulators, *, averaged: Sequence[bool]) -> None:
        self._record, self._averaged = record, averaged
        self._due_s, self._begin_s = 0.0, 0.0
        self._trends: list[Trend | None] = []
        self._steady: tuple[ChannelFit, ...] = ()
        self._bias_steps: list[Change | None] = []
        self._settling: list[bool] = []
        self._scatter: Floats | None = None

    def update(
        self,
        fits: Sequence[ChannelFit],
        curve: AllanCurve,
        bands: Sequence[Sequence[NarrowBand]],
        *,
        force: bool,
    ) -> None:
        """Recompute everything if the record has grown enough, its warm-up was excluded, or with `force`.

        `bands` are the narrow bands of the spectrum of each channel of the curve.
        """
        history = self._record.statistics.history
        elapsed, begin, drift = self._record.elapsed_s, history.begin_s, history.drift
        if not force and elapsed < self._due_s and begin == self._begin_s:
            return
        self._due_s, self._begin_s = max(elapsed + TREND_PAUSE_S, elapsed * TREND_GROWTH), begin
        noises: list[MeanCovariance | None] = [MeanCovariance.of(fit) for fit in fits]
        noises += [None] * (len(self._record.channels) - len(noises))
        self._trends = drift.result(noises, begin)
        steps = [noise and drift.bias_step(c, noise, begin) for c, noise in enumerate(noises)]
        self._bias_steps = [step.change if step else None for step in steps]
        steady = drift.without_temperature(curve, self._trends)
        self._steady = ()
        if steady is not None:
            self._steady = fit_curve(steady, averaged=self._averaged, time_to=False, bands=bands)
        self._scatter = self._scatter_of_quarters(bands)
        settled = dict.fromkeys(history.warmup_channels, False)
        settled.update(zip(settled, find_settling(drift, history.warmup_channels, begin), strict=True))
        self._settling = [settled.get(c, False) for c in range(len(fits))]
        if still_wanders_less(drift, history.warmup_channels, begin):
            # all axes warm up together
            self._settling = [own or c in history.warmup_channels for c, own in enumerate(self._settling)]

    def _scatter_of_quarters(self, bands: Sequence[Sequence[NarrowBand]]) -> Floats | None:
        """Return (c, 3) SI the standard deviations of N, B and K between the quarters of the record."""
        quarters = self._record.statistics.history.quarters()
        if quarters is None:
            return None
        averaged = self._averaged[: self._record.allan_channels]
        estimates = [point_estimates(quarter, averaged=averaged, bands=bands) for quarter in quarters]
        return np.asarray(np.std(estimates, axis=0, ddof=1))

    def scatter(self, column: int) -> tuple[float | None, ...]:
        """Return the standard deviations of N, B and K of a channel between quarters; None: unknown."""
        if self._scatter is None or column >= len(self._scatter):
            return (None, None, None)
        return tuple(float(value) if np.isfinite(value) else None for value in self._scatter[column])

    def is_settling(self, column: int) -> bool:
        """Return whether the mean of a channel settles in the samples that count, as during a warm-up."""
        return column < len(self._settling) and self._settling[column]

    @property
    def any_settling(self) -> bool:
        """Whether the mean of any channel settles."""
        return any(self._settling)

    def trend(self, column: int) -> Trend | None:
        """Return the trend of a channel; None if too little is known."""
        return self._trends[column] if column < len(self._trends) else None

    def bias_step(self, column: int) -> Change | None:
        """Return the sudden change of a channel's mean; None if there is none."""
        return self._bias_steps[column] if column < len(self._bias_steps) else None

    def steady_fit(self, column: int) -> ChannelFit | None:
        """Return the fit of a channel without what follows the temperature; None if nothing does."""
        trend = self.trend(column)
        follows = trend is not None and trend.temperature is not None and trend.temperature.significant
        return self._steady[column] if follows and column < len(self._steady) else None
