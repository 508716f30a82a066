"""The screen looks as it did: every view and every state, small and large, dark and light.

`tests/pictures.py` draws the pictures and tells how to renew them.
"""

from __future__ import annotations

from pathlib import Path

import pictures
import pytest
import reports
from pictures import FOLDER, PICTURES

from imumon.tui import picture


@pytest.fixture(scope="module")
def drawn() -> dict[str, str]:
    return pictures.drawn(PICTURES.values())


@pytest.mark.parametrize("name", PICTURES)
def test_the_screen_looks_as_it_did(name: str, drawn: dict[str, str], tmp_path: Path) -> None:
    kept = (FOLDER / f"{name}.svg").read_text(encoding="utf-8")
    if drawn[name] != kept:
        new = tmp_path / f"{name}.svg"
        new.write_text(drawn[name], encoding="utf-8")
        pytest.fail(f"{new} is not {FOLDER.name}/{name}.svg; if it is better: python tests/pictures.py")


def test_every_picture_is_drawn() -> None:
    assert {path.stem for path in FOLDER.glob("*.svg")} == set(PICTURES)


def test_a_picture_tells_nothing_of_those_drawn_before(drawn: dict[str, str]) -> None:
    """One screen draws them all; a screen that is started for a picture draws the same."""
    for name in ("lost-80-dark", "ascii-large"):
        assert pictures.drawn([PICTURES[name]])[name] == drawn[name]


def test_a_picture_is_drawn_of_a_report_alone(tmp_path: Path, drawn: dict[str, str]) -> None:
    target = tmp_path / "overview.svg"
    picture(reports.report(), target, signal=reports.signal(), events=reports.events())
    assert target.read_text(encoding="utf-8") == drawn["overview-150-dark"]
    assert len(drawn["overview-150-dark"]) < 100_000
