"""Hostile settings: those of a user, and those that a sensor had, as imumon saved them."""

from __future__ import annotations

from pathlib import Path

from hostile_input import Hostile, file

FAULTY_SETTINGS = {
    "escapes-in-a-key": '"a\\u001b]0;x\\u0007" = 1',
    "large": "#\n" * 1_000_000,
}
SETTINGS = (
    *(
        Hostile("settings", name, file("config.toml", lambda text=text: text), "faults", seconds=3.0)
        for name, text in FAULTY_SETTINGS.items()
    ),
    Hostile("settings", "endless-device", lambda place: Path("/dev/zero"), "faults", says="larger"),
    Hostile("settings", "empty-device", lambda place: Path("/dev/null"), "read"),
)
