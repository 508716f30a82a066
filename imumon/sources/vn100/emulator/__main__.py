"""Process of the emulator, with the settings that `spawn` gives it."""

from __future__ import annotations

import pickle
import sys

from imumon.sources.vn100.emulator.process import run

if __name__ == "__main__":
    try:
        (settings,) = map(bytes.fromhex, sys.argv[1:])
    except ValueError:
        sys.exit("imumon: this module is the process of an emulator: start one with imumon sim")
    sys.exit(run(pickle.loads(settings), (sys.stdin.fileno(),)))
