"""Condition of `imumon wait`: what a report must show, and what is still missing.

A grade is reached when the sensor certainly has it: the worst grade that the 95 % limits allow is that grade or
better. A sensor so good that its B is only bounded stays provisional as long as it runs, because it might be better
still, yet it is already good enough. A coefficient that is pending may have any.

A precision is reached when the coefficient of every channel is measured and half of its 95 % interval is at
most the required share of its value. A coefficient that the record only bounds is not measured and may never
be: give a timeout.
"""

from __future__ import annotations

from dataclasses import dataclass

from imumon.cli.exit_codes import USAGE, CommandError
from imumon.model.coefficients import NOISE, SCALE, GradeName
from imumon.model.messages import grade_text
from imumon.model.readiness import USUAL_RECORD_S, seconds_left
from imumon.model.report import Channel, Report, SensorGrade
from imumon.model.samples import INERTIAL, ChannelName
from imumon.model.units import duration, figures, share_text


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
        """Return what is missing, in a few words; None when the condition holds.

        Raises
        ------
        CommandError : no report of this device will meet it.
        """
        known = {part for name in report.channels for part in (name, name.sensor)}
        if unknown := [name for name in self.channels if known and name not in known]:
            text = f"the report has no {unknown[0]}; it has {', '.join(report.channels)}"
            raise CommandError("unknown_channel", f"--channel: {text}", "name one of these", USAGE)
        chosen = self._chosen(report)
        if self.grade and chosen and not any(name.sensor in INERTIAL for name in chosen):
            cure = "name gyro or accel with --channel, or give --coefficient"
            text = "--grade: only gyroscope and accelerometer have grades"
            raise CommandError("no_graded_channel", text, cure, USAGE)
        if not report.session.samples:
            return f"no sample yet, the daemon is {report.state}"
        if not chosen and (self.grade or self.coefficient):
            return "the report has neither gyroscope nor accelerometer"
        unmet = self._unmet_grade(report, chosen) if self.grade else None
        return unmet or self._unmet_precision(report, chosen)

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
            sensors = {name.sensor for name in chosen}
            parts += [f"{s} {grade_text(g)}" for s, g in report.grade.items() if s in sensors and g.meets]
        return "; ".join(parts) or report.state

    def unreachable_grade(self, report: Report) -> GradeName | None:
        """Return the best grade that a sensor may have, if the required one is better; None while it may be reached."""
        sensors = {name.sensor for name in self._chosen(report)}
        missed = [
            grade.best
            for sensor, grade in report.grade.items()
            if self.grade and sensor in sensors and grade.best and grade.compared_with(self.grade) == "missed"
        ]
        return max(missed, key=SCALE.index, default=None)

    def _chosen(self, report: Report) -> dict[ChannelName, Channel]:
        names = self.channels or INERTIAL
        return {n: c for n, c in report.channels.items() if n in names or n.sensor in names}

    def _unmet_grade(self, report: Report, chosen: dict[ChannelName, Channel]) -> str | None:
        assert self.grade is not None
        for sensor in (s for s in INERTIAL if any(name.sensor == s for name in chosen)):
            grade = report.grade.get(sensor, SensorGrade())
            if grade.meets is None:
                return f"{sensor} has no grade yet{f': {grade.reason}' if grade.reason else ''}"
            if grade.compared_with(self.grade) != "reached":
                by = grade.decided_by
                decided = f" by {by.coefficient} of {by.axis}" if by else ""
                return f"{sensor} {grade_text(grade)}{decided}{f': {grade.reason}' if grade.reason else ''}"
        return None

    def _unmet_precision(self, report: Report, chosen: dict[ChannelName, Channel]) -> str | None:
        if self.coefficient is None or self.precision is None:
            return None
        for name, channel in chosen.items():
            if missing := _missing(channel, self.coefficient, self.precision, report):
                return f"{self.coefficient} of {name} {missing}"
        return None


def _missing(channel: Channel, letter: str, precision: float, report: Report) -> str | None:
    """Return what a coefficient lacks; None if it is known to a share of its value."""
    coefficient = channel.estimates.get(letter)
    if coefficient is None and "N" in channel.estimates and letter not in NOISE:
        return "does not show"
    if coefficient is None or coefficient.status == "pending":
        return "is pending"
    if coefficient.is_bound or not coefficient.value:
        young = letter == "K" and report.session.elapsed_s < USUAL_RECORD_S
        usual = f"; it usually shows after {duration(USUAL_RECORD_S)}" if young else ""
        return f"is only bounded so far{usual}"
    half = coefficient.stated.half_width
    if half is None:
        return "has no limits yet"
    if coefficient.known_to(precision):
        return None
    left = seconds_left(channel, letter, report.precision)
    ahead = f", about {duration(left)} to the precision of the settings" if left else ""
    return f"is known to {figures(half, 2)}, required {precision:g}{ahead}"
