"""The picture of a record that grows: what is drawn at each length, with a temperature that is measured.

    python -m benchmarks.growing [--seeds 10] [--hours 48] [--every 2]

The sensor of the emulator (N, B and K of a VN-100, a bias that follows the temperature by 1e-6 rad/s/degC) warms up by
8 degC and lives in a room of +-1.5 degC a day. The thermometer has noise of its own, 0.02 degC. A replay fits once at
the end; a daemon fits at every length, and so does this. Counted at each length, for six channels: models whose shares
do not add up to them, octaves whose 95 % limits do not hold the drawn model, octaves where it is off by a factor of
1.5 and more outside the limits, and reports that name an oscillation, which the noise does not have.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

import imumon

RATE = 10.0
SENSORS = {"gyro": (6.1e-5, 2.4e-5, 1.5e-6), "accel": (1.37e-3, 4.0e-4, 1.0e-5)}
"""N, B and K in SI."""
THERMAL = 1e-6
FAR = 1.5
CHANNELS = tuple(f"{sensor}/{axis}" for sensor in SENSORS for axis in "xyz")


def samples(seed: int, n: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng([51, seed])
    t = np.arange(n) / RATE
    degrees = 25.0 - 8.0 * np.exp(-t / 600.0) + 1.5 * np.sin(2.0 * np.pi * (t / 86_400.0 + rng.random()))
    arrays = {
        sensor: imumon.simulate(n, RATE, *([strength] * 3 for strength in NBK), averaged=False, seed=rng)
        for sensor, NBK in SENSORS.items()
    }
    arrays["gyro"] += THERMAL * (degrees - degrees[0])[:, None]
    arrays["accel"][:, 2] += 9.81
    return arrays | {"temperature": degrees + rng.normal(0.0, 0.02, n)}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--hours", type=float, default=48.0)
    parser.add_argument("--every", type=float, default=2.0, help="hours between two reports")
    given = parser.parse_args()
    print("| seed | drawn models | sums off | octaves | outside | off by 1.5 | oscillation | K of gyro |")
    print("|---|---|---|---|---|---|---|---|")
    step = int(given.every * 3600.0 * RATE)
    for seed in range(given.seeds):
        arrays = samples(seed, int(given.hours * 3600.0 * RATE))
        live = imumon.Live(rate_hz=RATE, channels=(*CHANNELS, "temperature"))
        table = np.column_stack((arrays["gyro"], arrays["accel"], arrays["temperature"]))
        models = sums = octaves = outside = far = oscillations = 0
        for begin in range(0, len(table), step):
            live.update(table[begin : begin + step])
            report = live.result().report
            for name in CHANNELS:
                channel = report.channels[name]
                oscillations += "oscillation" in channel.caveats
                if channel.model is None or channel.allan is None or not channel.allan.model:
                    continue
                models += 1
                shares = np.sum(list(channel.model.shares.values()), axis=0)
                sums += not np.allclose(shares, np.square(channel.allan.model), rtol=1e-5)
                low, high, drawn, seen = (
                    np.array(part, dtype=float)
                    for part in (
                        channel.allan.low,
                        channel.allan.high,
                        channel.allan.model,
                        channel.allan.sigma,
                    )
                )
                known = np.isfinite(low) & np.isfinite(high)
                missed = known & ((drawn < low) | (drawn > high))
                octaves += int(known.sum())
                outside += int(missed.sum())
                far += int((missed & (np.abs(np.log(drawn / seen)) > np.log(FAR))).sum())
        walks = [report.channels[f"gyro/{axis}"].K for axis in "xyz"]
        shown = ", ".join(f"{walk.status} {walk.low:.2g} to {walk.high:.2g}" for walk in walks if walk)
        print(
            f"| {seed} | {models} | {sums} | {octaves} | {outside} | {far} | {oscillations} | {shown} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
