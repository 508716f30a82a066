"""Snapshots of the screen in about 15 states that matter; `tests/pictures.py` draws them and lists why."""

from __future__ import annotations

from pathlib import Path

import pictures
import pytest
from pictures import FOLDER, IN_README, PICTURES


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
