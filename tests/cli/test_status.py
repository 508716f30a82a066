"""What commands print: status, explain, the manual page, completion and the progress bar."""

from __future__ import annotations

import argparse
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
import reports
from commands import imumon, manual_page, run_inside
from paths import ROOT
from test_check import published
from waiting import until

from imumon.cli import parsers
from imumon.cli.explain_command import errors_listed
from imumon.cli.progress_bar import progress_bar
from imumon.model.coefficients import COEFFICIENTS, STATUSES
from imumon.model.glossary import explain, explanations
from imumon.model.messages import CAVEATS
from imumon.model.report import Report


@pytest.fixture
def report() -> Report:
    running = reports.report(state="running")
    return replace(running, precision={"N": 0.001, "B": 0.15, "K": 0.5})


def test_the_command_prints_a_screen_or_everything(report: Report) -> None:
    with published(report) as endpoint:
        where = ["status", "--connect", endpoint]
        code, screen, errors = run_inside(where)
        assert (code, errors) == (0, "")
        assert screen.startswith(f"running: {report.device.id}, VN-100T-CR ")
        _, everything, _ = run_inside([*where, "--verbose"])
        assert len(everything.splitlines()) > len(screen.splitlines())
        assert "## Appendix: distribution" in everything


def test_the_short_commands_import_nothing_heavy(report: Report, tmp_path: Path) -> None:
    """Also with the settings of a daemon: monitoring systems run them every minute, on small computers."""
    code = "import sys; from imumon.cli import main; [main([command, *sys.argv[1:]]) for command in "
    code += "('status', 'check')]; print(*sys.modules)"
    settings = tmp_path / "config.toml"
    settings.write_text(
        (ROOT / "config.toml").read_text().replace("save_period_s = 30.0", "save_period_s = 60")
    )
    with published(report) as endpoint:
        words = [sys.executable, "-P", "-c", code, "--connect", endpoint]
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


def test_the_command_explains_words_and_codes_of_errors_or_names_a_close_one() -> None:
    assert imumon("explain", "misfit").startswith("misfit: ")
    assert imumon("explain", "open").startswith("open (indistinct): ")  # the screen has this name
    assert "did you mean misfit?" in imumon("explain", "mistfit", code=2)
    text = imumon("explain", "port_busy")
    assert all(part in text for part in ("port_busy", "What to do:", "docs/ERRORS.md"))
    assert "did you mean port_busy?" in imumon("explain", "port_buzy", code=2)
    assert "walk" in imumon("explain")
    listed = list(errors_listed())
    assert len({code for codes, _, _ in listed for code in codes}) > 150
    assert all(codes and cause and cure for codes, cause, cure in listed)


# ---------------------------------------- manual page


def options(command: str, *, hidden: bool) -> set[str]:
    """Return the options of a command, with or without those that its help does not name."""
    every = (
        action for action in parsers()[1][command]._actions if hidden or action.help != argparse.SUPPRESS
    )
    return {option for action in every for option in action.option_strings}


@pytest.fixture(scope="module")
def page() -> str:
    pytest.importorskip("argparse_manpage", reason="argparse-manpage is not installed (extra test)")
    return manual_page()


def test_it_has_every_command_and_option(page: str) -> None:
    plain = page.replace("\\-", "-")
    for name in parsers()[1]:
        assert rf".SS \fBimumon {name}\fR" in plain
        assert not [
            option
            for option in options(name, hidden=False) - {"-h", "--help"}
            if rf"\fB{option}\fR" not in plain
        ]
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


# ---------------------------------------------------------------- completion


needs_bash = pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")


@cache
def script(shell: str) -> str:
    return imumon("completion", shell)


def complete(line: str, directory: Path) -> set[str]:
    """Return what bash offers at the end of a line."""
    words = line.split(" ")
    quoted = " ".join(f"'{word}'" for word in words)
    code = f"""{script("bash")}
COMP_LINE='{line}' COMP_POINT={len(line)} COMP_TYPE=9 COMP_WORDS=({quoted}) COMP_CWORD={len(words) - 1}
_python_argcomplete imumon
printf '%s\\n' "${{COMPREPLY[@]}}"
complete -p imumon >/dev/null"""
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-c", code],
        capture_output=True,
        text=True,
        check=True,
        cwd=directory,
        env={**os.environ, "PATH": path, "HOME": str(directory)},
    )
    assert done.stderr == ""
    return set(done.stdout.split())


@pytest.mark.few(3)
@needs_bash
@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("imumon ", set(parsers()[1])),
        ("imumon run -", options("run", hidden=True) - {"--stop-with-stdin"}),
        ("imumon st", {"status"}),
        ("imumon run --stream ", {"deltas", "uncompensated", "compensated"}),
        ("imumon wait --coefficient ", {"N", "B", "K", "M"}),
        ("imumon run --port si", {"sim"}),
        ("imumon replay cap", {"capture.bin"}),
        ("imumon run --state st", {"state/"}),
    ],
)
def test_bash_offers(line: str, offered: set[str], tmp_path: Path) -> None:
    (tmp_path / "capture.bin").touch()
    (tmp_path / "state").mkdir()
    assert complete(line, tmp_path) == offered


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("columns", [120, 40])
def test_a_bar_shows_share_rate_and_time_left_and_leaves_an_empty_line(
    columns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setenv("TERM", "xterm")
    with progress_bar(terminal := Terminal(), begin_s=0.05) as update:
        until(lambda: "opening" in terminal.getvalue())
        update(0.5, 3600.0)
        until(lambda: "50 %" in terminal.getvalue())
        update(0.6, 4320.0)
        until(lambda: "60 %" in terminal.getvalue())
    assert terminal.getvalue().endswith("\x1b[2K")
    assert "\x1b[?25h" in terminal.getvalue()  # the cursor is back
    text = re.sub(r"\x1b\[[?\d;]*[A-Za-z]", "", terminal.getvalue())  # without colours and movements
    assert max(map(len, re.split("[\r\n]", text))) <= columns
    if columns == 120:
        assert re.search(r"60 %  1 h 12 min of record, [\d,]+ times real time ━+╺━+ [-0:\d]+[\r\n]", text)
