"""Hostile reports, and every viewer of a report, for the fuzz tests.

A hostile report is a real one with values exchanged: it passes most checks and reaches deep into the viewers.
"""

from __future__ import annotations

import json
import random
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import cache
from typing import Any

import reports
from paths import ROOT

from imumon.cli.exit_codes import CommandError
from imumon.cli.wait_condition import WaitCondition
from imumon.documents import FORMS, NoCurve, document
from imumon.documents.summary import comparison_text, summary_text
from imumon.model.filter_report import DEFAULT_HORIZON_S
from imumon.model.report import Event, Report, Signal, from_json
from imumon.model.report_json import to_json
from imumon.record.filter_report_builder import filter_report
from imumon.tui import channel_table, charts, export, panels, text_panels
from imumon.tui.formatting import Notation
from imumon.tui.view_state import NOTHING, WINDOWS, ViewState

DOCS = ROOT / "docs"
SIZES = ((1, 1), (20, 5), (80, 24), (220, 60))
DRAWN_FORMS = ("html", "png", "svg")
"""Forms with figures of matplotlib, which take a second each."""
PANELS: tuple[Callable[[ViewState, int, int], Any], ...] = (
    panels.status, panels.headlines, panels.detail, panels.welcome, channel_table.table, charts.allan_chart,
    charts.signal_chart, charts.histogram_chart, charts.spectrum_chart, text_panels.device,
    text_panels.events, text_panels.sensors, text_panels.drift,
)  # fmt: skip

EXTREME = (0.0, -0.0, 1.0, -1.0, 5e-324, 1e-300, 1e-160, 1e-9, 0.5, 1e9, 1e100, 9e149, -9e149)
FORBIDDEN = (1e150, 1e308, -1e308, 10**400, float("nan"), float("inf"))
WHOLE = (0, 1, -1, 7, 2**31, 2**63, -(2**70), 10**149)
TEXTS = (
    "",
    " ",
    "x",
    "gyro/x",
    "\x1b]0;owned\x07",
    "a\nb",
    "=1+1",
    "|`<script>",
    "\u202eabc",
    "é" * 300,
    "[s]",
)
NAMES = ("gyro/x", "gyro/y", "accel/z", "mag/x", "temperature", "other", "other/w", "gyro", "N", "gyro/q")

ANYTHING = (
    None, True, *EXTREME, *WHOLE, *TEXTS, *FORBIDDEN, *NAMES, [], {}, "measured", "upper_bound", "pending",
    "constant", "navigation",
)  # fmt: skip


ALIKE: dict[type, tuple[Any, ...]] = {
    bool: (True, False),
    int: WHOLE,
    float: EXTREME,
    str: (*TEXTS, *NAMES),
    list: ([],),
}
"""Values of the same type, which pass more checks."""


def _places(data: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the path of every value; of an array only its ends."""
    yield path
    if isinstance(data, dict):
        for key, value in data.items():
            yield from _places(value, (*path, key))
    elif isinstance(data, list):
        for index in sorted({0, len(data) - 1} if data else set()):
            yield from _places(data[index], (*path, index))


@cache
def real_report() -> Report:
    """Return the report of the documentation: of a long record, so that every part is there."""
    return from_json(Report, (DOCS / "example" / "report.json").read_bytes())


@cache
def bases() -> tuple[tuple[str, tuple[tuple[Any, ...], ...]], ...]:
    """Return real reports as JSON, each with the paths of its values."""
    texts = [to_json(each) for each in (real_report(), reports.moving(), reports.nothing_yet())]
    return tuple((text, tuple(_places(json.loads(text)))[1:]) for text in texts)


def mutated(seed: int) -> str:
    """Return a real report of which some values are exchanged, as JSON."""
    draw = random.Random(seed)
    text, places = draw.choice(bases())
    data = json.loads(text)
    for _ in range(draw.randint(1, 8)):
        *way, last = draw.choice(places)
        part: Any = data
        try:
            for key in way:
                part = part[key]
            value = draw.choice(ALIKE.get(type(part[last]), ANYTHING) if draw.random() < 0.9 else ANYTHING)
            if isinstance(part, list) and draw.random() < 0.5:
                part[:] = [value] * len(part)
            else:
                part[last] = value
        except (TypeError, KeyError, IndexError):
            pass  # an earlier change has removed this part
    return json.dumps(data)


def show_everywhere(report: Report, signal: Signal | None, events: tuple[Event, ...], drawn: bool) -> None:
    """Show a report in every viewer; `drawn`: with the figures of matplotlib too."""
    for width in (20, 80):
        summary_text(report, width)
    comparison_text(report, real_report())
    to_json(report)
    for condition in (
        WaitCondition(),
        WaitCondition(grade="consumer"),
        WaitCondition(grade="navigation", channels=("gyro/x",)),
        *(WaitCondition(coefficient=letter, precision=0.05) for letter in "NBK"),
        WaitCondition(coefficient="N", precision=0.05, channels=("other", "gyro")),
    ):
        with suppress(CommandError):  # a channel that the report lacks
            if condition.unmet(report) is None:
                condition.description(report)
    filters = filter_report(report, DEFAULT_HORIZON_S)
    for form in FORMS:
        if drawn or form not in DRAWN_FORMS:
            try:
                document(report, form, filters)
            except NoCurve:
                assert form in DRAWN_FORMS
    show_on_screen(report, signal, events)


def show_on_screen(report: Report, signal: Signal | None, events: tuple[Event, ...]) -> None:
    """Draw every panel of every channel, in both notations, and name the file of the report."""
    other = replace(report, device=replace(report.device, id="other"))
    state = ViewState(
        reports={report.device.id: report, "other": other, "real": real_report()},
        ages={report.device.id: 1.0}, id=report.device.id, signal=signal, events=events,
        baseline=other, connected=True,
    )  # fmt: skip
    for number, channel in enumerate(tuple(report.channels)[:12] or (NOTHING,)):
        for size in SIZES if number < 2 else SIZES[2:3]:
            for si in (False, True):
                shown = state.updated(
                    channel=channel, notation=Notation(si=si), overlay=si, show_limits=True,
                    zoomed=si, window=WINDOWS[number % 3],
                )  # fmt: skip
                for panel in PANELS:
                    panel(shown, *size)
    export.copied_lines(report, state.program)
    export.file_name(report)
