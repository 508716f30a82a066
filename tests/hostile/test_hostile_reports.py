"""The law of viewers: what the parser accepts, every viewer shows; what it rejects is a ValueError.

A hostile report is a real one with values exchanged: it passes most checks and reaches deep into the viewers.
"""

from __future__ import annotations

import csv
import json
import random
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import cache
from typing import Any

import pytest
import reports
from cases import case
from hostile_input import little_memory, printable
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from paths import ROOT

from imumon.cli.exit_codes import CommandError
from imumon.cli.wait_condition import WaitCondition
from imumon.documents import FORMS, document
from imumon.documents.summary import comparison_text, summary_text
from imumon.model.filter_report import DEFAULT_HORIZON_S, FilterReport
from imumon.model.report import MAX_CHANNELS, Event, Report, Signal, from_json, is_device_name
from imumon.model.report_json import plain, to_json
from imumon.record.filter_report_builder import filter_report
from imumon.tui import channel_table, charts, export, panels, text_panels
from imumon.tui.formatting import Notation
from imumon.tui.view_state import NOTHING, WINDOWS, ViewState

LONGEST_S = 10.0
"""s of processor time that all viewers together may take for one report."""
SIZES = ((1, 1), (20, 5), (80, 24), (220, 60))
DRAWN_FORMS = ("html", "png", "svg")
"""Forms with figures of matplotlib, which take a second each: no hostile report is written in them."""
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
    return from_json(Report, (ROOT / "docs" / "example" / "report.json").read_bytes())


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


def show_everywhere(report: Report, signal: Signal | None, events: tuple[Event, ...]) -> None:
    """Show a report in every viewer."""
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
        if form not in DRAWN_FORMS:
            document(report, form, filters)
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


def holds(seed: int) -> None:
    """Assert the law for a changed report."""
    try:
        report = from_json(Report, mutated(seed))
    except ValueError:
        return
    begin = time.process_time()
    show_everywhere(report, reports.signal(), tuple(reports.events()))
    assert time.process_time() - begin < LONGEST_S


@pytest.mark.parametrize("count", [6, pytest.param(300, marks=[pytest.mark.slow, pytest.mark.timeout(1800)])])
def test_a_hostile_report_is_rejected_or_shown(count: int) -> None:
    law = given(st.integers(0, 2**32))(holds)
    settings(max_examples=count, derandomize=count < 300, suppress_health_check=list(HealthCheck))(law)()


# ---------------------------------------------------------------------- texts


def test_plain_text_has_no_character_that_a_terminal_obeys() -> None:
    hidden = [
        *range(0x20),
        *range(0x7F, 0xA0),
        0x61C,
        0x200B,
        0x200E,
        0x2028,
        0x202E,
        0x2066,
        0xFEFF,
        0xE0041,
    ]
    assert plain("".join(map(chr, hidden))) == ""
    assert plain("°/√h ×÷ τ ⠿ █") == "°/√h ×÷ τ ⠿ █"


@pytest.mark.parametrize("formula", ['=HYPERLINK("http://example.org")', "+1", "@x", "-2+3"])
def test_cells_that_a_spreadsheet_would_execute_are_escaped(formula: str) -> None:
    report = from_json(Report, changed("channels", "gyro/x", "unit", to=formula))
    text = document(report, "csv", FilterReport(time=report.time, device=report.device)).decode()
    cells = [cell for row in csv.reader(text.splitlines()) for cell in row]
    assert f"'{formula}" in cells
    for cell in cells:
        assert not cell.startswith(("=", "+", "@", "\t", "\r"))
        assert not cell.startswith("-") or float(cell) < 0.0


def changed(*path: str | int, to: Any) -> str:
    """Return the real report as JSON with one value exchanged or added."""
    data = json.loads(bases()[0][0])
    *way, last = path
    part = data
    for key in way:
        part = part[key]
    part[last] = to
    return json.dumps(data)


ALLAN = ("channels", "gyro/x", "allan")
NUMBERS: tuple[tuple[str | int, ...], ...] = (
    ("channels", "gyro/x", "mean"),
    ("session", "elapsed_s"),
    (*ALLAN, "sigma", 0),
)
"""Numbers of a report, each of which must not be infinite, missing or beyond the largest that is computed with."""
VALUES: dict[str, tuple[tuple[str | int, ...], Any]] = {
    "channel-without-a-name": (("channels", ""), {"unit": "V"}),
    "channel-with-escapes": (("channels", "\x1b]0;x\x07"), {"unit": "V"}),
    "grade-by-an-unknown-axis": (("grade", "gyro", "decided_by"), {"axis": "w", "coefficient": "N"}),
    "unknown-grade": (("grade", "gyro", "meets"), "splendid"),
    "unknown-state": (("state",), "asleep"),
    "unknown-status": (("channels", "gyro/x", "N", "status"), "guessed"),
    "negative-limit": (("channels", "gyro/x", "N", "low"), -1.0),
    "histogram-of-width-0": (("channels", "gyro/x", "histogram", "width"), 0.0),
    "unequal-degrees-of-freedom": ((*ALLAN, "edf"), [1.0]),
    "cluster-time-0": ((*ALLAN, "tau_s", 0), 0.0),
    "period-0": (("period_s",), 0.0),
    "10000-caveats": (("caveats",), ["x"] * 10_000),
}
STRIP = {"start_s": 0.0, "column_s": 0.0, "low": [1.0], "high": [1.0]}
SIGNALS: dict[str, dict[str, Any]] = {
    "column-of-0-s": {"minute": STRIP},
    "channel-with-a-wildcard": {"channel": "gyro/*"},
}
DEVICE_NAMES = {
    "escapes": "a\x1b]0;x\x07", "empty": "", "capital": "A", "long": "x" * 65, "umlaut": "ä", "blank": "a b",
    "line-end": "a\n", "slash": "a/b", "at": "@a",
}  # fmt: skip


def impossible() -> Iterator[tuple[str, type, str]]:
    """Yield the name of a message that no daemon sends, its type and its text."""
    for path in NUMBERS:
        for number in (1e150, 10**400, float("nan"), float("inf")):
            yield (
                f"{path} {number:g}" if number != 10**400 else f"{path} 1e400",
                Report,
                changed(*path, to=number),
            )
    for name, (path, value) in VALUES.items():
        yield name, Report, changed(*path, to=value)
    for count in (MAX_CHANNELS + 1, 100_000):
        yield (
            f"{count} channels",
            Report,
            changed("channels", to={f"x{k}": {"unit": "V"} for k in range(count)}),
        )
    yield "5 MB", Report, " " * 5_000_000
    for name, change in SIGNALS.items():
        yield name, Signal, json.dumps({"channel": "gyro/x", "unit": "V"} | change)


def test_an_impossible_message_is_rejected_in_printable_words() -> None:
    with little_memory(1 << 30):
        for name, kind, text in impossible():
            begin = time.process_time()
            with case(name), pytest.raises(ValueError, match=r"not a|more than") as error:
                from_json(kind, text)
            printable(str(error.value))
            assert time.process_time() - begin < LONGEST_S, name


@pytest.mark.slow
def test_a_report_with_the_most_channels_is_shown() -> None:
    real = json.loads(bases()[0][0])["channels"]["gyro/x"]
    text = changed("channels", to={f"gyro/x{k}": real for k in range(MAX_CHANNELS)})
    assert len(text) < 1_000_000  # what is accepted fits into a message of the bus
    show_on_screen(from_json(Report, text), None, ())


@pytest.mark.parametrize("name", DEVICE_NAMES)
def test_a_name_that_is_no_key_is_rejected(name: str) -> None:
    assert not is_device_name(DEVICE_NAMES[name])
