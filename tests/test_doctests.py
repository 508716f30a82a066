"""The examples in the docstrings are correct."""

from __future__ import annotations

import doctest
import pkgutil
from importlib import import_module

import imumon


def test_every_example_of_a_docstring_gives_what_it_says() -> None:
    """Modules are imported here alone: as tests of their own, each process of a run imports all of them."""
    names = [module.name for module in pkgutil.walk_packages(imumon.__path__, "imumon.")]
    results = {name: doctest.testmod(import_module(name)) for name in names if "__main__" not in name}
    assert sum(result.attempted for result in results.values()) > 100
    assert not [name for name, result in results.items() if result.failed]
