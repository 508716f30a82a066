"""Laws of the house: style, types, layers, and the map that a stranger reads first."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import imumon

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize(
    "command",
    [
        ["ruff", "check", "imumon", "tests", "benchmarks"],
        ["ruff", "format", "--check", "imumon", "tests", "benchmarks"],
        ["mypy"],
        ["importlinter.cli", "lint"],
    ],
    ids=["ruff", "format", "mypy", "layers"],
)
def test_the_whole_tree_keeps(command: list[str]) -> None:
    name, *words = command
    if name == "importlinter.cli":
        words = ["-c", "from importlinter.cli import lint_imports_command; lint_imports_command()"]
        call = [sys.executable, *words]
    else:
        call = [sys.executable, "-m", name, *words]
    done = subprocess.run(call, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_map_shows_every_module() -> None:
    shown = {
        line.split()[0].rstrip("/") for line in (imumon.__doc__ or "").splitlines() if line.startswith("  ")
    }
    package = ROOT / "imumon"
    real = {p.stem for p in package.glob("*.py")} | {p.parent.name for p in package.glob("*/__init__.py")}
    real -= {"__init__", "__main__"}
    assert {name.removesuffix(".py") for name in shown} == real


def test_ci_runs_exactly_the_readmes_test_command() -> None:
    command = (ROOT / ".ci" / "run").read_text().strip().splitlines()[-1]
    assert command in (ROOT / "README.md").read_text()
    assert "pytest" in command


def test_report_needs_the_standard_library_only() -> None:
    code = "import sys; before = set(sys.modules); import imumon.report; print(*set(sys.modules) - before)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name.partition(".")[0] for name in done.stdout.split()}
    assert not loaded & {"numpy", "scipy", "zenoh", "serial", "textual", "pydantic"}
