"""Hostile settings: those of a user, and those that a sensor had, as imumon saved them."""

from __future__ import annotations

import os
from pathlib import Path

from hostile_input import Hostile, file, link

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

SENSOR_SETTINGS = {
    "value-with-a-command": b'{"75": "2,8,01,0001\\r\\n$VNWNV*57"}',
    "escapes": b'{"5": "\\u001b"}',
    "nested": b"[" * 60_000,
    "no-text": b"\xff",
}
VALID_SETTINGS = b'{"5": "9600", "75": "2,8,01,0001", "new baud": "115200"}'


def settings_pipe(place: Path) -> Path:
    os.mkfifo(place / "found.json")
    return place / "found.json"


OF_A_SENSOR = (
    *(
        Hostile("sensor-settings", name, file("found.json", lambda data=data: data), "ignored")
        for name, data in SENSOR_SETTINGS.items()
    ),
    Hostile("sensor-settings", "pipe", settings_pipe, "ignored"),
    Hostile(
        "sensor-settings", "link",
        link("found.json", lambda place: file("target", lambda: b'{"5": "9600"}')(place)), "ignored",
    ),
    Hostile("sensor-settings", "endless-device", link("found.json", lambda _: Path("/dev/zero")), "ignored"),
    Hostile("sensor-settings", "valid", file("found.json", lambda: VALID_SETTINGS), "read"),
)  # fmt: skip
