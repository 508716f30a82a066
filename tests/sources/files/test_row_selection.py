"""Rows of sensors with different rates, and rows that are not in the order of their time: an error, or sorted."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from commands import imumon
from logs import SENSOR, ulog
from tables import RATE, csv, read, replayed, truth

from imumon.sources.files import OptionNotApplicable, RecordingError
from imumon.sources.files.base import ROWS
from imumon.sources.files.row_selection import WINDOW

NAMES = ["t", "gx [rad/s]", "gy [rad/s]", "gz [rad/s]", "ax [m/s2]", "ay [m/s2]", "az [m/s2]"]


SIGMA = {"gyro": 7e-4, "accel": 0.013}
"""Standard deviation of a sample of `truth`, SI."""


def refused(path: Path) -> str:
    with pytest.raises(RecordingError) as error:
        replayed(path)
    assert (error.value.code, error.value.cure) == (
        "different_rates",
        "read each alone, --sensor gyro and --sensor accel",
    )
    return error.value.message


@pytest.mark.parametrize(
    ("form", "says", "rates"),
    [
        ("empty cells", "have gyro", {"gyro": 100.0, "accel": 50.0}),
        ("zeros of gyro", "2,000 have gyro", {"gyro": 50.0, "accel": 100.0}),
        ("zeros of accel", "2,000 have accel", {"gyro": 100.0, "accel": 50.0}),
        ("rows of their own", "0 have both", {"gyro": 50.0, "accel": 50.0}),
        ("times of their own", "gyro has the time t_gyro and accel t_accel", {"gyro": 100.0, "accel": 50.0}),
    ],
)
def test_sensors_of_different_rates_are_an_error_whose_cure_gives_the_right_noise(
    tmp_path: Path, form: str, says: str, rates: dict[str, float]
) -> None:
    """Some drivers write zeros for the sensor that has no sample."""
    t, gyro, accel = truth(4000, seed=5)
    names, columns = NAMES, [t, gyro, accel]
    match form:
        case "empty cells":
            accel[1::2] = np.nan
        case "rows of their own":
            gyro[::2], accel[1::2] = np.nan, np.nan
        case "times of their own":
            names = ["t_gyro", *NAMES[1:4], "t_accel", *NAMES[4:]]
            columns = [t, gyro, 2 * t, accel]
        case _:
            {"gyro": gyro, "accel": accel}[form.rpartition(" ")[2]][::2] = 0.0
    path = csv(tmp_path / "a.csv", names, *columns)
    path.write_text(path.read_text().replace("nan", ""))
    assert says in refused(path)
    for sensor, rate in rates.items():
        report, _ = replayed(path, sensor=sensor)
        assert (report.device.sample_rate_hz, report.session.missing) == (rate, 0)
        n = report.channels[f"{sensor}/x"].N
        assert n.low < SIGMA[sensor] / rate**0.5 < n.high < 1.3 * n.low


def test_the_command_reads_one_sensor_of_a_table(tmp_path: Path) -> None:
    t, gyro, accel = truth(4000)
    accel[1::2] = np.nan
    path = csv(tmp_path / "a.csv", NAMES, t, gyro, accel)
    report = json.loads(imumon("replay", path, "--sensor", "accel", "--accept", "--json"))
    assert report["device"]["sample_rate_hz"] == 50.0
    assert "2,000 rows have no number of accel" in " ".join(report["device"]["remarks"])


def test_a_sensor_that_ends_early_is_one_of_another_rate(tmp_path: Path) -> None:
    """Columns of two files side by side: the shorter one is complete in the first block."""
    t, gyro, accel = truth(40_000)
    accel[20_000:] = np.nan
    assert "have both" in refused(csv(tmp_path / "a.csv", NAMES, t, gyro, accel))


def test_the_time_of_a_table_may_be_chosen(tmp_path: Path) -> None:
    t, gyro, accel = truth(1000)
    path = csv(tmp_path / "a.csv", ["t_gyro", *NAMES[1:4], "t_accel", *NAMES[4:]], t, gyro, 2 * t, accel)
    assert replayed(path, columns={"t": "t_gyro"})[0].device.sample_rate_hz == 100.0


def test_one_number_in_place_of_samples_is_missing(tmp_path: Path) -> None:
    t, gyro, accel = truth(4000)
    gyro[::50] = -999.0
    report, remarks = replayed(csv(tmp_path / "a.csv", NAMES, t, gyro, accel))
    assert "80 rows have the same number on all axes of gyro: no samples of it" in remarks
    assert report.session.missing == 79  # the first row is before the grid
    assert report.channels["gyro/x"].std == pytest.approx(7e-4, rel=0.05)


@pytest.mark.parametrize("step", [1e-3, 2e-3])
def test_coarse_numbers_that_repeat_or_are_zero_by_chance_are_samples(tmp_path: Path, step: float) -> None:
    t, gyro, accel = truth(3000)
    report, remarks = replayed(csv(tmp_path / "a.csv", NAMES, t, np.rint(gyro / step) * step, accel))
    assert report.session.samples == len(t)
    assert "repeat" not in remarks or "gyro/x" in report.channels


def test_sensor_and_columns_of_a_capture_are_no_choice(tmp_path: Path) -> None:
    (tmp_path / "b.bin").write_bytes(b'#imumon-recording {"driver": "vn100"}\n$VNRRG,1*XX\r\n')
    with pytest.raises(OptionNotApplicable) as error:
        replayed(tmp_path / "b.bin", columns={"gyro/x": "wx"})
    assert error.value.code == "map_not_applicable"


@pytest.mark.usefixtures("log_in_thread")
@pytest.mark.parametrize(("gyro_us", "accel_us"), [(10_000, 5000), (5000, 10_000)])
def test_sensors_of_a_log_with_different_rates_are_not_joined(
    tmp_path: Path, gyro_us: int, accel_us: int
) -> None:
    """Every second sample of a faster accelerometer would have its noise folded."""
    _, gyro, accel = truth(2000)

    def rows(values: np.ndarray, step: int) -> list[Sequence[float]]:
        return [(10**6 + k * step, 10**6 + k * step, *v, 30.0) for k, v in enumerate(values[: 10**7 // step])]

    path = ulog(
        tmp_path / "a.ulg",
        [("sensor_gyro", 0, SENSOR, rows(gyro, gyro_us)), ("sensor_accel", 0, SENSOR, rows(accel, accel_us))],
    )
    report, remarks = replayed(path, topic="sensor_gyro/0")
    assert "accel/x" not in report.channels
    assert (
        "sensor_accel not used: its samples are at other times; as the chosen topic it is read alone"
        in remarks
    )
    assert replayed(path, topic="sensor_accel/0")[0].device.sample_rate_hz == pytest.approx(1e6 / accel_us)


# ---------------------------------------------------------------- order


def in_order(path: Path, order: np.ndarray, n: int = 4000) -> tuple[np.ndarray, Path]:
    t, gyro, accel = truth(n)
    return gyro, csv(path, NAMES, t[order], gyro[order], accel[order])


@pytest.mark.parametrize("rate", [None, 100.0])
def test_rows_in_random_order_are_an_error(tmp_path: Path, rate: float | None) -> None:
    _, path = in_order(tmp_path / "a.csv", np.random.default_rng(1).permutation(4000))
    with pytest.raises(RecordingError, match="of the steps go back") as error:
        replayed(path, rate_hz=rate)
    assert (error.value.code, error.value.cure) == ("rows_not_sorted", "sort the rows by t")


def test_rows_that_lose_their_order_later_are_an_error(tmp_path: Path) -> None:
    order = np.arange(40_000)
    np.random.default_rng(1).shuffle(order[20_000:])
    _, path = in_order(tmp_path / "a.csv", order, 40_000)
    with pytest.raises(RecordingError) as error:
        replayed(path)
    assert error.value.code == "rows_not_sorted"


def late_rows(n: int) -> np.ndarray:
    """Swap neighbours, delay a row, and swap two datagrams, also where a block ends."""
    order = np.arange(n)
    for k in (5, 40, 900, 1200, ROWS - 1, ROWS + 40, n - 9):
        order[[k, k + 1]] = order[[k + 1, k]]
    order[2000 : 2000 + WINDOW - 4] = np.roll(order[2000 : 2000 + WINDOW - 4], -1)
    order[3000:3020] = np.roll(order[3000:3020], 10)
    return order


def test_late_rows_are_sorted_and_none_is_lost(tmp_path: Path) -> None:
    gyro, path = in_order(tmp_path / "a.csv", late_rows(20_000), 20_000)
    block = read(path)
    assert np.allclose(block.values[:, :3], gyro, rtol=1e-9)
    report, remarks = replayed(path)
    assert (report.session.samples, report.session.missing) == (20_000, 0)
    assert "18 rows are not in the order of t: sorted by it" in remarks


def test_late_rows_behind_a_wrap_of_the_counter_are_sorted(tmp_path: Path) -> None:
    t, gyro, accel = truth(3000)
    order, names = np.arange(3000), ["t_us", *NAMES[1:]]
    for k in (50, 900, 1500, 2900):
        order[[k, k + 1]] = order[[k + 1, k]]
    times = (np.rint(t * 1e6) + 2**32 - 3e6) % 2**32
    path = csv(tmp_path / "a.csv", names, times[order], gyro[order], accel[order])
    assert replayed(path)[0].session.missing == 0


def test_a_clock_that_restarts_or_has_one_wrong_stamp_is_not_sorted(tmp_path: Path) -> None:
    t, gyro, accel = truth(3000)
    for name, stamps in (
        ("restart", np.where(np.arange(3000) < 1500, t, t - t[1500])),
        ("little", np.where(np.arange(3000) < 1500, t, t - 0.2)),
        ("ahead", np.where(np.arange(3000) == 1500, t + 1e4, t)),
        ("behind", np.where(np.arange(3000) == 1500, t - 10.0, t)),
    ):
        path = csv(tmp_path / f"{name}.csv", NAMES, stamps, gyro, accel)
        assert np.allclose(read(path).values[:, :3], gyro, rtol=1e-9), name


@pytest.mark.parametrize("faster", [1.31, 2.0])
def test_held_samples_are_dropped_and_the_noise_is_that_of_the_sensor(tmp_path: Path, faster: float) -> None:
    t, gyro, _ = truth(3000, seed=5)
    rows = np.arange(int(len(t) * faster)) / (RATE * faster) + t[0]
    newest = np.clip(np.searchsorted(t, rows, side="right") - 1, 0, len(t) - 1)
    fast = np.random.default_rng(1).normal((0.1, -0.2, -9.8), 0.013, (len(rows), 3))
    names = ["t [s]", *(f"g{a} [rad/s]" for a in "xyz"), *(f"a{a}" for a in "xyz")]
    path = csv(tmp_path / "a.csv", names, rows, gyro[newest], fast)
    report, remarks = replayed(path)
    assert set(report.channels) == {"accel/x", "accel/y", "accel/z"}
    assert "the rows repeat gyro in" in remarks
    assert "--sensor gyro reads it" in remarks
    report, remarks = replayed(path, sensor="gyro")
    assert "the values of gyro of the row before: they are no samples of it" in remarks
    assert report.session.samples == pytest.approx(len(t), abs=2)
    assert report.device.sample_rate_hz == pytest.approx(RATE, rel=5e-3)
    estimate = report.channels["gyro/y"].N
    assert estimate.low < 7e-4 / RATE**0.5 < estimate.high
