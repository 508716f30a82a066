"""Figures of two versions side by side: the same rows of two outputs of `python -m benchmarks`.

    python benchmarks/comparison.py NAME THEN.md NOW.md

`NAME` is that of the version of THEN.md. Both have to be of the same machine, one after the other.
"""

from __future__ import annotations

import sys
from pathlib import Path

from document_tables import row


def figures(path: str) -> dict[str, str]:
    """Return what imumon needs, by the name of the row."""
    rows = [
        line.strip("| ").split(" | ")
        for line in Path(path).read_text("utf-8").splitlines()
        if line[:1] == "|"
    ]
    return {cells[0]: cells[1] for cells in rows if len(cells) > 3}


def main() -> None:
    name, then, now = sys.argv[1:]
    before = figures(then)
    print(row(["what", name, "now"]))
    print(row(["---"] * 3))
    for what, value in figures(now).items():
        print(row([what, before.get(what, "–"), value]))


if __name__ == "__main__":
    main()
