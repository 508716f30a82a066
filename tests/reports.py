"""Reports made by hand: what a daemon would say of a known sensor after some time, for the screen's tests.

The curves are N, B, K models with a scatter drawn from a fixed seed, so that every picture is the
same on every machine.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache

import numpy as np

from imumon.devices.vn100.registers import CHANGE_THE_DATA, REGISTERS
from imumon.report import (
    Allan,
    Channel,
    ChannelGrade,
    Coefficient,
    DecidedBy,
    DeviceDescription,
    Distribution,
    Drift,
    Event,
    FitQuality,
    GradeName,
    Grading,
    Histogram,
    Line,
    Readable,
    Readings,
    Report,
    SensorGrade,
    SessionCounters,
    Signal,
    Spectrum,
    Strip,
    TimeTo,
)
from imumon.units import READABLE, SI

ID = "vn100-0100056785"
RATE = 40.0

TRUTH: Mapping[str, tuple[float, float, float, float, float]] = {
    "gyro/x": (8.858e-5, 2.187e-6, 3.0e-7, 1.3e-3, 5.6e-4),
    "gyro/y": (1.119e-4, 3.559e-5, 8.0e-7, -2.2e-3, 7.1e-4),
    "gyro/z": (9.043e-5, 4.683e-6, 2.0e-7, 4.1e-4, 5.7e-4),
    "accel/x": (1.877e-3, 4.102e-4, 6.0e-6, 0.0312, 1.19e-2),
    "accel/y": (1.896e-3, 1.026e-3, 9.0e-6, -0.1104, 1.20e-2),
    "accel/z": (2.811e-3, 5.055e-4, 5.0e-6, -9.80612, 1.78e-2),
    "mag/x": (1.2e-4, 9.0e-6, 1.0e-7, 0.2104, 7.6e-4),
    "mag/y": (1.1e-4, 8.0e-6, 1.0e-7, -0.0312, 7.0e-4),
    "mag/z": (1.6e-4, 1.1e-5, 1.0e-7, 0.4417, 1.0e-3),
}
"""N, B, K, mean and standard deviation of each channel, SI."""

LIMITS = {
    "gyro": {
        "N": {"consumer": 5.818e-4, "industrial": 5.818e-5, "tactical": 1.454e-5, "navigation": 2.909e-6},
        "B": {"consumer": 4.848e-4, "industrial": 4.848e-5, "tactical": 4.848e-6, "navigation": 4.848e-8},
    },
    "accel": {
        "N": {"consumer": 1.667e-2, "industrial": 1.667e-3, "tactical": 5.0e-4, "navigation": 1.667e-4},
        "B": {"consumer": 9.807e-2, "industrial": 9.807e-3, "tactical": 9.807e-4, "navigation": 9.807e-5},
    },
}
SETTINGS = {
    f"{number} {REGISTERS[number].name}": REGISTERS[number].factory[2] for number in sorted(CHANGE_THE_DATA)
} | {"75 binary output 1": "1,20,01,0739", "of tomorrow": "a value without words"}

GRADES: Mapping[str, tuple[GradeName, GradeName]] = {
    "gyro/x": ("industrial", "tactical"),
    "gyro/y": ("industrial", "industrial"),
    "gyro/z": ("industrial", "tactical"),
    "accel/x": ("industrial", "tactical"),
    "accel/y": ("industrial", "tactical"),
    "accel/z": ("industrial", "tactical"),
}
PRECISION = {"N": 0.01, "B": 0.2, "K": 0.5}


def coefficient(sensor: str, name: str, truth: float, spread: float) -> Coefficient:
    """N, B or K known to a relative half-width of `spread`: measured, bounded or pending."""
    unit, shown = SI[(sensor, name)], READABLE[(sensor, name)]

    def of(
        value: float | None, low: float | None, high: float | None, status: str, reason: str | None
    ) -> Coefficient:
        scaled = [None if v is None else v * shown.factor for v in (value, low, high)]
        readable = Readable(value=scaled[0], low=scaled[1], high=scaled[2], unit=shown.unit)
        return Coefficient(
            value=value,
            low=low,
            high=high,
            status=status,
            unit=unit,
            readable=readable,
            reason=reason,  # type: ignore[arg-type]
        )

    if spread < 0.9:
        return of(truth, truth * (1 - 0.95 * spread), truth * (1 + 1.05 * spread), "measured", None)
    if spread < 6.0:
        return of(None, None, truth * (1 + spread), "upper_bound", "the record does not show it")
    return of(None, None, None, "pending", "too short to say anything")


def curve(n: float, b: float, k: float, elapsed_s: float, rng: np.random.Generator, *, cut: int = 0) -> Allan:
    """Allan deviation of a record of so many seconds, with the scatter that it has."""
    octaves = max(int(math.log2(elapsed_s * RATE / 2)), 0) + 1 if elapsed_s * RATE >= 2 else 0
    tau = 2.0 ** np.arange(octaves) / RATE
    model = np.sqrt(n * n / tau + 2 * math.log(2) / math.pi * b * b + k * k * tau / 3)
    edf = np.maximum(1.5 * elapsed_s / tau - 1.0, 0.8)
    half = 1.0 / np.sqrt(2.0 * edf)
    sigma = model * np.exp(half * rng.standard_normal(octaves) * 0.8)
    for j in range(min(cut, octaves)):
        sigma[j] *= 1.0 + 0.6 * 0.5**j
    low, high = sigma / (1 + 2.2 * half), sigma * (1 + 2.6 * half + 3.0 * half**3)
    used = [j >= cut for j in range(octaves)]
    return Allan(
        tau_s=tuple(tau.tolist()),
        sigma=tuple(sigma.tolist()),
        low=tuple(low.tolist()),
        high=tuple(high.tolist()),
        edf=tuple(edf.tolist()),
        model=tuple(model.tolist()),
        used=tuple(used),
    )


def channel(name: str, elapsed_s: float, *, cut: int = 0, scale: float = 1.0) -> Channel:
    """One channel after so many seconds."""
    sensor, _, _ = name.partition("/")
    n, b, k, mean, std = TRUTH[name]
    n, b, k = n * scale, b * scale, k * scale
    rng = np.random.default_rng(sum(map(ord, name)))
    spreads = {
        "N": 1.1 / math.sqrt(max(elapsed_s, 1e-9)),
        "B": 0.2 * math.sqrt(400.0 / max(elapsed_s, 1e-9)) * (n / b / 4.0),
        "K": 0.5 * math.sqrt(5000.0 / max(elapsed_s, 1e-9)) * (4e-7 * n / 1e-4 / k),
    }
    parts = {
        part: coefficient(sensor, part, value, spreads[part])
        for part, value in (("N", n), ("B", b), ("K", k))
    }
    still = {
        part: None
        if spread <= PRECISION[part]
        else max(elapsed_s, 1.0) * ((spread / PRECISION[part]) ** 2 - 1)
        for part, spread in spreads.items()
    }
    grade = None
    if name in GRADES:
        gn, gb = GRADES[name]
        known = elapsed_s > 20
        grade = (
            ChannelGrade(
                N=Grading(nearest=gn, meets="consumer"),
                B=Grading(nearest=gb, meets=gb),
                nearest=gn,
                meets="consumer",
            )
            if known
            else ChannelGrade()
        )
    half = 1.96 * n / math.sqrt(max(elapsed_s, 1.0))
    unit = {"gyro": "rad/s", "accel": "m/s^2", "mag": "gauss"}[sensor]
    allan = curve(n, b, k, elapsed_s, rng, cut=cut)
    return Channel(
        unit=unit,
        count=int(elapsed_s * RATE),
        mean=mean,
        std=std,
        min=mean - 4.1 * std,
        max=mean + 4.3 * std,
        skewness=0.012,
        excess_kurtosis=-0.031,
        last=mean + 0.7 * std,
        **parts,
        grade=grade,
        readings=Readings(N=n * 1.01, B=None, K=None),
        time_to=TimeTo(**still),
        fit=FitQuality(chi2=11.3, dof=12, p_value=0.5) if len(allan.tau_s) > 5 else None,
        caveats=("vibration",) if cut else (),
        allan=allan,
        distribution=Distribution(
            verdict="Gaussian",
            gaussian=True,
            recent_mean=mean,
            recent_std=std,
            bias=mean,
            bias_low=mean - half,
            bias_high=mean + half,
        ),
        drift=Drift(
            per_hour=1.4 * half,
            per_hour_low=-0.3 * half,
            per_hour_high=3.1 * half,
            significant=False,
            per_degC=0.8 * half,
            explained=0.12,
        ),
        histogram=shapes(name)[0],
        spectrum=shapes(name)[1],
    )


def report(
    elapsed_s: float = 10801.0,
    *,
    id: str = ID,
    state: str = "running",
    caveats: tuple[str, ...] = (),
    scale: float = 1.0,
    cut: int = 2,
    gaps: int = 3,
    speed: float = 1.0,
) -> Report:
    """Report of the sensor after so many seconds."""
    channels = {
        name: channel(name, elapsed_s, cut=cut if name == "accel/y" else 0, scale=scale) for name in TRUTH
    }
    channels["temperature"] = Channel(
        unit="degC", count=int(elapsed_s * RATE), mean=31.18, std=0.42, min=24.9, max=31.61, last=31.42
    )
    channels["pressure"] = Channel(
        unit="kPa", count=int(elapsed_s * RATE), mean=101.32, std=0.011, min=101.28, max=101.36, last=101.33
    )
    settled = elapsed_s > 600
    graded = elapsed_s > 20
    none = SensorGrade(reason="no coefficient is known well enough")
    grade = {
        "gyro": SensorGrade(
            nearest="industrial",
            meets="consumer",
            decided_by=DecidedBy(axis="gyro/y", coefficient="N"),
            provisional=not settled,
        ),
        "accel": SensorGrade(
            nearest="industrial",
            meets="consumer",
            decided_by=DecidedBy(axis="accel/z", coefficient="N"),
            provisional=not settled,
        ),
    }
    if "not_at_rest" in caveats:
        graded, none = False, SensorGrade(reason="the sensor moves")
    hours, rest = divmod(int(elapsed_s), 3600)
    return Report(
        time=f"2026-03-01T{8 + hours % 12:02d}:{rest // 60:02d}:{rest % 60:02d}.000Z",
        device=DeviceDescription(
            id=id,
            model="VN-100T-CR",
            serial=id.rpartition("-")[2],
            firmware="2.1.0.0",
            port="/dev/ttyUSB0",
            baud=115200,
            stream="uncompensated",
            sample_rate_hz=RATE,
            alias_factor=2.236,
            source="binary 01:0739",
            clock="startup",
            settings=SETTINGS,
        ),
        state=state,  # type: ignore[arg-type]
        session=SessionCounters(
            started="2026-03-01T08:00:00.000Z",
            elapsed_s=elapsed_s,
            samples=int(elapsed_s * RATE) - 61,
            missing=61 if gaps else 0,
            gaps=gaps,
            discarded_bytes=118,
            bad_checksums=2,
            disturbances=1,
            excluded_s=12.5,
            warmup_s=310.0,
            restarts=1,
            received_bytes=int(elapsed_s * RATE * 62),
            excluded_by={"disturbance": 12.5},
        ),
        grade=grade if graded else {"gyro": none, "accel": none},
        channels=channels,
        caveats=caveats,
        limits=LIMITS,
        speed=speed,
    )


@cache
def shapes(name: str) -> tuple[Histogram, Spectrum]:
    """Histogram and a spectrum with one line of a channel."""
    _, _, _, mean, std = TRUTH[name]
    rng = np.random.default_rng(7)
    width = 8 * std / 60
    centres = mean - 4 * std + width * (np.arange(60) + 0.5)
    gaussian = 432000 * width / (std * math.sqrt(2 * math.pi)) * np.exp(-0.5 * ((centres - mean) / std) ** 2)
    counts = np.maximum(gaussian + np.sqrt(gaussian) * rng.standard_normal(60), 0).astype(int)
    frequency = np.geomspace(0.002, 20.0, 160)
    density = 2 * TRUTH[name][0] ** 2 * (1 + 0.03 / frequency) * np.exp(0.1 * rng.standard_normal(160))
    peak = int(np.argmin(np.abs(frequency - 9.8)))
    density[peak] *= 40.0
    line = Line(
        frequency_hz=float(frequency[peak]), amplitude=2e-4, aliases_hz=(9.8, 30.2, 49.8), name="50 Hz mains?"
    )
    histogram = Histogram(
        start=mean - 4 * std, width=width, counts=tuple(counts.tolist()), gaussian=tuple(gaussian.tolist())
    )
    spectrum = Spectrum(
        frequency_hz=tuple(frequency.tolist()),
        density=tuple(density.tolist()),
        averages=(64,) * 160,
        lines=(line,),
        white=TRUTH[name][0],
    )
    return histogram, spectrum


@cache
def signal(name: str = "gyro/x") -> Signal:
    """Signal view of a channel."""
    _, _, _, mean, std = TRUTH[name]
    rng = np.random.default_rng(7)

    def strip(span: float, columns: int, samples: int, *, hole: bool = False) -> Strip:
        values = (
            mean
            + std * rng.standard_normal((columns, samples))
            + 0.6 * std * np.sin(np.arange(columns) / 31.0)[:, None]
        )
        low, high = values.min(axis=1).tolist(), values.max(axis=1).tolist()
        if hole:
            low[70:82] = high[70:82] = [None] * 12
        return Strip(start_s=10801.0 - span, column_s=span / columns, low=tuple(low), high=tuple(high))

    return Signal(
        channel=name,
        unit="rad/s",
        minute=strip(60.0, 240, 10),
        hour=strip(3600.0, 240, 600, hole=True),
        everything=strip(10801.0, 240, 1800),
    )


def events(id: str = ID) -> list[Event]:
    """A log as a day makes it; one text holds what a markup would swallow."""
    told = (
        ("08:00:00", "connect", "VN-100T-CR 0100056785 on /dev/ttyUSB0 at 115200 baud", None),
        ("08:05:10", "warm-up", "310 s of warm-up cut out", None),
        ("08:41:22", "gap", "1.2 s lost, 48 samples", None),
        ("09:02:47", "disturbance", "knock of 0.8 rad/s cut out, 12.5 s [bold]not markup[/bold]", "gyro/y"),
        ("09:14:03", "grade", "gyro: industrial, decided by y N [deg/sqrt(h)]", None),
        ("10:20:31", "disconnect", "the port is gone; waiting for it", None),
        ("10:20:44", "connect", "back after 13 s, statistics go on", None),
        ("10:20:44", "gap", "13.1 s lost", None),
    )
    return [
        Event(time=f"2026-03-01T{at}.000Z", kind=kind, text=text, device=id, channel=where)
        for at, kind, text, where in told
    ]


class Recorded:
    """A feed set by hand: what the bus would have put into the slot."""

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
        """A new report comes in."""
        self._reports[report.device.id] = (report, self.now)
        self._alive.add(report.device.id)
        self._connected = True
        self.version += 1

    def break_off(self) -> None:
        """The daemon and its link are gone."""
        self._alive.clear()
        self._connected = False
        self.version += 1

    def reports(self) -> dict[str, tuple[Report, float]]:
        return dict(self._reports)

    def alive(self) -> set[str]:
        return set(self._alive)

    def events(self, id: str) -> list[Event]:
        return self.log if id in self._reports else []

    def watch(self, id: str, channel: str | None) -> None:
        self.watched.append((id, channel))

    def signal(self) -> tuple[Signal, float] | None:
        id, chosen = self.watched[-1] if self.watched else ("", None)
        short = id in self._reports and self._reports[id][0].session.elapsed_s < 10.0
        return (signal(chosen), self.now) if chosen in TRUTH and not short else None

    def connected(self) -> bool:
        return self._connected


def nothing_yet() -> Report:
    """What a daemon says before its sensor is found."""
    return Report(
        time="2026-03-01T08:00:00.000Z",
        device=DeviceDescription(id="vn100", port="/dev/ttyUSB0"),
        state="starting",
        session=SessionCounters(),
    )
