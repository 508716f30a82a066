"""Figures: what a benchmark finds, and the one table they are shown in."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import NamedTuple

from document_tables import head, row


class Figure(NamedTuple):
    """One line of the table.

    Attributes
    ----------
    beside : the same of another tool or the bound, in the same run.
    met : whether the goal is; None where there is none.
    """

    what: str
    value: str
    beside: str = ""
    goal: str = ""
    met: bool | None = None


COLUMNS = ("what", "imumon", "beside it", "goal", "")
MARKS = {True: "met", False: "**missed**", None: ""}


def lines(figures: Iterable[Figure]) -> Iterable[str]:
    """Rows of the table as they are found."""
    for each in figures:
        yield row([*each[:4], MARKS[each.met]])


def show(name: str, figures: Iterable[Figure]) -> None:
    """The table of one benchmark."""
    print(head(name, *COLUMNS))
    for line in lines(figures):
        print(line, flush=True)


def at_most(what: str, value: float, goal: float, unit: str, beside: str = "", digits: int = 3) -> Figure:
    """A figure that is to be no more than its goal."""
    return Figure(what, f"{value:.{digits}g} {unit}", beside, f"≤ {goal:g} {unit}", value <= goal)


def seconds(work: Callable[[], object], repeat: int, warm: int = 2) -> float:
    """Processor time of one call, the least: what other work on the machine disturbed least."""
    for _ in range(warm):
        work()
    times = []
    for _ in range(repeat):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)
