"""Findings: fits, spectra and shapes of a record, renewed when it has grown enough to show.

They cost many times what the samples of a second do, and hardly move in it. So a report that follows
another takes them over until the record has grown by a tenth, or by five seconds and 2 %, or by a minute,
whichever is first: what was found belongs to one moment, curve and fit together. Counts, means and all else
that is cheap is of the moment of the report.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from imumon.noise.fit import ChannelFit, Estimator
from imumon.noise.grading import LIMITS
from imumon.noise.nonstationarity.drift import Step
from imumon.noise.statistics.histogram import DistributionShape
from imumon.pipeline import report_builder
from imumon.pipeline.accumulators import Accumulators
from imumon.pipeline.trends import Trends
from imumon.report import Channel, SensorGrade
from imumon.samples import UNITS, sensor_of


def pause_s(elapsed_s: float) -> float:
    """Growth after which a record so long is worth working out anew, s.

    Up to a minute it is young: what is known changes with every look. For a long one the dearest part,
    limits and terms, waits for 2 % (`Estimator`), but no curve stands still for more than a minute.

    >>> pause_s(10.0), pause_s(100.0), pause_s(86400.0)
    (1.0, 7.0, 60.0)
    """
    return min(0.1 * elapsed_s, 5.0 + 0.02 * elapsed_s, 60.0)


class Analysis:
    """What is dear to work out of a record.

    Parameters
    ----------
    averaged : (c,) which channels are true averages over their interval.
    precision : asked 95 % half-width by coefficient, as a share of its value.

    Attributes
    ----------
    fits : of the channels that have a curve.
    shapes : of the distribution of each channel; None where nothing came.
    channels : what a report says of each channel from here.
    grades : headline of each sensor that has a grade, by the fits alone.
    renewals : how often all was worked out.
    """

    def __init__(
        self, record: Accumulators, *, averaged: Sequence[bool], precision: Mapping[str, float]
    ) -> None:
        self._record = record
        self._estimator = Estimator(averaged=averaged, precision=dict(precision))
        self._trends = Trends(record, averaged=averaged)
        self._due_s = 0.0
        # samples of the grid, those past the guard, and warm-up then; and whether all of it was renewed
        self._seen = (-1, -1, 0.0, False)
        self.fits: dict[str, ChannelFit] = {}
        self.shapes: list[DistributionShape | None] = []
        self.channels: dict[str, Channel] = {}
        self.grades: dict[str, SensorGrade] = {}
        self.renewals = 0

    def step(self, column: int) -> Step | None:
        """Sudden change of a channel's mean; None where there is none."""
        return self._trends.step(column)

    def settling(self, column: int) -> bool:
        """Whether a channel's mean plainly settles, and no cut has taken that out."""
        return self._trends.settling(column)

    def renew(self, *, now: bool) -> None:
        """Work everything out anew where it is due, or whatever has changed, `now`."""
        record = self._record
        seen = (record.span, record.history.position, record.warmup_s, now)
        elapsed = record.elapsed_s
        waits = not now and elapsed < self._due_s and seen[2] == self._seen[2]
        if waits or seen == self._seen:
            return
        self._seen, self._due_s = seen, elapsed + pause_s(elapsed)
        self.renewals += 1
        curve, density = record.history.curve(), record.spectrum.result()
        self.shapes = record.histogram.result()
        steps = [shape.step or 0.0 if shape else 0.0 for shape in self.shapes[: record.noisy]]
        fits = self._estimator.fit(curve, renew=now or None, resolution=steps)
        self.fits = dict(zip(record.channels, fits, strict=False))
        self._trends.renew(fits, curve, now=now)
        self.grades = {
            sensor: report_builder.sensor_grade(sensor, axes)
            for sensor in LIMITS
            if (axes := {n.partition("/")[2]: fit for n, fit in self.fits.items() if sensor_of(n) == sensor})
        }
        for column, name in enumerate(record.channels):
            sensor, fit = sensor_of(name), self.fits.get(name)
            made = Channel(unit=UNITS[sensor], histogram=report_builder.histogram(self.shapes[column]))
            if fit is not None:
                made = replace(
                    report_builder.with_fit(made, sensor, curve, column, fit),
                    spectrum=report_builder.spectrum(sensor, density, column),
                    drift=report_builder.drift(sensor, self._trends.of(column), self._trends.steady(column)),
                )
            self.channels[name] = made
