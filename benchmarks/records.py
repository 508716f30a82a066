"""Combination of records: how often the limits of `imumon.combine` hold the coefficients of a sensor.

    python -m benchmarks.records [--sensors 40] [--records 4] [--seconds 1200]

A simulated sensor has a mean N and B; in each record they differ by a share that is normal in the logarithm. The limits
of a combination are for the mean. Beside it: the limits of the statistics alone, which leave the scatter out.
"""

from __future__ import annotations

import argparse

import numpy as np

import imumon

RATE = 10.0
N, B = 1e-4, 6e-5
"""rad/s/sqrt(Hz) and rad/s, of the mean of every sensor."""
SPREADS = {"N": 0.05, "B": 0.2}
"""1, standard deviation of the logarithm between the records of a sensor."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sensors", type=int, default=40)
    parser.add_argument("--records", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=1200.0)
    given = parser.parse_args()
    rng = np.random.default_rng(1)
    covered = {
        letter: [0, 0, 0] for letter in SPREADS
    }  # combined, statistics alone, records that state a value
    for sensor in range(0, given.sensors, 3):
        records = []
        for _ in range(given.records):
            # three sensors are the three axes of one analysis: it costs a third
            factors = {letter: np.exp(rng.normal(0.0, spread, 3)) for letter, spread in SPREADS.items()}
            samples = imumon.simulate(
                int(given.seconds * RATE), RATE, N=N * factors["N"], B=B * factors["B"], seed=rng
            )
            records.append(imumon.analyse(samples, rate_hz=RATE, kind="average"))
        combined = imumon.combine(records)
        for axis in "xyz"[: given.sensors - sensor]:
            for letter, truth in (("N", N), ("B", B)):
                part = combined[f"gyro/{axis}"].estimates[letter]
                if part.status != "measured" or part.low is None or part.high is None:
                    continue
                low, high = part.interval
                covered[letter][0] += bool(low and high and low < truth < high)
                covered[letter][1] += part.low < truth < part.high
                covered[letter][2] += 1
    print(f"{given.records} records of {given.seconds:g} s at {RATE:g} Hz")
    print(f"{'':4}{'between records':>17}{'combined':>12}{'statistics':>12}{'measured':>10}")
    for letter, (whole, statistics, measured) in covered.items():
        shares = [f"{100.0 * count / max(measured, 1):.0f} %" for count in (whole, statistics)]
        print(f"{letter:4}{100.0 * SPREADS[letter]:>15.0f} %{shares[0]:>12}{shares[1]:>12}{measured:>10}")


if __name__ == "__main__":
    main()
