"""Accumulators: the statistics of one stream, from its first sample on.

Placed samples pass the guard, which may exclude some, and then every accumulator in the same order. Each
accumulator sees each tick of the grid once: as a valid sample, as an invalid one, or within a gap.

The guard assesses its first frames together, after four seconds or forty samples. Until then, the statistics
are those of the samples that it holds back, unfiltered, so that there are results from the first sample on.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from imumon.grid.sample_clock import PlacedSamples
from imumon.model.samples import Bools, Floats, sensor_of
from imumon.model.saved_state import restorable
from imumon.noise.detection import Guard, GuardedSamples
from imumon.noise.detection.disturbance import Disturbance
from imumon.noise.statistics.differences import DifferenceAccumulator, RobustDeviation
from imumon.noise.statistics.envelope import Envelope
from imumon.noise.statistics.extreme_values import ExtremeVisits
from imumon.noise.statistics.histogram import HistogramAccumulator
from imumon.noise.stretches import RecordStatistics
from imumon.noise.stretches.record_statistics import Ended
from imumon.noise.validity_groups import ValidityGroups
from imumon.record.gap_fill import Break, DenseBlock, LongGap, fill_gaps

ALLAN_SENSORS = ("gyro", "accel", "mag")
"""Sensors with an Allan curve; the others have running statistics only."""


@dataclass(frozen=True, slots=True)
class Happened:
    """What some samples showed: it may have happened before them, because the guard holds samples back.

    Attributes
    ----------
    disturbances : that ended.
    rest, stuck : places on the grid where the sensor comes to rest or moves, and where it hangs or does not.
    ended : warm-ups, hours and stretches.
    """

    disturbances: list[Disturbance]
    rest: list[tuple[int, bool]]
    stuck: list[tuple[int, bool]]
    ended: Ended


@restorable
@dataclass(slots=True, eq=False)
class GuardedStatistics:
    """Accumulators behind the guard.

    Attributes
    ----------
    allan_channels, allan_groups : number of leading columns, and of their groups, with a curve and a spectrum.
    noise : curve and spectrum of these columns and moments of all, without the warm-up.
    histogram : of all columns.
    differences : of neighbouring samples in the columns with a curve, warm-up included.
    extremes : of these columns.
    """

    allan_channels: int
    allan_groups: int
    noise: RecordStatistics
    histogram: HistogramAccumulator
    differences: DifferenceAccumulator
    extremes: ExtremeVisits

    def update(self, items: Iterable[GuardedSamples]) -> None:
        """Add what the guard passed on."""
        for item in items:
            # A difference of neighbours across a gap would hold the drift of the gap, so both kinds of gaps end the
            # differences. The sums of the noise keep their grid over a gap of known length: only
            # one of unknown length ends them.
            if item.broken or item.skipped:
                self.differences.break_()
            if item.broken:
                self.noise.break_()
            if item.skipped:
                self.noise.skip(item.skipped)
            if len(item.values):
                # None lets every accumulator take its short way without masks: nearly all blocks are complete.
                valid = None if item.valid.all() else item.valid
                allan_valid = None if valid is None else valid[:, : self.allan_groups]
                self.noise.update(item.values, valid)
                self.histogram.update(item.values, valid)
                self.differences.update(item.values[:, : self.allan_channels], allan_valid)
                self.extremes.update(item.values[:, : self.allan_channels], allan_valid)


@restorable
class Accumulators:
    """Statistics of one stream.

    Parameters
    ----------
    channels : names of the columns.
    interval_s : s between two ticks.
    averaged : (c,) channels that are true averages over their interval.
    guarded : exclude disturbances and warm-up.

    Attributes
    ----------
    samples, missing, gaps, span : samples + missing = span, ticks of the grid; gaps interrupt it.
    groups : (c,) number of the sensor of each channel.
    allan_channels : number of leading columns with an Allan curve.
    envelope : sees all received samples, the statistics only those that the guard passes.
    """

    def __init__(
        self,
        channels: tuple[str, ...],
        interval_s: float,
        *,
        averaged: Sequence[bool],
        guarded: bool,
    ) -> None:
        self.channels = channels
        self.interval_s = interval_s
        sensors = [sensor_of(name) for name in channels]
        self.groups = [list(dict.fromkeys(sensors)).index(sensor) for sensor in sensors]
        self._by_sensor = ValidityGroups(len(channels), self.groups)
        # `Stream.channels` has the sensors with a curve first, so a count says which columns these are
        self.allan_channels = sum(sensor in ALLAN_SENSORS for sensor in sensors)
        self.samples = self.missing = self.gaps = self.span = 0
        rate = 1.0 / interval_s
        self.guarded, self._averaged = guarded, averaged
        self.guard = Guard(sensors, rate, excludes=guarded)  # without excluding it still detects motion
        self.envelope = Envelope(self.groups, rate)
        self.temperature = sensors.index("temperature") if "temperature" in sensors else None
        self._statistics = self._new_statistics()

    def feed(self, placed: PlacedSamples) -> Happened:
        """Add samples with their places on the grid; return what they show."""
        self.samples += len(placed.steps)
        # a step above 1 is a gap of known length, BREAK one of unknown length
        self.gaps += int(np.count_nonzero(placed.steps != 1))
        for part in fill_gaps(placed):
            if isinstance(part, Break):
                self._statistics.update(self.guard.break_())
            elif isinstance(part, LongGap):
                # a break has no ticks: its length is unknown, and nothing is known to be missing
                self.span += part.ticks
                self.envelope.skip(part.ticks)
                self._statistics.update(self.guard.skip(part.ticks))
            else:
                self.span += len(part.values)
                valid = self._valid(part)
                # The signal view shows what arrived, disturbances included: it does not pass the guard.
                self.envelope.update(part.values, valid)
                self._statistics.update(self.guard.update(part.values, valid, part.saturated))
        self.missing = self.span - self.samples
        return self._happened()

    def _valid(self, part: DenseBlock) -> Bools | None:
        """Return (n, g) ticks at which a sensor has a sample; None: all. One without a number has none."""
        present, shape = part.present, (len(part.values), max(self.groups) + 1)
        valid = np.ones(shape, bool) if present is None else np.repeat(present[:, None], shape[1], axis=1)
        return self._by_sensor.check(part.values, valid)[1]

    def flush(self) -> Happened:
        """Pass on what the guard holds back: the stream has ended or is interrupted."""
        self._statistics.update(self.guard.flush())
        return self._happened()

    def _happened(self) -> Happened:
        disturbances, stuck = self.guard.events(), self.guard.stuck_changes()
        if (
            not self.guarded
        ):  # the guard notices them also then, but nothing was excluded that an event could report
            disturbances, stuck = [], []
        return Happened(disturbances, self.guard.rest_changes(), stuck, self._statistics.noise.ended())

    @property
    def statistics(self) -> GuardedStatistics:
        """Statistics of what the guard passed; before that, of what it will assess first."""
        # Until the guard has assessed its first frames, nothing has passed it. A report shows the samples that it
        # holds back, through accumulators that are thrown away: they are few, and none is counted twice.
        if (pending := self.guard.pending) is None:
            return self._statistics
        preview = self._new_statistics()
        preview.update([pending])
        return preview

    @property
    def noise(self) -> RecordStatistics:
        """Statistics of what the guard has passed, split by time."""
        return self._statistics.noise

    @property
    def warmup_s(self) -> float:
        """s of received samples excluded as a detected warm-up."""
        return self._statistics.noise.warmup_s

    @property
    def elapsed_s(self) -> float:
        """s, length of the grid, gaps included."""
        return self.span * self.interval_s

    @property
    def missing_share(self) -> float:
        """Share of the grid that was not received, 0 to 1."""
        return self.missing / max(self.span, 1)

    @property
    def disturbances(self) -> int:
        """Number of excluded disturbances, a running one included."""
        return self.guard.disturbances if self.guarded else 0

    @property
    def excluded_s(self) -> float:
        """s of received samples that the guard excluded."""
        return self.guard.excluded_samples * self.interval_s

    @property
    def excluded_share(self) -> float:
        """Share of the received samples that the guard excluded, 0 to 1."""
        return self.guard.excluded_samples / max(self.samples, 1)

    def excluded_noise(self) -> Floats:
        """Return (c,) (channel unit)^2, what the excluded outliers would add to the variance where they are noise."""
        return self.guard.excluded_noise / max(self.samples - self.guard.excluded_samples, 1)

    @property
    def excluded_by(self) -> dict[str, float]:
        """s excluded by reason."""
        return {str(reason): n * self.interval_s for reason, n in self.guard.excluded.items()}

    @property
    def stuck(self) -> bool:
        """Whether the sensor or an axis of it repeats its values now."""
        return self.guarded and self.guard.stuck

    @property
    def stuck_share(self) -> float:
        """Share of the received samples that were excluded as stuck, 0 to 1."""
        return self.guard.excluded.get("stuck", 0) / max(self.samples, 1)

    def excess_kurtosis(self) -> Floats:
        """Return (c,) the excess kurtosis of the samples of each channel with a curve; 0.0 where unknown.

        Slow drift does not enter. The relative variance of N^2 gains it over the number of samples.
        """
        return self.statistics.differences.fast_kurtosis()

    def robust_deviations(self, steps: Sequence[float]) -> list[RobustDeviation | None]:
        """Return the robust companion of the shortest Allan deviation of each channel with a curve.

        Parameters
        ----------
        steps : (c,) channel unit, quantisation steps; 0.0 without.
        """
        return self.statistics.differences.result(steps)

    def _new_statistics(self) -> GuardedStatistics:
        groups = self.groups[: self.allan_channels]
        inertial = [i for i, name in enumerate(self.channels) if sensor_of(name) in ("gyro", "accel")]
        noise = RecordStatistics(
            self.groups,
            self.allan_channels,
            self.interval_s,
            averaged=self._averaged[: self.allan_channels],
            # A magnetometer sees currents and steel nearby, not the heat of the sensor: its mean shows no warm-up.
            warmup_channels=inertial if self.guarded else (),
            temperature=self.temperature,
        )
        histogram = HistogramAccumulator(self.groups)
        allan_groups = max(groups, default=-1) + 1
        return GuardedStatistics(
            self.allan_channels,
            allan_groups,
            noise,
            histogram,
            DifferenceAccumulator(groups),
            ExtremeVisits(groups),
        )
