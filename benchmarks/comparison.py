"""Figures of two versions side by side: the same rows of two outputs of `python -m benchmarks`.

    python benchmarks/comparison.py NAME THEN.md NOW.md

`NAME` is that of the version of THEN.md. Both have to be of the same machine, one after the other. Exit code 1 if a
ratio to another program has grown by more than `MOST_GROWTH`.
"""

from __future__ import annotations

import sys
from pathlib import Path

from document_tables import row

MOST_GROWTH = 1.25
"""A ratio of processor times that grows by more has become slower. Unit: factor.

Otherwise: one slow night of a shared machine fails, or a program becomes slower by degrees. Origin: ratios of two runs
on a shared machine differ by up to 20 %.
"""


def figures(path: str) -> dict[str, str]:
    """Return what imumon needs, by the name of the row."""
    lines = (line for line in Path(path).read_text("utf-8").splitlines() if line[:1] == "|")
    rows = [[cell.strip() for cell in line[1:-1].split("|")] for line in lines]
    return {cells[0]: cells[1] for cells in rows if len(cells) > 3}


def ratio(value: str) -> float | None:
    """Return a ratio to another program; None if the figure is none."""
    number, _, unit = value.partition(" ")
    return float(number) if unit == "×" else None


def main() -> int:
    name, then, now = sys.argv[1:]
    before, slower = figures(then), []
    print(row(["what", name, "now"]))
    print(row(["---"] * 3))
    for what, value in figures(now).items():
        print(row([what, before.get(what, "–"), value]))
        earlier, today = ratio(before.get(what, "")), ratio(value)
        if earlier is not None and today is not None and today > MOST_GROWTH * earlier:
            slower.append(what)
    for what in slower:
        print(f"slower: {what}", file=sys.stderr)
    return 1 if slower else 0


if __name__ == "__main__":
    raise SystemExit(main())
