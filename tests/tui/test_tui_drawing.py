"""The screen is readable at every size, in every theme and in every terminal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pictures
import pytest
import reports
from pictures import FOLDER, IN_README, PICTURES
from rich.style import Style
from screen_driver import drive, driven, table_number, visible_text
from textual.pilot import Pilot

from imumon.tui.app import ImumonApp
from imumon.tui.widgets import ROLES, THEMES, RoleStyles


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
            assert _row(app, y).isascii(), _row(app, y)


def _row(app: ImumonApp, y: int) -> str:
    return "".join(
        app.screen.get_widget_at(0, y)[0].render_line(y - app.screen.get_widget_at(0, y)[1].y).text
        for _ in range(1)
    )


# ---------------------------------------- snapshots of the screen in about 15 states that matter


@pytest.fixture(scope="module")
def drawn() -> dict[str, str]:
    return pictures.drawn(PICTURES.values())


@pytest.mark.parametrize("name", PICTURES)
def test_the_screen_matches_its_snapshot(name: str, drawn: dict[str, str], tmp_path: Path) -> None:
    saved = (FOLDER / f"{name}.svg").read_text(encoding="utf-8")
    if drawn[name] != saved:
        new = tmp_path / f"{name}.svg"
        new.write_text(drawn[name], encoding="utf-8")
        pytest.fail(f"{new} is not {FOLDER.name}/{name}.svg; if it is better: python tests/pictures.py")


def test_the_readme_shows_the_screen_of_today() -> None:
    name, copy = IN_README
    assert copy.read_bytes() == (FOLDER / f"{name}.svg").read_bytes(), "run python tests/pictures.py"


def test_there_are_no_other_snapshots() -> None:
    assert {path.stem for path in FOLDER.glob("*.svg")} == set(PICTURES)
