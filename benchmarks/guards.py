"""Benchmark of the guards: what they save, what they cost, and what they find in real recordings.

    python benchmarks/guards.py                     disturbances in records of known noise; false cuts; cost
    python benchmarks/guards.py --lines             lines found in clean noise
    python benchmarks/guards.py --recordings DIR    the tables of docs/ACCURACY.md, from such a folder

Records of known noise are spoilt by one sample of +1 rad/s, by a knock of 0.1 rad/s for 2 s, and by 60 s of
repeated samples; N, B and K are then compared with those of the same record unspoilt. The goal: N within
0.1 %, B within its interval, no K that was not there.
"""

from __future__ import annotations

import argparse
import csv
import gzip
import time
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from document_tables import head, row

from imumon.coefficients import COEFFICIENTS
from imumon.noise.allan import OctaveCascade
from imumon.noise.detection import Guard
from imumon.noise.fit import ChannelFit, Estimator
from imumon.noise.statistics.envelope import Envelope
from imumon.noise.statistics.histogram import HistogramAccumulator
from imumon.noise.synthesis import synthesise
from imumon.pipeline import Monitor, MonitorOptions
from imumon.replay import ReplayOptions, replay
from imumon.report import Channel, DeviceDescription, Report, SessionCounters
from imumon.samples import ACCEL, GYRO, MAG, Floats, SampleBlock, Stream
from imumon.units import figures, pretty

NOISE = {"N": 6.1e-5, "B": 4.8e-6, "K": 1e-7}
SENSORS = ("gyro",) * 3 + ("accel",) * 3 + ("mag",) * 3
GROUPS = (0, 0, 0, 1, 1, 1, 2, 2, 2)
SCALE = np.array([4e-4] * 3 + [1e-2] * 3 + [1e-3] * 3)
"""rad/s, m/s^2 and gauss, deviation of the samples of a quiet sensor."""
RATES_HZ = {
    "kiran_stat5min": 40.0,
    "sahq_parked": 40.0,
    "fc_car_idle": 40.0,
    "fc_drive_circle": 40.0,
    "fc_cal_square": 40.0,
    "sahq_drive_circles": 40.0,
    "chase_0513": 200.0,
    "jpsnir_emulator": 40.0,
}


def fitted(values: Floats, rate: float, guarded: bool) -> tuple[ChannelFit, ...]:
    """N, B, K of three gyro channels."""
    cascade = OctaveCascade(3, 1.0 / rate)
    guard = Guard(SENSORS[:3], rate)
    for i in range(0, len(values), 8000):
        block = values[i : i + 8000]
        if not guarded:
            cascade.update(block)
            continue
        for piece in guard.update(block):
            cascade.update(piece.values, piece.valid)
    for piece in guard.flush() if guarded else ():
        cascade.update(piece.values, piece.valid)
    return Estimator(averaged=True, time_to=False).fit(cascade.result())


def spoilt(clean: Floats, rate: float) -> Iterator[tuple[str, Floats]]:
    """The record with each disturbance, on all three axes."""
    n = len(clean)
    for what in ("one sample of +1 rad/s", "knock of 0.1 rad/s, 2 s", "stuck, 60 s"):
        values = clean.copy()
        if what.startswith("one"):
            values[n // 5] += 1.0
        elif what.startswith("knock"):
            values[n // 2 : n // 2 + round(2 * rate)] += 0.1
        else:
            values[n * 3 // 4 : n * 3 // 4 + round(60 * rate)] = values[n * 3 // 4]
        yield what, values


class Tally:
    """Channels of many records, each spoilt and unspoilt."""

    def __init__(self) -> None:
        self.channels = self.within = self.agree = self.lost = self.invented = 0
        self.off: list[float] = []
        self.widths: list[float] = []

    def add(self, clean: ChannelFit, found: ChannelFit) -> None:
        """Compare one channel with itself unspoilt."""
        self.channels += 1
        self.off.append(abs((found.N.value or 0.0) / (clean.N.value or 1.0) - 1.0))
        # B may be a bound in one or both: its interval then begins at zero
        low, high = found.B.low or 0.0, found.B.high or np.inf
        shown = clean.B.value if clean.B.value is not None else 0.0
        self.within += low <= shown <= high
        self.agree += found.B.status == clean.B.status
        self.widths.append(high / (clean.B.high or np.inf) - 1.0)
        self.invented += found.K.status == "measured" and clean.K.status != "measured"
        self.lost += found.K.status != "measured" and clean.K.status == "measured"

    def cells(self) -> list[str]:
        off, wide = np.array(self.off) * 100.0, np.array(self.widths) * 100.0
        return [
            f"{np.median(off):.4f}",
            f"{off.max():.4f}",
            f"{self.within} of {self.channels}",
            f"{self.agree}",
            f"{np.median(wide):+.1f} %",
            f"{self.invented} / {self.lost}",
        ]


def save_the_numbers(seeds: int) -> None:
    """N, B and K of spoilt records against the same ones unspoilt; three axes a record."""
    rate, hours = 40.0, 5.0
    tallies: dict[tuple[str, str], Tally] = {}
    for seed in range(seeds):
        clean = synthesise(round(hours * 3600 * rate), rate, N=[NOISE["N"]] * 3, B=NOISE["B"], seed=seed)
        truth = fitted(clean, rate, guarded=False)
        for what, values in (("nothing", clean), *spoilt(clean, rate)):
            for word, guarded in (("on", True), ("off", False)):
                tally = tallies.setdefault((what, word), Tally())
                for each, own in zip(fitted(values, rate, guarded), truth, strict=True):
                    tally.add(own, each)
    print(f"{hours:g} h at {rate:g} Hz, N = {NOISE['N']:g}, B = {NOISE['B']:g}, no K; {seeds} records\n")
    columns = ("N off, median, %", "largest, %", "clean B in limits", "B of the same status")
    columns = ("disturbance", "guards", *columns, "B's upper limit moves by", "K invented / lost")
    print(head("guards-disturbances", *columns))
    for (what, word), tally in tallies.items():
        print(row([what, word, *tally.cells()]))


def false_cuts() -> None:
    """Clean samples that are cut: of a quiet sensor whose mean wanders, and of cheap ones with white noise."""
    rng = np.random.default_rng(4)
    for rate in (40.0, 200.0):
        guard, level = Guard(SENSORS, rate), np.zeros(9)
        for _ in range(400):
            walk = level + np.cumsum(rng.standard_normal((10_000, 9)), axis=0) * 1e-3
            level = walk[-1]
            guard.update((rng.standard_normal((10_000, 9)) + walk) * SCALE)
        print(f"false cuts at {rate:g} Hz: {guard.excluded_samples:,} of 4,000,000 clean samples")
    for rate in (50.0, 100.0, 400.0):
        for degrees in (1.0, 2.0, 5.0):
            guard, scale = Guard(SENSORS[:6], rate), np.array([np.radians(degrees)] * 3 + [0.3] * 3)
            for _ in range(100):
                guard.update(rng.standard_normal((10_000, 6)) * scale)
            guard.flush()
            motions = sum(event.kind == "motion" for event in guard.events())
            cut = f"{guard.excluded_samples:,} of 1,000,000, motion {motions} times"
            print(f"false cuts at {rate:g} Hz, {degrees:g} deg/s and 0.3 m/s^2: {cut}")


def false_lines(reports: int) -> None:
    """Share of reports on clean noise that show a line: short records, each asked at several lengths."""
    rate, told, asked = 40.0, 0, 0
    lengths = [round(rate * s) for s in (15, 30, 60, 120, 300, 600)]
    seed = 0
    while asked < reports:
        noise = synthesise(lengths[-1], rate, N=[6e-5] * 3, B=2.4e-5, K=1e-6, seed=seed)
        plain = np.random.default_rng(seed).standard_normal((lengths[-1], 6))
        values = np.concatenate((noise, plain), axis=1)
        cascade, done = OctaveCascade(9, 1.0 / rate, groups=GROUPS), 0
        for length in lengths:
            cascade.update(values[done:length])
            done, asked = length, asked + 1
            told += any(cascade.spectrum.result().lines)
        seed += 1
    bound = -np.log(0.05) / asked if not told else np.nan
    print(
        f"false lines: {told} of {asked:,} reports of nine channels"
        + f", below {bound:.1e} at 95 %" * (not told)
    )


def cost() -> None:
    """Processor time a channel-sample at rest, for blocks of a file and live ones."""
    values = np.random.default_rng(1).standard_normal((200_000, 9)) * SCALE
    made = {
        "guard": lambda: Guard(SENSORS, 200.0),
        "histogram": lambda: HistogramAccumulator(GROUPS),
        "strip": lambda: Envelope(GROUPS, 200.0),
        "octaves, spectrum and blocks, to compare": lambda: OctaveCascade(9, 1 / 200.0, groups=GROUPS),
    }
    for block, rows in ((8000, 200_000), (1000, 200_000), (40, 40_000)):
        print(f"blocks of {block} x 9 at 200 Hz:")
        for name, make in made.items():
            best = np.inf
            for _ in range(3):
                part = make()
                start = time.process_time()
                for i in range(0, rows, block):
                    part.update(values[i : i + block])
                best = min(best, time.process_time() - start)
            each = f"{best / rows / 9 * 1e9:7.1f} ns"
            print(f"  {name:42} {each}    {best / (rows / block) * 1e6:7.0f} us a block")


def blocks_of(path: Path) -> list[SampleBlock]:
    """A recording that exists as arrays only."""
    data = np.load(path)
    uncompensated = "gyro_uncomp" in data
    gyro, accel = (
        (data["gyro_uncomp"], data["accel_uncomp"]) if uncompensated else (data["gyro"], data["accel"])
    )
    columns = [gyro, accel] + ([data["mag"]] if "mag" in data else [])
    names = GYRO + ACCEL + (MAG if "mag" in data else ())
    kind = "uncompensated" if uncompensated else "compensated"
    stream = Stream(kind, names, path.stem, "startup")
    return [block(stream, np.concatenate(columns, axis=1), data["t"])]


def deltas_of(path: Path) -> list[SampleBlock]:
    """The delta columns of a csv, as rates."""
    with gzip.open(path, "rt") as file:
        rows = list(csv.DictReader(file))
    names = list(rows[0])

    def column(part: str) -> Floats:
        name = next(n for n in names if part in n)
        return np.array([float(row[name]) for row in rows if row[name]])

    dt = column("DeltaTime")
    theta = np.column_stack([column(f"DeltaTheta::{axis}") for axis in "XYZ"]) * np.pi / 180.0
    velocity = np.column_stack([column(f"DeltaVel::{axis}") for axis in "XYZ"])
    stream = Stream("deltas", GYRO + ACCEL, path.stem, "startup")
    values = np.concatenate((theta, velocity), axis=1) / dt[:, None]
    return [block(stream, values, np.cumsum(dt))]


def block(stream: Stream, values: Floats, t: Floats) -> SampleBlock:
    time_ns = np.rint((t - t[0]) * 1e9).astype(np.int64)
    return SampleBlock(stream, values, time_ns, np.zeros(len(values), dtype=np.int64))


def report_of(blocks: Iterable[SampleBlock], name: str, guarded: bool) -> Report:
    monitor = Monitor(MonitorOptions(guarded=guarded))
    for each in blocks:
        monitor.feed(each)
    monitor.flush()
    return monitor.report(datetime.now(UTC), DeviceDescription(id=name), "stopped", SessionCounters())


def shown(channel: Channel, name: str) -> str:
    """N, B or K of a channel in readable units."""
    known = channel.coefficients.get(name)
    if known is None or known.status == "pending":
        return "–"
    readable = known.readable
    if known.status == "upper_bound":
        return f"< {figures(readable.high, 2)}" if readable.high else "–"
    return figures(readable.value, 3) if readable.value else "–"


def fit_cells(report: Report, sensor: str) -> list[str]:
    """N, B, K of the three axes and the grade of a sensor."""
    channels = [report.channels[f"{sensor}/{axis}"] for axis in "xyz"]
    cells = [" / ".join(shown(c, name) for c in channels) for name in "NBK"]
    grade = report.grade.get(sensor)
    return [*cells, (grade.nearest if grade else None) or "none"]


def slope_cells(report: Report, sensor: str) -> list[str]:
    """The classical readings of N, B and K."""
    out = []
    for name in "NBK":
        values = []
        for axis in "xyz":
            readings = report.channels[f"{sensor}/{axis}"].readings
            value = (readings or {}).get(name)
            values.append(
                "–" if value is None else figures(value * COEFFICIENTS[name].units[sensor].factor, 3)
            )
        out.append(" / ".join(values))
    return out


def found_cells(report: Report) -> list[str]:
    """What the guards exclude or detect, and the strongest line of each axis by sensor."""
    session = report.session
    parts = [f"{reason} {seconds:.3g} s" for reason, seconds in session.excluded_by.items()]
    if session.missing:
        parts.append(f"{session.gaps} gaps, {session.missing} samples missing")
    if "not_at_rest" in report.caveats:
        parts.append("not at rest at the end")
    lines = [
        {
            f"{entry.frequency_hz:.3g}"
            for axis in "xyz"
            if (channel := report.channels.get(f"{sensor}/{axis}")) and channel.spectrum
            for entry in channel.spectrum.lines[:1]
        }
        for sensor in ("gyro", "accel", "mag")
    ]
    return ["; ".join(parts) or "nothing", *(", ".join(sorted(found, key=float)) or "–" for found in lines)]


def recordings(folder: Path) -> None:
    """The tables: what is excluded or detected, the fits, and the classical readings."""
    columns = ("excluded or detected", "lines, Hz: gyro", "accel", "mag")
    print(head("guards-found", "recording", "samples", "s", *columns))
    for name, pair in _reports(folder).items():
        session = pair[True].session
        print(row([name, session.samples, f"{session.elapsed_s:.3g}", *found_cells(pair[True])]))
    for sensor in ("gyro", "accel"):
        n, b, k = (f"{name}, {pretty(COEFFICIENTS[name].units[sensor].unit)}" for name in "NBK")
        reports = [
            (name, "on" if guarded else "off", each)
            for name, pair in _reports(folder).items()
            for guarded, each in pair.items()
            if f"{sensor}/x" in each.channels
        ]
        print("\n" + head(f"guards-{sensor}", "recording", "guards", n, b, k, "grade"))
        for name, on, each in reports:
            print(row([name, on, *fit_cells(each, sensor)]))
        print("\n" + head(f"guards-{sensor}-slopes", "recording", "guards", n, b, k))
        for name, on, each in reports:
            print(row([name, on, *slope_cells(each, sensor)]))


_CACHE: dict[str, dict[bool, Report]] = {}


def _reports(folder: Path) -> dict[str, dict[bool, Report]]:
    """Reports of each recording, with and without guards."""
    if not _CACHE:
        for name, rate in RATES_HZ.items():
            path = folder / f"{name}.vnymr.txt.gz"
            if path.exists():
                _CACHE[name] = {
                    g: replay(ReplayOptions(path=str(path), rate_hz=rate, guarded=g)) for g in (True, False)
                }
        for name in ("pelka_zup", "rob_static2", "instinct_vn310_static", "instinct_vn310_lckf"):
            path = folder / f"{name}.npz"
            if path.exists():
                _CACHE[name] = {g: report_of(blocks_of(path), name, g) for g in (True, False)}
            original = folder / f"{name}.orig.csv.gz"
            if original.exists():
                _CACHE[f"{name}, deltas"] = {
                    g: report_of(deltas_of(original), name, g) for g in (True, False)
                }
    return _CACHE


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--recordings", type=Path, help="folder of recordings")
    parser.add_argument("--lines", action="store_true", help="only the lines found in clean noise")
    parser.add_argument("--seeds", type=int, default=4, help="records of known noise")
    arguments = parser.parse_args()
    if arguments.recordings:
        recordings(arguments.recordings)
    elif arguments.lines:
        false_lines(6000)
    else:
        save_the_numbers(arguments.seeds)
        false_cuts()
        cost()
