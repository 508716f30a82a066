"""The screen, driven by keys, in every state that a user meets."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
import reports
from pictures import SOURCES, SwitchableSource
from screen_driver import drive, driven, status, table_number, text_of, visible_text
from textual.pilot import Pilot
from textual.widgets import Input

from imumon.api.measurement import Measurement
from imumon.documents.program_settings import number_lines
from imumon.model.report import Report, from_json
from imumon.model.samples import ACCEL, GYRO, MAG
from imumon.tui.app import ImumonApp
from imumon.tui.over_time import LEAST_ROWS, QUANTITIES, over_time_chart, parse
from imumon.tui.panels import FIRST_KEYS, LAST_KEYS, VIEW_KEYS, footer
from imumon.tui.view_state import SPANS, VIEWS, ViewState
from imumon.tui.views import View, keys_of
from imumon.tui.widgets import THEMES, ScrolledPanel

OTHER = "vn100-0100056799"


# ---------------------------------------------------------------------------- keys


@driven()
async def test_digits_and_tab_change_the_view(app: ImumonApp, pilot: Pilot[int]) -> None:
    for key, name in zip("123456", VIEWS, strict=True):
        await pilot.press(key)
        assert app.view_state.view == name
        assert [v for v in app.query(View) if v.display] == [app.focused]
        assert app.focused.title == name
    await pilot.press("tab")
    assert app.view_state.view == "overview"
    await pilot.press("shift+tab")
    assert app.view_state.view == "over time"


@driven(lambda: reports.FakeSource(reports.report()))
async def test_arrows_select_the_channel_and_request_its_signal(app: ImumonApp, pilot: Pilot[int]) -> None:
    assert app.view_state.channel == "gyro/x"
    await pilot.press("down", "down")
    assert app.view_state.channel == "gyro/z"
    await pilot.press("right")
    assert app.view_state.channel == "accel/z"
    await pilot.press("left", "left")
    assert app.view_state.channel == "mag/z"
    await pilot.press("up", "up", "up", "k")
    assert app.view_state.channel == "accel/y"
    assert app.source.watched[-1] == (reports.ID, ACCEL[1])
    await pilot.press("2")
    assert app.view_state.signal.channel == "accel/y"


def test_units_freeze_overlay_limits_zoom_and_theme() -> None:
    source = reports.FakeSource(reports.report(200.0))

    async def script(app: ImumonApp, pilot: Pilot[int]) -> None:
        assert "°/√h" in visible_text(app)
        await pilot.press("u")
        assert "rad/s/√Hz" in visible_text(app)
        await pilot.press("u", "o", "g")
        assert app.view_state.overlay
        assert "tactical" in visible_text(app)
        await pilot.press("z")
        assert app.query_one("#allan").size.width > 140
        await pilot.press("z", "t")
        assert app.theme == THEMES[1].name
        await pilot.press("f")
        source.arrive(reports.report())
        app.poll()
        assert "frozen" in status(app)
        assert "3 min 20 s ·" in status(app)
        await pilot.press("f")
        assert "2 h ·" in status(app)

    drive(source, script)


@driven(size=(170, 40))
async def test_a_baseline_is_set_and_removed(app: ImumonApp, pilot: Pilot[int]) -> None:
    await pilot.press("b")
    assert app.view_state.baseline is app.view_state.report
    assert "at 10:00" in visible_text(app)
    await pilot.press("b")
    assert app.view_state.baseline is None


@pytest.mark.parametrize(
    ("key", "before"),
    [("q", ()), ("ctrl+c", ()), ("ctrl+q", ()), ("q", ("question_mark",)), ("ctrl+c", ("question_mark",))],
)
def test_each_quit_key_ends_the_screen(key: str, before: tuple[str, ...]) -> None:
    """From a view at once; from a window above it, q closes that first."""

    async def script(app: ImumonApp, pilot: Pilot[int]) -> None:
        await pilot.press(*before, key)
        if before == ("question_mark",) and key == "q":
            await pilot.press(key)
        await pilot.pause()
        assert app._exit

    assert drive(reports.FakeSource(reports.report()), script).return_code == 0


@driven(lambda: reports.FakeSource(reports.report(), reports.report(id=OTHER)), size=(60, 20))
async def test_help_names_every_key_of_the_visible_view(app: ImumonApp, pilot: Pilot[int]) -> None:
    for key in "123456":
        await pilot.press(key)
        view = app._view()
        await pilot.press("question_mark")
        await pilot.pause()
        text = visible_text(app)
        for _, what in keys_of(list(type(view).BINDINGS)):
            assert what.removeprefix("next ").removeprefix("previous ") in text, what
        window = app.screen.query_one(ScrolledPanel)
        assert "…" not in text_of(window.lines())
        assert window.max_scroll_x == 0
        titles = [title.strip() for title in text_of(window.lines()).splitlines()]
        # every key is visible at once; only the words below them scroll
        assert titles.index("words of this view") - 1 <= window.size.height, (key, window.size)
        await pilot.press("escape")
        await pilot.pause()
    await pilot.press("question_mark", "2")
    await pilot.pause()
    assert (len(app.screen_stack), app.view_state.view) == (1, "signal")  # a digit closes the help


def test_events_are_filtered_by_words() -> None:
    async def script(app: ImumonApp, pilot: Pilot[int]) -> None:
        await pilot.press("4", "slash", *"gap")
        assert app.view_state.filter_text == "gap"
        assert "13.1 s lost" in visible_text(app)
        assert "knock" not in visible_text(app)
        await pilot.press("enter")
        assert isinstance(app.focused, View)
        await pilot.press("escape")
        assert app.view_state.filter_text == ""
        assert "knock" in visible_text(app)
        assert app.query_one("#filter", Input).value == ""

    drive(reports.FakeSource(reports.report()), script)


@driven(lambda: reports.FakeSource(reports.report()), id=OTHER)
async def test_the_screen_waits_for_the_requested_device(app: ImumonApp, pilot: Pilot[int]) -> None:
    """With --id, no other device is shown instead."""
    assert not app.view_state.has_report
    assert f"first report of {OTHER}" in visible_text(app)
    app.source.arrive(reports.report(id=OTHER))
    app.poll()
    await pilot.pause()
    assert app.view_state.id == OTHER


# ---------------------------------------------------------------------------- status


@driven(lambda: reports.FakeSource(connected=False))
async def test_the_screen_survives_loss_and_return_of_the_daemon(app: ImumonApp, pilot: Pilot[int]) -> None:
    """The last data stay, dimmed, with their age; when the daemon returns the screen continues."""
    assert "no daemon" in status(app)
    app.source.arrive(reports.report())
    app.poll()
    await pilot.pause()
    assert "● live" in status(app)
    assert app.focused is app.query_one("#overview")
    app.source.disconnect()
    for seconds in (2.0, 5.0, 30.0):
        app.source.now += seconds
        app.poll()
    assert "no report for 37 s; reconnecting" in status(app)
    assert app.query_one("#body").has_class("stale")
    assert table_number(reports.report(), GYRO[0], "N") in visible_text(app)
    app.source.arrive(reports.report())
    app.poll()
    assert "● live" in status(app)
    assert not app.query_one("#body").has_class("stale")


STATUSES = {
    "running": "● live", "no-daemon": "no daemon", "starting": "starting", "warming-up": "warming up",
    "moving": "not at rest", "stale": "stale  no report for 14 s", "lost": "reconnecting",
    "gone": "daemon gone  no report for", "waiting": "sensor gone  waiting for /dev/ttyUSB0", "finished": "finished",
}  # fmt: skip
"""Words of the status by the source that has it."""


@driven(lambda: SwitchableSource(), size=(80, 24))
async def test_every_view_shows_the_status(app: ImumonApp, pilot: Pilot[int]) -> None:
    """In every state and view: title of the status, old numbers dimmed, never blank."""
    for name in SOURCES:
        app.source.use(name)
        app.poll()
        assert STATUSES.get(name, "") in status(app)
        now = app.view_state.connection_status()
        for view in VIEWS:
            app.action_view(view)
            await pilot.pause()
            assert status(app).startswith(f" {now.mark} {now.title} "), (name, view)
            assert len(visible_text(app).split()) > 10, (name, view)
            if app.view_state.channels:
                assert app.query_one("#body").has_class("stale") is not now.live, (name, view)


@pytest.mark.few
@pytest.mark.parametrize("width", [44, 66, 80, 99, 120, 150, 200])
@pytest.mark.parametrize("view", VIEWS)
def test_the_footer_names_the_views_and_the_help_wherever_they_fit(view: str, width: int) -> None:
    text = text_of(footer(ViewState(view=view), width)[:1])
    assert len(text) == width
    assert f"{VIEWS.index(view) + 1} {view}" in text
    assert "? help" in text
    for key, name in FIRST_KEYS:
        assert f" {key} {name}" in text
    for key, name in (*VIEW_KEYS.get(view, ()), *LAST_KEYS) if width >= 150 else ():
        assert f" {key} {name}" in text
    for name in VIEWS if width >= 80 else ():
        assert name in text
    assert "…" not in text


def with_times(report: Report, times: dict[str, float | None]) -> Report:
    """Return a report in which gyro z reaches the precision after these times."""
    report = replace(report, precision={"N": 0.001, "B": 0.15, "K": 0.5})
    return reports.with_channel(report, GYRO[2], time_to=times)


@pytest.mark.few
@pytest.mark.parametrize("size", [(80, 24), (120, 36), (150, 40)])
def test_the_time_to_the_configured_precision_is_visible(size: tuple[int, int]) -> None:
    report = with_times(reports.report(), {"N": 42.0, "B": 1500.0, "K": 259_200.0})

    async def script(app: ImumonApp, pilot: Pilot[int]) -> None:
        await pilot.press("down", "down")
        text = visible_text(app)
        for goal in ("±0.1 % in 42 s", "±15 % in 25 min", "±50 % in 3.0 d"):
            assert text.count(goal) == 1
        app.source.arrive(replace(report, state="stopped"))
        app.poll()
        await pilot.pause()
        assert "±0.1 % in" not in visible_text(app)  # it does not grow any more

    drive(reports.FakeSource(report), script, size)


@driven(size=(80, 24))
async def test_the_numbers_are_shown_and_copied_through_the_terminal(
    app: ImumonApp, pilot: Pilot[int]
) -> None:
    await pilot.press("c")
    await app.workers.wait_for_complete()
    await pilot.pause()
    report = app.view_state.report
    settings = number_lines(Measurement(report).text("kalibr"))
    assert app.clipboard.splitlines()[1:] == settings
    assert "gyroscope_noise_density" in visible_text(app)
    assert "OSC 52" in visible_text(app)


def test_the_report_is_saved_as_a_baseline(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)

    async def script(app: ImumonApp, pilot: Pilot[int]) -> None:
        await pilot.press("s")
        await pilot.pause()
        (note,) = app._notifications
        (file,) = tmp_path.iterdir()
        assert note.message == f"saved {file}"
        assert from_json(Report, file.read_bytes()) == app.view_state.report
        monkeypatch.setattr("imumon.tui.app.save_directory", lambda: Path("/proc/[nowhere]"))
        app.clear_notifications()
        await pilot.press("s")
        await pilot.pause()
        (note,) = app._notifications
        assert note.message.startswith("not saved: ")

    drive(reports.FakeSource(reports.report()), script)


@pytest.mark.parametrize("size", [(80, 24), (120, 36)])
def test_no_label_of_an_axis_is_cut(size: tuple[int, int]) -> None:
    """A value with many digits that hardly changes has long labels."""
    report = reports.report()
    channel = report.channels["mag/x"]
    stated = replace(channel.convergence, elapsed_s=(10.0, 100.0, 1000.0))
    values = (-331.75010, -331.75011, -331.75012)
    series = {"N": replace(stated.coefficients["N"], value=values, low=values, high=values)}
    channel = replace(channel, convergence=replace(stated, coefficients=series))
    state = ViewState(
        reports={report.device.id: replace(report, channels={MAG[0]: channel})},
        id=report.device.id,
        channel=MAG[0],
    )
    rows = text_of(over_time_chart(state, *size)).splitlines()
    factor = state.notation.coefficient_scale("mag", "N")[0]
    labels = [float(found[0]) for row in rows if (found := re.match(r" *-[\d.]+", row))]
    assert len(labels) > 1
    assert all(abs(label - factor * values[0]) < 1e-3 * factor for label in labels)


# ---------------------------------------------------------------- the view over time


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
        shown = [name for name in QUANTITIES if f"{name} [" in text_of(lines)]
        assert (
            shown == [name for name in QUANTITIES if name != "M"][: (size[1] - 2) // LEAST_ROWS]
        )  # no row has M
        assert "↓" in text_of(lines)  # K is only bounded
        assert size[0] < 80 or "each " in text_of(lines)
        assert "▏" in text_of(lines)


@pytest.mark.parametrize("span", SPANS)
def test_a_young_record_fills_the_chart(span: str) -> None:
    rows, _ = reports.history_reply(GYRO[0], 10_800.0, "1h")
    lines = text_of(
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
    assert len(series.time) == (2 if value is None else 1)
    shown = ViewState(id=reports.ID, channel=GYRO[0], history=series, span="day")
    assert over_time_chart(shown, 80, 24)


def test_the_view_asks_for_what_it_shows() -> None:
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
