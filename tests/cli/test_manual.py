"""Manual page: generated from the parser, complete, with examples that parse."""

from __future__ import annotations

import argparse
import re
import shlex
import shutil
import subprocess

import pytest
from commands import manual_page

from imumon.cli import parsers


@pytest.fixture(scope="module")
def page() -> str:
    pytest.importorskip("argparse_manpage", reason="argparse-manpage is not installed (extra test)")
    return manual_page()


def test_it_has_every_command_and_option(page: str) -> None:
    plain = page.replace("\\-", "-")
    for name, parser in parsers()[1].items():
        assert rf".SS \fBimumon {name}\fR" in plain
        for action in parser._actions:
            if action.help == argparse.SUPPRESS:
                continue
            names = [option for option in action.option_strings if option not in ("-h", "--help")]
            assert all(rf"\fB{option}\fR" in plain for option in names)
    for section in ("COMMANDS", "EXIT STATUS", "ENVIRONMENT", "FILES", "EXAMPLES"):
        assert f".SH {section}" in page.replace(".SH\n", ".SH ")


def test_its_examples_parse(page: str) -> None:
    examples = re.findall(r"^\.EX\n(.*?)\n\.EE$", page.replace("\\-", "-"), re.MULTILINE | re.DOTALL)
    assert examples
    for command in (line for example in examples for line in example.splitlines()):
        program, *arguments = shlex.split(command.partition(" > ")[0])
        _, unknown = parsers()[0].parse_known_args(arguments)
        assert (program, unknown) == ("imumon", [])


@pytest.mark.skipif(shutil.which("groff") is None, reason="groff is not installed")
def test_groff_formats_it_without_a_warning(page: str) -> None:
    command = ["groff", "-man", "-ww", "-Tutf8"]
    done = subprocess.run(command, input=page, capture_output=True, text=True, check=True)
    assert done.stderr == ""
