"""How long a record has to be until N, B and K are as precise as configured, with the noise of the emulated sensor.

    python benchmarks/record_length.py [--records 12] | python benchmarks/document_tables.py -

N is that of 100 Hz; B and K do not depend on the rate, and are taken from longer records at 10 Hz. A record grows by a
quarter from one statement to the next, and the length between two is interpolated. Warm-up and knocks are left out.
"""

from __future__ import annotations

import argparse
import math

import numpy as np
from document_tables import head, row

from imumon.model.coefficients import default_precision
from imumon.model.samples import INERTIAL
from imumon.model.units import duration, share_text
from imumon.noise import Estimator, OctaveCascade, synthesise
from imumon.sources.vn100.emulator.emulator_settings import ACCEL, GYRO

GROWTH = 10.0**0.1
CASES = (("N", 100.0, 3600.0), ("B", 10.0, 86_400.0), ("K", 10.0, 86_400.0))
"""Coefficient, Hz of the record, and s of the longest one."""
BATCH = 6
NAMES = {"gyro": "gyroscope", "accel": "accelerometer"}


def lengths(sensor: str, letter: str, rate_hz: float, longest_s: float, seed: int) -> list[float]:
    """Return the length, s, at which each of `BATCH` channels is precise enough; infinite: none."""
    noise = {"gyro": GYRO, "accel": ACCEL}[sensor]
    count, white, flicker, walk = round(rate_hz * longest_s), noise.n[0], noise.b[0], noise.k[0]
    columns = [
        synthesise(count, rate_hz, [white], [flicker], [walk], seed=seed + k, averaged=False)
        for k in range(BATCH)
    ]
    samples = np.concatenate(columns, axis=1)
    cascade, estimator = OctaveCascade(BATCH, tau0=1.0 / rate_hz), Estimator(averaged=False)
    least, done, length = default_precision()[letter], 0, 40.0
    before, reached = np.full(BATCH, math.inf), np.full(BATCH, math.inf)
    while length <= longest_s and not np.isfinite(reached).all():
        cascade.update(samples[done : int(length * rate_hz)])
        done = int(length * rate_hz)
        fits = estimator.fit(cascade.result())
        now = np.array([fit.coefficients[letter].half_width or math.inf for fit in fits])
        for k in np.flatnonzero(np.isinf(reached) & (now <= least)):
            part = (
                math.log(before[k] / least) / math.log(before[k] / now[k])
                if math.isfinite(before[k])
                else 1.0
            )
            reached[k] = length * GROWTH ** (part - 1.0)
        before, length = now, length * GROWTH
    return [float(value) for value in reached]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--records", type=int, default=12)
    records = parser.parse_args().records
    print(
        head(
            "record-length",
            "result",
            *(f"{NAMES[sensor]}: half of the records, nine of ten" for sensor in INERTIAL),
        )
    )
    for letter, rate_hz, longest_s in CASES:
        cells = [f"{letter} to {share_text(default_precision()[letter])}"]
        for sensor in INERTIAL:
            known = [
                length
                for seed in range(0, records, BATCH)
                for length in lengths(sensor, letter, rate_hz, longest_s, 100 * seed)
            ]
            cells.append(", ".join(map(_text, np.quantile(known, (0.5, 0.9), method="higher").tolist())))
        print(row(cells), flush=True)


def _text(length_s: float) -> str:
    """Return a length with two digits; of a record that was too short, that it was."""
    if math.isinf(length_s):
        return "longer than the records"
    return duration(float(f"{length_s:.2g}"))


if __name__ == "__main__":
    main()
