"""The rules of docs/ARCHITECTURE.md: layers, owners of libraries, names, errors, and the style checks."""

from __future__ import annotations

import ast
import collections
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from paths import ROOT

import imumon

PACKAGE = ROOT / "imumon"
TREES = {path.relative_to(PACKAGE): ast.parse(path.read_text("utf-8")) for path in PACKAGE.rglob("*.py")}
REPEATABLE = {"__init__.py", "__main__.py", "base.py"}


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
def test_the_tree_passes(command: list[str]) -> None:
    name, *words = command
    if name == "importlinter.cli":
        words = ["-c", "from importlinter.cli import lint_imports_command; lint_imports_command()"]
        call = [sys.executable, *words]
    else:
        call = [sys.executable, "-m", name, *words]
    done = subprocess.run(call, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_overview_shows_every_module() -> None:
    shown = {
        line.split()[0].rstrip("/") for line in (imumon.__doc__ or "").splitlines() if line.startswith("  ")
    }
    real = {p.stem for p in PACKAGE.glob("*.py")} | {p.parent.name for p in PACKAGE.glob("*/__init__.py")}
    real -= {"__init__", "__main__"}
    assert {name.removesuffix(".py") for name in shown} == real


def test_ci_runs_the_readmes_test_command_with_all_peers() -> None:
    command = (ROOT / ".ci" / "run").read_text().strip().splitlines()[-1]
    assert ".[test,peers]" in command
    assert command.replace(",peers", "") in (ROOT / "README.md").read_text()
    assert "pytest" in command


def test_report_needs_the_standard_library_only() -> None:
    code = "import sys; before = set(sys.modules); import imumon.report; print(*set(sys.modules) - before)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name.partition(".")[0] for name in done.stdout.split()}
    assert not loaded & {"numpy", "scipy", "zenoh", "serial", "textual", "pydantic"}


# ---------------------------------------------------------------------- names


def test_no_file_name_occurs_twice() -> None:
    names = collections.Counter(path.name for path in TREES if path.name not in REPEATABLE)
    assert not [name for name, count in names.items() if count > 1]


def test_no_public_class_name_occurs_twice() -> None:
    names = collections.Counter(
        node.name
        for tree in TREES.values()
        for node in tree.body
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    )
    assert not [name for name, count in names.items() if count > 1]


@pytest.mark.parametrize("path", [p for p in TREES if p.name == "__init__.py"], ids=str)
def test_an_init_only_reexports(path: Path) -> None:
    kinds = (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    lazy = {"__getattr__", "__dir__"}  # PEP 562: re-exports whose modules are imported at their first use
    assert not [node.name for node in TREES[path].body if isinstance(node, kinds) and node.name not in lazy]


SHORT = {"errors.py", "exit_codes.py", "datasheet.py", "noise_sums.py", "report_source.py", "tui.py"}
"""Modules under 60 lines that a reader looks for by their name."""


@pytest.mark.parametrize("path", [p for p in TREES if p.name not in REPEATABLE], ids=str)
def test_a_module_is_worth_its_file_and_can_be_read_at_once(path: Path) -> None:
    lines = len((PACKAGE / path).read_text("utf-8").splitlines())
    assert lines <= 550
    assert lines >= 60 or path.name in SHORT


# ---------------------------------------------------------------------- imports


def imports(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def test_only_a_device_package_imports_itself() -> None:
    """Also not by the name of the module in a string."""
    devices = [path.name for path in (PACKAGE / "devices").iterdir() if (path / "__init__.py").exists()]
    assert "vn100" in devices
    for device in devices:
        name = f"imumon.devices.{device}"
        for path, tree in TREES.items():
            if path.parts[:2] == ("devices", device):
                continue
            assert not [found for found in imports(tree) if found.startswith(name)], path
            texts = [
                n.value for n in ast.walk(tree) if isinstance(n, ast.Constant) and isinstance(n.value, str)
            ]
            assert not [text for text in texts if name in text or f"devices.{device}" in text], path


PURE = ("noise", "pipeline", "timebase", "report.py", "samples.py", "units.py", "messages.py")
PURE_MODULES = [
    path
    for path in TREES
    if path.parts[0] in PURE
    or path.name == "braille_canvas.py"
    or (
        path.parts[:2] == ("devices", "vn100")
        and path.name
        in ("decoder.py", "ascii.py", "binary.py", "measurements.py", "checksum.py", "registers.py")
    )
]
IMPURE = {
    "time", "os", "io", "socket", "subprocess", "threading", "asyncio", "select", "logging", "sys", "pathlib",
    "serial", "zenoh", "textual", "pydantic", "queue", "tempfile", "shutil",
}  # fmt: skip


@pytest.mark.parametrize("path", PURE_MODULES, ids=str)
def test_mathematics_and_decoders_do_no_io_and_read_no_clock(path: Path) -> None:
    tree = TREES[path]
    assert not {name.partition(".")[0] for name in imports(tree)} & IMPURE
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            assert called not in ("open", "print", "now", "today", "utcnow", "monotonic", "input")


# ---------------------------------------------------------------------- errors


def _is_error_text(node: ast.AST) -> bool:
    """Whether an expression is the text of an error: ``str(error)``, ``error.message``, ``error.cure``."""
    names = ("e", "err", "error", "exc", "exception", "problem", "failure")
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "str" and node.args:
        return isinstance(node.args[0], ast.Name) and node.args[0].id in names
    return (
        isinstance(node, ast.Attribute)
        and node.attr in ("message", "cure", "reason")
        and isinstance(node.value, ast.Name)
        and node.value.id in names
    )


@pytest.mark.parametrize("path", list(TREES), ids=str)
def test_no_control_flow_depends_on_the_text_of_a_message(path: Path) -> None:
    for node in ast.walk(TREES[path]):
        if isinstance(node, ast.Compare):
            searched = any(isinstance(op, ast.In | ast.NotIn) for op in node.ops)
            assert not (searched and any(_is_error_text(side) for side in node.comparators)), node.lineno
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            methods = ("split", "partition", "rpartition", "startswith", "endswith", "find", "splitlines")
            assert not (node.func.attr in methods and _is_error_text(node.func.value)), node.lineno
            if node.func.attr in ("match", "search", "fullmatch", "findall"):
                assert not any(_is_error_text(argument) for argument in node.args), node.lineno
