"""Completion scripts: bash completes our command line for real; the others parse where they are installed."""

from __future__ import annotations

import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest


@cache
def script(shell: str) -> str:
    command = [sys.executable, "-m", "imumon", "completion", shell]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def complete(line: str, cwd: Path) -> set[str]:
    """What bash offers at the end of a line."""
    words = line.split(" ")
    asked = " ".join(f"'{word}'" for word in words)
    code = f"""{script("bash")}
COMP_WORDS=({asked}) COMP_CWORD={len(words) - 1}
_imumon
printf '%s\\n' "${{COMPREPLY[@]}}"
complete -p imumon >/dev/null"""
    done = subprocess.run(["bash", "-c", code], capture_output=True, text=True, check=True, cwd=cwd)
    assert done.stderr == ""
    return set(done.stdout.split())


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("imumon st", {"status"}),
        ("imumon do", {"doctor"}),
        ("imumon run --strea", {"--stream"}),
        ("imumon run --stream ", {"deltas", "uncompensated", "compensated"}),
        ("imumon wait --grade t", {"tactical"}),
        ("imumon wait --coefficient ", {"N", "B", "K"}),
        ("imumon config ", {"show", "check"}),
        ("imumon config --c", {"--config"}),
        ("imumon completion z", {"zsh"}),
        ("imumon sim --gyro-", {"--gyro-n", "--gyro-b", "--gyro-k", "--gyro-thermal"}),
        ("imumon run --port si", {"sim"}),
        ("imumon run --duration ", set()),
        ("imumon replay cap", {"capture.bin"}),
        ("imumon run --config cap", {"capture.bin"}),
        ("imumon run --state st", {"state"}),
        ("imumon nonsense ", set()),
    ],
)
def test_bash_offers(line: str, offered: set[str], tmp_path: Path) -> None:
    (tmp_path / "capture.bin").touch()
    (tmp_path / "state").mkdir()
    assert complete(line, tmp_path) == offered


def test_every_command_and_option_is_offered(tmp_path: Path) -> None:
    from imumon.cli import parsers

    commands = parsers()[1]
    assert complete("imumon ", tmp_path) == {*commands, "--help", "--version"}
    for name, parser in commands.items():
        options = {option for action in parser._actions for option in action.option_strings}
        assert complete(f"imumon {name} -", tmp_path) == options
        for shell in ("zsh", "fish"):
            assert name in script(shell)


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_shell_reads_its_script(shell: str) -> None:
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    done = subprocess.run([shell, "-n"], input=script(shell), capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_version_costs_nothing() -> None:
    code = "import sys; from imumon.cli import main\ntry: main(['--version'])\nfinally: print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    loaded = {name.partition(".")[0] for name in done.stdout.split()}
    assert "argparse" in loaded
    assert not loaded & {"numpy", "scipy", "zenoh", "serial", "textual", "pydantic", "dataclasses"}
