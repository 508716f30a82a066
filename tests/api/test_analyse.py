"""`imumon.analyse`: one path to a number, whichever way samples come, and no number from what is no record."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from analyses import comparable
from commands import imumon as command
from tables import csv

import imumon
from imumon.model.errors import ImumonError
from imumon.model.report import Report, from_json

RATE, N = 200.0, 6.1e-5
SAMPLES = 24_000


def samples(effect: str) -> dict[str, Any]:
    """Return arrays of a sensor at rest with an effect that occurs every day."""
    rng = np.random.default_rng(5)
    gyro = imumon.simulate(SAMPLES, RATE, N=[N] * 3, B=2e-5, seed=1)
    arrays: dict[str, Any] = {"gyro": gyro}
    if effect == "none":
        arrays["accel"] = imumon.simulate(SAMPLES, RATE, N=[1e-3] * 3, bias=[0.0, 0.0, 9.80665], seed=2)
    if effect == "glitches":
        gyro[rng.integers(0, SAMPLES, 20), rng.integers(0, 3, 20)] += 0.1
    elif effect == "knocks":
        for begin in (3_000, 10_000, 20_000):
            gyro[begin : begin + 200] += rng.normal(0.0, 0.02, (200, 3))
    elif effect == "quantised":
        step = 2.3 * N * np.sqrt(RATE)
        arrays["gyro"] = step * np.rint(gyro / step)
    elif effect == "temperature":
        degrees = 25.0 + 2.0 * np.sin(2.0 * np.pi * np.arange(SAMPLES) / SAMPLES)
        arrays |= {"gyro": gyro + 1e-4 * (degrees - 25.0)[:, None], "temperature": degrees}
    elif effect == "missing":
        gyro[rng.random(SAMPLES) < 0.01, 0] = np.nan
    return arrays


EFFECTS = ("glitches", "knocks", "quantised", "temperature", "missing")


@pytest.mark.few(2)
@pytest.mark.parametrize("effect", EFFECTS)
def test_a_file_its_arrays_and_the_command_give_equal_reports(tmp_path: Path, effect: str) -> None:
    arrays, path = samples(effect), tmp_path / "a.npz"
    units = {"gyro": "rps", "accel": "mps2", "temperature": "degC"}
    stated = {f"{name}_{units[name]}": array for name, array in arrays.items()}
    np.savez(path, **stated)
    of_file = imumon.analyse(path, rate_hz=RATE)
    of_arrays = imumon.analyse(**arrays, rate_hz=RATE)
    masked = {name: np.ma.masked_invalid(array) for name, array in stated.items()}
    of_mapping = imumon.analyse(masked, rate_hz=RATE)
    printed = from_json(Report, command("replay", path, "--rate", "200", "--json"))
    assert comparable(of_arrays.report) == comparable(of_file.report)
    assert comparable(of_mapping.report) == comparable(of_file.report)
    assert comparable(printed) == comparable(of_file.report)
    x = of_file["gyro/x"].N
    if effect == "quantised":
        assert (x.status, x.value) == ("pending", None)
        assert x.reason
    else:
        low, high = x.interval
        assert 0.98 * low < N < 1.02 * high


def test_a_table_with_time_is_the_same_as_text_and_as_a_frame(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    arrays = {name: array[:6000] for name, array in samples("none").items()}
    t = 5.0 + np.arange(6000) / RATE
    kept = np.random.default_rng(1).random(6000) > 0.02  # the others are lost
    names = [
        "t [s]",
        *(f"gyro_{axis} [rad/s]" for axis in "xyz"),
        *(f"accel_{axis} [m/s2]" for axis in "xyz"),
    ]
    path = csv(tmp_path / "a.csv", names, t[kept], arrays["gyro"][kept], arrays["accel"][kept])
    frame = pandas.read_csv(path)
    of_file = comparable(imumon.analyse(str(path)).report)
    assert of_file.session.missing == np.count_nonzero(~kept)
    assert comparable(imumon.analyse(frame).report) == of_file
    assert comparable(imumon.analyse(frame.convert_dtypes()).report) == of_file
    assert comparable(imumon.analyse(frame.set_index("t [s]")).report) == of_file
    columns = {name: frame[name].to_numpy() for name in frame}
    by_sensor = {
        s: np.column_stack([v for k, v in columns.items() if k.startswith(s)]) for s in ("gyro", "accel")
    }
    # the file states its units
    units = {"gyro": "rad/s", "accel": "m/s2"}
    of_arrays = imumon.analyse(**by_sensor, time_s=columns["t [s]"], units=units)
    assert comparable(of_arrays.report) == of_file


@pytest.mark.parametrize(
    ("given", "code"),
    [
        ({"gyro": np.zeros((3, 900))}, "array_transposed"),
        ({"gyro": np.zeros((900, 6))}, "array_shape"),
        ({"gyro": np.zeros((0, 3))}, "no_rows"),
        ({"source": {"gyro": np.zeros((0, 3))}}, "no_rows"),
        ({"gyro": np.full((900, 3), 1e-3)}, "all_constant"),
        ({"gyro": np.full((900, 3), np.nan)}, "no_complete_row"),
        ({"gyro": np.ones((900, 3), object)}, "array_type"),
        ({"gyro": np.ones((900, 3)), "accel": np.ones((800, 3))}, "array_lengths"),
        ({"gyro": np.ones((900, 3)), "time_s": np.ones((900, 2))}, "array_shape"),
        ({"gyro": np.ones((900, 3)), "time_s": np.r_[0.0:450.0, 100.0:550.0]}, "time_goes_back"),
        ({"accel": np.ones((900, 3)) * [0.0, 0.0, 1.0]}, "wrong_unit"),
        ({"gyro": np.ones((900, 3)), "units": {"gyro": "furlong"}}, "unknown_unit"),
        ({"gyro": np.ones((900, 3)), "units": {"gyros": "deg/s"}}, "units_of_unknown"),
        ({"gyro": np.ones((900, 3)), "kind": "samples"}, "kind_unknown"),
        (
            {"source": {"delta_theta": np.random.default_rng(0).normal(size=(90, 3))}, "kind": "point"},
            "kind_contradicts",
        ),
        ({}, "no_source"),
        ({"source": "a.csv", "gyro": np.ones((900, 3))}, "two_sources"),
        ({"source": "no_such_file.csv"}, "not_readable"),
        ({"gyro": np.ones((900, 3)), "filter": "strong"}, "filter_invalid"),
        ({"gyro": np.ones((900, 3)), "stream": "best"}, "stream_invalid"),
        ({"gyro": np.ones((900, 3)), "precision": {"X": 0.1}}, "precision_invalid"),
    ],
)
def test_bad_input_is_an_error_with_a_cure_and_never_a_number(given: dict[str, Any], code: str) -> None:
    given = (
        given if "time_s" in given or isinstance(given.get("source"), str) else {"rate_hz": 200.0, **given}
    )
    with pytest.raises(ImumonError) as error:
        imumon.analyse(**given)
    assert (error.value.code, bool(error.value.cure)) == (code, True)
    assert "--" not in str(error.value)


def test_increments_averages_and_units_are_one_measurement() -> None:
    rates = imumon.simulate(20_000, RATE, N=[N] * 3, seed=4)
    average = imumon.analyse(rates, rate_hz=RATE, kind="average")["gyro/x"].N
    increment = imumon.analyse(rates / RATE, rate_hz=RATE, kind="increment")["gyro/x"].N
    degrees = imumon.analyse(np.degrees(rates), rate_hz=RATE, kind="average", units={"gyro": "deg/s"})[
        "gyro/x"
    ].N
    assert average.value is not None
    for other in (increment, degrees):
        assert other.value == pytest.approx(average.value, rel=1e-9)


def test_importing_loads_no_numbers_and_threads_stay_those_of_the_caller() -> None:
    code = """
import sys
import imumon
assert not {"numpy", "scipy", "pandas", "matplotlib"} & set(sys.modules), "loaded"
import numpy as np
from threadpoolctl import threadpool_info, threadpool_limits
with threadpool_limits(2, user_api="blas"):
    before = {pool["filepath"]: pool["num_threads"] for pool in threadpool_info()}
    imumon.analyse(np.random.default_rng(1).normal(0.0, 1e-3, (900, 3)), rate_hz=100.0)
    after = {pool["filepath"]: pool["num_threads"] for pool in threadpool_info()}
    assert before.items() <= after.items(), (before, after)
assert not {"pandas", "xarray", "matplotlib"} & set(sys.modules), "loaded by analyse"
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
