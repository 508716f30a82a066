"""Save: what is seen, as numbers or as a picture."""

from __future__ import annotations

import csv
import io
import re
import shutil
import subprocess
from collections.abc import Iterable
from pathlib import Path

from imumon.report import Strip, to_json
from imumon.tui.channel_table import GRADED
from imumon.tui.text_panels import chosen_events
from imumon.tui.view_state import ViewState

CONVERTERS = (
    ("rsvg-convert", ("rsvg-convert", "--zoom", "1.5", "-o")),
    ("inkscape", ("inkscape", "--export-type=png", "--export-filename")),
)
"""Programs that turn an SVG into a PNG, with how they are called."""


def name_of(scene: ViewState, suffix: str) -> str:
    """File name by device, view and time of the report: two saves never meet by chance."""
    report = scene.report
    when = re.sub(r"[^0-9TZ]", "", report.time.partition(".")[0]) if report is not None else "empty"
    device = re.sub(r"[^\w.-]", "_", scene.id or "none")
    return f"imumon-{device}-{scene.view}-{when}.{suffix}"


def png(svg: Path) -> Path | None:
    """Picture of the same name by whatever converter there is; None without one.

    Raises
    ------
    OSError : the converter failed.
    """
    for program, command in CONVERTERS:
        if shutil.which(program):
            target = svg.with_suffix(".png")
            run = subprocess.run(
                [*command, str(target), str(svg)], capture_output=True, timeout=30, check=False
            )
            if run.returncode:
                raise OSError(
                    run.stderr.decode(errors="replace").strip().partition("\n")[0] or f"{program} failed"
                )
            return target
    return None


def text(scene: ViewState, form: str) -> str:
    """CSV of what the view shows, or JSON of the whole report."""
    if form == "json":
        return to_json(scene.report, indent=1) + "\n"
    out = io.StringIO()
    csv.writer(out).writerows(rows(scene))
    return out.getvalue()


def rows(scene: ViewState) -> Iterable[Iterable[object]]:
    """Table of what the view shows, in SI units, its first row the names."""
    report = scene.report
    if report is None:
        return []
    if scene.view == "signal":
        return _signal(scene)
    if scene.view == "events":
        head = ("time", "kind", "channel", "text")
        return [
            head,
            *((e.time, e.kind, e.channel, e.text) for e in chosen_events(scene.events, scene.needle)),
        ]
    if scene.view == "device":
        parts = ("device", report.device), ("session", report.session)
        return [("part", "name", "value"), *((p, n, getattr(o, n)) for p, o in parts for n in o.__slots__)]
    if scene.view == "sensors":
        out: list[Iterable[object]] = [("id", "state", "gyro", "accel", "elapsed_s")]
        for name, r in scene.reports.items():
            grades = (r.grade[sensor].nearest if sensor in r.grade else None for sensor in GRADED)
            out.append((name, r.state, *grades, r.session.elapsed_s))
        return out
    return _curves(scene)


def _curves(scene: ViewState) -> list[Iterable[object]]:
    """Coefficients and Allan deviations of every channel."""
    out: list[Iterable[object]] = [
        ("channel", "unit", "tau_s", "sigma", "low", "high", "edf", "model", "used")
    ]
    channels = scene.report.channels.items() if scene.report is not None else ()
    for name, channel in channels:
        a = channel.allan
        if a is not None:
            columns = zip(a.tau_s, a.sigma, a.low, a.high, a.edf, a.model, a.used, strict=True)
            out += [(name, channel.unit, *column) for column in columns]
    out += [(), ("channel", "coefficient", "unit", "value", "low", "high", "status")]
    for name, channel in channels:
        for part in ("N", "B", "K"):
            c = getattr(channel, part)
            if c is not None:
                out.append((name, part, c.unit, c.value, c.low, c.high, c.status))
    return out


def _signal(scene: ViewState) -> list[Iterable[object]]:
    """The strip in the chosen window, the histogram and the spectrum of the chosen channel."""
    found = scene.signal
    if found is None:
        return [("time_s", "low", "high")]
    out: list[Iterable[object]] = [("time_s", "low", "high")]
    strip: Strip | None = getattr(found, scene.window)
    if strip is not None:
        times = (strip.start_s + k * strip.column_s for k in range(len(strip.low)))
        out += zip(times, strip.low, strip.high, strict=False)
    channel = scene.chosen
    if channel is not None and channel.histogram is not None:
        h = channel.histogram
        out += [(), ("bin_start", "count", "gaussian")]
        out += [
            (h.start + k * h.width, c, g) for k, (c, g) in enumerate(zip(h.counts, h.gaussian, strict=False))
        ]
    if channel is not None and channel.spectrum is not None:
        s = channel.spectrum
        out += [
            (),
            ("frequency_hz", "density", "averages"),
            *zip(s.frequency_hz, s.density, s.averages, strict=False),
        ]
    return out
