"""Laws of canvas and formatting: nothing is truncated, the axes do not move, any size draws."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pictures
import pytest
import reports
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pictures import FOLDER, IN_README, PICTURES
from rich.style import Style
from screen_driver import drive, driven, table_number, text_of, visible_text
from textual.pilot import Pilot

from imumon.model import units
from imumon.model.coefficients import Estimate
from imumon.model.report_json import MAX_NUMBER
from imumon.model.samples import GYRO
from imumon.model.units import FLICKER
from imumon.tui import braille_canvas, channel_table, charts, formatting, panels, text_panels
from imumon.tui.app import ImumonApp
from imumon.tui.formatting import CELL, Notation
from imumon.tui.view_state import ViewState
from imumon.tui.widgets import ROLES, THEMES, RoleStyles

DRAWN = {
    "allan": charts.allan_chart,
    "strip": charts.signal_chart,
    "histogram": charts.histogram_chart,
    "spectrum": charts.spectrum_chart,
    "table": channel_table.table,
    "detail": panels.detail,
    "headlines": panels.headlines,
    "status": panels.status,
    "welcome": panels.welcome,
    "device": text_panels.device,
    "events": text_panels.events,
    "sensors": text_panels.sensors,
    "drift": text_panels.drift,
}
sizes = st.tuples(st.integers(12, 230), st.integers(3, 64))
finite = st.floats(1e-12, 1e12) | st.floats(-MAX_NUMBER, MAX_NUMBER)


@cache
def running() -> ViewState:
    """Return the state of the screen beside a daemon that runs."""
    return ViewState(
        reports={reports.ID: reports.report()},
        ages={reports.ID: 0.0},
        alive=frozenset({reports.ID}),
        connected=True,
        id=reports.ID,
        channel=GYRO[1],
        signal=reports.signal(GYRO[1]),
        events=tuple(reports.events()),
    )


@pytest.mark.parametrize("name", DRAWN)
@settings(max_examples=25)
@given(size=sizes, si=st.booleans(), more=st.booleans())
def test_every_part_draws_at_every_size(name: str, size: tuple[int, int], si: bool, more: bool) -> None:
    """No size fails, and no line differs from the given width."""
    width, height = size
    state = running().updated(
        notation=Notation(si=si),
        show_limits=more,
        overlay=more,
        baseline=running().report if more else None,
    )
    lines = DRAWN[name](state, width, height)
    for line in lines:
        assert formatting.length(line) == width
    shown = text_of(lines)
    plain = formatting.to_ascii(shown)
    assert plain.isascii()
    assert len(plain) == len(shown)
    assert "?" not in plain.replace("? help", "")


@settings(max_examples=300)
@example(value=9e149, low=1e-5, high=1.5e-5, status="measured", seconds=None, si=False)
@given(value=finite, low=finite, high=finite, status=st.sampled_from(["measured", "upper_bound", "pending"]),
       seconds=st.none() | st.floats(0, 1e12), si=st.booleans())  # fmt: skip
def test_a_coefficient_fits_its_column(
    value: float, low: float, high: float, status: str, seconds: float | None, si: bool
) -> None:
    part = Estimate(
        value=value if status == "measured" else None,
        low=low,
        high=high,
        status=status,
    )
    text, _ = Notation(si=si).coefficient(part, seconds)
    assert len(text) <= CELL


@settings(max_examples=200)
@given(text=st.text(alphabet="ab [/]°", max_size=120), width=st.integers(1, 40))
def test_wrapping_keeps_every_letter(text: str, width: int) -> None:
    lines = formatting.wrap(text, width)
    assert "".join("".join(lines).split()) == "".join(text.split())
    assert all(len(line) <= width for line in lines)


def test_dots_of_crossing_lines_merge() -> None:
    """Two lines through one cell: the cell has the dots of both and the colour of the later one."""
    canvas = braille_canvas.Canvas(1, 1)
    canvas.line(np.array([0.0, 1.0]), np.array([0.0, 3.0]), "one")
    canvas.line(np.array([0.0, 1.0]), np.array([3.0, 0.0]), "two")
    ((cell, role),) = canvas.rows()[0]
    assert role == "two"
    assert ord(cell) - 0x2800 & 0x01  # upper left, of the first
    assert ord(cell) - 0x2800 & 0x80  # lower right, of the first
    assert ord(cell) - 0x2800 & 0x40  # lower left, of the second


def test_a_point_is_placed_by_its_axes() -> None:
    canvas = braille_canvas.Canvas(40, 20)
    frame = braille_canvas.PlotFrame(
        canvas,
        (0, 0, 40, 20),
        braille_canvas.AxisScale(1e-2, 1e2, log=True),
        braille_canvas.AxisScale(1.0, 1e4, log=True),
    )
    assert frame.cell(1.0, 100.0) == (20, 9) or frame.cell(1.0, 100.0) == (20, 10)
    assert frame.cell(1e-2, 1e4) == (0, 0)
    assert frame.cell(1e2, 1.0) == (39, 19)
    assert frame.cell(1e3, 1.0) is None


def test_the_axes_do_not_move_while_a_curve_grows() -> None:
    """Half decades: between two reports a second apart the frame does not move."""
    ends = {
        (s.low, s.high)
        for t in np.linspace(1000, 1200, 50)
        for s in [braille_canvas.logarithmic(np.array([0.025, t]))]
    }
    assert len(ends) == 1


def test_the_chart_marks_only_measured_coefficients() -> None:
    cases = ((8.0, GYRO[0], "N"), (7200.0, GYRO[1], "NB"), (reports.LONG_S, GYRO[0], "NBK"))
    for age, channel, letters in cases:
        report = reports.report(age)
        text = text_of(
            charts.allan_chart(running().updated(reports={reports.ID: report}, channel=channel), 100, 40)
        )
        for letter in "NBK":
            part = report.channels[channel].coefficients.get(letter)
            assert (part.status == "measured") == (letter in letters)
            if letter in letters:
                height = FLICKER if letter == "B" else 1.0
                mark = "0.664 B =" if letter == "B" else letter
                assert f"{mark} {units.number(height * part.readable.value, 3)}" in text  # as the axis says
            else:
                assert f"{letter} " not in text


spans = st.tuples(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6))


@given(span=spans, rows=st.integers(3, 60), from_zero=st.booleans())
def test_a_linear_axis_contains_its_values_and_has_two_ticks(
    span: tuple[float, float], rows: int, from_zero: bool
) -> None:
    values = np.array([0.0, span[1]] if from_zero else [span[0], span[0] + span[1]])
    scale, ticks = braille_canvas.ticked(values, rows, 0.0 if from_zero else None)
    assert scale.low <= values.min()
    assert scale.high >= values.max()
    assert 2 <= len(ticks) <= 2 * braille_canvas.MOST_TICKS
    assert all(scale.low <= tick <= scale.high for tick in ticks[1:-1])


# ---------- the screen is readable at every size, in every theme and in every terminal


@pytest.mark.few
@pytest.mark.parametrize("size", [(80, 24), (150, 40), (220, 60)])
def test_no_number_is_truncated(size: tuple[int, int]) -> None:
    """Each coefficient is shown in full, also after rows without values."""
    source = reports.FakeSource(reports.report(8.0))

    async def script(app: ImumonApp, pilot: Pilot[int]) -> None:
        source.arrive(reports.report())
        app.poll()
        await pilot.pause()
        text = visible_text(app)
        report = reports.report()
        whole = [
            table_number(report, name, letter) for name in reports.GYRO + reports.ACCEL for letter in "NBK"
        ]
        # where a channel has correlated noise, its column takes the place of the mean
        mean = ["-9.807"] if "mean m/s²" in text else []
        for number in (*whole, *mean, "consumer"):
            assert number in text, number

    drive(source, script, size)


@pytest.mark.few
@pytest.mark.parametrize("theme", [*(t.name for t in THEMES), "ansi-dark"])
def test_no_colour_and_every_theme_draw(theme: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NO_COLOR", "1")

    async def script(app: ImumonApp, pilot: Pilot[int]) -> None:
        assert app.no_color
        await pilot.press(*"12345", "1", "question_mark")
        await pilot.pause()

    drive(reports.FakeSource(reports.report(), age=14.0), script, (80, 24), theme=theme)


def _contrast(style: Style) -> float:
    """Return the contrast ratio of WCAG 2.2."""
    parts = np.array([style.color.get_truecolor(), style.bgcolor.get_truecolor()]) / 255.0
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    dark, light = sorted(linear @ [0.2126, 0.7152, 0.0722])
    return float((light + 0.05) / (dark + 0.05))


@pytest.mark.parametrize("theme", [theme.name for theme in THEMES])
def test_text_and_marks_are_readable(theme: str) -> None:
    """WCAG 2.2: 4.5 for text, 3 for what a chart consists of. Areas and the grid lie behind."""
    marks, behind = {"axis", "unused", "baseline"}, {"page", "band", "bar", "grid"}

    async def script(app: ImumonApp, pilot: Pilot[int]) -> None:
        roles, page = app.query_one(RoleStyles), app.screen.rich_style.bgcolor
        found = {role: _contrast(roles.style(role, page)) for role in {*ROLES} - behind}
        assert not {role: each for role, each in found.items() if each < (3.0 if role in marks else 4.5)}

    drive(reports.FakeSource(reports.report()), script, (60, 20), theme=theme)


@driven(size=(80, 24), ascii=True)
async def test_ascii_mode_draws_only_ascii(app: ImumonApp, pilot: Pilot[int]) -> None:
    for key in "12345":
        await pilot.press(key)
        await pilot.pause()
        for y in range(app.size.height):
            widget, place = app.screen.get_widget_at(0, y)
            row = widget.render_line(y - place.y).text
            assert row.isascii(), row


# ---------------------------------------- snapshots of the screen in about 15 states that matter


@pytest.fixture(scope="module")
def pictures_drawn() -> dict[str, str]:
    return pictures.drawn(PICTURES.values())


@pytest.mark.parametrize("name", PICTURES)
def test_the_screen_matches_its_snapshot(name: str, pictures_drawn: dict[str, str], tmp_path: Path) -> None:
    saved = (FOLDER / f"{name}.svg").read_text(encoding="utf-8")
    if pictures_drawn[name] != saved:
        new = tmp_path / f"{name}.svg"
        new.write_text(pictures_drawn[name], encoding="utf-8")
        pytest.fail(f"{new} is not {FOLDER.name}/{name}.svg; if it is better: python tests/pictures.py")


def test_the_readme_shows_the_screen_of_today() -> None:
    name, copy = IN_README
    assert copy.read_bytes() == (FOLDER / f"{name}.svg").read_bytes(), "run python tests/pictures.py"


def test_there_are_no_other_snapshots() -> None:
    assert {path.stem for path in FOLDER.glob("*.svg")} == set(PICTURES)
