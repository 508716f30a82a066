"""Hostile messages: reports, signals and names of devices, on the bus or saved."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from hostile_input import Hostile, file
from hostile_reports import real_report

from imumon.model.report import MAX_CHANNELS
from imumon.model.report_json import to_json


def changed(*path: str | int, to: Any) -> str:
    """Return the real report as JSON with one value exchanged or added."""
    data = json.loads(to_json(real_report()))
    *way, last = path
    part = data
    for key in way:
        part = part[key]
    part[last] = to
    return json.dumps(data)


def written(number: float) -> str:
    """Return a number, or a power of ten that is no float, as a part of a name."""
    return f"1e{len(str(number)) - 1}" if isinstance(number, int) else str(number)


ALLAN = ("channels", "gyro/x", "allan")
NUMBERS: tuple[tuple[str | int, ...], ...] = (
    ("channels", "gyro/x", "mean"),
    ("session", "elapsed_s"),
    (*ALLAN, "sigma", 0),
)
"""Numbers of a report, each of which must not be infinite, missing or beyond the largest that is computed with."""
VALUES: dict[str, tuple[tuple[str | int, ...], Any]] = {
    "channel-without-a-name": (("channels", ""), {"unit": "V"}),
    "channel-with-escapes": (("channels", "\x1b]0;x\x07"), {"unit": "V"}),
    "grade-by-an-unknown-axis": (("grade", "gyro", "decided_by"), {"axis": "w", "coefficient": "N"}),
    "unknown-grade": (("grade", "gyro", "meets"), "splendid"),
    "unknown-state": (("state",), "asleep"),
    "unknown-status": (("channels", "gyro/x", "N", "status"), "guessed"),
    "negative-limit": (("channels", "gyro/x", "N", "low"), -1.0),
    "histogram-of-width-0": (("channels", "gyro/x", "histogram", "width"), 0.0),
    "unequal-degrees-of-freedom": ((*ALLAN, "edf"), [1.0]),
    "cluster-time-0": ((*ALLAN, "tau_s", 0), 0.0),
    "period-0": (("period_s",), 0.0),
    "10000-caveats": (("caveats",), ["x"] * 10_000),
}
STRIP = {"start_s": 0.0, "column_s": 0.0, "low": [1.0], "high": [1.0]}
SIGNALS: dict[str, dict[str, Any]] = {
    "column-of-0-s": {"minute": STRIP},
    "channel-with-a-wildcard": {"channel": "gyro/*"},
}
DEVICE_NAMES = {
    "escapes": "a\x1b]0;x\x07", "empty": "", "capital": "A", "long": "x" * 65, "umlaut": "ä", "blank": "a b",
    "line-end": "a\n", "slash": "a/b", "at": "@a",
}  # fmt: skip


def channels(count: int) -> str:
    """Return a report with so many channels, real ones if they are few."""
    real = json.loads(to_json(real_report()))["channels"]["gyro/x"]
    entry = real if count < 100 else {"unit": "V"}
    return changed("channels", to={f"gyro/x{k}": entry for k in range(count)})


def sparse(place: Path) -> Path:
    """Write a file of 1 TB that takes no place on the disk."""
    path = place / "report.json"
    with path.open("wb") as out:
        out.write(b"{")
        out.truncate(1 << 40)
    return path


MESSAGES = (
    *(
        Hostile(
            "report", f"{'.'.join(map(str, path))}={written(number)}",
            lambda _, path=path, number=number: changed(*path, to=number), "rejected", says="not a report",
        )
        for path in NUMBERS
        for number in (1e150, 10**400, float("nan"), float("inf"))
    ),
    *(
        Hostile(
            "report", name, lambda _, path=path, value=value: changed(*path, to=value), "rejected", says="not a report"
        )
        for name, (path, value) in VALUES.items()
    ),
    Hostile("report", "64-channels", lambda _: channels(MAX_CHANNELS), "shown", seconds=10.0),
    Hostile("report", "65-channels", lambda _: channels(MAX_CHANNELS + 1), "rejected"),
    Hostile("report", "100000-channels", lambda _: channels(100_000), "rejected"),
    Hostile("report", "5-MB", lambda _: " " * 5_000_000, "rejected", says="more than"),
    *(
        Hostile(
            "signal", name, lambda _, change=change: json.dumps({"channel": "gyro/x", "unit": "V"} | change),
            "rejected", says="not a signal",
        )
        for name, change in SIGNALS.items()
    ),
    *(Hostile("device-name", name, lambda _, text=text: text, "rejected") for name, text in DEVICE_NAMES.items()),
)  # fmt: skip

SAVED = (
    Hostile("saved-report", "escapes", file("a\x1b]0;owned\x07.json", lambda: '{"\x1b]0;owned\x07": 1}'), "refused"),
    Hostile("saved-report", "escapes-in-a-missing-file", lambda place: place / "none\x1b[2J", "refused"),
    Hostile("saved-report", "1-TB", sparse, "refused", says="not a saved report"),
)  # fmt: skip
