"""All of it in one command and one table: accuracy, cost, memory, growth, end to end.

    python -m benchmarks                             about a quarter of an hour
    python -m benchmarks --quick                     a few minutes: fewer records, shorter ones
    python -m benchmarks --plot docs/scaling.svg | python benchmarks/document_tables.py -

Every peer works in the same run on the same machine: ratios are what to look at, for other work makes all
times longer. The last command saves the tables and writes them into docs/PERFORMANCE.md.
"""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from importlib.metadata import version
from itertools import chain
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import accuracy
import cascade
import daemon_cost
import replay
import soak
from document_tables import COLUMNS, Figure, head, lines, row


def parts(quick: bool, plot: str | None) -> dict[str, Iterator[Figure]]:
    """What is measured, in the order of the table; nothing runs before it is asked for."""
    return {
        "Accuracy": accuracy.measure(40 if quick else 100, 10 if quick else 20),
        "A sample": cascade.measure(),
        "The pipeline": daemon_cost.measure(),
        "A day of samples": cascade.day(6.0 if quick else 24.0),
        "The length of the record": cascade.growth(8, plot),
        "A recording": replay.measure(0.5, 50_000, 100_000, 50_000, 1) if quick else replay.measure(),
        "The daemon": soak.measure(1.0 if quick else 3.0),
    }


def commit() -> str:
    """Return the commit that is measured."""
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty"]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip() or "unknown"


def machine() -> dict[str, str]:
    """Processor, other work, system and versions."""
    cpu = platform.processor() or platform.machine()
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            cpu = line.partition(":")[2].strip()
            break
    libraries = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "allantools"))
    return {
        "processor": f"{cpu}, {os.cpu_count()} cores",
        "other work on them": f"load {os.getloadavg()[0]:.1f} at the start",
        "system": f"{platform.system()} {platform.release().partition('-')[0]}, Python {platform.python_version()}",
        "libraries": libraries,
    }


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__.partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="fewer records, shorter ones: a few minutes")
    parser.add_argument("--plot", metavar="FILE", help="draw cost and state against the length, SVG")
    words = parser.parse_args()
    command = " ".join(["python -m benchmarks", *sys.argv[1:]])
    run = {"command": f"`{command}`", "commit": commit(), "date": f"{datetime.now(UTC):%Y-%m-%d}"}
    run |= machine()
    print(
        "\n".join(
            [head("performance-run", "run", ""), *map(row, run.items()), "", head("performance", *COLUMNS)]
        )
    )
    for title, figures in parts(words.quick, words.plot).items():
        for line in chain([row([f"**{title}**", "", "", "", ""])], lines(figures)):
            print(line, flush=True)


if __name__ == "__main__":
    main()
