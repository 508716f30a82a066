"""The docstring of the package lists what it has."""

from __future__ import annotations

import pkgutil

import imumon.noise


def test_the_docstring_lists_every_module() -> None:
    assert set(imumon.noise.__all__) <= set(dir(imumon.noise))
    modules = {name for _, name, _ in pkgutil.iter_modules(imumon.noise.__path__)}
    rows = [row for row in (imumon.noise.__doc__ or "").splitlines() if row.startswith("| `")]
    assert {row.split("`")[1].rstrip("/") for row in rows} == modules
