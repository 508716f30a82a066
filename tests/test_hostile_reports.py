"""The law of viewers: what the parser accepts, every viewer shows; what it rejects is a ValueError."""

from __future__ import annotations

import time
from typing import Any

import pytest
from hostile_reports import Generator, mutated, show_everywhere
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from imumon.report import Event, Report, Signal, from_json

LONGEST_S = 10.0
"""s that all viewers together may take for one report on a busy machine."""
FAST = settings(deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)


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


def drawn_messages(seed: int) -> tuple[str, str, tuple[str, ...]]:
    """Return a report, a signal and events: every other report is a changed real one."""
    draw = Generator(seed)
    report = mutated(seed) if seed % 2 else draw.message("Report")
    return report, draw.message("Signal"), (draw.message("Event"), draw.message("Event"))


seeds = st.integers(0, 2**32)


@settings(FAST, max_examples=60)
@given(seeds)
def test_a_hostile_report_is_rejected_or_shown(seed: int) -> None:
    holds(*drawn_messages(seed))


@pytest.mark.slow
@pytest.mark.timeout(1800)
@settings(FAST, max_examples=1500, derandomize=False)
@given(seeds)
def test_many_hostile_reports_are_rejected_or_shown(seed: int) -> None:
    holds(*drawn_messages(seed))


@pytest.mark.slow
@pytest.mark.timeout(1200)
@settings(FAST, max_examples=60, derandomize=False)
@given(seeds)
def test_hostile_reports_are_drawn(seed: int) -> None:
    holds(drawn_messages(seed)[0], drawn=True)
