"""Laws of canvas and formatting: nothing is truncated, the axes do not move, any size draws."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import reports
from hypothesis import example, given, settings
from hypothesis import strategies as st

from imumon.model import units
from imumon.model.coefficients import Estimate
from imumon.model.report_json import MAX_NUMBER
from imumon.model.samples import GYRO
from imumon.model.units import FLICKER
from imumon.tui import (
    braille_canvas,
    channel_table,
    charts,
    formatting,
    panels,
    text_panels,
)
from imumon.tui.formatting import CELL, Line, Notation
from imumon.tui.view_state import ViewState

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


def text_of(lines: list[Line]) -> str:
    return "\n".join("".join(text for text, _ in line) for line in lines)


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
