"""The emulator alone: ``python -m imumon.devices.vn100.emulator``."""

from __future__ import annotations

import sys

from imumon.devices.base import InvalidOption
from imumon.devices.vn100.emulator import from_command_line
from imumon.devices.vn100.emulator.main_loop import run

if __name__ == "__main__":
    try:
        settings = from_command_line(sys.argv[1:])
    except InvalidOption as error:
        sys.exit(f"imumon sim: {error}")
    sys.exit(run(settings))
