"""A daemon on an emulator in time-lapse that somebody else holds, and can ask what it has sent.

    python benchmarks/lapse.py SPEED ... run --port PATH --state DIR --listen ENDPOINT

`imumon run --port sim --speed X` keeps its emulator to itself. This is the same daemon with the same task;
the words before ``run`` are passed over, so that it can stand before any command that starts a daemon. What
the command does before it makes the daemon, for memory's sake, is done here too.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from imumon import heap
from imumon.config import load_apart


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("--port", "--state", "--listen"):
        parser.add_argument(name, required=True)
    speed, words = float(sys.argv[1]), parser.parse_args(sys.argv[sys.argv.index("run") + 1 :])
    heap.tune()
    answer = load_apart(None, {"zenoh.listen": [words.listen]})
    from imumon.daemon import Daemon, RunOptions

    settings = answer()
    Daemon(settings, RunOptions(path=words.port, state_directory=Path(words.state), speed=speed)).run()


if __name__ == "__main__":
    main()
