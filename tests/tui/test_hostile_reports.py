"""The law of viewers: what the parser accepts, every viewer shows; what it rejects is a ValueError."""

from __future__ import annotations

import csv
import json
import time
from pathlib import Path
from typing import Any

import pytest
from cases import case
from commands import imumon
from hostile_reports import FORBIDDEN, Generator, mutated, real_report, show_everywhere, show_on_screen
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from imumon.datasheet import document
from imumon.filter_report import FilterReport
from imumon.report import MAX_CHANNELS, Event, Report, Signal, from_json, is_device_name, plain, to_json
from imumon.tui.export import exported_text
from imumon.tui.view_state import VIEWS, ViewState

LONGEST_S = 10.0
"""s that all viewers together may take for one report on a busy machine."""
FAST = settings(suppress_health_check=list(HealthCheck), derandomize=True)


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
    begin = time.process_time()
    show_everywhere(report, parsed(Signal, signal), known, drawn)
    assert time.process_time() - begin < LONGEST_S


def drawn_messages(seed: int) -> tuple[str, str, tuple[str, ...]]:
    """Return a report, a signal and events: every other report is a changed real one."""
    draw = Generator(seed)
    report = mutated(seed) if seed % 2 else draw.message("Report")
    return report, draw.message("Signal"), (draw.message("Event"), draw.message("Event"))


seeds = st.integers(0, 2**32)


@settings(FAST, max_examples=20)
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


# ---------------------------------------------------------------------- the rules of the parser


def changed(*path: str | int, to: Any) -> str:
    """Return the real report as JSON with one value exchanged or added."""
    data = json.loads(to_json(real_report()))
    *way, last = path
    part = data
    for key in way:
        part = part[key]
    part[last] = to
    return json.dumps(data)


ALLAN = ("channels", "gyro/x", "allan")


@pytest.mark.parametrize(
    "path",
    [
        ("channels", "gyro/x", "mean"),
        ("channels", "gyro/x", "count"),
        ("channels", "gyro/x", "N", "value"),
        ("session", "elapsed_s"),
        ("session", "samples"),
        (*ALLAN, "sigma", 0),
        ("limits", "gyro", "N", "tactical"),
        ("device", "sample_rate_hz"),
    ],
    ids=lambda path: ".".join(map(str, path)),
)
def test_numbers_beyond_the_limit_are_rejected(path: tuple[str | int, ...]) -> None:
    for number in FORBIDDEN:
        with case(number), pytest.raises(ValueError, match="not a report"):
            from_json(Report, changed(*path, to=number))


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("channels", ""), {"unit": "V"}),
        (("channels", "gyro/"), {"unit": "V"}),
        (("channels", "a/b/c"), {"unit": "V"}),
        (("channels", "gyro/*"), {"unit": "V"}),
        (("channels", "\x1b]0;x\x07"), {"unit": "V"}),
        (("grade", "gyro", "decided_by"), {"axis": "w", "coefficient": "N"}),
        (("grade", "gyro", "decided_by"), {"axis": "x", "coefficient": "Z"}),
        (("grade", "gyro", "nearest"), "splendid"),
        (("grade", ""), {}),
        (("state",), "asleep"),
        (("channels", "gyro/x", "N", "status"), "guessed"),
        (("channels", "gyro/x", "N", "low"), -1.0),
        (("channels", "gyro/x", "histogram", "width"), 0.0),
        (("channels", "gyro/x", "histogram", "width"), -1.0),
        (("channels", "gyro/x", "histogram", "gaussian"), []),
        ((*ALLAN, "used"), []),
        ((*ALLAN, "edf"), [1.0]),
        ((*ALLAN, "tau_s", 0), 0.0),
        (("session", "samples"), -1),
        (("period_s",), 0.0),
        (("speed",), 0.0),
        (("limit_curves", "gyro", "tactical"), {"tau_s": [], "sigma": []}),
        (("limit_curves", "gyro", "tactical"), {"tau_s": [1.0], "sigma": [0.0]}),
        (("caveats",), ["x"] * 10_000),
        (("device", "model"), "x" * 100_000),
        (("device", "settings"), {str(k): "" for k in range(10_000)}),
    ],
)
def test_values_that_no_daemon_sends_are_rejected(path: tuple[str, ...], value: Any) -> None:
    with pytest.raises(ValueError, match="not a report"):
        from_json(Report, changed(*path, to=value))


def test_a_report_has_at_most_64_channels_and_these_are_shown() -> None:
    channel = json.loads(to_json(real_report()))["channels"]["gyro/x"]
    for count, accepted in ((MAX_CHANNELS, True), (MAX_CHANNELS + 1, False), (100_000, False)):
        entry = channel if count < 100 else {"unit": "V"}
        text = changed("channels", to={f"gyro/x{k}": entry for k in range(count)})
        assert (parsed(Report, text) is not None) is accepted
        if accepted:
            assert len(text) < 1_000_000  # fits into a message of the bus
            show_on_screen(from_json(Report, text), None, ())


def test_a_signal_without_a_column_width_or_with_another_channel_is_rejected() -> None:
    strip = {"start_s": 0.0, "column_s": 0.0, "low": [1.0], "high": [1.0]}
    for change in ({"minute": strip}, {"channel": "gyro/*"}, {"channel": ""}):
        with pytest.raises(ValueError, match="not a signal"):
            from_json(Signal, json.dumps({"channel": "gyro/x", "unit": "V"} | change))


def test_a_text_is_rejected_when_it_is_too_long_to_be_parsed() -> None:
    with pytest.raises(ValueError, match="more than"):
        from_json(Report, " " * 5_000_000)


@pytest.mark.parametrize("name", ["a\x1b]0;x\x07", "", "A", "x" * 65, "ä", "a b", "a\n", "a/b", "@a"])
def test_names_of_devices_have_no_special_characters(name: str) -> None:
    assert not is_device_name(name)


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


# ---------------------------------------------------------------------- files


def test_cells_that_a_spreadsheet_would_execute_are_escaped() -> None:
    formula = '=HYPERLINK("http://example.org")'
    report = from_json(Report, changed("channels", "gyro/x", "unit", to=formula))
    event = Event(time="+1", kind="@x", text="-2+3", device=report.device.id, channel=None)
    state = ViewState(reports={report.device.id: report}, id=report.device.id, events=(event,))
    texts = [document(report, "csv", FilterReport(time=report.time, device=report.device)).decode()]
    texts += [exported_text(state.updated(view=view), "csv") for view in VIEWS]
    cells = [cell for text in texts for row in csv.reader(text.splitlines()) for cell in row]
    assert f"'{formula}" in cells
    assert {"'+1", "'@x", "'-2+3"} <= set(cells)
    for cell in cells:
        assert not cell.startswith(("=", "+", "@", "\t", "\r"))
        assert not cell.startswith("-") or float(cell) < 0.0


def test_messages_about_files_have_no_escape_sequences(tmp_path: Path) -> None:
    bad = tmp_path / "a\x1b]0;owned\x07.json"
    bad.write_text('{"\x1b]0;owned\x07": 1}')
    for path in (bad, tmp_path / "none\x1b[2J"):
        errors = imumon("report", path, code=1)
        assert "\x1b" not in errors
        assert "\x07" not in errors
        assert tmp_path.name in errors


def test_a_file_that_is_too_long_for_a_report_is_not_read_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "report.json"
    with path.open("wb") as file:
        file.write(b"{")
        file.truncate(1 << 40)  # sparse
    assert "not a saved report" in imumon("report", path, code=1)
