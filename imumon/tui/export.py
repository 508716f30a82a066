"""What the screen hands out: the name of a saved report, and numbers for other programs."""

from __future__ import annotations

import re

from imumon.model.report import Report


def file_name(report: Report) -> str:
    """Return a file name with device and time of the report, so that saved files do not collide."""
    when = re.sub(r"[^0-9TZ]", "", report.time.partition(".")[0])
    device = re.sub(r"[^\w.-]", "_", report.device.id)
    return f"imumon-{device}-{when}.json"


def copied_lines(report: Report, program: str) -> list[str]:
    """Return the numbers in the settings of a program, as ``imumon report --format`` has them; a bound is a comment."""
    # computing them takes what no other key needs
    from imumon.api.measurement import Measurement
    from imumon.documents.program_settings import number_lines

    settings = Measurement(report).text(program)
    return [f"# imumon report --format {program} explains each number", *number_lines(settings)]
