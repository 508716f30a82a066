"""Laws of the periods of the history: they add up, belong to their own time, and survive a restart."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.model.history_report import HistoryPeriod
from imumon.model.samples import Floats, SampleBlock, Stream
from imumon.model.saved_state import pack, unpack
from imumon.record import Record, RecordOptions

RATE = 4.0
STREAM = Stream(kind="deltas", source="made", clock="startup", channels=("gyro/x", "gyro/y", "temperature"))
STEPS = (3600, 86400)


def values(hours: float, noise: float = 1e-3, seed: int = 1) -> Floats:
    n = round(hours * 3600 * RATE)
    samples = np.random.default_rng(seed).normal(size=(n, 3)) * [noise, noise, 0.01]
    samples[:, 2] += 30.0
    return samples


def feed(monitor: Record, samples: Floats, first: int = 0, chunk: int = 777) -> list[HistoryPeriod]:
    periods = []
    for at in range(0, len(samples), chunk):
        part = samples[at : at + chunk]
        times = 10**9 + np.rint((first + at + np.arange(len(part))) * 1e9 / RATE).astype(np.int64)
        monitor.feed(SampleBlock(STREAM, part, times, np.zeros(len(part), dtype=np.int64)))
        periods += monitor.periods()
    return periods


def monitor() -> Record:
    return Record(RecordOptions(periods=True))


def of(periods: list[HistoryPeriod], step_s: int) -> list[HistoryPeriod]:
    return [each for each in periods if each.step_s == step_s]


def test_counts_add_up_to_the_record() -> None:
    made = monitor()
    samples = values(2.4)
    periods = feed(made, samples[:20000])
    periods += feed(made, samples[21000:], first=21000)
    made.flush()
    periods += made.periods() + made.periods_in_progress()
    for step in STEPS:
        assert sum(each.samples for each in of(periods, step)) == made.samples
        assert sum(each.missing for each in of(periods, step)) == 1000
        assert [each.number for each in of(periods, step)] == list(range(len(of(periods, step))))


def test_noise_belongs_to_its_own_period() -> None:
    made = monitor()
    periods = feed(made, np.concatenate((values(1.0), values(1.1, noise=2e-3, seed=2))))
    first, second = of(periods, 3600)[:2]
    truth = 1e-3 / np.sqrt(RATE)
    for each, factor in ((first, 1.0), (second, 2.0)):
        n = each.channels["gyro/x"].coefficients["N"]
        assert n.value == pytest.approx(truth * factor, rel=0.05)
        assert n.low < truth * factor < n.high
    assert first.temperature == pytest.approx(30.0, abs=0.01)
    assert not first.channels["temperature"].coefficients
    assert first.channels["gyro/y"].std == pytest.approx(1e-3, rel=0.05)


def test_a_day_has_the_slope_against_its_temperature() -> None:
    made, samples = monitor(), values(2.0)
    heat = 20.0 * (1.0 - np.exp(-np.arange(len(samples)) / (0.2 * len(samples))))
    samples[:, 2] += heat
    samples[:, 0] += 1e-4 * heat
    feed(made, samples)
    made.flush()
    (in_progress,) = of(made.periods_in_progress(), 86400)
    made.end()
    (day,) = of(made.periods(), 86400)
    assert in_progress.channels == day.channels
    slope = day.channels["gyro/x"].coefficients["slope"]
    assert slope.low < 1e-4 < slope.high
    assert "slope" not in day.channels["temperature"].coefficients


@pytest.mark.few
@pytest.mark.parametrize(("rate", "hours"), [(4.0, 0.5), (100.0, 0.005)])
def test_a_young_period_of_any_length_shows_what_it_has(
    rate: float, hours: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(globals(), "RATE", rate)
    made = monitor()
    samples = values(hours)
    for at in range(0, len(samples), 100):
        feed(made, samples[at : at + 100], first=at)
        if at < 400:
            made.periods_in_progress()  # a daemon asks from the first samples on, which the guard still holds
    young, *longer = made.periods_in_progress()
    assert [each.step_s for each in longer] == [86400]
    assert longer[0].samples == young.samples > 0
    assert (longer[0].begin_age_s, longer[0].channels) == (young.begin_age_s, young.channels)


def test_a_restart_in_the_middle_of_a_period_does_not_show() -> None:
    samples = values(2.2)
    whole = feed(monitor(), samples)
    first = monitor()
    half = round(len(samples) * 0.7)
    periods = feed(first, samples[:half])
    second = monitor()
    second.restore(unpack(pack(first.save())), 0.0)
    periods += feed(second, samples[half:], first=half)
    assert [(p.step_s, p.number) for p in periods] == [(p.step_s, p.number) for p in whole]
    periods += second.periods_in_progress()
    for step in STEPS:
        assert sum(p.samples for p in of(periods, step)) == second.samples
    for a, b in zip(whole, periods, strict=False):
        assert b.channels["gyro/x"].mean == pytest.approx(a.channels["gyro/x"].mean, rel=1e-9)


def test_a_gap_of_days_has_no_periods_and_is_counted_as_missing() -> None:
    made = monitor()
    periods = feed(made, values(0.5))
    days = round(3 * 86400 * RATE)
    periods += feed(made, values(0.5, seed=3), first=days)
    assert len(of(periods, 3600)) < 2
    made.flush()
    periods += made.periods() + made.periods_in_progress()
    for step in STEPS:
        assert sum(p.samples for p in of(periods, step)) == made.samples
        assert sum(p.missing for p in of(periods, step)) == days - round(1800 * RATE)
