"""The law of viewers: what the parser accepts, every viewer shows; what it rejects is a ValueError."""

from __future__ import annotations

import csv
import json
import time
from pathlib import Path
from typing import Any

import pytest
import reports
from hostile_input import Hostile, go_through, rows
from hostile_reports import mutated, real_report, show_everywhere
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from imumon.documents import document
from imumon.model.filter_report import FilterReport
from imumon.model.report import MAX_CHANNELS, Report, from_json
from imumon.model.report_json import plain, to_json

LONGEST_S = 10.0
"""s that all viewers together may take for one report on a busy machine."""
FAST = settings(suppress_health_check=list(HealthCheck), derandomize=True)


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


def changed(*path: str | int, to: Any) -> str:
    """Return the real report as JSON with one value exchanged or added."""
    data = json.loads(to_json(real_report()))
    *way, last = path
    part = data
    for key in way:
        part = part[key]
    part[last] = to
    return json.dumps(data)


def written(number: float) -> str:
    """Return a number, or a power of ten that is no float, as a part of a name."""
    return f"1e{len(str(number)) - 1}" if isinstance(number, int) else str(number)


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


def channels(count: int) -> str:
    """Return a report with so many channels, real ones if they are few."""
    real = json.loads(to_json(real_report()))["channels"]["gyro/x"]
    entry = real if count < 100 else {"unit": "V"}
    return changed("channels", to={f"gyro/x{k}": entry for k in range(count)})


MESSAGES = (
    *(
        Hostile(
            "report", f"{'.'.join(map(str, path))}={written(number)}",
            lambda _, path=path, number=number: changed(*path, to=number), "rejected", says="not a report",
        )
        for path in NUMBERS
        for number in (1e150, 10**400, float("nan"), float("inf"))
    ),
    *(
        Hostile(
            "report", name, lambda _, path=path, value=value: changed(*path, to=value), "rejected", says="not a report"
        )
        for name, (path, value) in VALUES.items()
    ),
    Hostile("report", "64-channels", lambda _: channels(MAX_CHANNELS), "shown", seconds=10.0),
    Hostile("report", "65-channels", lambda _: channels(MAX_CHANNELS + 1), "rejected"),
    Hostile("report", "100000-channels", lambda _: channels(100_000), "rejected"),
    Hostile("report", "5-MB", lambda _: " " * 5_000_000, "rejected", says="more than"),
    *(
        Hostile(
            "signal", name, lambda _, change=change: json.dumps({"channel": "gyro/x", "unit": "V"} | change),
            "rejected", says="not a signal",
        )
        for name, change in SIGNALS.items()
    ),
    *(Hostile("device-name", name, lambda _, text=text: text, "rejected") for name, text in DEVICE_NAMES.items()),
)  # fmt: skip


@pytest.mark.parametrize("hostile", rows(MESSAGES))
def test_a_hostile_message_does_what_the_corpus_says(hostile: Hostile, tmp_path: Path) -> None:
    go_through(hostile, tmp_path)
