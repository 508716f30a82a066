"""VN-100 emulator on a pseudo-terminal: registers, commands, output streams and noise.

`spawn` starts it in a separate process; `process.run` is what that process does.
"""

from __future__ import annotations

from imumon.sources.vn100.emulator.emulator_settings import (
    EmulatorSettings,
    Noise,
    add_arguments,
    from_arguments,
    time_lapse_settings,
)
from imumon.sources.vn100.emulator.process import EmulatorProcess, spawn

__all__ = [
    "EmulatorProcess",
    "EmulatorSettings",
    "Noise",
    "add_arguments",
    "from_arguments",
    "spawn",
    "time_lapse_settings",
]
