"""The example datasheet: a day of an emulated VN-100 at 100 Hz, through decoder and monitor, as documents.

    python benchmarks/example.py [--hours 24] [--out docs/example] [--again]

The emulated sensor (its memory, filter, warm-up and noise are those of `imumon sim`) is run as fast as it
goes, without the pseudo-terminal between: about three minutes for a day. It streams what the daemon asks for:
time, magnetometer, temperature, pressure, delta angles and velocities. A bit is flipped on the line about
once an hour. The truth that was put in stands beside what was found; the magnetometer's N is told as its
point samples show it, aliased from 250 readings a second.
"""

from __future__ import annotations

import argparse
import sys
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from imumon.datasheet import document
from imumon.datasheet.text_table import coefficient
from imumon.devices.vn100 import Vn100Decoder
from imumon.devices.vn100.emulator.command_handler import CommandHandler as Emulated
from imumon.devices.vn100.emulator.emulator_settings import EmulatorSettings, Noise
from imumon.devices.vn100.emulator.sensor_model import SensorModel
from imumon.devices.vn100.registers import LOOP_RATE
from imumon.pipeline import Monitor
from imumon.report import Channel, Coefficient, DeviceDescription, Report, SessionCounters, from_json
from imumon.samples import SampleBlock
from imumon.units import READABLE, figures, pretty

RATE = 100
OUTPUT = ("1", str(LOOP_RATE // RATE), "05", "0001", "00F2")
PIECE_S = 20
BEGUN = datetime(2026, 1, 1, tzinfo=UTC)
GYRO = Noise((5.4e-5, 6.6e-5, 6.1e-5), (2.0e-5, 3.1e-5, 2.4e-5), (8e-7, 1.5e-6, 1e-6))
ACCEL = Noise((1.25e-3, 1.37e-3, 1.55e-3), (1.8e-4, 2.4e-4, 2e-4), (1e-5, 7e-6, 1.4e-5))
MAG_HZ = 250.0
DOCUMENTS = {
    "report.json": "json",
    "datasheet.md": "md",
    "datasheet.html": "html",
    "allan.png": "png",
    "kalibr_imu.yaml": "kalibr",
}


README = """# Example datasheet

{hours:g} hours of an emulated VN-100 at {rate} Hz, as `imumon report` writes it; made by
`python benchmarks/example.py`.

[The datasheet](datasheet.md), [as a page](datasheet.html), [the report](report.json),
[for Kalibr](kalibr_imu.yaml)

![Allan deviation](allan.png)

What was put into the emulator, and what was found:

```
{told}
```
"""


def measure(hours: float, seed: int) -> tuple[Report, EmulatorSettings]:
    """Report of a run of so many hours."""
    settings = EmulatorSettings(rate=RATE, baud=921600, seed=seed, gyro=GYRO, accel=ACCEL)
    sensor = Emulated(settings, SensorModel(settings))
    sensor.set(6, "0")
    sensor.set(75, *OUTPUT)
    decoder, monitor = Vn100Decoder(), Monitor(rate_hz=RATE)
    rng = np.random.default_rng(seed)
    pieces = round(hours * 3600 / PIECE_S)
    damage = set(rng.choice(pieces, min(pieces, round(hours)), replace=False).tolist())
    for piece in range(pieces):
        data = bytearray(
            b"".join(message for _, message in sensor.advance((piece + 1) * PIECE_S * LOOP_RATE))
        )
        if piece in damage and data:
            data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
        for item in decoder.feed(bytes(data)):
            if isinstance(item, SampleBlock):
                monitor.feed(item)
        if sys.stderr.isatty():
            print(f"\r{(piece + 1) / pieces:4.0%}", end="", file=sys.stderr)
    monitor.flush()
    device = DeviceDescription(
        id=f"vn100-{settings.serial}",
        model=settings.model,
        serial=settings.serial,
        firmware=settings.firmware,
        port="emulated",
        baud=settings.baud,
        settings={
            "75 binary output 1": ",".join(OUTPUT),
            "82 delta theta and delta velocity": ",".join(sensor.registers.read(82)),
            "85 IMU filtering": ",".join(sensor.registers.read(85)),
        },
    )
    session = SessionCounters(
        started="2026-01-01T00:00:00.000Z",
        discarded_bytes=decoder.discarded,
        bad_checksums=decoder.bad_checksums,
        received_bytes=decoder.fed,
    )
    return monitor.report(BEGUN + timedelta(hours=hours), device, "stopped", session), settings


def beside_truth(made: Report, settings: EmulatorSettings) -> str:
    """What was put in, and how many of the 95 % limits hold it."""
    lines = [f"{'':9}{'put in':>10}   found with 95 % limits"]
    held = asked = 0
    for sensor in ("gyro", "accel", "mag"):
        noise: Noise = getattr(settings, sensor)
        folded = (MAG_HZ / RATE) ** 0.5 if sensor == "mag" else 1.0
        for letter, truth in (("N", [n * folded for n in noise.n]), ("B", noise.b), ("K", noise.k)):
            factor, unit = READABLE[sensor, letter].factor, pretty(READABLE[sensor, letter].unit)
            for axis, true in zip("xyz", truth, strict=True):
                channel: Channel = made.channels[f"{sensor}/{axis}"]
                found: Coefficient = getattr(channel, letter)
                low, high = found.low or 0.0, found.high or float("inf")
                asked, held = asked + 1, held + (low <= true <= high)
                name = f"{sensor}/{axis} {letter}"
                lines.append(f"{name:9}{figures(true * factor, 4):>10}   {coefficient(found)} {unit}")
    return "\n".join([*lines, f"{held} of {asked} intervals hold the truth"])


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "example")
    parser.add_argument("--again", action="store_true", help="only the documents, of the report that is kept")
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    kept = asked.out / "report.json"
    if asked.again:
        made = from_json(Report, kept.read_text())
    else:
        begun = time.perf_counter()
        made, settings = measure(asked.hours, asked.seed)
        spent = time.perf_counter() - begun
        times = asked.hours * 3600 / spent
        print(f"{made.session.samples:,} samples in {spent:.0f} s: {times:.0f} times real time")
        told = beside_truth(made, settings)
        print(told)
        (asked.out / "README.md").write_text(README.format(hours=asked.hours, rate=RATE, told=told))
    for name, form in DOCUMENTS.items():
        (asked.out / name).write_bytes(document(made, form))


if __name__ == "__main__":
    main()
