"""Tables of the documents, from the saved results of the benchmarks.

    python benchmarks/accuracy.py --records 90 | python benchmarks/document_tables.py -
    python benchmarks/document_tables.py

A benchmark prints `<!-- table: NAME -->` above each of its tables. The first command saves the tables of such an
output as `results/NAME.csv`, and writes the documents; names of files may take the place of `-`. The second command
writes the documents from what is saved: below each line `<!-- table: NAME -->`, the lines of the table are replaced.
The text around a table is written by hand.
"""

from __future__ import annotations

import argparse
import csv
import re
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

RESULTS = Path(__file__).parent / "results"
NAMES = ("ACCURACY.md", "PERFORMANCE.md", "dev/ACCURACY.md")
DOCUMENTS = [Path(__file__).parents[1] / name for name in ("README.md", *(f"docs/{name}" for name in NAMES))]
_TABLE = re.compile(r"^<!-- table: ([\w-]+) -->\n((?:\|.*\n)*)", re.MULTILINE)


def mark(name: str) -> str:
    """Return the line above a table."""
    return f"<!-- table: {name} -->"


def row(cells: Sequence[object]) -> str:
    """Return a line of a table.

    >>> row(["N", 0.3])
    '| N | 0.3 |'
    """
    return f"| {' | '.join(map(str, cells))} |"


def head(name: str, *columns: str) -> str:
    """Return the mark of a table and its first two lines."""
    return "\n".join([mark(name), row(columns), "|---" * len(columns) + "|"])


class Figure(NamedTuple):
    """What a benchmark finds: one line of the table of figures.

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


def save(output: str) -> list[str]:
    """Save the tables of the output of a benchmark; return their names."""
    names = []
    for name, lines in _TABLE.findall(output + "\n"):
        rows = [[cell.strip() for cell in line[1:-1].split("|")] for line in lines.splitlines()]
        with (RESULTS / f"{name}.csv").open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows([rows[0], *rows[2:]])
        names.append(name)
    return names


def written(document: str) -> str:
    """Return a document with the saved tables below their marks."""

    def table(match: re.Match[str]) -> str:
        columns, *rows = DERIVED[match[1]]() if match[1] in DERIVED else _saved(match[1])
        return "\n".join([head(match[1], *columns), *map(row, rows)]) + "\n"

    return _TABLE.sub(table, document)


def _saved(name: str) -> list[list[str]]:
    """Return the rows of a saved table, of which the first has the names of the columns."""
    with (RESULTS / f"{name}.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.reader(file))


def _peers() -> list[list[str]]:
    """Return the errors of imumon and of other tools in records of 5 h, the bound, and errors over more records."""
    _, *methods = _saved("accuracy-peers")
    others = ["no", "no"]
    rows = [["", "N", "B", "K", "uncertainty", "live, in bounded memory"]]
    for method, *errors in methods:
        rows.append([method, *errors[:3], *(["95 %", "yes"] if "imumon" in method else others)])
    goals = [line for line in _saved("performance") if line[0].startswith("rms error of ")]
    records = goals[0][0].rpartition(", ")[2]
    found = [re.search(r"Cramér–Rao ([\d.]+)", line[2]) for line in goals]
    rows.append(["Cramér–Rao bound", *(f"– / {match[1]}" if match else "–" for match in found), "", ""])
    rows.append([f"imumon, {records}", *(f"– / {line[1].partition(' ')[0]}" for line in goals), "", ""])
    return rows


DERIVED: Mapping[str, Callable[[], list[list[str]]]] = {"readme-peers": _peers}
"""Tables of a document that are parts of saved ones."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("outputs", nargs="*", metavar="FILE", help="output of a benchmark; -: standard input")
    for name in parser.parse_args().outputs:
        text = sys.stdin.read() if name == "-" else Path(name).read_text("utf-8")
        print("\n".join(save(text)))
    for path in DOCUMENTS:
        path.write_text(written(path.read_text("utf-8")), "utf-8")


if __name__ == "__main__":
    main()
