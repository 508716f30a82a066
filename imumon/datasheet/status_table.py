"""One report on one screen: the state first, then the grades, and one line per channel.

It fits a terminal of 80 x 24 cells for a sensor of nine axes. The whole report is `tables.report_table`.
A wider terminal shows the limits of each coefficient.
"""

from __future__ import annotations

from dataclasses import replace

from imumon.alarms import known
from imumon.datasheet.tables import channel_rows, grade_lines, invalid_noun, sensor_title, stream_noun
from imumon.messages import caveats, exclusions
from imumon.report import Report
from imumon.units import counted, duration


def status_table(report: Report, width: int, late: str | None) -> str:
    """Return what an operator wants to know first.

    Parameters
    ----------
    width : cells of the terminal.
    late : why the numbers are not current; None: they are.
    """
    device, session = report.device, report.session
    where = f" on {device.port}" if device.port else ""
    lines = [
        f"{report.state}: {device.id}, {sensor_title(report)}{where}",
        *([late] if late else []),
        f"{duration(session.elapsed_s)} of {stream_noun(device)}"
        f"{f' at {device.sample_rate_hz:g} Hz' if device.sample_rate_hz else ''}{_temperature(report)}",
        f"{counted(session.samples, 'sample')}, {session.missing:,} missing in {counted(session.gaps, 'gap')}, "
        f"{counted(session.bad_checksums, invalid_noun(device))}",
    ]
    facts = [alarm.text(value) for alarm, value, _ in known(report) if value]
    if excluded := exclusions(report, duration):
        facts.append(f"{' and '.join(excluded)} excluded")
    lines += ["; ".join(facts)] if facts else []
    lines += grade_lines(report, reasons=False)
    if names := [caveat.replace("_", " ") for caveat in caveats(report)]:
        lines.append(f"caveats: {', '.join(names)} (--verbose explains them)")
    noise = {name: channel for name, channel in report.channels.items() if channel.coefficients}
    rows = channel_rows(replace(report, channels=noise), width) if noise else []
    return "\n".join([*lines, *slowest_goals(report), *rows])


def _temperature(report: Report) -> str:
    channel = report.channels.get("temperature")
    return f", {channel.last:.1f} °C" if channel is not None and channel.last is not None else ""


def slowest_goals(report: Report) -> list[str]:
    """Return when the last axis has the configured precision of N, B and K, as far as a record that grows shows it."""
    parts = []
    for letter, share in report.precision.items() if report.state == "running" else ():
        times = [(c.time_to or {}).get(letter) or 0.0 for c in report.channels.values() if c.grade]
        if longest := max(times, default=0.0):
            parts.append(f"{letter} within ±{100.0 * share:g}% in {duration(longest)}")
    return [f"still to come: {', '.join(parts)}"] if parts else []
