"""The command line as a user runs it, and its manual page."""

from __future__ import annotations

import io
import subprocess
import sys
import tomllib
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import forked
from paths import ROOT

from imumon.cli.main import main

WITHOUT_END = ("run", "doctor", "demo", "web")
"""Commands that take signals or ports run in a process; others inside the test: starting Python takes longer."""


def imumon(*arguments: str | Path, code: int = 0) -> str:
    """Return the output of a command that ends with this code, or its one line on stderr if it fails.

    A command with wrong words (code 2) ends before it opens anything, and runs inside the test too.
    """
    words = [str(argument) for argument in arguments]
    inside = code == 2 or words[0] not in WITHOUT_END
    if inside:
        returned, output, errors = run_inside(words)
    else:
        done = forked.run(*words)
        returned, output, errors = done.returncode, done.stdout, done.stderr
    assert returned == code, errors
    assert "Traceback" not in errors
    if code:
        assert len(errors.strip().splitlines()) == 1, errors
        return errors
    return output


def run_inside(words: list[str]) -> tuple[int, str, str]:
    """Return exit code, output and messages of a command that runs in this process."""
    output, errors = (io.TextIOWrapper(io.BytesIO(), "utf-8", write_through=True) for _ in range(2))
    with redirect_stdout(output), redirect_stderr(errors):
        try:
            returned = main(words)
        except SystemExit as end:  # argparse, at --help
            returned = int(end.code or 0)
    texts = [stream.detach().getvalue().decode() for stream in (output, errors)]
    return returned, texts[0], texts[1]


def manual_page() -> str:
    """Return the manual page imumon(1) as the build of a wheel makes it."""
    (page,) = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["build_manpages"]["manpages"]
    arguments = [f"--{option.replace('_', '-')}" for option in page.split(":")[1:]]
    command = [sys.executable, "-c", "from argparse_manpage.cli import main; main()", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
