"""`combine` and `compare`: one sensor from several records, and several sensors side by side."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import imumon as command

import imumon
from imumon import Measurement
from imumon.model.coefficients import Estimate
from imumon.model.errors import ImumonError
from imumon.noise.uncertainty import of_records
from imumon.record.record_combination import combined_estimate


@pytest.fixture(scope="module")
def days() -> list[Measurement]:
    """Return records of one sensor on three days, at two rates, whose N is 5 % off the mean on two of them."""
    records = []
    for k, (rate, n) in enumerate([(100.0, 0.95e-4), (200.0, 1.0e-4), (100.0, 1.05e-4)]):
        gyro = imumon.simulate(30_000, rate, N=[n] * 3, seed=k + 1)
        records.append(imumon.analyse(gyro, rate_hz=rate, kind="average"))
    return records


def test_the_limits_of_a_combination_hold_the_scatter_between_records(days: list[Measurement]) -> None:
    combined = imumon.combine(days)
    n = combined["gyro/x"].N
    assert n.value == pytest.approx(1e-4, rel=0.02)
    low, high = n.interval
    assert (low or 0.0) < 0.95e-4 < 1.05e-4 < (high or 0.0)
    assert (n.high or 0.0) - (n.low or 0.0) < 0.2 * ((high or 0.0) - (low or 0.0)), "beyond their statistics"
    assert combined["gyro/x"].K.status == "upper_bound"
    assert combined.report.session.samples == 90_000
    assert combined.report.device.sample_rate_hz is None
    assert "gyro" in combined.grade
    assert "combination of 3 records at 100 Hz and 200 Hz" in combined.remarks[0]
    assert "gyro/x" in repr(combined)
    assert combined.filter()["gyro/x"].white == n.value
    assert combined.settings("kalibr")["gyroscope_noise_density"] > 0.99 * n.value
    with pytest.raises(ImumonError):
        combined.plot()


def test_the_command_combines_files(tmp_path: Path, days: list[Measurement]) -> None:
    paths = []
    for k, n in enumerate([0.95e-4, 1.05e-4]):
        paths.append(tmp_path / f"{k}.npz")
        gyro = imumon.simulate(9_000, 100.0, N=[n] * 3, seed=k + 1)
        np.savez(paths[-1], gyro_rads=gyro)
    printed = json.loads(command("replay", *paths, "--rate", "100", "--json"))
    expected = imumon.combine([imumon.analyse(path, rate_hz=100.0) for path in paths])
    n = expected["gyro/x"].N
    assert printed["channels"]["gyro/x"]["N"]["value"] == n.value
    assert printed["channels"]["gyro/x"]["N"]["combined_high"] == n.combined_high
    assert "N" in command("replay", *paths, "--rate", "100")


def test_what_cannot_be_combined(days: list[Measurement]) -> None:
    one, two = days[0], days[1]

    def serial(m: Measurement, number: str) -> Measurement:
        return replace(m, report=replace(m.report, device=replace(m.report.device, serial=number)))

    accel = imumon.analyse(accel=imumon.simulate(900, 100.0, N=1e-3, bias=9.8, seed=1), rate_hz=100.0)
    for records, code in (
        ([one], "too_few_records"),
        ([one, one.report], "no_measurement"),
        ([serial(one, "1"), serial(two, "2")], "different_sensors"),
        ([one, accel], "no_common_channel"),
    ):
        with pytest.raises(ImumonError) as error:
            imumon.combine(records)  # type: ignore[arg-type]
        assert error.value.code == code


def test_measured_bounded_and_pending_coefficients() -> None:
    measured = Estimate(value=1.0, low=0.9, high=1.11, status="measured", unit="u")
    bound = Estimate(low=0.0, high=4.0, status="upper_bound", unit="u")
    pending = Estimate(unit="u", reason="too short")
    both = combined_estimate([measured, bound])
    assert (both.status, both.value, both.high) == ("measured", 1.0, 1.11)
    varying = combined_estimate([measured, measured, replace(bound, high=0.5)])
    assert varying.status == "measured"
    assert (varying.value or 1.0) < 0.9
    assert (varying.combined_low or 1.0) < 0.5
    rare = combined_estimate([measured, bound, bound])
    assert (rare.status, rare.high, rare.reason) == ("upper_bound", 1.11, "1 of 3 records show it")
    bounded = combined_estimate([bound, replace(bound, high=1.0), pending])
    assert (bounded.status, bounded.value, bounded.high) == ("upper_bound", None, 2.0)
    single = combined_estimate([measured, pending])
    assert (single.value, single.high) == (1.0, 1.11)
    assert "one record" in (single.reason or "")
    nothing = combined_estimate([pending, pending])
    assert (nothing.status, nothing.reason) == ("pending", "too short")


@pytest.mark.few
@pytest.mark.parametrize("scatter", [0.0, 0.02, 0.1])
@pytest.mark.parametrize("records", [2, 5])
def test_the_limits_cover_the_mean(records: int, scatter: float) -> None:
    """Of 400 sensors: 95 % at least; 1.6 % less is the 5 % quantile of a binomial."""
    rng = np.random.default_rng(records)
    errors = [0.02 * (1 + k % 2) for k in range(records)]
    covered = 0
    for _ in range(400):
        values = [math.exp(rng.normal(0.0, scatter) + rng.normal(0.0, error)) for error in errors]
        mean = of_records(values, errors)
        covered += mean.combined_low < 1.0 < mean.combined_high
    assert covered >= 0.934 * 400


def test_one_frame_of_several_measurements(days: list[Measurement]) -> None:
    pytest.importorskip("pandas")
    frame = imumon.compare({"monday": days[0], "friday": days[2]})
    row = frame.loc["gyro/y", "N"]
    value = days[2]["gyro/y"].N
    assert row["friday", "value"] == value.value
    assert row["friday", "ratio"] == pytest.approx(1.05 / 0.95, rel=0.03)
    assert bool(row["friday", "differs"])
    assert ("monday", "ratio") not in frame.columns
    with pytest.raises(ImumonError):
        imumon.compare({})
