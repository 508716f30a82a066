"""`Measurement`: tables, figures, settings and texts of a report, and what crosses the border of a process."""

from __future__ import annotations

import csv
import io
import json
import math
import pickle
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from commands import imumon as command
from paths import ROOT

import imumon
from imumon import Measurement
from imumon.model.coefficients import NOT_WHITE, Estimate
from imumon.model.errors import ImumonError
from imumon.model.samples import Floats
from imumon.noise.uncertainty import of_records
from imumon.record.record_combination import combined_estimate

mpl.use("Agg")
RATE = 200.0


@pytest.fixture(scope="module")
def m() -> Measurement:
    gyro = imumon.simulate(60_000, RATE, N=[6.1e-5] * 3, B=4e-5, seed=2)
    accel = imumon.simulate(60_000, RATE, N=[1e-3] * 3, B=3e-4, bias=[0.0, 0.0, 9.80665], seed=3)
    gyro[30_000:30_200] += np.random.default_rng(1).normal(0.0, 0.05, (200, 3))
    degrees = 25.0 + 3.0 * np.sin(np.arange(60_000) / 9000.0)
    return imumon.analyse(gyro=gyro, accel=accel, temperature=degrees, rate_hz=RATE, kind="average")


def known(estimate: Estimate | None) -> Estimate:
    assert estimate is not None
    return estimate


def test_channels_by_name(m: Measurement) -> None:
    assert list(m)[:3] == ["gyro/x", "gyro/y", "gyro/z"]
    assert ("gyro/x" in m, "gyro/w" in m, len(m), dict(m)["gyro/y"] == m["gyro/y"]) == (True, False, 7, True)
    n = known(m["gyro/x"].N)
    assert (n.status, n.unit, n.reason) == ("measured", "rad/s/sqrt(Hz)", None)
    assert n.interval == (n.combined_low, n.combined_high)
    assert known(m["gyro/x"].K).interval == (0.0, known(m["gyro/x"].K).high)
    assert (m["temperature"].N, m["gyro/x"].M, m["gyro/x"].R) == (None, None, None)
    with pytest.raises(ImumonError, match="there are gyro/x") as error:
        m["gyro/w"]
    assert error.value.code == "no_channel"


def test_a_text_is_one_screen(m: Measurement) -> None:
    for shown in (repr(m), repr(m.report), repr(m["gyro/x"]), repr(m.allan("gyro/x")), repr(m.filter())):
        assert len(shown) < 4000
        assert shown.count("\n") < 40
    assert "gyro/x" in repr(m)
    assert repr(m).splitlines()[0] == "record"  # arrays have no name, and neither have combinations
    html = m._repr_html_()
    assert html.count("<table") == html.count("</table>") == 2
    assert len(html) < 10_000


def test_tables(m: Measurement) -> None:
    pytest.importorskip("pandas")
    frame = m.to_frame()
    n = known(m["accel/z"].N)
    row = frame.loc["accel/z", "N"]
    assert (row["value"], row["low"], row["combined_high"]) == (n.value, n.low, n.combined_high)
    text = m.text("csv")
    rows = m.rows()
    assert len(list(csv.DictReader(io.StringIO(text)))) == len(rows)
    assert {"kind": "coefficient", "name": "N", "channel": "gyro/x"}.items() <= next(
        row for row in rows if row["kind"] == "coefficient"
    ).items()
    curve = m.allan("gyro/x").to_frame()
    assert len(curve) == len(m["gyro/x"].allan.tau_s)  # type: ignore[union-attr]
    assert list(curve) == ["sigma", "low", "high", "edf", "model", "noise", "used"]


def test_a_dataset_of_xarray(m: Measurement) -> None:
    pytest.importorskip("xarray")
    dataset = m.allan("gyro/x").to_xarray()
    assert dataset.attrs["unit"] == "rad/s"
    assert float(dataset.sigma.sel(tau_s=0.005)) == m.allan("gyro/x").sigma[0]


def test_figures_are_drawn_on_the_axes_of_the_caller(m: Measurement) -> None:
    from matplotlib import pyplot

    figure, (one, two) = pyplot.subplots(1, 2)
    assert m.plot("gyro", ax=one) is one
    assert m.plot_spectrum("accel", ax=two) is two
    assert one.get_xscale() == two.get_yscale() == "log"
    own = m.plot("accel").figure
    assert own is not figure
    narrow, panels = pyplot.subplots(1, 2, layout="constrained")
    for sensor, panel in zip(("gyro", "accel"), panels, strict=True):
        m.plot(sensor, ax=panel)
    for drawn in (own, narrow):  # a legend beside the axes would take their width
        drawn.savefig(io.BytesIO())
        assert sum(panel.get_position().width for panel in drawn.axes) > 0.5
    pyplot.close("all")
    with pytest.raises(ImumonError) as error:
        m.plot("mag")
    assert error.value.code == "unknown_sensor"
    assert m.plot_bias("accel").get_xlabel() == "temperature, °C"
    pyplot.close("all")
    without = imumon.analyse(imumon.simulate(9000, RATE, N=6e-5, seed=1), rate_hz=RATE)
    with pytest.raises(ImumonError) as error:
        without.plot_bias()
    assert error.value.code == "no_bias_curve"


def test_filters_have_the_covariance_of_a_step(m: Measurement) -> None:
    numbers = m.filter(horizon_s=60.0)["gyro/x"]
    n, w, dt = numbers.white, numbers.walk, 0.1
    # the sum of many small steps, without a formula
    transition, total, steps = np.array([[1.0, -dt / 1000], [0.0, 1.0]]), np.zeros((2, 2)), 1000
    for _ in range(steps):
        total = transition @ total @ transition.T + np.diag([n**2, w**2]) * dt / steps
    np.testing.assert_allclose(numbers.Q(dt), total, rtol=3e-3)
    with pytest.raises(ImumonError):
        numbers.Q(0.0)
    with pytest.raises(ImumonError):
        m.filter(horizon_s=0.0)


def test_a_measurement_is_saved_and_loaded(tmp_path: Path, m: Measurement) -> None:
    m.save(tmp_path / "m.json")
    assert imumon.load(tmp_path / "m.json").report == m.report
    again = imumon.analyse(
        imumon.simulate(20_000, RATE, N=[9e-5] * 3, seed=1), rate_hz=RATE, baseline=tmp_path / "m.json"
    )
    assert any(change.against == "baseline" for change in again["gyro/x"].changes)
    (tmp_path / "m.json").write_text("{}")
    for path, code in ((tmp_path / "m.json", "not_a_report"), (tmp_path / "none.json", "file_unreadable")):
        with pytest.raises(ImumonError) as error:
            imumon.load(path)
        assert error.value.code == code


# ---------------------------------------------------------------- across processes


FLEET_N = 1e-4
"""rad/s/√Hz"""
FLEET_RATE = 100.0


def gyroscope(seed: int) -> Floats:
    return imumon.simulate(6000, FLEET_RATE, N=[FLEET_N] * 3, seed=seed)


def test_a_measurement_and_a_growing_record_continue_in_another_process(m: Measurement) -> None:
    assert pickle.loads(pickle.dumps(m)).report == m.report
    live, gyro = imumon.Live(FLEET_RATE), gyroscope(1)
    live.update(gyro[:3000])
    copy = pickle.loads(pickle.dumps(live))
    for one in (live, copy):
        one.update(gyro[3000:])
    assert copy.result().report.channels == live.result().report.channels


@pytest.mark.slow
def test_the_program_of_the_page_combines_recordings_on_a_local_cluster(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="the extra test has dask")
    (program,) = re.findall(
        r"```python example\n(.*?)```", (ROOT / "docs" / "FLEET.md").read_text(), re.DOTALL
    )
    (tmp_path / "fleet.py").write_text(program)
    names = "t_s," + ",".join(f"gyro_{axis} [rad/s]" for axis in "xyz")
    for k in range(4):
        table = np.column_stack((np.arange(6000) / FLEET_RATE, gyroscope(k)))
        np.savetxt(tmp_path / f"{k}.csv", table, "%.9g", ",", header=names, comments="")
    (tmp_path / "damaged.csv").write_text(f"{names}\n")
    done = subprocess.run(
        [sys.executable, "fleet.py", "."],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
        timeout=250,
    )
    assert "damaged.csv: " in done.stdout
    together = imumon.load(tmp_path / "sensor.json")
    for axis in "xyz":
        assert together[f"gyro/{axis}"].N.value == pytest.approx(FLEET_N, rel=0.03)


# ---------- `combine` and `compare`: one sensor from several records, and several sensors side by side


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


def test_noise_that_is_not_white_in_one_record_has_no_grade_in_all(days: list[Measurement]) -> None:
    one = days[0].report
    channels = {
        name: replace(
            channel,
            coefficients={
                **channel.coefficients,
                "N": replace(channel.coefficients["N"], reason_code=NOT_WHITE),
            },
        )
        for name, channel in one.channels.items()
    }
    combined = imumon.combine([replace(days[0], report=replace(one, channels=channels)), *days[1:]])
    assert combined.grade["gyro"].meets is None
    assert "not white" in (combined.grade["gyro"].reason or "")


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
