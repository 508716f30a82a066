"""The emulator by itself: ``python -m imumon.devices.vn100.emulator``."""

from __future__ import annotations

import sys

from imumon.devices.vn100.emulator import from_words, run

if __name__ == "__main__":
    try:
        settings = from_words(sys.argv[1:])
    except ValueError as error:
        sys.exit(f"imumon sim: {error}")
    sys.exit(run(settings))
