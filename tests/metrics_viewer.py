"""A real `imumon metrics` in a process of its own, for tests."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from free_ports import free_port


class MetricsViewer:
    """`imumon metrics` of the daemon on an endpoint, until the context is left.

    Parameters
    ----------
    file : to write; None: it listens on `address`, and does so when the context begins.
    """

    def __init__(self, endpoint: str, *words: str, file: Path | None = None) -> None:
        self.address = f"127.0.0.1:{free_port()}"
        where = ("--listen", self.address) if file is None else ("--file", str(file))
        command = [sys.executable, "-m", "imumon", "metrics", *where, "--connect", endpoint, *words]
        self._listens = file is None
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)

    def __enter__(self) -> MetricsViewer:
        if self._listens:
            assert self.address in self.process.stderr.readline()
        return self

    def __exit__(self, *_: object) -> None:
        self.process.terminate()
        _, errors = self.process.communicate(timeout=60)
        assert "Traceback" not in errors
