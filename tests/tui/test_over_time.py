"""The view over time: what it asks, what it draws, and what it makes of hostile replies."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
import reports
from textual.pilot import Pilot

from imumon.model.samples import ACCEL, GYRO
from imumon.tui.app import ImumonApp
from imumon.tui.over_time import LEAST_ROWS, QUANTITIES, over_time_chart, parse
from imumon.tui.view_state import SPANS, ViewState


def text(lines: object) -> str:
    return "\n".join("".join(part for part, _ in line) for line in lines)


def state(span: str = "day", *, shown: bool = True) -> ViewState:
    report = reports.warming_up()
    series = parse(GYRO[0], *reports.history_reply(GYRO[0], *SPANS[span])) if shown else None
    return ViewState(reports={reports.ID: report}, id=reports.ID, channel=GYRO[0], history=series, span=span)


@pytest.mark.few
@pytest.mark.parametrize("span", SPANS)
@pytest.mark.parametrize("size", [(60, 20), (80, 24), (150, 40), (20, 3)])
def test_it_draws_every_quantity_that_fits_with_its_events(span: str, size: tuple[int, int]) -> None:
    lines = over_time_chart(state(span), *size)
    assert len(lines) <= size[1]
    assert all(sum(len(part) for part, _ in line) == size[0] for line in lines)
    if size[1] >= 20:
        shown = [name for name in QUANTITIES if f"{name} [" in text(lines)]
        assert (
            shown == [name for name in QUANTITIES if name != "M"][: (size[1] - 2) // LEAST_ROWS]
        )  # no row has M
        assert "↓" in text(lines)  # K is only bounded
        assert size[0] < 80 or "each " in text(lines)
        assert "▏" in text(lines)


@pytest.mark.parametrize("span", SPANS)
def test_a_young_record_fills_the_chart(span: str) -> None:
    rows, _ = reports.history_reply(GYRO[0], 10_800.0, "1h")
    lines = text(
        over_time_chart(replace(state(span), history=parse(GYRO[0], rows, b"[]")), 80, 24)
    ).splitlines()
    assert lines[-1].split()[:3] == ["01", "Mar", "05:00"]
    assert lines[-1].split()[-1] == "08:00"
    points = [k for line in lines[2:-1] for k in range(12, 80) if "\u2801" <= line[k] <= "\u28ff"]
    assert min(points) < 30
    assert max(points) > 60


@pytest.mark.parametrize(
    "reply",
    [
        b"", b"[", b"{}", b"null", b"[1, 2]", b"[" * 100_000, b'[{"time": 1}]', b'[{"channel": "gyro/x"}]',
        b'[{"channel": "gyro/x", "time": "2026-01-01T00:00:00Z", "end": "x"}]', b"\xff\xfe",
    ],
)  # fmt: skip
def test_a_reply_that_is_none(reply: bytes) -> None:
    assert parse(GYRO[0], reply, reply) is None


@pytest.mark.parametrize("value", [1e300, "x", True, [], {"value": "1"}, None, float("1e149"), -5])
def test_a_value_that_is_none(value: object) -> None:
    row = {"channel": GYRO[0], "time": "2026-01-01T00:00:00Z", "end": "2026-01-01T00:10:00Z"}
    rows = [row, row | {"N": {"value": value}, "B": value, "mean": value, "temperature": value}]
    event = json.dumps([{"time": "2026-01-01T00:00:00Z", "kind": value}]).encode()
    series = parse(GYRO[0], json.dumps(rows).encode(), event)
    assert series is not None
    assert len(series.time) == (2 if value is None else 1)
    shown = ViewState(id=reports.ID, channel=GYRO[0], history=series, span="day")
    assert over_time_chart(shown, 80, 24)


def test_the_view_asks_for_what_it_shows() -> None:
    from screen_driver import drive, visible_text

    source = reports.FakeSource(reports.warming_up())

    async def script(app: ImumonApp, pilot: Pilot[int]) -> None:
        await pilot.press("6")
        assert source.asked_history is None
        await pilot.press("w", "w")
        assert source.asked_history == (reports.ID, GYRO[0], *SPANS["month"])
        app.poll()
        await pilot.press("down")
        assert source.asked_history == (reports.ID, GYRO[1], *SPANS["month"])
        app.change()
        await pilot.pause()
        assert "temperature [" in visible_text(app)
        await pilot.press("1")
        assert source.asked_history is None

    drive(source, script)


@pytest.mark.few
@pytest.mark.parametrize("size", [(60, 20), (80, 24), (150, 40)])
def test_the_span_of_the_record_shows_each_coefficient_as_it_is_now(size: tuple[int, int]) -> None:
    from screen_driver import drive, table_number, visible_text

    async def script(app: ImumonApp, pilot: Pilot[int]) -> None:
        await pilot.press("6", "right", "down")
        await pilot.pause()
        shown = visible_text(app)
        for letter in "NBK":
            assert table_number(reports.report(), ACCEL[1], letter) in shown
        assert "ready" in shown
        assert "only a bound" in shown
        assert "now" in shown

    drive(reports.FakeSource(reports.report()), script, size)
