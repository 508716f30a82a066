"""The command line as a user runs it, and its manual page."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]


def imumon(*arguments: str | Path, code: int = 0) -> str:
    """Return the output of a command that ends with this code, or its one line on stderr if it fails."""
    done = subprocess.run(
        [sys.executable, "-m", "imumon", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    if code:
        assert len(done.stderr.strip().splitlines()) == 1, done.stderr
        return done.stderr
    return done.stdout


def manual_page() -> str:
    """Return the manual page imumon(1) as the build of a wheel makes it."""
    (page,) = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["build_manpages"]["manpages"]
    arguments = [f"--{option.replace('_', '-')}" for option in page.split(":")[1:]]
    command = [sys.executable, "-c", "from argparse_manpage.cli import main; main()", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
