"""Readiness: which coefficients are precise enough for a purpose, and how long the others take.

A user wants to know one thing first: may I stop, and copy the numbers? The answer is one word per coefficient, over all
axes of gyroscope and accelerometer. It follows from the report alone, so that screen, tables and documents agree.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Literal, TypeAlias

from imumon.model.coefficients import NOISE
from imumon.model.report import Channel, Report
from imumon.model.samples import INERTIAL, sensor_of
from imumon.model.units import duration

ProgramName: TypeAlias = Literal[
    "kalibr", "ros", "px4", "ardupilot", "gtsam", "openvins", "vins", "fastlio", "liosam", "orbslam3",
    "robot_localization", "kfgins",
]  # fmt: skip
"""Programs that take the noise of a sensor, as `imumon report --format` calls them."""


def letters_for(program: str) -> tuple[str, ...]:
    """Return the coefficients that the numbers of a program rest on: a covariance of samples rests on N alone."""
    return ("N",) if program == "ros" else NOISE


State: TypeAlias = Literal["ready", "growing", "bound", "none"]
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


def state_of(channel: Channel, letter: str) -> State:
    """Return the state of a coefficient of one channel."""
    part = channel.estimates.get(letter)
    if part is None or part.status == "pending":
        return "none"
    if part.is_bound:
        return "bound"
    return "ready" if (channel.time_to or {}).get(letter) == 0.0 else "growing"


def readiness(report: Report, letters: Collection[str]) -> list[Readiness]:
    """Return the readiness of some coefficients; empty of a sensor without gyroscope and accelerometer."""
    axes = [channel for name, channel in report.channels.items() if sensor_of(name) in INERTIAL]
    axes = [channel for channel in axes if channel.estimates]
    out = []
    for letter in letters if axes else ():
        ready = all(state_of(channel, letter) == "ready" for channel in axes)
        times = [(channel.time_to or {}).get(letter) for channel in axes]
        known = [seconds for seconds in times if seconds is not None]
        grows = report.state == "running" and len(known) == len(times)
        out.append(Readiness(letter, ready, max(known) if grows and not ready else None))
    return out


def ready_text(
    report: Report, program: str, letters: Collection[str], length: Callable[[float], str] = duration
) -> str:
    """Return whether the numbers of a program are precise enough, in one line; empty if there are none.

    Parameters
    ----------
    length : makes a text of a time, s.
    """
    parts = []
    for item in readiness(report, letters):
        if item.ready:
            text = "yes"
        elif item.seconds is not None:
            # in time lapse, the host clock shows a fraction of it
            whose = " of sensor time" if report.time_lapse is not None else ""
            text = f"in {length(item.seconds)}{whose}"
        else:
            text = "not yet" if report.state == "running" else "no"
        parts.append(f"{item.letter} {text}")
    return f"ready for {program}: {', '.join(parts)}" if parts else ""
