"""All of it in one command and one table: accuracy, cost, memory, growth, end to end.

    python -m benchmarks                             about a quarter of an hour
    python -m benchmarks --quick                     a few minutes: fewer records, shorter ones
    python -m benchmarks --into docs/PERFORMANCE.md --plot docs/scaling.svg

Every peer works in the same run on the same machine: ratios are what to look at, for other work makes all
times longer. `--into` puts machine, date, command and table between the two marks of a document.
"""

from __future__ import annotations

import argparse
import os
import platform
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
import codec
import daemon_cost
import memory
import replay
import scaling
import soak
from figures import HEAD, Figure, lines

BEGIN, END = "<!-- table: python -m benchmarks --into -->", "<!-- end of the table -->"


def parts(quick: bool, plot: str | None) -> dict[str, Iterator[Figure]]:
    """What is measured, in the order of the table; nothing runs before it is asked for."""
    return {
        "Accuracy": accuracy.measure(40 if quick else 100, 10 if quick else 20),
        "A sample": cascade.measure(),
        "The pipeline": daemon_cost.measure(),
        "A day of samples": memory.measure(6.0 if quick else 24.0),
        "The length of the record": scaling.measure(8, plot),
        "Bytes": codec.measure(),
        "A recording": replay.measure(0.5, 50_000, 100_000, 50_000, 1) if quick else replay.measure(),
        "The daemon": soak.measure(1.0 if quick else 3.0),
    }


def machine() -> str:
    """Processor, system and versions in a line."""
    cpu = platform.processor() or platform.machine()
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            cpu = line.partition(":")[2].strip()
            break
    libraries = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "allantools"))
    load = os.getloadavg()[0]
    return (
        f"{cpu}, {os.cpu_count()} cores, other work on them: load {load:.1f} at the start; "
        f"{platform.system()} {platform.release().partition('-')[0]}, Python {platform.python_version()}, "
        f"{libraries}"
    )


def replaced(document: str, table: str) -> str:
    """A document with another table between its marks."""
    before, begin, rest = document.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise SystemExit(f"the document has no {BEGIN!r} and {END!r}")
    return f"{before}{BEGIN}\n\n{table}\n{END}{after}"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__.partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="fewer records, shorter ones: a few minutes")
    parser.add_argument("--plot", metavar="FILE", help="draw cost and state against the length, SVG")
    parser.add_argument("--into", metavar="FILE", help="put the table into a document, too")
    words = parser.parse_args()
    command = " ".join(["python -m benchmarks", *sys.argv[1:]])
    shown = [f"`{command}`, {datetime.now(UTC):%Y-%m-%d}. {machine()}.", "", HEAD]
    print("\n".join(shown))
    for title, figures in parts(words.quick, words.plot).items():
        for line in chain([f"| **{title}** | | | | |"], lines(figures)):
            print(line, flush=True)
            shown.append(line)
    if words.into:
        path = Path(words.into)
        path.write_text(replaced(path.read_text("utf-8"), "\n".join(shown) + "\n"), "utf-8")


if __name__ == "__main__":
    main()
