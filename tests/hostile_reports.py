"""Hostile reports, and every viewer of a report, for the fuzz tests.

A report is hostile in two ways: a real one with values exchanged, which passes most checks and reaches deep
into the viewers, or one that is drawn from the JSON Schema as a whole.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import reports
from hypothesis import strategies as st

from imumon.cli.wait_condition import WaitCondition
from imumon.datasheet import FORMS, NoCurve, document
from imumon.datasheet.signal_text import baseline_summary, signal_lines
from imumon.datasheet.tables import report_table
from imumon.report import Event, Report, Signal, to_json
from imumon.tui import channel_table, charts, export, panels, text_panels
from imumon.tui.formatting import Notation
from imumon.tui.view_state import VIEWS, WINDOWS, ViewState

SCHEMA = json.loads((Path(__file__).parents[1] / "docs" / "report.schema.json").read_text("utf-8"))["$defs"]
SIZES = ((1, 1), (20, 5), (80, 24), (220, 60))
DRAWN_FORMS = ("html", "png")
"""Forms with figures of matplotlib, which take a second each."""
PANELS: tuple[Callable[[ViewState, int, int], Any], ...] = (
    panels.status, panels.headlines, panels.detail, panels.welcome, channel_table.table, charts.allan_chart,
    charts.signal_chart, charts.histogram_chart, charts.spectrum_chart, text_panels.device,
    text_panels.events, text_panels.sensors, text_panels.drift,
)  # fmt: skip

EXTREME = (0.0, -0.0, 1.0, -1.0, 5e-324, 1e-300, 1e-160, 1e-9, 0.5, 1e9, 1e100, 9e149, -9e149)
FORBIDDEN = (1e150, 1e308, -1e308, 10**400, float("nan"), float("inf"))
WHOLE = (0, 1, -1, 7, 2**31, 2**63, -(2**70), 10**149)
TEXTS = ("", " ", "x", "gyro/x", "\x1b]0;owned\x07", "a\nb", "=1+1", "|`<script>", "\u202eabc", "é" * 300, "[s]")
NAMES = ("gyro/x", "gyro/y", "accel/z", "mag/x", "temperature", "other", "other/w", "gyro", "N", "gyro/q")

numbers = st.sampled_from(EXTREME) | st.floats(-9e149, 9e149, allow_nan=False)
integers = st.sampled_from(WHOLE)
texts = st.sampled_from(TEXTS)
anything = st.one_of(
    st.none(), st.booleans(), numbers, integers, texts, st.sampled_from(FORBIDDEN), st.just([]), st.just({}),
    st.sampled_from(NAMES), st.sampled_from(("measured", "upper_bound", "pending", "constant", "navigation")),
)  # fmt: skip


def from_schema(rule: dict[str, Any]) -> st.SearchStrategy[Any]:
    """Return JSON data that match a rule of the schema, with hostile values."""
    if "$ref" in rule:
        return _definition(rule["$ref"].rpartition("/")[2])
    if "anyOf" in rule:
        return st.one_of([from_schema(one) for one in rule["anyOf"]])
    if "enum" in rule:
        return st.sampled_from(rule["enum"])
    kinds = rule["type"] if isinstance(rule["type"], list) else [rule["type"]]
    return st.one_of([_of_kind(kind, rule) for kind in kinds])


def _of_kind(kind: str, rule: dict[str, Any]) -> st.SearchStrategy[Any]:
    if kind == "array":
        return st.lists(from_schema(rule["items"]), max_size=3)
    if kind == "object" and "additionalProperties" in rule:
        return st.dictionaries(st.sampled_from(NAMES), from_schema(rule["additionalProperties"]), max_size=3)
    if kind == "object":
        return _object(rule)
    simple: dict[str, st.SearchStrategy[Any]] = {
        "string": texts, "number": numbers, "integer": integers, "boolean": st.booleans(), "null": st.none(),
    }  # fmt: skip
    return simple[kind]


def _object(rule: dict[str, Any]) -> st.SearchStrategy[Any]:
    """Return objects whose arrays have one length."""
    properties = rule["properties"]
    lists = {n: r["items"] for n, r in properties.items() if r.get("type") == "array" and "type" in r["items"]}
    rest = {n: from_schema(r) for n, r in properties.items() if n not in lists}

    def with_arrays(length: int) -> st.SearchStrategy[Any]:
        arrays = {n: st.lists(from_schema(i), min_size=length, max_size=length) for n, i in lists.items()}
        return st.fixed_dictionaries(rest | arrays)

    return st.integers(0, 3).flatmap(with_arrays)


@cache
def _definition(name: str) -> st.SearchStrategy[Any]:
    return st.deferred(lambda: from_schema(SCHEMA[name]))


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
def bases() -> tuple[tuple[str, tuple[tuple[Any, ...], ...]], ...]:
    """Return real reports as JSON, each with the paths of its values."""
    whole = (reports.long_report(), reports.report(60.0), reports.nothing_yet())
    texts = [to_json(each) for each in whole]
    return tuple((text, tuple(_places(json.loads(text)))[1:]) for text in texts)


@st.composite
def mutated(draw: st.DrawFn) -> str:
    """Return a real report of which some values are exchanged."""
    text, places = draw(st.sampled_from(bases()))
    data = json.loads(text)
    for _ in range(draw(st.integers(1, 6))):
        *way, last = draw(st.sampled_from(places))
        value = draw(anything)
        part: Any = data
        try:
            for key in way:
                part = part[key]
            if isinstance(part, list):
                part[:] = [value] * len(part)
            else:
                part[last] = value
        except (TypeError, KeyError, IndexError):
            pass  # an earlier change has removed this part
    return json.dumps(data)


def show_everywhere(report: Report, signal: Signal | None, events: tuple[Event, ...], drawn: bool) -> None:
    """Show a report in every viewer; `drawn`: with the figures of matplotlib too."""
    for width in (None, 20, 80):
        report_table(report, width)
        signal_lines(report, width)
    baseline_summary(report, reports.long_report())
    to_json(report)
    for condition in (
        WaitCondition(),
        WaitCondition(grade="consumer"),
        WaitCondition(grade="navigation", channels=("gyro/x",)),
        *(WaitCondition(coefficient=letter, precision=0.05) for letter in "NBK"),
        WaitCondition(coefficient="N", precision=0.05, channels=("other", "gyro")),
    ):
        if condition.unmet(report) is None:
            condition.description(report)
    for form in FORMS:
        if drawn or form not in DRAWN_FORMS:
            try:
                document(report, form)
            except NoCurve:
                assert form == "png"
    show_on_screen(report, signal, events)


def show_on_screen(report: Report, signal: Signal | None, events: tuple[Event, ...]) -> None:
    """Draw every panel of every channel, in both notations, and save every view."""
    other = replace(report, device=replace(report.device, id="other"))
    state = ViewState(
        reports={report.device.id: report, "other": other, "real": reports.long_report()},
        ages={report.device.id: 1.0}, id=report.device.id, signal=signal, events=events, compared_id="real",
        baseline=other, connected=True,
    )  # fmt: skip
    for number, channel in enumerate(tuple(report.channels)[:12] or (None,)):
        for size in SIZES if number < 2 else SIZES[2:3]:
            for si in (False, True):
                shown = state.updated(
                    channel=channel, notation=Notation(si=si, ascii=si), overlay=si, show_limits=True,
                    zoomed=si, window=WINDOWS[number % 3],
                )  # fmt: skip
                for panel in PANELS:
                    panel(shown, *size)
    for view in VIEWS:
        export.exported_text(state.updated(view=view, channel=next(iter(report.channels), None)), "csv")
        export.file_name(state.updated(view=view), "csv")
