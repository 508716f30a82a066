"""Counts of a record: what became of the ticks of its grid so far."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from imumon.model.report import SessionCounters
from imumon.model.samples import Bools, Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Counts:
    """What a record has received, and what the guard has excluded of it.

    Attributes
    ----------
    interval_s : s between two ticks of the grid.
    span, samples : ticks, and those of them with a received sample; the others are missing.
    gaps : interruptions of the samples.
    excluded : received samples that the guard has excluded, by reason.
    excluded_samples : number of them; a sample that only the magnetometer has excluded is none.
    excluded_squares : (c,) (channel unit)^2, sum of the squares of excluded outliers where they are noise.
    noisy : (c,) channels whose outliers are noise.
    disturbances : number of excluded ones, a running one included.
    at_rest, stuck : whether the sensor is at rest, and repeats its values, now.
    warmup_s : s of received samples excluded as a warm-up.
    """

    interval_s: float
    span: int
    samples: int
    gaps: int
    excluded: Mapping[str, int]
    excluded_samples: int
    excluded_squares: Floats
    noisy: Bools
    disturbances: int
    at_rest: bool
    stuck: bool
    warmup_s: float

    @property
    def elapsed_s(self) -> float:
        """s, length of the grid, gaps included."""
        return self.span * self.interval_s

    @property
    def missing(self) -> int:
        """Ticks of the grid without a sample."""
        return self.span - self.samples

    @property
    def missing_share(self) -> float:
        """Share of the grid that was not received, 0 to 1."""
        return self.missing / max(self.span, 1)

    @property
    def excluded_by(self) -> dict[str, float]:
        """s excluded by reason."""
        return {reason: count * self.interval_s for reason, count in self.excluded.items()}

    @property
    def excluded_share(self) -> float:
        """Share of the received samples that the guard excluded, 0 to 1."""
        return self.excluded_samples / max(self.samples, 1)

    @property
    def stuck_share(self) -> float:
        """Share of the received samples that were excluded as stuck, 0 to 1."""
        return self.excluded.get("stuck", 0) / max(self.samples, 1)

    def excluded_variance(self) -> Floats:
        """Return (c,) (channel unit)^2, what the excluded outliers would add to the variance where they are noise."""
        return self.excluded_squares / max(self.samples - self.excluded_samples, 1)

    def added_to(self, link: SessionCounters) -> SessionCounters:
        """Return the counters of the link with those of the record."""
        return replace(
            link,
            elapsed_s=self.elapsed_s,
            samples=self.samples,
            missing=self.missing,
            gaps=self.gaps,
            disturbances=self.disturbances,
            excluded_s=self.excluded_samples * self.interval_s,
            excluded_by=self.excluded_by,
            warmup_s=self.warmup_s,
        )
