"""The law of viewers: what the parser accepts, every viewer shows; what it rejects is a ValueError."""

from __future__ import annotations

import json
import time
from typing import Any

import pytest
import reports
from hostile_reports import (
    FORBIDDEN,
    bases,
    from_schema,
    mutated,
    show_everywhere,
)
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from imumon.report import MAX_CHANNELS, Event, Report, Signal, from_json, is_device_name, plain, to_json

LONGEST_S = 10.0
"""s that all viewers together may take for one report on a busy machine."""
FAST = settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
LONG = settings(max_examples=1500, deadline=None, suppress_health_check=list(HealthCheck))


def parsed(cls: type, text: str) -> Any:
    try:
        return from_json(cls, text)
    except ValueError:
        return None


def holds(text: str, signal: str = "{}", events: tuple[str, ...] = (), *, drawn: bool = False) -> None:
    """Assert the law for a report, a signal and events."""
    report = parsed(Report, text)
    if report is None:
        return
    known = tuple(event for event in (parsed(Event, each) for each in events) if event is not None)
    begin = time.perf_counter()
    show_everywhere(report, parsed(Signal, signal), known, drawn)
    assert time.perf_counter() - begin < LONGEST_S


signals = from_schema({"$ref": "#/$defs/Signal"}).map(json.dumps)
some_events = st.lists(from_schema({"$ref": "#/$defs/Event"}).map(json.dumps), max_size=2).map(tuple)
whole = from_schema({"$ref": "#/$defs/Report"}).map(json.dumps)


@FAST
@given(mutated(), signals, some_events)
def test_a_changed_report_is_rejected_or_shown(text: str, signal: str, events: tuple[str, ...]) -> None:
    holds(text, signal, events)


@FAST
@given(whole, signals, some_events)
def test_a_report_of_the_schema_is_rejected_or_shown(text: str, signal: str, events: tuple[str, ...]) -> None:
    holds(text, signal, events)


@pytest.mark.slow
@pytest.mark.timeout(1200)
@LONG
@given(mutated() | whole, signals, some_events)
def test_many_hostile_reports_are_rejected_or_shown(text: str, signal: str, events: tuple[str, ...]) -> None:
    holds(text, signal, events)


@pytest.mark.slow
@pytest.mark.timeout(1200)
@settings(LONG, max_examples=60)
@given(mutated() | whole)
def test_hostile_reports_are_drawn(text: str) -> None:
    holds(text, drawn=True)
