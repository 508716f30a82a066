"""The command line as a user runs it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def imumon(*words: str | Path, code: int = 0) -> str:
    """Output of a command that ends with that code; of one that fails its one line on stderr."""
    done = subprocess.run(
        [sys.executable, "-m", "imumon", *map(str, words)],
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
