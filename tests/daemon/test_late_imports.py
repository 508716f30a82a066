"""Imports of a daemon: they happen at its start, because there may be no descriptor for them later."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from daemons import free_endpoint
from free_ports import free_port

NAMED = """
import os, sys
known, begun = set(sys.modules), False

def note(event, words):
    global begun
    if event == "open" and str(words[0]).endswith(".lock"):  # the daemon begins with the lock of the state
        begun = True
    if event == "import" and begun:
        os.write(2, f"LATE {words[0]}\\n".encode())

sys.addaudithook(note)
from imumon.cli.main import main
sys.exit(main(sys.argv[1:]))
"""
PRINTS = ("imumon.datasheet", "imumon.filter_report")
"""Modules that print the last report, when no door is open any more."""


@pytest.mark.slow
def test_a_daemon_imports_nothing_while_its_doors_are_open(tmp_path: Path) -> None:
    settings = tmp_path / "config.toml"
    settings.write_text(
        f'[metrics]\nlisten = "127.0.0.1:{free_port()}"\n[alert]\ncommand = "true"\n[state]\nsave_period_s = 1.0\n'
    )
    words = ["run", "--port", "sim", "--speed", "60", "--duration", "10", "--config", str(settings)]
    words += ["--record", str(tmp_path / "a.bin"), "--listen", free_endpoint(), "--state", str(tmp_path)]
    command = [sys.executable, "-c", NAMED, *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    late = [line[5:] for line in done.stderr.splitlines() if line.startswith("LATE ")]
    assert "imumon.datasheet" in late  # the hook works
    assert [name for name in late if not name.startswith(PRINTS)] == []
