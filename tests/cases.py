"""Cases of one law in one test: a failure names its case."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def case(name: object) -> Iterator[None]:
    """Add the name of a case to what fails in it."""
    try:
        yield
    except BaseException as error:
        error.add_note(f"case: {name}")
        raise
