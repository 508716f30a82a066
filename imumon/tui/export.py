"""What the screen shows, saved as CSV, JSON or PNG."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable
from pathlib import Path

from imumon.files import replace_file
from imumon.messages import spreadsheet_cell
from imumon.report import SensorGrade, Strip
from imumon.report_json import to_json
from imumon.samples import INERTIAL, sensor_of
from imumon.tui.text_panels import filtered_events
from imumon.tui.view_state import ViewState

PNG_ZOOM = 1.5
"""Pixels of a PNG per unit of the SVG: text of a terminal is then legible on paper."""


def file_name(state: ViewState, suffix: str) -> str:
    """Return a file name with device, view and time of the report, so that saved files do not collide."""
    report = state.report
    when = re.sub(r"[^0-9TZ]", "", report.time.partition(".")[0]) if report is not None else "empty"
    device = re.sub(r"[^\w.-]", "_", state.id or "none")
    return f"imumon-{device}-{state.view}-{when}.{suffix}"


def convert_to_png(svg: Path) -> Path | None:
    """Convert with the library of the extra ``png``, and return the new file; None if it is not installed.

    Raises
    ------
    OSError, ValueError : it failed.
    """
    try:
        import resvg_py
    except ImportError:
        return None
    target = svg.with_suffix(".png")
    replace_file(target, bytes(resvg_py.svg_to_bytes(svg_path=str(svg), zoom=PNG_ZOOM)))
    return target


def exported_text(state: ViewState, form: str) -> str:
    """Return what the view shows as CSV, or the whole report as JSON."""
    if form == "json":
        return to_json(state.report, indent=1) + "\n"
    out = io.StringIO()
    csv.writer(out).writerows(map(spreadsheet_cell, row) for row in table_rows(state))
    return out.getvalue()


def table_rows(state: ViewState) -> Iterable[Iterable[object]]:
    """Return what the view shows as a table in SI units, headings first."""
    report = state.report
    if report is None:
        return []
    if state.view == "signal":
        return _signal(state)
    if state.view == "events":
        head = ("time", "kind", "channel", "text")
        shown = filtered_events(state.events, state.filter_text)
        return [head, *((e.time, e.kind, e.channel, e.text) for e in shown)]
    if state.view == "convergence":
        return _convergence(state)
    if state.view == "device":
        parts = ("device", report.device), ("session", report.session)
        return [("part", "name", "value"), *((p, n, getattr(o, n)) for p, o in parts for n in o.__slots__)]
    if state.view == "sensors":
        out: list[Iterable[object]] = [
            ("id", "state", "gyro", "accel", "elapsed_s", "gyro_meets", "accel_meets")
        ]
        for name, r in state.reports.items():
            grades = [r.grade.get(sensor, SensorGrade()) for sensor in INERTIAL]
            nearest, meets = [g.nearest for g in grades], [g.meets for g in grades]
            out.append((name, r.state, *nearest, r.session.elapsed_s, *meets))
        return out
    return _curves(state)


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


def _curves(state: ViewState) -> list[Iterable[object]]:
    """Return coefficients and Allan deviations of every channel."""
    head = ("channel", "unit", "tau_s", "sigma", "low", "high", "edf", "model", "noise", "used")
    out: list[Iterable[object]] = [head]
    channels = state.report.channels.items() if state.report is not None else ()
    for name, channel in channels:
        a = channel.allan
        if a is not None:
            columns = zip(a.tau_s, a.sigma, a.low, a.high, a.edf, a.model, a.noise, a.used, strict=True)
            out += [(name, channel.unit, *column) for column in columns]
    out += [(), ("channel", "coefficient", "unit", "value", "low", "high", "status")]
    for name, channel in channels:
        for letter, c in ((letter, part.stated) for letter, part in channel.estimates.items()):
            out.append((name, letter, c.unit, c.value, c.low, c.high, c.status))
    return out


def _convergence(state: ViewState) -> list[Iterable[object]]:
    """Return what was stated of every coefficient of the selected channel when the record was shorter."""
    out: list[Iterable[object]] = [("channel", "coefficient", "elapsed_s", "value", "low", "high", "status")]
    stated = state.selected.convergence if state.selected is not None else None
    if stated is None:
        return out
    for letter, series in stated.coefficients.items():
        columns = (stated.elapsed_s, series.value, series.low, series.high, series.status)
        out += [(state.channel, letter, *row) for row in zip(*columns, strict=True)]
    return out


def _signal(state: ViewState) -> list[Iterable[object]]:
    """Return signal, histogram and spectrum of the selected channel."""
    out: list[Iterable[object]] = [("time_s", "low", "high")]
    envelope: Strip | None = getattr(state.signal, state.window) if state.signal is not None else None
    if envelope is not None:
        # not strict: columns of a report from another program may differ in length
        times = (envelope.start_s + k * envelope.column_s for k in range(len(envelope.low)))
        out += zip(times, envelope.low, envelope.high, strict=False)
    channel = state.selected
    if channel is not None and channel.histogram is not None:
        h = channel.histogram
        starts = (h.start + k * h.width for k in range(len(h.counts)))
        out += [(), ("bin_start", "count", "gaussian"), *zip(starts, h.counts, h.gaussian, strict=False)]
    if channel is not None and channel.spectrum is not None:
        s = channel.spectrum
        out += [(), ("frequency_hz", "density", "averages")]
        out += zip(s.frequency_hz, s.density, s.averages, strict=False)
    return out
