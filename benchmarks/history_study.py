"""False alarms and power of the change detection over days: many sensor-months through the pipeline.

Each month is another sensor. It is as restless as real ones: its N follows the temperature, wanders from day to day,
and the temperature has a daily cycle and weather. Samples pass the whole pipeline; days are judged one after the
other, as a daemon does it. What does not enter is left out to save time: fits of shorter periods, and the comparison of
each hour with those before. Afterwards the same months are judged again with a step of N in their daily values.

    python -m benchmarks.history_study --months 36
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from typing import Any

import numpy as np

from imumon.history.day_changes import DayChanges
from imumon.history.store import TimedPeriod
from imumon.model.history_report import PeriodChannel
from imumon.model.samples import Floats, SampleBlock, Stream
from imumon.noise.stretches import Sums
from imumon.noise.synthesis import synthesise
from imumon.record import Record, RecordOptions
from imumon.record import record as record_module
from imumon.record.periods import Periods

RATE = 0.2
"""Hz: a day has 17,280 samples, so that a month passes in half a minute. N of a day is known to 0.6 %."""
DAYS = 30
STREAM = Stream(
    kind="deltas",
    source="made",
    clock="startup",
    channels=("gyro/x", "gyro/y", "gyro/z", "accel/x", "accel/y", "accel/z", "temperature"),
)
STEPS = (1.06, 1.12, 1.3)
STEP_DAY = 20


def samples(seed: int) -> Floats:
    """Samples of one restless sensor, (n, 7) SI."""
    rng = np.random.default_rng([seed, 7])
    n = round(DAYS * 86400 * RATE)
    days = np.arange(n) / (86400 * RATE)
    scales = np.array([1e-4] * 3 + [1e-3] * 3) * rng.uniform(0.3, 3.0, 6)
    flicker = 0.1 * scales * rng.uniform(0.2, 2.0, 6)
    walk = 3e-5 * scales * rng.uniform(0.1, 3.0, 6)
    noise = synthesise(
        n, RATE, N=scales.tolist(), B=flicker.tolist(), K=walk.tolist(), seed=seed, averaged=True
    )
    weather = np.cumsum(rng.normal(0.0, 1.5, DAYS + 2))
    weather -= weather.mean()
    heat = 30.0 + 4.0 * np.sin(2.0 * np.pi * days) + np.interp(days, np.arange(DAYS + 2), 0.7 * weather)
    per_degree = rng.normal(0.0, 0.003, 6)
    wander = np.cumsum(rng.normal(0.0, 0.003, (DAYS + 2, 6)), axis=0) + rng.normal(0.0, 0.005, (DAYS + 2, 6))
    for column in range(6):
        slow = np.interp(days, np.arange(DAYS + 2), wander[:, column])
        noise[:, column] *= 1.0 + per_degree[column] * (heat - 30.0) + slow
    return np.column_stack((noise, heat + 0.02 * rng.standard_normal(n)))


class _Days(Periods):
    """Periods of which only days are fitted."""

    def _channels(self, stretch: Any, moments: Any) -> dict[str, PeriodChannel]:
        return super()._channels(stretch, moments) if stretch.length_s == 86400 else {}


def days_of(seed: int) -> list[TimedPeriod]:
    """The daily periods of one month."""
    record_module.Periods = _Days  # type: ignore[misc]
    Sums._compare = lambda self, hour, hour_begin: {}  # type: ignore[method-assign]
    monitor, values, days = Record(RecordOptions(periods=True)), samples(seed), []
    for at in range(0, len(values), 20_000):
        part = values[at : at + 20_000]
        times = 10**9 + np.rint((at + np.arange(len(part))) * 1e9 / RATE).astype(np.int64)
        monitor.feed(SampleBlock(STREAM, part, times, np.zeros(len(part), dtype=np.int64)))
        for period in monitor.periods():
            if period.step_s == 86400:
                begin = 1.7e9 + 86400.0 * period.number
                days.append(TimedPeriod(record="r", begin=begin, end=begin + 86400.0, period=period))
    return days


def alarms(days: list[TimedPeriod]) -> list[tuple[int, str, str]]:
    """Changes in the order in which a daemon would report them: day, channel, coefficient."""
    judged, found, known = DayChanges(), [], set()
    for number, day in enumerate(days):
        judged.add([day])
        for name, changes in judged.changes.items():
            for change in changes:
                if (name, change.quantity) not in known:
                    known.add((name, change.quantity))
                    found.append((number, name, change.quantity))
    return found


def stepped(days: list[TimedPeriod], name: str, factor: float) -> list[TimedPeriod]:
    """The same days with a step of N of one channel."""

    changed = []
    for number, day in enumerate(days):
        channels = dict(day.period.channels)
        if number >= STEP_DAY:
            known = channels[name].coefficients
            sizes = {size: getattr(known["N"], size) for size in ("value", "low", "high")}
            n = replace(known["N"], **{size: value and value * factor for size, value in sizes.items()})
            channels[name] = replace(channels[name], coefficients={**known, "N": n})
        changed.append(replace(day, period=replace(day.period, channels=channels)))
    return changed


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--months", type=int, default=36)
    parser.add_argument("--first", type=int, default=0, help="seed of the first month")
    words = parser.parse_args()
    false, found, delays = 0, dict.fromkeys(STEPS, 0), {step: [] for step in STEPS}
    begin = time.time()
    for month in range(words.first, words.first + words.months):
        days = days_of(month)
        wrong = alarms(days)
        false += len(wrong)
        for step in STEPS:
            changed = alarms(stepped(days, "gyro/y", step))
            hits = [
                at for at, name, letter in changed if (name, letter) == ("gyro/y", "N") and at >= STEP_DAY
            ]
            found[step] += bool(hits)
            delays[step] += [at - STEP_DAY + 1 for at in hits]
        print(
            f"month {month}: {len(days)} days, false alarms {wrong}, {time.time() - begin:.0f} s", flush=True
        )
    print(f"{words.months} sensor-months: {false} false alarms, {false / words.months:.2f} per sensor-month")
    for step in STEPS:
        shown = ""
        if delays[step]:
            shown = f", days until then: median {np.median(delays[step]):g}, longest {max(delays[step])}"
        print(f"N times {step}: found in {found[step]} of {words.months}{shown}")


if __name__ == "__main__":
    main()
