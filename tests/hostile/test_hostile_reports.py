"""The law of viewers: what the parser accepts, every viewer shows; what it rejects is a ValueError."""

from __future__ import annotations

import csv
import time
from pathlib import Path
from typing import Any

import pytest
import reports
from corpus_messages import MESSAGES, changed
from hostile_input import Hostile, go_through, rows
from hostile_reports import mutated, show_everywhere
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from imumon.documents import document
from imumon.model.filter_report import FilterReport
from imumon.model.report import Report, from_json
from imumon.model.report_json import plain

LONGEST_S = 10.0
"""s that all viewers together may take for one report on a busy machine."""
FAST = settings(suppress_health_check=list(HealthCheck), derandomize=True)


@pytest.mark.parametrize("hostile", rows(MESSAGES))
def test_a_hostile_message_does_what_the_corpus_says(hostile: Hostile, tmp_path: Path) -> None:
    go_through(hostile, tmp_path)


# ---------------------------------------------------------------------- random reports


def parsed(cls: type, text: str) -> Any:
    try:
        return from_json(cls, text)
    except ValueError:
        return None


def holds(seed: int, *, drawn: bool = False) -> None:
    """Assert the law for a changed report."""
    report = parsed(Report, mutated(seed))
    if report is not None:
        begin = time.process_time()
        show_everywhere(report, reports.signal(), tuple(reports.events()), drawn)
        assert time.process_time() - begin < LONGEST_S


seeds = st.integers(0, 2**32)


@settings(FAST, max_examples=6)
@given(seeds)
def test_a_hostile_report_is_rejected_or_shown(seed: int) -> None:
    holds(seed)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@settings(FAST, max_examples=300, derandomize=False)
@given(seeds)
def test_many_hostile_reports_are_rejected_or_shown(seed: int) -> None:
    holds(seed)


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
