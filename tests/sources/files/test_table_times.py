"""Times of a table: which column is the clock, wraps, stamps that are not set, and a rate that a comment states."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tables import csv, replayed, truth

NAMES = [*(f"g{a} [rad/s]" for a in "xyz"), *(f"a{a} [m/s2]" for a in "xyz")]
N = 2000
STATED = "// Update Rate: 100.0Hz\n"


def table(path: Path, names: list[str], *times: np.ndarray, preamble: str = "") -> Path:
    _, gyro, accel = truth(N)
    csv(path, [*names, *NAMES], *times, gyro, accel)
    path.write_text(preamble + path.read_text())
    return path


@pytest.mark.parametrize("bits", [30, 32])
@pytest.mark.parametrize("unit", ["us", "ms"])
def test_a_counter_that_wraps_continues(bits: int, unit: str, tmp_path: Path) -> None:
    step = {"us": 10_000, "ms": 10}[unit]
    times = (np.arange(N) * step + 2**bits - 900 * step - 3) % 2**bits
    report, remarks = replayed(table(tmp_path / "a.csv", [f"t [{unit}]"], times))
    session = report.session
    assert (session.samples, session.missing, session.gaps, session.restarts) == (N, 0, 0, 0)
    assert f"the counter t [{unit}] wraps" in remarks


def test_of_two_times_the_one_with_the_stated_rate_is_the_clock(tmp_path: Path) -> None:
    ticks = np.arange(N) * 1.0
    path = table(tmp_path / "a.csv", ["t", "stamp"], ticks, 10.0 * ticks, preamble=STATED)
    report, _ = replayed(path)
    assert report.device.sample_rate_hz == 100.0
    assert report.recording is not None
    assert report.recording.times == ("stamp",)


def test_a_time_that_contradicts_the_stated_rate_is_doubted(tmp_path: Path) -> None:
    _, remarks = replayed(table(tmp_path / "a.csv", ["t [ms]"], np.arange(N) * 20.0, preamble=STATED))
    assert "a comment states 100 Hz, and the time in t [ms] shows 50 Hz" in remarks


def test_stamps_that_are_zero_give_way_to_the_next_time(tmp_path: Path) -> None:
    report, _ = replayed(table(tmp_path / "a.csv", ["t", "Time [ms]"], np.zeros(N), np.arange(N) * 10.0))
    assert report.recording is not None
    assert report.recording.times == ("Time [ms]",)


def test_stamps_before_the_clock_is_set_are_no_years_of_missing_samples(tmp_path: Path) -> None:
    times = np.arange(N) * 10.0 + 1.7e12
    times[:500] = 0.0
    report, remarks = replayed(table(tmp_path / "a.csv", ["t [ms]"], times))
    assert (report.session.samples, report.session.missing) == (N - 500, 0)
    assert "is 0 in rows before its clock was set" in remarks


def test_t_in_degrees_is_a_temperature(tmp_path: Path) -> None:
    report, _ = replayed(table(tmp_path / "a.csv", ["T [degC]"], np.linspace(25.0, 26.0, N)), rate_hz=100.0)
    assert "temperature" in report.channels


def test_a_single_number_beside_arrays_is_no_column(tmp_path: Path) -> None:
    t, gyro, _ = truth(N)
    np.savez(tmp_path / "a.npz", t_s=t, gyro_rads=gyro, rate=np.float64(100.0))
    report, _ = replayed(tmp_path / "a.npz")
    assert report.session.samples == N
