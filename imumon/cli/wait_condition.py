"""Condition of `imumon wait`: what a report must show, and what is still missing.

A grade is reached when no value that is still unknown can change it: the headline grade is that grade or better
and final, or every N and B of every axis has an upper 95 % limit whose nearest grade is that grade or better.
The second rule matters: a sensor so good that its B is only bounded stays provisional as long as it runs,
because it might be better still, yet it is already good enough. A coefficient that is pending, or a record of
which more than half is excluded, reaches no grade.

A precision is reached when the coefficient of every channel is measured and half of its 95 % interval is at
most the required share of its value. A coefficient that the record only bounds is not measured and may never
be: give a timeout.
"""

from __future__ import annotations

from dataclasses import dataclass

from imumon.model.coefficients import GRADED, GRADES, NOISE, GradeName
from imumon.model.messages import nearest_text
from imumon.model.report import Channel, Report
from imumon.model.samples import INERTIAL, sensor_of
from imumon.model.units import duration, figures, pretty, share_text
from imumon.noise.grading import grade_coefficient


@dataclass(frozen=True, slots=True, kw_only=True)
class WaitCondition:
    """What to wait for; without any of it, for the first sample.

    Attributes
    ----------
    grade : that both sensors, or those of `channels`, must have.
    coefficient : N, B, K, or M, which only some channels have.
    precision : 1, half-width of its 95 % interval as a share of its value.
    channels : names such as ``gyro/x`` or ``gyro``; empty: gyroscope and accelerometer.
    """

    grade: GradeName | None = None
    coefficient: str | None = None
    precision: float | None = None
    channels: tuple[str, ...] = ()

    def unmet(self, report: Report) -> str | None:
        """Return what is missing, in a few words; None when the condition holds."""
        if not report.session.samples:
            return f"no sample yet, the daemon is {report.state}"
        if unknown := self.unknown_channel(report):
            return f"the report has no {unknown}; it has {', '.join(report.channels)}"
        chosen = self._chosen(report)
        if not chosen and (self.grade or self.coefficient):
            return "the report has neither gyroscope nor accelerometer"
        unmet = self._unmet_grade(report, chosen) if self.grade else None
        return unmet or self._unmet_precision(chosen)

    def unknown_channel(self, report: Report) -> str | None:
        """Return the first of `channels` that the report lacks; None while it has no channels at all."""
        known = {part for name in report.channels for part in (name, sensor_of(name))}
        return next((name for name in self.channels if known and name not in known), None)

    def description(self, report: Report) -> str:
        """Return what holds of a report that meets the condition, as far as it is part of the condition."""
        chosen = self._chosen(report)
        parts = []
        if self.coefficient is not None and self.precision is not None:
            known = {n: c.estimates.get(self.coefficient) for n, c in chosen.items()}
            halves = {n: (part and part.stated.half_width) or 0.0 for n, part in known.items()}
            worst = max(halves, key=lambda name: halves[name])
            reached = f"{self.coefficient} known to {share_text(halves[worst])} ({worst}) or better"
            parts.append(f"{reached}, required {100 * self.precision:g} %")
        if self.grade is not None or not parts:
            sensors = {sensor_of(name) for name in chosen}
            parts += [f"{s} {nearest_text(g)}" for s, g in report.grade.items() if s in sensors and g.nearest]
        return "; ".join(parts) or report.state

    def without_grade(self, report: Report) -> bool:
        """Return whether a grade is required of channels that have none, such as those of a magnetometer."""
        chosen = self._chosen(report)
        return self.grade is not None and bool(chosen) and not any(sensor_of(c) in INERTIAL for c in chosen)

    def unreachable_grade(self, report: Report) -> GradeName | None:
        """Return the final grade of a sensor that is worse than the required one; None while it may be reached."""
        sensors = {sensor_of(name) for name in self._chosen(report)}
        final = [
            g.nearest for s, g in report.grade.items() if s in sensors and g.nearest and not g.provisional
        ]
        worst = max(final, key=GRADES.index, default=None)
        if self.grade is None or worst is None or GRADES.index(worst) <= GRADES.index(self.grade):
            return None
        return worst

    def _chosen(self, report: Report) -> dict[str, Channel]:
        names = self.channels or INERTIAL
        return {n: c for n, c in report.channels.items() if n in names or sensor_of(n) in names}

    def _unmet_grade(self, report: Report, chosen: dict[str, Channel]) -> str | None:
        assert self.grade is not None
        sensors = [s for s in INERTIAL if any(sensor_of(name) == s for name in chosen)]
        for sensor in sensors:
            headline = report.grade.get(sensor)
            if headline is None or headline.nearest is None:
                why = f": {headline.reason}" if headline and headline.reason else ""
                return f"{sensor} has no grade yet{why}"
            if GRADES.index(headline.nearest) > GRADES.index(self.grade):
                by = headline.decided_by
                decided = f" by {by.coefficient} of {by.axis}" if by else ""
                return f"{sensor} {nearest_text(headline)}{decided}"
            if headline.provisional and (unmet := _uncertain_grade(report, sensor, self.grade)):
                return unmet
        return None if sensors else "only gyroscope and accelerometer have grades"

    def _unmet_precision(self, chosen: dict[str, Channel]) -> str | None:
        if self.coefficient is None or self.precision is None:
            return None
        for name, channel in chosen.items():
            coefficient = channel.estimates.get(self.coefficient)
            subject = f"{self.coefficient} of {name}"
            if coefficient is None and "N" in channel.estimates and self.coefficient not in NOISE:
                return f"{subject} does not show"
            if coefficient is None or coefficient.status == "pending":
                return f"{subject} is pending"
            if coefficient.is_bound or not coefficient.value:
                return f"{subject} is only bounded so far"
            half = coefficient.stated.half_width
            if half is None:
                return f"{subject} has no limits yet"
            if half > self.precision:
                left = (channel.time_to or {}).get(self.coefficient)
                ahead = f", about {duration(left)} to the precision of the settings" if left else ""
                return f"{subject} is known to {figures(half, 2)}, required {self.precision:g}{ahead}"
        return None


def _uncertain_grade(report: Report, sensor: str, grade: GradeName) -> str | None:
    """Return why a sensor may turn out worse than the grade; None: it cannot."""
    if report.session.mostly_excluded:
        return f"{sensor} is not certain: {report.grade[sensor].reason or 'most of the record is excluded'}"
    axes = ((name, channel) for name, channel in report.channels.items() if sensor_of(name) == sensor)
    return next(filter(None, (_uncertain_limit(name, channel, grade) for name, channel in axes)), None)


def _uncertain_limit(name: str, channel: Channel, grade: GradeName) -> str | None:
    """Return which coefficient may be worse than the grade, by its upper limit; None: none."""

    for letter in GRADED:
        coefficient = channel.estimates.get(letter)
        if coefficient is None or coefficient.status == "pending":
            return f"{letter} of {name} is pending"
        limits = coefficient.stated
        worst = limits.high if limits.high is not None else limits.value
        nearest = grade_coefficient(sensor_of(name), letter, worst).nearest
        if nearest is None or GRADES.index(nearest) > GRADES.index(grade):
            shown, unit = limits.readable.high, pretty(limits.readable.unit)
            limit = "anything" if shown is None else f"{figures(shown)} {unit}"
            return f"{letter} of {name} may be up to {limit}, that is {nearest or 'no grade'}"
    return None
