"""docs/ZENOH.md is correct: its programs run, its settings are valid, its commands make certificates."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from bus_actors import free_endpoint, stage

from imumon.config import load

TEXT = (Path(__file__).parents[1] / "docs" / "ZENOH.md").read_text("utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("number", range(len(blocks("python"))))
def test_the_programs_run(number: int) -> None:
    with stage() as start:
        address = free_endpoint()
        start("daemon", id="imu-1", listen=[address]).ready()
        code = blocks("python")[number].replace("tcp/127.0.0.1:7448", address)
        code = code.replace("Subscriber()", f"Subscriber([{address!r}])")
        process = subprocess.Popen(
            [sys.executable, "-u", "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        assert process.stdout
        try:
            line = process.stdout.readline()
        finally:
            process.kill()
            _, errors = process.communicate()
        assert "imu-1" in line, errors
        assert errors == ""


@pytest.mark.parametrize("text", blocks("toml"))
def test_the_settings_are_valid(text: str, tmp_path: Path) -> None:
    file = tmp_path / "config.toml"
    file.write_text(text)
    settings = load(file)
    assert "config.toml" in " ".join(settings.origins.values())


def test_the_table_lists_every_key() -> None:
    keys = re.findall(r"^\| `(imumon/[^`]+)` \|", TEXT, re.MULTILINE)
    assert keys == [
        f"imumon/{{id}}/{name}"
        for name in ("report", "{sensor}/{axis}", "grade", "event", "signal/{sensor}/{axis}", "alive")
    ]


def test_the_linked_schema_is_json() -> None:
    linked = re.findall(r"\]\(([\w.]+\.json)\)", TEXT)
    for name in linked:
        json.loads((Path(__file__).parents[1] / "docs" / name).read_text("utf-8"))
    assert linked
