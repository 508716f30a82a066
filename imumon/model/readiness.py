"""Readiness: the mark of a coefficient, the time that remains, and whether the numbers of a program are complete.

A user wants to know one thing first: may I stop, and copy the numbers? Screen, `wait`, tables and documents ask this
module, which knows the numbers that stand beside the answer and nothing else:

- a coefficient is ready if half of its 95 % limits is at most the configured share of its value;
- the time until then is that of the fit, which knows its statistics alone. Where other components make the limits
  wider than the goal, more data may not narrow them, and no time is promised;
- a program takes N, and K for the walk of the bias, of all axes: the worst axis decides.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

from imumon.model.report import Channel, Report
from imumon.model.samples import INERTIAL
from imumon.model.units import duration

ProgramName: TypeAlias = Literal[
    "kalibr", "ros", "px4", "ardupilot", "gtsam", "openvins", "vins", "fastlio", "liosam", "orbslam3",
    "robot_localization", "kfgins",
]  # fmt: skip
"""Programs that take the noise of a sensor, as `imumon report --format` calls them."""


USUAL_RECORD_S = 8 * 3600.0
"""s, record that usually shows K or bounds it well below what matters."""


def letters_for(program: str) -> tuple[str, ...]:
    """Return the coefficients that a program takes: a covariance of samples is N alone."""
    return ("N",) if program == "ros" else ("N", "K")


ReadinessState: TypeAlias = Literal["ready", "growing", "bound", "none"]
"""Of one coefficient: as precise as configured; measured, not precise enough; only a bound; pending or absent."""


@dataclass(frozen=True, slots=True)
class Readiness:
    """Readiness of a coefficient over all inertial axes.

    Attributes
    ----------
    letter : of the coefficient.
    ready : every axis has the configured precision.
    seconds : s of the sample clock until the last axis has it; None: nothing can be promised.
    """

    letter: str
    ready: bool
    seconds: float | None


def state_of(channel: Channel, letter: str, precision: Mapping[str, float]) -> ReadinessState:
    """Return the state of a coefficient of one channel.

    Parameters
    ----------
    precision : of the report, 1: half-widths that are asked for, by letter.
    """
    part = channel.estimates.get(letter)
    if part is None or part.status == "pending":
        return "none"
    if part.is_bound:
        return "bound"
    return "ready" if letter in precision and part.known_to(precision[letter]) else "growing"


def seconds_left(channel: Channel, letter: str, precision: Mapping[str, float]) -> float | None:
    """Return the s of the sample clock until a coefficient is ready; 0 if it is, None where none can be promised."""
    if state_of(channel, letter, precision) == "ready":
        return 0.0
    return (channel.time_to or {}).get(letter) or None


def readiness(report: Report, letters: Collection[str]) -> list[Readiness]:
    """Return the readiness of some coefficients; empty of a sensor without gyroscope and accelerometer."""
    axes = [channel for name, channel in report.channels.items() if name.sensor in INERTIAL]
    axes = [channel for channel in axes if channel.estimates]
    out = []
    for letter in letters if axes else ():
        times = [seconds_left(channel, letter, report.precision) for channel in axes]
        known = [seconds for seconds in times if seconds is not None]
        ready = not any(times) and len(known) == len(times)
        grows = report.state == "running" and len(known) == len(times)
        out.append(Readiness(letter, ready, max(known) if grows and not ready else None))
    return out


def ready_text(report: Report, program: str, length: Callable[[float], str] = duration) -> str:
    """Return whether the numbers that a program takes are precise enough, in one line; empty if there are none.

    Parameters
    ----------
    length : makes a text of a time, s.
    """
    # in time lapse, the host clock shows a fraction of it
    whose = " of sensor time" if report.time_lapse is not None else ""
    parts = []
    for item in readiness(report, letters_for(program)):
        if item.ready:
            text = "yes"
        elif report.state != "running":
            text = "no"
        elif item.seconds is not None:
            text = f"in {length(item.seconds)}{whose}"
        elif item.letter == "K" and report.session.elapsed_s < USUAL_RECORD_S:
            text = f"usually after {duration(USUAL_RECORD_S)}{whose}"
        else:
            text = "not yet"
        parts.append(f"{item.letter} {text}")
    return f"ready for {program}: {', '.join(parts)}" if parts else ""
