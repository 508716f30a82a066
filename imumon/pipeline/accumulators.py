"""Record: the statistics of one stream, from its first sample on.

Placed samples go in; they pass the guard, which may cut some out, and then every accumulator in the same
order. Each accumulator sees each tick of the grid once: as a valid sample, an invalid one, or in a hole.

The guard judges its first frames together, after four seconds or forty samples. Until then the statistics
are those of what it holds, taken as it came: who looks sees numbers from the first sample on.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from imumon.noise.allan import AllanCurve
from imumon.noise.detection import Guard, GuardedSamples
from imumon.noise.detection.disturbance import Disturbance
from imumon.noise.fit import ChannelFit, fit_curve
from imumon.noise.nonstationarity import HourlyStatistics
from imumon.noise.nonstationarity.warmup import warming
from imumon.noise.statistics.envelope import Envelope
from imumon.noise.statistics.histogram import HistogramAccumulator
from imumon.noise.statistics.psd import SpectrumAccumulator
from imumon.pipeline.gap_fill import Break, Hole, stretches
from imumon.samples import Bools, Floats, sensor_of
from imumon.timebase.sample_clock import PlacedSamples

NOISE = ("gyro", "accel", "mag")
"""Sensors with an Allan curve; the others have running statistics only."""

COUNTS = ("samples", "missing", "gaps", "span")
PARTS: dict[str, Any] = {"spectrum": SpectrumAccumulator, "histogram": HistogramAccumulator}
"""Statistics beside the history, by their names in the saved state."""

ROUNDED = ("strip.", "spectrum.", "guard.watch")
"""Beginnings of the names of what is kept to seven digits: what is drawn, and what the guard compares with.
Samples that wait and what is summed for the figures are kept whole: they go on as if nothing had happened."""

LONG_S = 3600.0
"""Segments of the spectrum of less than this are not kept: beginning them anew costs a few of many."""

Saved = dict[str, npt.NDArray[Any]]


@dataclass(slots=True, eq=False)
class Statistics:
    """What is accumulated of the samples that count, all of it in one order.

    Attributes
    ----------
    noisy, groups : the first so many columns, and groups of them, have a curve and a spectrum.
    """

    noisy: int
    groups: int
    history: HourlyStatistics
    spectrum: SpectrumAccumulator
    histogram: HistogramAccumulator

    def apply(self, pieces: Iterable[GuardedSamples]) -> None:
        """Take what the guard let pass."""
        everyone = (self.history, self.spectrum, self.histogram)
        for piece in pieces:
            for part in everyone:
                if piece.broken:
                    part.break_()
                if piece.skipped:
                    part.skip(piece.skipped)
            if len(piece.values):
                self._account(piece.values, None if piece.valid.all() else piece.valid)

    def _account(self, values: Floats, valid: Bools | None) -> None:
        """Every accumulator takes these ticks."""
        fit = None if valid is None else valid[:, : self.groups]
        self.history.update(values, valid)
        self.spectrum.update(values[:, : self.noisy], fit)
        self.histogram.update(values, valid)


class Accumulators:
    """Statistics of one stream.

    Parameters
    ----------
    channels : names of the columns.
    interval_s : s between two ticks.
    averaged : (c,) which channels are true averages over their interval.
    guarded : whether disturbances and warm-up are cut out.

    Attributes
    ----------
    samples, missing, gaps, span : samples + missing = span, ticks of the grid; gaps are the holes in it.
    strip : sees everything that came; the statistics only what the guard lets pass.
    """

    def __init__(
        self, channels: tuple[str, ...], interval_s: float, *, averaged: Sequence[bool], guarded: bool
    ) -> None:
        self.channels = channels
        self.interval_s = interval_s
        sensors = [sensor_of(name) for name in channels]
        names = list(dict.fromkeys(sensors))
        self.groups = [names.index(s) for s in sensors]
        self.noisy = sum(s in NOISE for s in sensors)
        self.samples = self.missing = self.gaps = self.span = 0
        rate = 1.0 / interval_s
        self.guarded, self._averaged = guarded, averaged
        self.guard = Guard(sensors, rate, cuts=guarded)  # without cutting it still says what is at rest
        self.strip = Envelope(self.groups, rate)
        self.temperature = sensors.index("temperature") if "temperature" in sensors else None
        self._passed = self._statistics()

    def feed(self, placed: PlacedSamples) -> None:
        """Take samples with their places on the grid."""
        n = len(placed.steps)
        self.samples += n
        self.gaps += int(np.count_nonzero(placed.steps != 1))
        for part in stretches(placed):
            if isinstance(part, Break):
                self.strip.break_()
                self._passed.apply(self.guard.break_())
            elif isinstance(part, Hole):
                self.span += part.ticks
                self.strip.skip(part.ticks)
                self._passed.apply(self.guard.skip(part.ticks))
            else:
                self.span += len(part.values)
                valid = self._valid(part.present)
                self.strip.update(part.values, valid)
                self._passed.apply(self.guard.update(part.values, valid, part.saturated))
        self.missing = self.span - self.samples

    @property
    def history(self) -> HourlyStatistics:
        """Curve and moments without the warm-up; curves are those of the first `noisy` columns."""
        return self._shown().history

    @property
    def spectrum(self) -> SpectrumAccumulator:
        """Of the first `noisy` columns."""
        return self._shown().spectrum

    @property
    def histogram(self) -> HistogramAccumulator:
        """Of all columns."""
        return self._shown().histogram

    @property
    def warmup_s(self) -> float:
        """Seconds of received samples that a recognised warm-up took."""
        return self._passed.history.warmup_s

    @property
    def missing_share(self) -> float:
        """Part of the grid that was not received, 0 to 1."""
        return self.missing / max(self.span, 1)

    def _statistics(self) -> Statistics:
        """Statistics of nothing yet."""
        noisy = self.groups[: self.noisy]
        inertial = [i for i, name in enumerate(self.channels) if sensor_of(name) in ("gyro", "accel")]

        averaged = self._averaged  # not this record, which a circle would keep

        def fit(curve: AllanCurve) -> tuple[ChannelFit, ...]:
            return fit_curve(curve, averaged=averaged, time_to=False)

        history = HourlyStatistics(
            self.groups,
            self.noisy,
            self.interval_s,
            fit,
            warming=inertial if self.guarded else (),
            temperature=self.temperature,
        )
        return Statistics(
            self.noisy,
            max(noisy, default=-1) + 1,
            history,
            SpectrumAccumulator(noisy, 1.0 / self.interval_s),
            HistogramAccumulator(self.groups),
        )

    def _shown(self) -> Statistics:
        """Statistics of what the guard let pass; until it has, of what it will judge first."""
        first = self.guard.first
        if first is None:
            return self._passed
        shown = self._statistics()
        shown.apply([first])
        return shown

    def flush(self) -> None:
        """Let out what the guard holds back: the stream has ended, or stands still."""
        self._passed.apply(self.guard.flush())

    @property
    def elapsed_s(self) -> float:
        """Length of the grid, holes included."""
        return self.span * self.interval_s

    @property
    def at_rest(self) -> bool:
        """False while the sensor moves or is handled."""
        return self.guard.at_rest

    @property
    def disturbances(self) -> int:
        """Stretches cut out so far, a running one included."""
        return self.guard.disturbances if self.guarded else 0

    @property
    def excluded_s(self) -> float:
        """Seconds of received samples that were cut out."""
        return self.guard.excluded_samples * self.interval_s

    @property
    def excluded_share(self) -> float:
        """Part of the received samples that was cut out, 0 to 1."""
        return self.guard.excluded_samples / max(self.samples, 1)

    @property
    def excluded_by(self) -> dict[str, float]:
        """The same by reason."""
        cut = self.guard.excluded
        return {str(reason): n * self.interval_s for reason, n in cut.items()}

    @property
    def repeating(self) -> str | None:
        """Reason why what comes now is taken for no measurement: ``stuck`` or ``loop``."""
        return self.guard.repeating if self.guarded else None

    @property
    def repeated_share(self) -> float:
        """Part of the received samples that only repeated others, 0 to 1."""
        cut = self.guard.excluded
        return (cut.get("stuck", 0) + cut.get("loop", 0)) / max(self.samples, 1)

    def warming(self) -> bool:
        """Whether the sensor's temperature still rises."""
        return warming(self.history.drift, self.temperature)

    def found(self) -> list[Disturbance]:
        """Disturbances that ended since the last call."""
        return self.guard.events() if self.guarded else []

    def save(self) -> tuple[dict[str, Any], Saved]:
        """State that `resume` continues from: JSON values and small arrays."""
        meta = {name: getattr(self, name) for name in COUNTS}
        parts = {
            "guard": self.guard.save(),
            "strip": self.strip.save(),
            "history": self._passed.history.save(),
        }
        parts |= {
            "spectrum": self._passed.spectrum.save(least_s=LONG_S),
            "histogram": self._passed.histogram.save(),
        }
        named = {f"{name}.{key}": array for name, own in parts.items() for key, array in own.items()}
        return meta, {
            name: array.astype(np.float32) if name.startswith(ROUNDED) and _is_table(array) else array
            for name, array in named.items()
        }

    def resume(self, meta: Mapping[str, Any], arrays: Saved) -> None:
        """Continue from a state, in a record just made with the same arguments."""
        for name in COUNTS:
            setattr(self, name, int(meta[name]))

        def own(name: str) -> Saved:
            return {
                k.removeprefix(f"{name}."): v.astype(np.float64) if v.dtype == np.float32 else v
                for k, v in arrays.items()
                if k.startswith(f"{name}.")
            }

        self.guard, self.strip = Guard.restore(own("guard")), Envelope.restore(own("strip"))
        self._passed.history.resume(own("history"))
        for name, kind in PARTS.items():
            setattr(self._passed, name, kind.restore(own(name)))

    def _valid(self, present: Bools | None) -> Bools | None:
        if present is None:
            return None
        return np.repeat(present[:, None], max(self.groups) + 1, axis=1)


def _is_table(array: npt.NDArray[Any]) -> bool:
    return array.dtype == np.float64 and array.ndim > 1
