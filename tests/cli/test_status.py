"""Commands that print: status, explain and the manual page."""

from __future__ import annotations

import argparse
import os
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import reports
from commands import manual_page, run_inside
from paths import ROOT
from test_check import published

from imumon.cli import parsers
from imumon.cli.exit_codes import SUCCESS, USAGE
from imumon.cli.explain_command import errors_listed
from imumon.cli.main import main
from imumon.documents.summary import summary_text
from imumon.model.coefficients import COEFFICIENTS, STATUSES
from imumon.model.glossary import explain, explanations
from imumon.model.messages import CAVEATS
from imumon.model.report import Report


@pytest.fixture
def report() -> Report:
    running = reports.report(state="running")
    return replace(running, precision={"N": 0.001, "B": 0.15, "K": 0.5})


def test_it_is_one_screen_with_the_state_first(report: Report) -> None:
    lines = summary_text(report, 80).splitlines()
    assert len(lines) < 24
    assert lines[0].startswith(f"running: {report.device.id}, VN-100T-CR ")
    assert max(map(len, lines)) <= 80
    for name, channel in report.channels.items():
        assert sum(line.startswith(f"{name} ") for line in lines) == bool(channel.coefficients)
    assert any(line.startswith("caveats: aliased") for line in lines) == ("aliased" in report.caveats)


def test_why_the_numbers_are_not_current_is_in_the_second_line(report: Report) -> None:
    waiting = replace(report, state="waiting")
    lines = summary_text(waiting, 80, late="the sensor is disconnected: gone").splitlines()
    assert lines[0].startswith("waiting: ")
    assert lines[1] == "the sensor is disconnected: gone"
    assert not any(line.startswith("still to come") for line in lines)


def test_the_command_prints_a_screen_or_everything(report: Report) -> None:
    with published(report) as endpoint:
        where = ["status", "--connect", endpoint]
        code, screen, errors = run_inside(where)
        assert (code, errors) == (0, "")
        assert screen.startswith("running: ")
        _, everything, _ = run_inside([*where, "--verbose"])
        assert len(everything.splitlines()) > len(screen.splitlines())
        assert "## Appendix: distribution" in everything


@pytest.mark.parametrize("command", ["status", "check"])
def test_a_short_command_imports_nothing_heavy(report: Report, command: str, tmp_path: Path) -> None:
    """Also with the settings of a daemon: monitoring systems run them every minute, on small computers."""
    code = "import sys; from imumon.cli import main; main(sys.argv[1:]); print(*sys.modules)"
    settings = tmp_path / "config.toml"
    settings.write_text(
        (ROOT / "config.toml").read_text().replace("save_period_s = 30.0", "save_period_s = 60")
    )
    with published(report) as endpoint:
        words = [sys.executable, "-P", "-c", code, command, "--connect", endpoint]
        environment = {**os.environ, "XDG_CONFIG_HOME": str(tmp_path)}
        done = subprocess.run(
            words, capture_output=True, text=True, check=True, cwd=tmp_path, env=environment
        )
    loaded = {name.partition(".")[0] for name in done.stdout.split()}
    assert "zenoh" in loaded
    assert not loaded & {"numpy", "scipy", "textual", "matplotlib", "serial", "rosbags"}


# ---------------------------------------- every word that a user meets is explained


def test_every_word_has_at_most_three_sentences_and_a_page() -> None:
    for entry in explanations():
        most = 5 if entry.word in CAVEATS else 3
        assert len(re.findall(r"[.?!](?: |$)", entry.text)) <= most, entry.word
        assert (ROOT / entry.page).is_file(), entry.word


@pytest.mark.parametrize(
    "word", [*CAVEATS, *STATUSES, *COEFFICIENTS, "open", "×÷", "alias factor", "Not At Rest"]
)
def test_what_the_screen_shows_is_explained(word: str) -> None:
    assert explain(word) is not None


def test_the_command_prints_a_word_or_names_a_close_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "misfit"]) == SUCCESS
    assert capsys.readouterr().out.startswith("misfit: ")
    assert main(["explain", "mistfit"]) == USAGE
    assert "did you mean misfit?" in capsys.readouterr().err
    assert main(["explain"]) == SUCCESS
    assert "walk" in capsys.readouterr().out


def test_the_code_of_each_error_is_explained(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "port_busy"]) == SUCCESS
    text = capsys.readouterr().out
    assert "port_busy" in text
    assert "What to do:" in text
    assert "docs/ERRORS.md" in text
    assert main(["explain", "port_buzy"]) == USAGE
    assert "did you mean port_busy?" in capsys.readouterr().err
    listed = list(errors_listed())
    assert len({code for codes, _, _ in listed for code in codes}) > 150
    assert all(codes and cause and cure for codes, cause, cure in listed)


# ---------------------------------------- manual page


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
