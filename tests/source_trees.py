"""The syntax of every module of imumon, parsed when the first test asks for it, not when tests are collected."""

from __future__ import annotations

import ast
import functools
from pathlib import Path

from paths import ROOT

PACKAGE = ROOT / "imumon"


@functools.cache
def nodes() -> dict[Path, list[ast.AST]]:
    """Return the nodes of each module by its path in the package; the first node is the module."""
    return {
        path.relative_to(PACKAGE): list(ast.walk(ast.parse(path.read_text("utf-8"))))
        for path in sorted(PACKAGE.rglob("*.py"))
    }
