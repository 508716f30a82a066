"""A VN-100 on a pseudo-terminal: its registers, commands, streams and noise, in a process of its own.

`spawn` starts one and gives its path; `run` is what the process does.
"""

from __future__ import annotations

from imumon.emulator.process import EmulatorProcess, spawn
from imumon.emulator.serve import run
from imumon.emulator.settings import EmulatorSettings, Noise, add_arguments, from_arguments, from_words

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
