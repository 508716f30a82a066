"""Combined limits of N and B of sensors whose N and B wander: how often they hold the truth, as Markdown.

    python benchmarks/wander.py [--records 50] | python benchmarks/document_tables.py -

Records of two hours, six sensors each, N = 6.1e-5 rad/s/sqrt(Hz), B = 2.4e-5 rad/s, point samples at 40 Hz. A wander
that returns is a log-normal factor of all white noise and one of all flicker, with a memory of ten minutes: means of
hours of the factor vary by the wander. The truth is what the sensor has over years, its root mean square. A walk never
returns: the factor begins at 1 and varies by the wander after an hour. It has no mean over years. The truth is the root
mean square in the record, and in a second row what the sensor had at first. Seeds are 0, 1, 2 ...
"""

from __future__ import annotations

import argparse
import math
from datetime import UTC, datetime

import numpy as np
from accuracy import share
from document_tables import head, row

from imumon.model.coefficients import Estimate
from imumon.model.report import Channel, DeviceDescription, SessionCounters
from imumon.model.samples import ACCEL, GYRO, SampleBlock, Stream
from imumon.noise import synthesise
from imumon.record import Record
from imumon.record.combined_limits import with_combined

TRUTH = {"N": 6.1e-5, "B": 2.4e-5}
RATE_HZ, LENGTH_S = 40.0, 7200
SENSORS = GYRO + ACCEL
MEMORY_S, HOUR_S = 600.0, 3600.0
CELLS = [("returns", w) for w in (0.0, 0.005, 0.01, 0.03)] + [("walks", w) for w in (0.005, 0.01, 0.03)]
STREAM = Stream("uncompensated", SENSORS, "benchmark", "startup")


def factors(law: str, wander: float, generator: np.random.Generator) -> np.ndarray:
    """Return (LENGTH_S, c) the factor of the noise in each second."""
    steps = generator.standard_normal((LENGTH_S, len(SENSORS)))
    if law == "walks":
        return np.exp(wander / math.sqrt(HOUR_S) * np.cumsum(steps, axis=0))
    keep, x = math.exp(-1.0 / MEMORY_S), HOUR_S / MEMORY_S
    spread = wander / math.sqrt(
        2.0 / x * (1.0 - (1.0 - math.exp(-x)) / x)
    )  # of a value, for that of hourly means
    logs, at = np.empty_like(steps), steps[0]
    for second, step in enumerate(steps):
        at = keep * at + math.sqrt(1.0 - keep**2) * step
        logs[second] = at
    return np.exp(spread * logs - spread**2)  # root mean square 1


def sensors(law: str, wander: float, seed: int) -> list[tuple[Channel, dict[str, float]]]:
    """Return each channel of a record with its combined limits, and the root mean square of N and B in the record."""
    generator, n = np.random.default_rng([20_261, seed]), round(LENGTH_S * RATE_HZ)
    values = np.zeros((n, len(SENSORS)))
    present = {}
    for letter, size in TRUTH.items():
        factor = factors(law, wander, generator)
        present[letter] = size * np.sqrt(np.mean(factor**2, axis=0))
        noise = synthesise(n, RATE_HZ, **{letter: [size] * len(SENSORS)}, seed=generator, averaged=False)
        values += np.repeat(factor, round(RATE_HZ), axis=0) * noise
    monitor, stamps = Record(), np.rint(np.arange(n) * 1e9 / RATE_HZ).astype(np.int64)
    for begin in range(0, n, 8000):
        rows = slice(begin, min(begin + 8000, n))
        block = SampleBlock(STREAM, values[rows], stamps[rows], np.zeros(rows.stop - begin, dtype=np.int64))
        monitor.feed(block)
    report = monitor.report(
        datetime(2026, 1, 1, tzinfo=UTC),
        DeviceDescription(id="benchmark"),
        "stopped",
        SessionCounters(),
    )
    made = with_combined(report).values()
    return [(each, {name: float(v[k]) for name, v in present.items()}) for k, each in enumerate(made)]


def held(part: Estimate, truth: float) -> tuple[bool, bool, bool]:
    """Return whether the limits of the fit and the combined ones hold the truth, and whether scatter shows."""
    limits = (part, part.stated)
    one, two = ((each.low or 0.0) <= truth <= (each.high or math.inf) for each in limits)
    return one, two, part.excess is not None and part.excess.value is not None


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--records", type=int, default=50, help="of each kind, of six sensors; default 50")
    records = parser.parse_args().records
    columns = ("fit", "combined", "scatter shows", "median ±, %")
    print(
        head(
            "wander",
            "wander",
            "an hour, %",
            "truth",
            *(f"{letter}: {name}" for letter in "NB" for name in columns),
        )
    )
    for law, wander in CELLS:
        made = [each for seed in range(records) for each in sensors(law, wander, seed)]
        for truth in ("over years",) if law == "returns" else ("in the record", "at first"):
            cells = []
            for letter, size in TRUTH.items():
                parts = [each.coefficients[letter] for each, _ in made]
                true = [own[letter] if truth == "in the record" else size for _, own in made]
                found = np.array([held(part, each) for part, each in zip(parts, true, strict=True)])
                widths = [100.0 * (part.stated.half_width or math.nan) for part in parts]
                cells += [share(found[:, 0]), share(found[:, 1]), f"{100.0 * found[:, 2].mean():.0f}"]
                cells.append(f"{np.nanmedian(widths):.2g}")
            print(row([law, f"{100.0 * wander:g}", truth, *cells]), flush=True)


if __name__ == "__main__":
    main()
