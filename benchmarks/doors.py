"""Benchmark of the doors: what connections that say nothing cost a daemon and its viewers.

    python benchmarks/doors.py [--connections 2000]

Each row is a run of its own, on loopback: so many connections to the Zenoh port of a daemon and as many to `imumon
metrics`, which stay open until the daemon has ended. The columns are those of `Cost` in tests/idle_connections.py. Exit
code 1 if a sample is lost.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from idle_connections import cost

HEAD = ("connections", "lost", "save, s", "viewer, s", "metrics, s", "memory, MB", "of metrics, MB", "end, s")


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--connections", type=int, default=2000)
    most, lost = parser.parse_args().connections, 0
    print(f"| {' | '.join(HEAD)} |\n|{'---:|' * len(HEAD)}")
    for count in (0, most):
        with tempfile.TemporaryDirectory() as folder:
            each = cost(Path(folder), count)
        times = f"{each.save_s:.1f} | {each.viewer_s:.1f} | {each.metrics_s:.1f}"
        memory = f"{each.memory_mb:.0f} | {each.metrics_mb:.0f}"
        print(f"| {count:,} | {each.lost} | {times} | {memory} | {each.end_s:.1f} |", flush=True)
        lost += each.lost
    print(f"load of the last minute: {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    return int(lost > 0)


if __name__ == "__main__":
    sys.exit(main())
