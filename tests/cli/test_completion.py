"""Shell completion: a real bash completes the command line; other shells parse the script if installed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from commands import imumon

from imumon.cli import parsers

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


@pytest.mark.few
@needs_bash
@pytest.mark.parametrize(
    ("line", "offered"),
    [
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


@needs_bash
def test_bash_offers_every_command_and_option(tmp_path: Path) -> None:
    commands = parsers()[1]
    assert complete("imumon ", tmp_path) == set(commands)
    for name in ("run", "replay"):
        options = {
            option
            for action in commands[name]._actions
            for option in action.option_strings
            if option != "--stop-with-stdin"
        }
        assert complete(f"imumon {name} -", tmp_path) == options


def test_the_version_imports_nothing_heavy() -> None:
    code = "import sys; from imumon.cli import main\ntry: main(['--version'])\nfinally: print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    loaded = {name.partition(".")[0] for name in done.stdout.split()}
    heavy = {"numpy", "scipy", "zenoh", "serial", "textual", "pydantic", "matplotlib", "argcomplete"}
    assert "argparse" in loaded
    assert not loaded & heavy


def test_the_parser_of_all_commands_needs_the_standard_library_only() -> None:
    """The manual page is built from it, in an environment that has nothing else."""
    code = "import sys; before = {*sys.modules}; from imumon.cli import parsers; parsers()[0].format_help(); "
    code += "print(*{*sys.modules} - before)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name.partition(".")[0] for name in done.stdout.split()}
    assert loaded - set(sys.stdlib_module_names) == {"imumon"}
