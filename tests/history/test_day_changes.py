"""Laws of what the history finds: a step in days is found once, scatter is none; power-ups and their biases."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import imumon
from histories import BEGIN, NAMES, period, with_slopes, write
from reports import warming_up as report

from imumon.documents.summary import summary_text
from imumon.history.day_changes import DayChanges
from imumon.history.history import History
from imumon.history.power_ups import LEAST_POWER_UPS, PowerUps
from imumon.history.rows import iso
from imumon.history.store import TimedPeriod
from imumon.model.messages import change_text
from imumon.model.report import Distribution, Event
from imumon.model.samples import GYRO, MAG
from imumon.noise.statistics.moments import deviation_limits

DAY = 86400.0


def days(count: int, *, begin: float = BEGIN, step_at: int = 999) -> list[TimedPeriod]:
    """Days of a sensor with 1 % of scatter, with a step of N by 12 % in all channels."""
    factors = 1.0 + 0.01 * np.random.default_rng(1).standard_normal(count)
    factors[step_at:] *= 1.12
    return [
        period(number, step_s=86400, begin=begin + number * DAY, noise=float(factor))
        for number, factor in enumerate(factors)
    ]


def test_a_step_is_found_with_its_day_and_the_scatter_is_not() -> None:
    judged = DayChanges()
    judged.add(days(30))
    assert judged.changes == {}
    judged = DayChanges()
    judged.add(days(30, step_at=27))
    (change,) = judged.changes["gyro/y"]
    assert (change.quantity, change.against, change.since) == ("N", "history", "2026-01-28T00:00:00.000Z")
    assert change.ratio == pytest.approx(1.12, abs=0.02)
    assert change.p_value is not None
    assert change.p_value < 1e-5
    assert "temperature" not in judged.changes
    assert change_text(GYRO[1], change).startswith(
        "gyro/y: N has grown by 12 % against the history since 2026-01-28, p = "
    )


def test_days_that_are_short_in_progress_or_warm_up_do_not_count() -> None:
    judged = DayChanges()
    judged.add([period(k, step_s=86400, complete=False) for k in range(20)])
    judged.add([period(k, step_s=86400, warming_up=True) for k in range(20)])
    judged.add([period(k) for k in range(20)])
    assert judged._days == {}


def test_a_step_of_the_slope_is_judged_by_the_errors_of_the_days() -> None:
    """Of any sign; a day with a wide error, however far off, is no change."""
    scatter = 1e-7 * np.random.default_rng(5).standard_normal(30)
    slopes = np.where(np.arange(30) < 20, -1e-6, 1e-6) + scatter
    for values, expected in ((scatter, 0), (np.append(scatter, 1e-5), 0), (slopes, 1)):
        judged = DayChanges()
        judged.add(with_slopes(values.tolist(), 1e-7))
        assert len(judged.changes.get(GYRO[0], ())) == expected
    (change,) = judged.changes["gyro/x"]
    assert (change.quantity, change.ratio, change.since) == ("slope", None, "2026-01-21T00:00:00.000Z")
    assert (change.before, change.now) == (pytest.approx(-1e-6, abs=2e-7), pytest.approx(1e-6, abs=2e-7))
    text = change_text(GYRO[0], change)
    assert text.startswith("gyro/x: the slope against the temperature has moved from -")
    assert " per degC against the history since 2026-01-21, p = " in text
    shown = report()
    shown = replace(
        shown, channels={**shown.channels, GYRO[0]: replace(shown.channels["gyro/x"], changes=(change,))}
    )
    assert text in summary_text(shown, 200)


def test_the_history_prints_the_slope_of_a_day(tmp_path: Path) -> None:
    write(tmp_path, "imu", with_slopes([-1e-6] * 3, 1e-7))
    ask = ["history", "--state", tmp_path, "--since", "2026-01-01", "--step", "1d"]
    text = imumon(*ask, "--channel", "gyro")
    assert text.count("slope -0.206 ±0.041 °/h/°C") == 2
    assert text.count("slope") == 3
    assert '"slope":{"value":-1e-06,"low":-1.2e-06,' in imumon(*ask, "--json")


@pytest.mark.few
@pytest.mark.parametrize("correlation", [0.0, 0.8, 1.0])
def test_scatter_of_any_kind_makes_few_changes(correlation: float) -> None:
    """500 series of 30 days: white, strongly correlated, and a random walk."""
    rng, changed = np.random.default_rng(3), 0
    for _ in range(500):
        series = [0.0]
        for shock in 0.03 * rng.standard_normal(29):
            series.append(correlation * series[-1] + float(shock))
        judged = DayChanges()
        judged.add(
            [
                period(day, step_s=86400, noise=float(np.exp(level)), names=(GYRO[0],))
                for day, level in enumerate(series)
            ]
        )
        changed += bool(judged.changes)
    assert changed <= 15  # one of a hundred by chance: 15 have a probability of 1e-4


def test_a_change_is_reported_once_also_after_a_restart(tmp_path: Path) -> None:
    now = time.time()
    begin = now - 31 * DAY
    write(tmp_path, "imu", days(30, begin=begin, step_at=27))
    for expected in (len(NAMES), 0):
        history = History(tmp_path, "imu", keep_days=400)
        end = time.monotonic() + 60
        while history._power_ups is None:
            assert time.monotonic() < end
            time.sleep(0.01)
        found = history.new_changes()
        assert len(found) == expected
        assert history.new_changes() == []
        for name, text in found:
            history.event(Event(time=iso(now), kind="change", text=text, device="imu", channel=name))
        annotated = history.annotated(report())
        assert [c.against for c in annotated.channels["gyro/y"].changes][-1] == "history"
        assert "changed" in annotated.channels["gyro/y"].caveats
        history.close()


# ---------------------------------------------------------------------- power-ups


def settled(bias: float, now: float) -> TimedPeriod:
    return period(0, begin=now - 3600.0, mean=bias)


def test_a_restart_of_the_daemon_is_no_power_up_and_one_of_the_sensor_is() -> None:
    ups = PowerUps([])
    ups.update(100.0, BEGIN)
    ups.update(4000.0, BEGIN + 3900.0)
    again = PowerUps(ups._all)
    again.update(90_000.0, BEGIN + 89_900.5)  # the daemon was away
    assert len(again._all) == 1
    again.update(5.0, BEGIN + 90_000.0)  # the clock restarted
    again.update(
        90_000.0, BEGIN + 400_000.0
    )  # it is ahead, but not by as much as the host: off for days in between
    assert [round(each.time - BEGIN) for each in again._all] == [-100, 89_995, 310_000]


def test_the_bias_is_taken_once_the_sensor_has_settled() -> None:
    ups = PowerUps([])
    ups.update(700.0, BEGIN)
    assert not ups.settle(settled(0.1, BEGIN), 100.0)  # half an hour is not over
    ups.update(3000.0, BEGIN + 2300.0)
    assert not ups.settle(period(1, complete=False), 2400.0)
    assert not ups.settle(period(1, warming_up=True), 2400.0)
    assert ups.settle(settled(0.2, BEGIN + 2300.0), 2400.0)
    assert not ups.settle(settled(0.3, BEGIN + 2900.0), 3000.0)
    assert ups.biases(GYRO[0]) == [0.2]
    assert ups.biases(MAG[0]) == []


def test_the_repeatability_has_limits_after_five_power_ups() -> None:
    ups, biases = PowerUps([]), [0.1, 0.14, 0.09, 0.11, 0.12]
    for number, bias in enumerate(biases):
        shape = ups.described(Distribution(), GYRO[2])
        assert shape.turn_on_count == (number or None)
        assert shape.turn_on_std is None
        begin = BEGIN + number * DAY
        ups.update(1.0, begin)
        ups.update(4000.0, begin + 4000.0)
        assert ups.settle(settled(bias, begin + 4000.0), 3300.0)
    shape = ups.described(Distribution(), GYRO[2])
    assert shape.turn_on_count == LEAST_POWER_UPS
    assert shape.turn_on_std == pytest.approx(np.std(biases, ddof=1))
    assert (shape.turn_on_low, shape.turn_on_high) == deviation_limits(shape.turn_on_std or 0.0, 4)


def test_power_ups_are_in_the_file(tmp_path: Path) -> None:
    now = time.time()
    for number, bias in enumerate((0.1, 0.2)):
        history = History(tmp_path, "imu", keep_days=400)
        end = time.monotonic() + 60
        while history._power_ups is None:
            assert time.monotonic() < end
            time.sleep(0.01)
        history.clock(9000.0 - number, now)
        history.add([period(number, mean=bias, complete=True).period], "r", now)
        history.close()
        assert history._power_ups.biases(GYRO[0]) == [0.1, 0.2][: number + 1]
