"""A daemon on an emulator in time-lapse that somebody else holds, and can ask what it has sent.

    python benchmarks/lapse.py SPEED [NAME=VALUE ...] ... run --port PATH --state DIR --listen ENDPOINT

`imumon run --port sim --speed X` keeps its emulator to itself. This is the same daemon with the same options. Words
with ``=`` before ``run`` are settings, in JSON. The others are skipped, so that it can precede any command that starts
a daemon.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from imumon.clock import HostClock
from imumon.config import load
from imumon.daemon import Daemon, RunOptions


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("--port", "--state", "--listen"):
        parser.add_argument(name, required=True)
    own, words = sys.argv[1 : (at := sys.argv.index("run"))], parser.parse_args(sys.argv[at + 1 :])
    speed, pairs = float(own[0]), (word.partition("=") for word in own if "=" in word)
    given = {name: json.loads(value) for name, _, value in pairs}
    settings = load(None, {"zenoh.listen": [words.listen], **given})
    Daemon(
        settings, RunOptions(url=words.port, state_directory=Path(words.state), clock=HostClock(speed))
    ).run()


if __name__ == "__main__":
    main()
