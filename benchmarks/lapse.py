"""A daemon on an emulator in time-lapse that somebody else holds, and can ask what it has sent.

    python benchmarks/lapse.py SPEED ... run --port PATH --state DIR --listen ENDPOINT

`imumon run --port sim --speed X` keeps its emulator to itself. This is the same daemon with the same options;
the words before ``run`` are skipped, so that it can precede any command that starts a daemon.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from imumon.config import load
from imumon.daemon import Daemon, RunOptions


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("--port", "--state", "--listen"):
        parser.add_argument(name, required=True)
    speed, words = float(sys.argv[1]), parser.parse_args(sys.argv[sys.argv.index("run") + 1 :])
    settings = load(None, {"zenoh.listen": [words.listen]})
    Daemon(settings, RunOptions(url=words.port, state_directory=Path(words.state), speed=speed)).run()


if __name__ == "__main__":
    main()
