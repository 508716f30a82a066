"""Reports of real runs of the pipeline on synthesised noise, for tests that need a report.

A run feeds a `Monitor` with a sensor of known N, B and K that has gaps, a knock, a vibration and a slowly
cycling temperature. The seed is fixed, so the numbers are the same on every machine. Each run happens once per
test run: its processes share the results.
"""

from __future__ import annotations

import fcntl
import json
import os
import pickle
from collections.abc import Callable, Hashable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path
from typing import TypeVar

import numpy as np

from imumon.model.coefficients import Estimate
from imumon.model.messages import EVENT_LEVELS
from imumon.model.report import Channel, DeviceDescription, Event, Report, SessionCounters, Signal, stamp
from imumon.model.samples import ACCEL, GYRO, MAG, Floats, SampleBlock, Stream
from imumon.noise import OctaveCascade, fit_curve
from imumon.noise.synthesis import synthesise
from imumon.record import Monitor, MonitorOptions
from imumon.sources import registry

ID = "vn100-0100056785"
RATE = 20.0
"""Hz, sample rate of `report`."""
LENGTH_S = 7200.0
"""s, length of the record of `report`."""
LONG_RATE, LONG_S = 4.0, 43_200.0
"""Hz and s, of a record that shows every N, B and K."""
AGES = (0.05, 3.0, 8.0, 60.0, 200.0, 400.0, 900.0, 3600.0, 7198.0, LENGTH_S)
"""s, elapsed times at which a run reports."""
BEGIN = datetime(2026, 3, 1, 8, tzinfo=UTC)

NOISE = GYRO + ACCEL + MAG
TRUTH: dict[str, tuple[float, float, float, float]] = {
    "gyro/x": (8.858e-5, 2.187e-5, 2.0e-6, 1.3e-3),
    "gyro/y": (1.119e-4, 3.559e-5, 1.0e-6, -2.2e-3),
    "gyro/z": (9.043e-5, 1.683e-5, 5.0e-7, 4.1e-4),
    "accel/x": (1.877e-3, 4.102e-4, 1.5e-5, 0.0312),
    "accel/y": (1.896e-3, 1.026e-3, 2.5e-5, -0.1104),
    "accel/z": (2.811e-3, 5.055e-4, 2.0e-5, -9.80612),
    "mag/x": (1.2e-4, 9.0e-6, 3.0e-7, 0.2104),
    "mag/y": (1.1e-4, 8.0e-6, 3.0e-7, -0.0312),
    "mag/z": (1.6e-4, 1.1e-5, 3.0e-7, 0.4417),
}
"""N, B, K and mean of each channel, SI."""
SETTINGS = {
    "75 binary output 1": "1,40,01,0739",
    "82 delta theta and delta velocity": "0,0,0,0,0",
    "85 IMU filtering": "0,4,4,4,0,0,3,3,3,0",
    "of tomorrow": "a value without a text",
}
DEVICE = DeviceDescription(
    id=ID,
    driver="vn100",
    model="VN-100T-CR",
    serial="0100056785",
    firmware="2.1.0.0",
    port="/dev/ttyUSB0",
    baud=115200,
    alias_factor=3.162,
    settings=SETTINGS,
    setting_texts=registry.setting_texts(registry.driver("vn100"), SETTINGS),
)
STREAM = Stream("uncompensated", (*NOISE, "temperature", "pressure"), "binary 01:0739", "startup")
AMBIENT_S = 7200.0
"""s, period of the ambient temperature."""
VIBRATION_HZ = 4.37
"""Hz, vibration along accel/y."""
CHUNK = 2000
"""Samples per block."""


T = TypeVar("T")


def once_per_test_run(make: Callable[..., T]) -> Callable[..., T]:
    """Let the processes of a test run share the results of a function; the first that needs one makes it."""

    @cache
    def shared(*arguments: Hashable) -> T:
        directory = os.environ.get("IMUMON_TEST_RUN")  # tests/conftest.py sets it
        if directory is None:
            return make(*arguments)
        path = Path(directory) / f"{make.__name__}{arguments}.pickle"
        with path.with_suffix(".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not path.exists():
                path.write_bytes(pickle.dumps(make(*arguments)))
        made: T = pickle.loads(path.read_bytes())
        return made

    return shared


class Run:
    """A monitor that is fed with a synthetic sensor.

    Parameters
    ----------
    scale : factor of all noise.
    walk : factor of K.
    moving_s : s of motion at the end of the record.
    warm_up : let the gyroscopes settle with the temperature.
    convergence : of `MonitorOptions`.
    """

    def __init__(
        self,
        length_s: float = LENGTH_S,
        rate_hz: float = RATE,
        *,
        seed: int = 1,
        scale: float = 1.0,
        walk: float = 1.0,
        moving_s: float = 0.0,
        warm_up: bool = False,
        convergence: bool = False,
    ) -> None:
        self.monitor = Monitor(MonitorOptions(convergence=convergence))
        self._rate_hz = rate_hz
        self._values = _samples(
            round(length_s * rate_hz), rate_hz, seed, (scale, scale, scale * walk), moving_s, warm_up
        )
        self._kept = np.ones(len(self._values), dtype=np.bool_)
        for begin_s, count in ((1000.0, 24), (2300.0, 36), (5000.0, 1)):
            self._kept[round(begin_s * rate_hz) :][:count] = False
        self._at = 0

    def report_at(self, elapsed_s: float, state: str = "running") -> Report:
        """Feed the samples up to a time, and return the report; times must not decrease."""
        end = min(round(elapsed_s * self._rate_hz), len(self._values))
        while self._at < end:
            rows = np.arange(self._at, min(self._at + CHUNK, end))
            rows = rows[self._kept[rows]]
            stamps = 10**9 + np.rint(rows * 1e9 / self._rate_hz).astype(np.int64)
            self._at = min(self._at + CHUNK, end)
            self.monitor.feed(
                SampleBlock(STREAM, self._values[rows], stamps, np.zeros(len(rows), dtype=np.int64))
            )
        session = SessionCounters(
            started=stamp(BEGIN),
            discarded_bytes=118,
            bad_checksums=2,
            received_bytes=62 * end,
            restarts=1,
        )
        now = BEGIN + timedelta(seconds=elapsed_s)
        # a full analysis: a report depends only on its time, not on earlier reports
        report = self.monitor.report(now, DEVICE, "stopped", session)
        return replace(report, state=state)  # type: ignore[arg-type]


def of_sensors(report: Report, *sensors: str) -> Report:
    """Return the report with the channels of these sensors alone: a figure of each takes most of a document's time."""
    kept = {name: channel for name, channel in report.channels.items() if name.partition("/")[0] in sensors}
    return replace(report, channels=kept)


def with_coefficients(channel: Channel, **changed: Estimate) -> Channel:
    """Return a channel with other estimates of some coefficients."""
    return replace(channel, coefficients={**channel.coefficients, **changed})


def _samples(
    count: int, rate_hz: float, seed: int, scales: tuple[float, float, float], moving_s: float, warm_up: bool
) -> Floats:
    """Return (count, 11) samples of `STREAM`."""
    n, b, k = ([scale * TRUTH[name][i] for name in NOISE] for i, scale in enumerate(scales))
    noise = synthesise(count, rate_hz, N=n, B=b, K=k, seed=seed, averaged=False)
    time = np.arange(count) / rate_hz
    rng = np.random.default_rng([seed, 1])  # not the numbers of the noise: they would follow the temperature
    ambient = 0.5 - 0.5 * np.cos(2.0 * np.pi * time / AMBIENT_S)
    heat = 1.0 - np.exp(-time / 400.0) if warm_up else ambient
    values = noise + [TRUTH[name][3] for name in NOISE]
    if 0.5 * rate_hz > VIBRATION_HZ:
        values[:, 4] += 0.6 * values[:, 4].std() * np.sin(2.0 * np.pi * VIBRATION_HZ * time)
    if warm_up:
        values[:, :3] += 0.004 * heat[:, None]
    knock = (time >= 4000.0) & (time < 4000.8)
    values[knock, 1] += 0.8 * np.sin(2.0 * np.pi * 3.0 * time[knock])
    if moving_s:
        moving = time >= time[-1] - moving_s
        values[moving, :3] += 0.5 * np.sin(2.0 * np.pi * 0.3 * time[moving])[:, None]
        values[moving, 3:6] += 2.0 * np.sin(2.0 * np.pi * 0.3 * time[moving])[:, None]
    temperature = 24.9 + 6.6 * heat + 0.01 * rng.standard_normal(count)
    pressure = 101.32 + 0.002 * rng.standard_normal(count)
    return np.column_stack((values, temperature, pressure))


@once_per_test_run
def _run(scale: float) -> tuple[dict[float, Report], dict[str, Signal]]:
    """Return the reports of a run by age, and its signals at the end."""
    run = Run(scale=scale) if scale == 1.0 else Run(900.0, seed=2, scale=scale)
    ages = AGES if scale == 1.0 else (900.0,)
    reports = {age: run.report_at(age) for age in ages}
    return reports, {name: make() for name, make in run.monitor.signals().items() if name in NOISE}


@once_per_test_run
def long_report() -> Report:
    """Return the report of a record that shows every N, B and K, and what its first parts showed."""
    return Run(LONG_S, LONG_RATE, seed=4, walk=2.0, convergence=True).report_at(LONG_S)


@once_per_test_run
def correlated() -> Report:
    """Return the report of gyroscopes with Gauss–Markov noise: x shows it, y does not separate it from B and K.

    The noise of z is flicker.
    """
    rate_hz, count = 10.0, 108_000
    rng = np.random.default_rng(3)
    values = rng.standard_normal((count, 6)) * np.sqrt(rate_hz) * np.repeat((3e-4, 2e-3), 3)
    values[:, 0] += markov_noise(np.random.default_rng([2, 7]), count, 4e-4, rate_hz * 30.0)
    values[:, 1] += _not_separable(values[:, 1], rate_hz)
    values[:, 2] += synthesise(count, rate_hz, N=1e-9, B=1.5e-4, seed=9)[:, 0]
    values[:, 5] -= 9.80665
    monitor, stream = Monitor(), Stream("uncompensated", (*GYRO, *ACCEL), "binary 01:0739", "startup")
    for begin in range(0, count, CHUNK):
        rows = np.arange(begin, min(begin + CHUNK, count))
        stamps = 10**9 + np.rint(rows * 1e9 / rate_hz).astype(np.int64)
        monitor.feed(SampleBlock(stream, values[rows], stamps, np.zeros(len(rows), dtype=np.int64)))
    session = SessionCounters(started=stamp(BEGIN))
    return monitor.report(BEGIN + timedelta(seconds=count / rate_hz), DEVICE, "running", session)


def _not_separable(white: Floats, rate_hz: float) -> Floats:
    """Return the first of some Gauss–Markov noises which, beside white noise, a fit does not separate from flicker."""
    for seed in range(12):
        rng = np.random.default_rng([seed, 7])
        noise = markov_noise(rng, len(white), 0.6e-4, rate_hz * 100.0)
        cascade = OctaveCascade(1, tau0=1.0 / rate_hz)
        cascade.update((white + noise)[:, None])
        if fit_curve(cascade.result(), averaged=False)[0].B.status == "indistinct":
            return noise
    raise AssertionError("every noise is separable")


def markov_noise(rng: np.random.Generator, count: int, sigma: float, time: float) -> Floats:
    """Return (count,) Gauss–Markov noise; its time constant is in samples."""
    import scipy.signal

    ratio = np.exp(-1.0 / time)
    drive = sigma * np.sqrt(1.0 - ratio**2) * rng.standard_normal(count)
    drive[0] = sigma * rng.standard_normal()  # it begins stationary
    noise: Floats = scipy.signal.lfilter([1.0], [1.0, -ratio], drive)
    return noise


@once_per_test_run
def moving() -> Report:
    """Return the report of a sensor that has begun to move."""
    return Run(150.0, moving_s=20.0).report_at(150.0)


@once_per_test_run
def warming_up() -> Report:
    """Return the report of a sensor that warms up."""
    return Run(200.0, warm_up=True).report_at(200.0)


def report(
    elapsed_s: float = LENGTH_S,
    *,
    id: str = ID,
    state: str = "running",
    caveats: tuple[str, ...] = (),
    scale: float = 1.0,
    speed: float = 1.0,
) -> Report:
    """Return the report of a run at one of `AGES`, or of the long run; the same object for the same words.

    Parameters
    ----------
    caveats : of the device, for the whole record.
    """
    # `cache` would distinguish a word that is given from the same one by default
    return _report(elapsed_s, id, state, caveats, scale, speed)


@cache
def _report(
    elapsed_s: float, id: str, state: str, caveats: tuple[str, ...], scale: float, speed: float
) -> Report:
    report = long_report() if elapsed_s == LONG_S else _run(scale)[0][elapsed_s]
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


@cache
def nothing_yet() -> Report:
    """Return what a daemon publishes before it detects its sensor."""
    device = DeviceDescription(id="vn100", port="/dev/ttyUSB0")
    return Monitor().report(BEGIN, device, "starting", SessionCounters())


def signal(name: str = "gyro/x") -> Signal:
    """Return the signal of a channel at the end of the run."""
    return _run(1.0)[1][name]


def events(id: str = ID) -> list[Event]:
    """Return the events of a day; one text contains markup, which must be shown as it is."""
    texts = (
        ("08:00:00", "connect", "VN-100T-CR 0100056785 on /dev/ttyUSB0 at 115200 baud", None),
        ("08:05:10", "warmup", "310 s of warm-up excluded", None),
        ("08:16:40", "gap", "1.2 s lost, 24 samples", None),
        ("09:06:40", "disturbance", "knock of 0.8 rad/s, 2.5 s excluded [bold]not markup[/bold]", "gyro/y"),
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

    def __init__(
        self, *reports: Report, age: float = 0.0, alive: bool = True, connected: bool = True
    ) -> None:
        self.version = 1
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
