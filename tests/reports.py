"""Reports of runs of the pipeline on synthesised noise, for tests that draw, print or check a report.

They are files, so that no test waits for a pipeline. `report_runs.py` makes them; run it after a change of the
report or of its numbers.
"""

from __future__ import annotations

import gzip
import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import cache
from typing import Any

import numpy as np
from paths import TESTS

from imumon.model.coefficients import Estimate
from imumon.model.messages import EVENT_LEVELS
from imumon.model.report import (
    Channel,
    Event,
    Report,
    Signal,
    from_json,
    stamp,
)
from imumon.model.report_json import to_json
from imumon.model.samples import ACCEL, GYRO, MAG

FOLDER = TESTS / "data" / "reports"
ID = "vn100-0100056785"
RATE = 20.0
"""Hz, sample rate of `report`."""
LENGTH_S = 7200.0
"""s, length of the record of `report`."""
LONG_RATE, LONG_S = 4.0, 43_200.0
"""Hz and s, of a record that shows every N, B and K."""
BEGIN = datetime(2026, 3, 1, 8, tzinfo=UTC)

NOISE = GYRO + ACCEL + MAG
TRUTH: dict[str, tuple[float, float, float, float]] = {
    GYRO[0]: (8.858e-5, 2.187e-5, 2.0e-6, 1.3e-3),
    GYRO[1]: (1.119e-4, 3.559e-5, 1.0e-6, -2.2e-3),
    GYRO[2]: (9.043e-5, 1.683e-5, 5.0e-7, 4.1e-4),
    ACCEL[0]: (1.877e-3, 4.102e-4, 1.5e-5, 0.0312),
    ACCEL[1]: (1.896e-3, 1.026e-3, 2.5e-5, -0.1104),
    ACCEL[2]: (2.811e-3, 5.055e-4, 2.0e-5, -9.80612),
    MAG[0]: (1.2e-4, 9.0e-6, 3.0e-7, 0.2104),
    MAG[1]: (1.1e-4, 8.0e-6, 3.0e-7, -0.0312),
    MAG[2]: (1.6e-4, 1.1e-5, 3.0e-7, 0.4417),
}
"""N, B, K and mean of each channel, SI."""
AGES = {8.0: "seconds", 200.0: "minutes", 900.0: "other", LENGTH_S: "hours", LONG_S: "long"}
"""Files by the length of the record, s; "other" is a sensor of twice the noise."""


def written(part: Report | tuple[Signal, ...]) -> bytes:
    """Return the content of a file."""
    return gzip.compress(to_json(part).encode(), mtime=0)


@cache
def read(name: str) -> Report:
    """Return the report of a file."""
    return from_json(Report, gzip.decompress((FOLDER / f"{name}.json.gz").read_bytes()))


def long_report() -> Report:
    """Return the report of a record that shows every N, B and K, and what its first parts showed."""
    return read("long")


def correlated() -> Report:
    """Return the report of gyroscopes with Gauss–Markov noise: x shows it, y does not separate it from B and K.

    The noise of z is flicker.
    """
    return read("correlated")


def moving() -> Report:
    """Return the report of a sensor that has begun to move."""
    return read("moving")


def warming_up() -> Report:
    """Return the report of a sensor that warms up."""
    return read("warming_up")


def with_coefficients(channel: Channel, **changed: Estimate) -> Channel:
    """Return a channel with other estimates of some coefficients."""
    return replace(channel, coefficients={**channel.coefficients, **changed})


def with_channel(report: Report, name: str, **changed: Any) -> Report:
    """Return a report in which some fields of a channel differ."""
    channel = replace(report.channels[name], **changed)
    return replace(report, channels={**report.channels, name: channel})


def with_bound(report: Report, letter: str, *names: str, high: float | None = None) -> Report:
    """Return a report in which a coefficient of some channels is only bounded."""
    for name in names:
        known = report.channels[name].coefficients
        bound = replace(
            known[letter], status="upper_bound", value=None, low=0.0, high=high or known[letter].high
        )
        report = with_channel(report, name, coefficients={**known, letter: bound})
    return report


def report(
    elapsed_s: float = LENGTH_S,
    *,
    id: str = ID,
    state: str = "running",
    caveats: tuple[str, ...] = (),
    speed: float = 1.0,
) -> Report:
    """Return the report of a run at one of `AGES`; the same object for the same words.

    Parameters
    ----------
    caveats : of the device, for the whole record.
    """
    # `cache` would distinguish a word that is given from the same one by default
    return _report(elapsed_s, id, state, caveats, speed)


@cache
def _report(elapsed_s: float, id: str, state: str, caveats: tuple[str, ...], speed: float) -> Report:
    report = read(AGES[elapsed_s])
    channels = {
        name: replace(channel, caveats=tuple(dict.fromkeys((*caveats, *channel.caveats))))
        if channel.allan is not None
        else channel
        for name, channel in report.channels.items()
    }
    return replace(
        report,
        state=state,  # type: ignore[arg-type]
        device=replace(report.device, id=id, serial=id.rpartition("-")[2]),
        caveats=tuple(dict.fromkeys((*caveats, *report.caveats))),
        channels=channels,
        speed=speed,
    )


def nothing_yet() -> Report:
    """Return what a daemon publishes before it detects its sensor."""
    return read("nothing")


@cache
def _signals() -> dict[str, Signal]:
    text = gzip.decompress((FOLDER / "signals.json.gz").read_bytes())
    return {part["channel"]: from_json(Signal, json.dumps(part)) for part in json.loads(text)}


def signal(name: str = GYRO[0]) -> Signal:
    """Return the signal of a channel at the end of the run."""
    return _signals()[name]


def events(id: str = ID) -> list[Event]:
    """Return the events of a day; one text contains markup, which must be shown as it is."""
    texts = (
        ("08:00:00", "connect", "VN-100T-CR 0100056785 on /dev/ttyUSB0 at 115200 baud", None),
        ("08:05:10", "warmup", "310 s of warm-up excluded", None),
        ("08:16:40", "gap", "1.2 s lost, 24 samples", None),
        ("09:06:40", "disturbance", "knock of 0.8 rad/s, 2.5 s excluded [bold]not markup[/bold]", GYRO[1]),
        ("09:14:03", "grade", "gyro: consumer", None),
        ("09:20:31", "disconnect", "the port is gone; waiting for it", None),
        ("09:20:44", "connect", "back after 13 s, the record continues", None),
        ("09:20:44", "gap", "13.1 s lost", None),
    )
    return [
        Event(
            time=f"2026-03-01T{at}.000Z",
            kind=kind,
            text=text,
            device=id,
            channel=channel,
            level="notice" if text.startswith("back") else EVENT_LEVELS[kind],
        )
        for at, kind, text, channel in texts
    ]


@cache
def history_reply(channel: str, span: float, step: str) -> tuple[bytes, bytes]:
    """Return rows and events of a sensor whose N grew, as a daemon replies."""
    length = {"1h": 3600, "1d": 86400}[step]
    count, rng = round(span / length), np.random.default_rng(5)
    rows = []
    for k in range(count):
        begin = BEGIN + timedelta(seconds=k * length - span)
        factor = 1.0 + 0.02 * rng.standard_normal() + 0.12 * (k > 0.7 * count)
        noise = TRUTH.get(channel, (1.0, 1.0, 1.0, 1.0))[0] * factor
        heat = 30.0 + 4.0 * np.sin(k * length / 86400.0 * 2.0 * np.pi)
        flicker = {"value": 0.2 * noise if k % 3 else None, "low": 0.0, "high": noise, "status": "measured"}
        rows.append(
            {"time": stamp(begin), "end": stamp(begin + timedelta(seconds=length)), "channel": channel, "B": flicker,
             "N": {"value": noise, "low": 0.97 * noise, "high": 1.03 * noise, "status": "measured"},
             "K": {"value": None, "low": 0.0, "high": 0.05 * noise, "status": "upper_bound"},
             "mean": 1e-3 * heat, "temperature": heat}
        )  # fmt: skip
    changed = stamp(BEGIN - timedelta(seconds=0.3 * span))
    marks = [{"time": changed, "kind": "change", "text": "", "count": 1}]
    return json.dumps(rows).encode(), json.dumps(marks).encode()


class FakeSource:
    """A report source that a test sets: what a subscriber would have received."""

    version = 1

    def __init__(
        self, *reports: Report, age: float = 0.0, alive: bool = True, connected: bool = True
    ) -> None:
        self.now = 1000.0
        self._reports = {r.device.id: (r, self.now - age) for r in reports}
        self._alive = set(self._reports) if alive else set()
        self._connected = connected
        self.log = events()
        self.watched: list[tuple[str, str | None]] = []

    def clock(self) -> float:
        return self.now

    def arrive(self, report: Report) -> None:
        """Receive a report."""
        self._reports[report.device.id] = (report, self.now)
        self._alive.add(report.device.id)
        self._connected = True
        self.version += 1

    def disconnect(self) -> None:
        """Lose the daemon and the connection."""
        self._alive.clear()
        self._connected = False
        self.version += 1

    def reports(self) -> dict[str, tuple[Report, float]]:
        return dict(self._reports)

    def alive(self) -> set[str]:
        return set(self._alive)

    def events(self, id: str) -> list[Event]:
        return self.log if id in self._reports else []

    def rivals(self) -> dict[str, tuple[str, ...]]:
        return {}

    def watch(self, id: str, channel: str | None) -> None:
        self.watched.append((id, channel))

    def signal(self) -> tuple[Signal, float] | None:
        id, channel = self.watched[-1] if self.watched else ("", None)
        early = id in self._reports and self._reports[id][0].session.elapsed_s < 10.0
        return (signal(channel), self.now) if channel in TRUTH and not early else None

    def watch_history(self, asked: tuple[str, str, float, str] | None) -> None:
        self.asked_history = asked

    def history_answer(self) -> tuple[tuple[str, str, float, str], bytes, bytes] | None:
        asked = getattr(self, "asked_history", None)
        return None if asked is None else (asked, *history_reply(asked[1], asked[2], asked[3]))

    def connected(self) -> bool:
        return self._connected
