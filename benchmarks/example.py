"""The example datasheet: a day of an emulated VN-100 at 100 Hz, through decoder and monitor, as documents.

    python benchmarks/example.py [--hours 24] [--out docs/example] [--again]

The emulated sensor (registers, filter, warm-up and noise of `imumon sim`) runs as fast as possible, without
the pseudo-terminal: about three minutes for a day. It sends what the daemon requests: time, magnetometer,
temperature, pressure, delta angles and velocities. About once an hour a bit of the stream is flipped. The
README compares the configured noise with the result; N of the magnetometer is given as its point samples
show it, aliased from 250 readings per second.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from imumon.api.document_report import document_report
from imumon.documents import document
from imumon.documents.report_texts import coefficient_text
from imumon.model.coefficients import COEFFICIENTS
from imumon.model.filter_report import DEFAULT_HORIZON_S
from imumon.model.report import Channel, DeviceDescription, Report, SessionCounters, from_json
from imumon.model.report_json import MAX_ITEMS
from imumon.model.samples import SampleBlock
from imumon.model.units import figures, pretty
from imumon.record import Record
from imumon.record.filter_report_builder import filter_report
from imumon.sources import registry
from imumon.sources.vn100.decoder import Vn100Decoder
from imumon.sources.vn100.emulator.command_handler import CommandHandler as Emulated
from imumon.sources.vn100.emulator.emulator_settings import EmulatorSettings, Noise
from imumon.sources.vn100.emulator.sensor_model import SensorModel
from imumon.sources.vn100.registers import LOOP_RATE

RATE = 100
OUTPUT = ("1", str(LOOP_RATE // RATE), "05", "0001", "00F2")
CHUNK_S = 20
BEGIN = datetime(2026, 1, 1, tzinfo=UTC)
GYRO = Noise((5.4e-5, 6.6e-5, 6.1e-5), (2.0e-5, 3.1e-5, 2.4e-5), (8e-7, 1.5e-6, 1e-6))
ACCEL = Noise((1.25e-3, 1.37e-3, 1.55e-3), (1.8e-4, 2.4e-4, 2e-4), (1e-5, 7e-6, 1.4e-5))
MAG_HZ = 250.0
DOCUMENTS = {
    "report.json": "json",
    "datasheet.md": "md",
    "datasheet.html": "html",
    "datasheet.csv": "csv",
    "allan.png": "png",
    "allan.svg": "svg",
    "kalibr_imu.yaml": "kalibr",
}


README = """# Example datasheet

{hours:g} hours of an emulated VN-100 at {rate} Hz, as `imumon report` writes it; made by
`python benchmarks/example.py`.

[The datasheet](datasheet.md), [as a page](datasheet.html), [as a table](datasheet.csv), [the report](report.json),
[the figure as SVG](allan.svg), [for Kalibr](kalibr_imu.yaml)

![Allan deviation](allan.png)

Configured noise of the emulator, and the result:

```
{comparison}
```
"""


def measure(hours: float, seed: int) -> tuple[Report, EmulatorSettings]:
    """Return the report of a run."""
    settings = EmulatorSettings(rate=RATE, baud=921600, seed=seed, gyro=GYRO, accel=ACCEL)
    sensor = Emulated(settings, SensorModel(settings))
    sensor.set_register(6, "0")
    sensor.set_register(75, *OUTPUT)
    decoder, monitor = Vn100Decoder(), Record(rate_hz=RATE)
    rng = np.random.default_rng(seed)
    chunks = round(hours * 3600 / CHUNK_S)
    damage = set(rng.choice(chunks, min(chunks, round(hours)), replace=False).tolist())
    for chunk in range(chunks):
        data = bytearray(
            b"".join(message for _, message in sensor.advance((chunk + 1) * CHUNK_S * LOOP_RATE))
        )
        if chunk in damage and data:
            data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
        for item in decoder.feed(bytes(data)):
            if isinstance(item, SampleBlock):
                monitor.feed(item)
        if sys.stderr.isatty():
            print(f"\r{(chunk + 1) / chunks:4.0%}", end="", file=sys.stderr)
    monitor.flush()
    registers = {
        "75 binary output 1": ",".join(OUTPUT),
        "82 delta theta and delta velocity": ",".join(sensor.registers[82]),
        "85 IMU filtering": ",".join(sensor.registers[85]),
    }
    device = DeviceDescription(
        id=f"vn100-{settings.serial}",
        driver="vn100",
        model=settings.model,
        serial=settings.serial,
        firmware=settings.firmware,
        port="emulated",
        baud=settings.baud,
        settings=registers,
        setting_texts=registry.setting_texts(registry.driver("vn100"), registers),
    )
    session = SessionCounters(
        started="2026-01-01T00:00:00.000Z",
        discarded_bytes=decoder.discarded,
        bad_checksums=decoder.bad_checksums,
        received_bytes=decoder.fed,
    )
    end = BEGIN + timedelta(hours=hours)
    made = monitor.report(end, device, "stopped", session)
    events = tuple(event.stamped(end, device.id) for event in monitor.events())[:MAX_ITEMS]
    return replace(made, events=events), settings


def compared_with_truth(report: Report, settings: EmulatorSettings) -> str:
    """Return configured and measured values, and how many of the 95 % limits contain the truth."""
    lines = [f"{'':9}{'truth':>10}   result with 95 % limits"]
    contained = total = 0
    for sensor in ("gyro", "accel", "mag"):
        noise: Noise = getattr(settings, sensor)
        folded = (MAG_HZ / RATE) ** 0.5 if sensor == "mag" else 1.0
        for letter, truth in (("N", [n * folded for n in noise.n]), ("B", noise.b), ("K", noise.k)):
            factor, unit = (
                COEFFICIENTS[letter].units[sensor].factor,
                pretty(COEFFICIENTS[letter].units[sensor].unit),
            )
            for axis, true in zip("xyz", truth, strict=True):
                channel: Channel = report.channels[f"{sensor}/{axis}"]
                found = channel.coefficients[letter]
                low, high = found.low or 0.0, found.high or float("inf")
                total, contained = total + 1, contained + (low <= true <= high)
                name = f"{sensor}/{axis} {letter}"
                lines.append(f"{name:9}{figures(true * factor, 4):>10}   {coefficient_text(found)} {unit}")
    return "\n".join([*lines, f"{contained} of {total} intervals contain the truth"])


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "example")
    parser.add_argument("--again", action="store_true", help="only the documents, from the saved report")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    saved = arguments.out / "report.json"
    if arguments.again:
        made = from_json(Report, saved.read_text())
        print("the README is left as it is: it compares with the noise of the run")
    else:
        start = time.perf_counter()
        made, settings = measure(arguments.hours, arguments.seed)
        spent = time.perf_counter() - start
        times = arguments.hours * 3600 / spent
        print(f"{made.session.samples:,} samples in {spent:.0f} s: {times:.0f} times real time")
        comparison = compared_with_truth(made, settings)
        print(comparison)
        (arguments.out / "README.md").write_text(
            README.format(hours=arguments.hours, rate=RATE, comparison=comparison)
        )
    made = document_report(made)
    filters = filter_report(made, DEFAULT_HORIZON_S)
    for name, form in DOCUMENTS.items():
        (arguments.out / name).write_bytes(document(made, form, filters))


if __name__ == "__main__":
    main()
