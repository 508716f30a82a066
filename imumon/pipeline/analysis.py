"""Analysis: fits, spectra and shapes of a record, recomputed when it has grown enough to show.

They cost many times what the samples of a second cost and hardly change in a second. A report therefore
reuses the last ones until the record has grown by a tenth, or by five seconds and 2 %, or by a minute,
whichever comes first. Curve and fit always belong to the same moment. Counts, means and everything else that
is cheap belong to the moment of the report.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from imumon.noise.fit import ChannelFit, Estimator
from imumon.noise.grading import LIMITS, GradedCoefficient, grade_sensor
from imumon.noise.statistics.differences import RobustDeviation
from imumon.noise.statistics.histogram import DistributionShape
from imumon.noise.statistics.narrow_bands import NarrowBand
from imumon.pipeline import report_builder
from imumon.pipeline.accumulators import Accumulators
from imumon.pipeline.trends import Trends
from imumon.report import Channel, SensorGrade
from imumon.samples import UNITS, sensor_of

YOUNG_GROWTH = 0.1
"""Growth of a young record, as a share, after which it is analysed again: each result changes visibly. Not
critical."""
BASE_PAUSE_S = 5.0
"""s, with `OLD_GROWTH` the pause from one analysis to the next, for the processor time. Not critical."""
OLD_GROWTH = 0.02
"""Growth of an older record, as a share, after which it is analysed again. `Estimator` recomputes limits, its
most expensive part, after the same growth. Not critical."""
LONGEST_PAUSE_S = 60.0
"""s, longest pause, so that the end of the curve moves every minute. Not critical."""


def pause_s(elapsed_s: float) -> float:
    """Return the growth, s, after which a record of this length is analysed again.

    >>> pause_s(10.0), pause_s(100.0), pause_s(86400.0)
    (1.0, 7.0, 60.0)
    """
    return min(YOUNG_GROWTH * elapsed_s, BASE_PAUSE_S + OLD_GROWTH * elapsed_s, LONGEST_PAUSE_S)


class Analysis:
    """The expensive results of a record.

    Parameters
    ----------
    averaged : (c,) channels that are true averages over their interval.
    precision : target of the 95 % half-width by coefficient, as a share of the value.

    Attributes
    ----------
    trends : drift of each channel, steps and settling of its mean.
    fits : by channel, of those with a curve.
    robust : by channel, of those with a curve, the robust companion of its shortest deviation.
    shapes : (c,) shape of the distribution of each channel; None without samples.
    channels : by channel, the fields of a report that come from the analysis.
    grades : headline of each graded sensor, from the fits alone.
    resolution : (c,) channel unit, quantisation steps of the channels with a curve; 0.0 without.
    bands : narrow bands of the spectrum of each channel with a curve; None before the first analysis.
    """

    def __init__(
        self, record: Accumulators, *, averaged: Sequence[bool], precision: Mapping[str, float]
    ) -> None:
        self._record = record
        self._estimator = Estimator(averaged=averaged, precision=dict(precision))
        self.trends = Trends(record, averaged=averaged)
        self._due_s = 0.0
        self._analysed = (-1, -1, 0.0, False)  # length, samples past the guard, warm-up, and `force`
        self.fits: dict[str, ChannelFit] = {}
        self.robust: dict[str, RobustDeviation | None] = {}
        self.shapes: list[DistributionShape | None] = []
        self.channels: dict[str, Channel] = {}
        self.grades: dict[str, SensorGrade] = {}
        self.resolution: list[float] | None = None
        self.bands: Sequence[Sequence[NarrowBand]] | None = None

    def update(self, *, force: bool) -> None:
        """Recompute everything if it is due, or, with `force`, if anything has changed."""
        record, statistics = self._record, self._record.statistics
        current = (record.span, statistics.history.position, record.warmup_s, force)
        elapsed = record.elapsed_s
        early = not force and elapsed < self._due_s and record.warmup_s == self._analysed[2]
        if early or current == self._analysed:
            return
        self._analysed, self._due_s = current, elapsed + pause_s(elapsed)
        curve, density = statistics.history.curve(), statistics.spectrum.result()
        self.shapes = statistics.histogram.result()
        steps = [shape.step or 0.0 if shape else 0.0 for shape in self.shapes[: record.allan_channels]]
        self.resolution, self.bands = steps, density.bands
        history = statistics.history
        fits = self._estimator.fit(
            curve,
            renew=force or None,
            resolution=steps,
            bands=density.bands,
            quiet=None if history.begin_s else density.quiet,  # the spectrum contains the warm-up
            kurtosis=record.excess_kurtosis().tolist(),
            blocks=history.drift.blocks(record.allan_channels, history.begin_s),
        )
        robust = record.robust_deviations(steps)
        self.robust = dict(zip(record.channels, robust, strict=False))
        self.fits = dict(zip(record.channels, fits, strict=False))
        self.trends.update(fits, curve, density.bands, force=force)
        graded: dict[str, dict[str, dict[str, GradedCoefficient]]] = {}  # N and B by sensor and axis
        for name, each in self.fits.items():
            graded.setdefault(sensor_of(name), {})[name.partition("/")[2]] = {"N": each.N, "B": each.B}
        self.grades = {sensor: grade_sensor(sensor, graded[sensor]) for sensor in LIMITS if sensor in graded}
        for column, name in enumerate(record.channels):
            sensor, fit, shape = sensor_of(name), self.fits.get(name), self.shapes[column]
            step = shape.step if shape is not None else None
            channel = Channel(
                unit=UNITS[sensor], resolution=step or None, histogram=report_builder.histogram(shape)
            )
            if fit is not None:
                trend, steady = self.trends.trend(column), self.trends.steady_fit(column)
                channel = replace(
                    report_builder.with_fit(channel, sensor, curve, column, fit, self.trends.scatter(column)),
                    spectrum=report_builder.spectrum(sensor, density, column),
                    drift=report_builder.drift(sensor, trend, steady),
                    robust=report_builder.robust(self.robust[name]),
                )
            self.channels[name] = channel
