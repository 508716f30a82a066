"""What the screen hands out: the name of a saved report, and numbers for other programs."""

from __future__ import annotations

import re

from imumon.model.report import Report
from imumon.model.samples import sensor_of
from imumon.tui.view_state import ViewState


def file_name(report: Report) -> str:
    """Return a file name with device and time of the report, so that saved files do not collide."""
    when = re.sub(r"[^0-9TZ]", "", report.time.partition(".")[0])
    device = re.sub(r"[^\w.-]", "_", report.device.id)
    return f"imumon-{device}-{when}.json"


KALIBR = {"gyro": "gyroscope", "accel": "accelerometer"}
"""Sensors in the names of the numbers of Kalibr."""


def copied_lines(state: ViewState) -> list[str]:
    """Return N and K of the worst axis of each inertial sensor in SI, as lines of Kalibr; a bound is a comment."""
    report = state.report
    if report is None:
        return []
    lines = [
        "# continuous time, SI; worst axis; random_walk is plain K: imumon report --format kalibr widens it for B"
    ]
    for sensor, word in KALIBR.items():
        axes = {name: c for name, c in report.channels.items() if sensor_of(name) == sensor}
        for letter, name in (("N", "noise_density"), ("K", "random_walk")):
            known = {n: part for n, c in axes.items() if (part := c.estimates.get(letter)) is not None}
            sizes = {n: part.value if part.value is not None else part.high for n, part in known.items()}
            worst = max(
                (n for n, size in sizes.items() if size is not None),
                key=lambda n: sizes[n] or 0.0,
                default=None,
            )
            if worst is None:
                lines.append(f"# {word}_{name}: not known yet")
            elif known[worst].value is None:
                lines.append(f"# {word}_{name}: < {sizes[worst]:.3e}  # {worst}: 95 % upper bound")
            else:
                lines.append(f"{word}_{name}: {sizes[worst]:.4e}  # {worst}, {known[worst].unit}")
    return lines
