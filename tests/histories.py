"""Histories for tests: periods of a synthetic sensor, years of them in seconds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from imumon.history import HistoryStore
from imumon.history.store import SUFFIX, TimedPeriod
from imumon.model.coefficients import Estimate
from imumon.model.history_report import HistoryPeriod, PeriodChannel
from imumon.model.samples import ACCEL, GYRO, MAG, TEMPERATURE, ChannelName

NAMES = (*GYRO, *ACCEL, *MAG)
BEGIN = 1_767_225_600.0
"""s since 1970, 2026-01-01."""
RECORD = "2026-01-01T00:00:00.000Z"


def coefficient(value: float) -> Estimate:
    return Estimate(value=value, low=0.99 * value, high=1.01 * value, status="measured")


def period(
    number: int,
    *,
    step_s: int = 3600,
    begin: float | None = None,
    noise: float = 1.0,
    mean: float = 0.1,
    temperature: float = 30.0,
    complete: bool = True,
    warming_up: bool = False,
    record: str = RECORD,
    names: tuple[ChannelName, ...] = NAMES,
) -> TimedPeriod:
    """One period; `noise` is the factor of N."""
    channels = {
        name: PeriodChannel(
            coefficients={
                "N": coefficient(1.234567e-4 * noise),
                "B": coefficient(2.345678e-5),
                "K": Estimate(low=0.0, high=3.4e-6, status="upper_bound"),
            },
            mean=mean,
            std=1e-3,
        )
        for name in names
    }
    channels[TEMPERATURE] = PeriodChannel(mean=temperature, std=0.1)
    made = HistoryPeriod(
        step_s=step_s,
        number=number,
        begin_age_s=float(step_s),
        end_age_s=0.0,
        complete=complete,
        samples=100 * step_s,
        missing=3,
        excluded_s=0.5,
        temperature=temperature,
        warming_up=warming_up,
        grades={"gyro": "industrial", "accel": None},
        channels=channels,
    )
    begin = BEGIN + number * step_s if begin is None else begin
    return TimedPeriod(record=record, begin=begin, end=begin + step_s, period=made)


def with_slopes(slopes: list[float], error: float, begin: float = BEGIN) -> list[TimedPeriod]:
    """Return days of a sensor with slopes of gyro/x against the temperature, the last of which is known badly."""
    made = []
    for number, slope in enumerate(slopes):
        day = period(number, step_s=86400, begin=begin + number * 86400)
        half = 2.0 * error * (100.0 if number == len(slopes) - 1 else 1.0)
        channel = day.period.channels["gyro/x"]
        known = {
            **channel.coefficients,
            "slope": Estimate(value=slope, low=slope - half, high=slope + half, status="measured"),
        }
        channels = {**day.period.channels, "gyro/x": replace(channel, coefficients=known)}
        made.append(replace(day, period=replace(day.period, channels=channels)))
    return made


def write(directory: Path, device: str, periods: list[TimedPeriod]) -> Path:
    """A history with these periods."""
    path = directory / f"{device}{SUFFIX}"
    with HistoryStore(path, write=True) as store:
        store.add(periods)
    return path
