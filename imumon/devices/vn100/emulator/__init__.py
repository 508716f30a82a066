"""A VN-100 on a pseudo-terminal: its registers, commands, streams and noise, in a process of its own.

`spawn` starts one and gives its path; `run` is what the process does.
"""

from __future__ import annotations

from imumon.devices.vn100.emulator.emulator_settings import (
    EmulatorSettings,
    Noise,
    add_arguments,
    from_arguments,
    from_words,
)
from imumon.devices.vn100.emulator.main_loop import run
from imumon.devices.vn100.emulator.process import EmulatorProcess, spawn

__all__ = [
    "EmulatorProcess",
    "EmulatorSettings",
    "Noise",
    "add_arguments",
    "from_arguments",
    "from_words",
    "run",
    "spawn",
]
