"""Goal of `imumon wait`: what a report must show, and what it still lacks.

A grade is reached when nothing that is not known yet could take it away: the headline is that grade or
better and final, or every N and B of every axis has an upper 95 % limit that lies nearest to that grade or
better. The second rule matters: a sensor so good that its B is only bounded stays provisional for as long
as it runs, for it might be better still, yet it is already good enough. A coefficient that is pending, or
a record of which more than half was cut out, reaches no grade.

A precision is reached when every channel's coefficient is measured and half of its 95 % interval is within
the asked share of its value. A coefficient that the record only bounds is not measured, and may never be:
give a timeout.
"""

from __future__ import annotations

from dataclasses import dataclass

from imumon.report import Channel, Coefficient, GradeName, Report
from imumon.samples import sensor_of
from imumon.units import duration, figures, pretty

GRADED = ("gyro", "accel")
MOSTLY = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class WaitCondition:
    """What to wait for; without any of it, for the first sample.

    Attributes
    ----------
    grade : that both sensors, or those of `channels`, must have.
    coefficient : N, B or K.
    precision : 1, half-width of its 95 % interval as a share of its value.
    channels : names such as ``gyro/x`` or ``gyro``; empty: gyroscope and accelerometer.
    """

    grade: GradeName | None = None
    coefficient: str | None = None
    precision: float | None = None
    channels: tuple[str, ...] = ()

    def lacks(self, made: Report) -> str | None:
        """What is missing, in a few words; None when the goal is reached."""
        if not made.session.samples:
            return f"no sample yet, the daemon is {made.state}"
        if unknown := self.unknown(made):
            return f"the report has no {unknown}; it has {', '.join(made.channels)}"
        chosen = self._chosen(made)
        found = self._lacks_grade(made, chosen) if self.grade else None
        return found or self._lacks_precision(chosen)

    def unknown(self, made: Report) -> str | None:
        """The first of `channels` that the sensor has not, as soon as it shows what it has."""
        there = {part for name in made.channels for part in (name, sensor_of(name))}
        return next((name for name in self.channels if there and name not in there), None)

    def reached(self, made: Report) -> str:
        """What holds of a report that lacks nothing, as far as it was asked for."""
        chosen, said = self._chosen(made), []
        if self.coefficient is not None and self.precision is not None:
            halves = {name: _half(getattr(channel, self.coefficient)) for name, channel in chosen.items()}
            worst = max(halves, key=lambda name: halves[name] or 0.0)
            said.append(
                f"{self.coefficient} known to {100 * (halves[worst] or 0.0):.2g} % ({worst}) or better, "
                f"asked {100 * self.precision:g} %"
            )
        if self.grade is not None or not said:
            sensors = {sensor_of(name) for name in chosen}
            said += [f"{s} {g.nearest}" for s, g in made.grade.items() if s in sensors and g.nearest]
        return ", ".join(said) or made.state

    def _chosen(self, made: Report) -> dict[str, Channel]:
        wanted = self.channels or GRADED
        return {n: c for n, c in made.channels.items() if n in wanted or sensor_of(n) in wanted}

    def _lacks_grade(self, made: Report, chosen: dict[str, Channel]) -> str | None:
        from imumon.noise.grading import GRADES

        assert self.grade is not None
        sensors = [s for s in GRADED if any(sensor_of(name) == s for name in chosen)]
        for sensor in sensors:
            headline = made.grade.get(sensor)
            if headline is None or headline.nearest is None:
                why = f": {headline.reason}" if headline and headline.reason else ""
                return f"{sensor} has no grade yet{why}"
            if GRADES.index(headline.nearest) > GRADES.index(self.grade):
                by = headline.decided_by
                return f"{sensor} is {headline.nearest}" + (
                    f" by {by.coefficient} of {by.axis}" if by else ""
                )
            if not headline.provisional:
                continue
            if made.session.excluded_s > MOSTLY * made.session.elapsed_s:
                return f"{sensor} is not certain: {headline.reason or 'most of the record was cut out'}"
            for name, channel in made.channels.items():
                if sensor_of(name) == sensor and (doubt := _doubt(name, channel, self.grade)):
                    return doubt
        return None if sensors else "only gyroscope and accelerometer have grades"

    def _lacks_precision(self, chosen: dict[str, Channel]) -> str | None:
        if self.coefficient is None or self.precision is None:
            return None
        for name, channel in chosen.items():
            found: Coefficient | None = getattr(channel, self.coefficient)
            told = f"{self.coefficient} of {name}"
            if found is None or found.status == "pending":
                return f"{told} is pending"
            if found.status == "upper_bound" or not found.value:
                return f"{told} is only bounded so far"
            half = _half(found)
            if half is None:
                return f"{told} has no limits yet"
            if half > self.precision:
                left = channel.time_to and getattr(channel.time_to, self.coefficient)
                ahead = f", about {duration(left)} to the precision of the settings" if left else ""
                return f"{told} is known to {half:.2g}, wanted {self.precision:g}{ahead}"
        return None


def _half(found: Coefficient | None) -> float | None:
    """1, half of the 95 % interval as a share of the value; None where one of them is not known."""
    if found is None or not found.value or found.low is None or found.high is None:
        return None
    return (found.high - found.low) / (2.0 * found.value)


def _doubt(name: str, channel: Channel, asked: GradeName) -> str | None:
    """Which coefficient might still be worse than the grade, judged by its upper limit."""
    from imumon.noise.grading import GRADES, grade_coefficient

    for letter in ("N", "B"):
        found: Coefficient | None = getattr(channel, letter)
        if found is None or found.status == "pending":
            return f"{letter} of {name} is pending"
        worst = found.high if found.high is not None else found.value
        nearest = grade_coefficient(sensor_of(name), letter, worst).nearest
        if nearest is None or GRADES.index(nearest) > GRADES.index(asked):
            shown = found.readable.high
            limit = f"{figures(shown)} {pretty(found.readable.unit)}" if shown is not None else "anything"
            return f"{letter} of {name} may be up to {limit}, that is {nearest or 'no grade'}"
    return None
