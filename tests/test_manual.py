"""The manual pages: in step with the parsers and the settings, and read by `man` without a complaint."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

from imumon.cli import parsers
from imumon.cli.manual import ABOUT, COMMON, pages
from imumon.config import NAMES

ROOT = Path(__file__).parents[1]
PLACE = ROOT / "docs" / "man"
WHOLE, COMMANDS = parsers()
PAGES = pages(WHOLE, COMMANDS)


def test_the_pages_are_those_of_the_parsers() -> None:
    kept = {path.name: path.read_text() for path in PLACE.iterdir()}
    assert kept == PAGES, "make them anew: python -m imumon.cli.manual"


def test_an_installation_has_them() -> None:
    shipped = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["data-files"]
    files = {path for patterns in shipped.values() for pattern in patterns for path in ROOT.glob(pattern)}
    assert {PLACE / name for name in PAGES} <= files
    assert all(list(ROOT.glob(pattern)) for patterns in shipped.values() for pattern in patterns)


def test_every_option_and_setting_has_its_place() -> None:
    for name, parser in COMMANDS.items():
        plain = PAGES[f"imumon-{name}.1"].replace("\\-", "-")
        for action in parser._actions:
            assert all(rf"\fB{option}\fR" in plain for option in action.option_strings)
    keys = re.findall(r"^\\fB(\w+)\\fR = ", PAGES["imumon.5"], re.MULTILINE)
    assert keys == [name.partition(".")[2] for name in NAMES]


def test_every_page_that_is_named_is_there() -> None:
    for name, text in PAGES.items():
        for title, section in re.findall(r"\\fB([\w\\-]+)\\fR\((\d)\)", text):
            assert f"{title}.{section}".replace("\\", "") in PAGES, name


def test_the_examples_can_be_typed() -> None:
    for command in (*COMMON, *(line for about in ABOUT.values() for line in about.examples)):
        words = shlex.split(command.partition(" > ")[0])
        if words[0] == "imumon":
            _, unknown = WHOLE.parse_known_args(words[1:])
            assert not unknown, command


@pytest.mark.parametrize("name", sorted(PAGES))
def test_man_shows_it_without_a_warning(name: str) -> None:
    if shutil.which("groff") is None:
        pytest.skip("groff is not installed")
    command = ["groff", "-man", "-ww", "-Tutf8", "-rCHECKSTYLE=3", PLACE / name]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    shown = re.sub(r"\x1b\[\d*m", "", done.stdout)
    assert name.partition(".")[0].upper() in shown
