"""A number that may be wrong has a caveat that the settings of other programs show."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from commands import imumon
from followed_cures import outcomes
from tables import DEG, G, csv, replayed, truth

from imumon.api.replay import replay
from imumon.api.replay_options import ReplayOptions
from imumon.sources.files import RecordingError

T, GYRO, ACCEL = truth(800)
NAMES = ["t [s]", *(f"g{a} [rad/s]" for a in "xyz"), *(f"a{a} [m/s2]" for a in "xyz")]
BARE = ["gx", "gy", "gz"]
QUIET = GYRO / DEG * 0.05
"""A gyroscope in deg/s whose noise is as small as that of many in rad/s."""


def kalibr(path: Path) -> str:
    return imumon("report", path, "--format", "kalibr")


@pytest.mark.parametrize(
    ("caveat", "names", "columns"),
    [
        ("assumed unit", [NAMES[0], *BARE, *NAMES[4:]], (T, QUIET, ACCEL)),
        ("doubtful unit", NAMES, (T, GYRO / DEG, ACCEL)),
        ("doubtful unit", NAMES, (T, GYRO, ACCEL * 0.3)),
        ("doubtful rate", [NAMES[0], "sensor_time [s]", *NAMES[1:]], (T, 2.0 * T, GYRO, ACCEL)),
    ],
    ids=["no unit", "noise", "size", "two times"],
)
def test_a_doubt_is_in_the_settings_of_other_programs(
    tmp_path: Path, caveat: str, names: list[str], columns: tuple[np.ndarray, ...]
) -> None:
    assert f"# WARNING: {caveat}: " in kalibr(csv(tmp_path / "a.csv", names, *columns))


def test_what_is_stated_and_fits_has_no_doubt(tmp_path: Path) -> None:
    names = [NAMES[0], "sensor_time [ms]", *NAMES[1:]]
    text = kalibr(csv(tmp_path / "a.csv", names, T, 1e3 * T + 7.0, GYRO, ACCEL))
    assert "assumed unit" not in text
    assert "doubtful" not in text


def test_a_rate_in_a_comment_that_the_times_contradict_is_a_caveat(tmp_path: Path) -> None:
    path = csv(tmp_path / "a.csv", NAMES, T, GYRO, ACCEL)
    path.write_text("# Update Rate: 200.0 Hz\n" + path.read_text())
    assert "# WARNING: doubtful rate: " in kalibr(path)


@pytest.mark.parametrize(("name", "factor"), [("dt", 1.0), ("dt", 1e6), ("dt [ms]", 1e3), ("dt", 1e9)])
def test_intervals_without_a_unit_have_that_of_the_times(tmp_path: Path, name: str, factor: float) -> None:
    names = [NAMES[0], *(f"{s}_{a}" for s in ("delta_angle", "delta_velocity") for a in "xyz"), name]
    path = csv(tmp_path / "a.csv", names, T, GYRO / 100.0, ACCEL / 100.0, np.full(len(T), 0.01 * factor))
    report, _ = replayed(path)
    assert report.channels["accel/z"].mean == pytest.approx(ACCEL[:, 2].mean(), rel=1e-6)
    without_times = csv(
        tmp_path / "b.csv", names[1:], GYRO / 100.0, ACCEL / 100.0, np.full(len(T), 0.01 * factor)
    )
    report, _ = replayed(without_times)
    assert report.channels["accel/z"].mean == pytest.approx(ACCEL[:, 2].mean(), rel=1e-6)


def test_intervals_that_the_times_refute_are_an_error(tmp_path: Path) -> None:
    names = [NAMES[0], *(f"delta_{s}_{a}" for s in ("angle", "velocity") for a in "xyz"), "dt [s]"]
    path = csv(tmp_path / "a.csv", names, T, GYRO / 100.0, ACCEL / 100.0, np.full(len(T), 1e4))
    with pytest.raises(RecordingError) as error:
        replayed(path)
    assert error.value.code == "wrong_interval"
    assert "--map dt=dt:us" in error.value.cure


def test_counts_that_are_near_one_g_in_a_unit_are_counts(tmp_path: Path) -> None:
    path = csv(tmp_path / "a.csv", ["t", "ax", "ay", "az"], T, np.rint(ACCEL / G * 800.0))
    with pytest.raises(RecordingError) as error:
        replayed(path)
    assert error.value.code == "raw_counts"


@pytest.mark.parametrize("ticks", [1e6, 1e4])
def test_fine_times_of_both_kinds_of_xsens_are_known_by_the_rate(tmp_path: Path, ticks: float) -> None:
    names = ["PacketCounter", "SampleTimeFine", *NAMES[1:]]
    path = csv(tmp_path / "a.csv", names, np.arange(len(T)), np.rint(T * ticks), GYRO, ACCEL)
    assert replayed(path)[0].device.sample_rate_hz == pytest.approx(100.0)


def test_a_time_that_is_far_too_slow_in_its_unit_is_a_caveat(tmp_path: Path) -> None:
    report, remarks = replayed(csv(tmp_path / "a.csv", NAMES, T * 1e3, GYRO, ACCEL))
    assert "doubtful_rate" in report.caveats
    assert "--map t=t:ms" in remarks


@pytest.mark.parametrize(
    "names", [[*NAMES[:1], *NAMES[4:], *NAMES[1:4]], ["t [s]", "temp [degC]", *NAMES[1:]]]
)
def test_another_header_ends_the_table(tmp_path: Path, names: list[str]) -> None:
    """Rows behind it would be read as other columns."""
    first = csv(tmp_path / "a.csv", NAMES, T, GYRO, ACCEL).read_text()
    columns = (ACCEL, GYRO) if len(names) == len(NAMES) else (np.full(len(T), 25.0), GYRO, ACCEL)
    path = tmp_path / "c.csv"
    path.write_text(first + csv(tmp_path / "b.csv", names, T + 8.0, *columns).read_text())
    report = replay(ReplayOptions(path=str(path), guarded=False))
    assert report.session.ledger == {"received": 1602, "samples": 800, "header": 1, "other_message": 801}
    assert "truncated" in report.caveats
    path.write_text(first + first.replace("\n1", "\n2"))
    assert replayed(path)[0].session.ledger["header"] == 2


def test_rows_of_two_sensors_in_turn_are_a_caveat(tmp_path: Path) -> None:
    pairs = np.stack([np.hstack([GYRO, ACCEL]), np.hstack([GYRO[::-1] + 2e-4, ACCEL[::-1] + 0.02])], axis=1)
    path = csv(tmp_path / "a.csv", NAMES, np.repeat(T, 2), pairs.reshape(-1, 6))
    assert "mixed_rows" in replayed(path)[0].caveats
    assert "mixed_rows" not in replayed(csv(tmp_path / "b.csv", NAMES, T, GYRO, ACCEL))[0].caveats


@pytest.mark.parametrize("every", [2, 4])
def test_held_samples_of_one_sensor_count_once(tmp_path: Path, every: int) -> None:
    held = ACCEL[np.arange(len(T)) // every * every]
    report, _ = replayed(csv(tmp_path / "a.csv", [NAMES[0], *NAMES[4:]], T, held))
    assert report.device.sample_rate_hz == pytest.approx(100.0 / every, rel=1e-3)
    assert report.session.ledger["repeated"] == len(T) - len(T) // every


@pytest.mark.parametrize(
    ("code", "lines"),
    [
        ("thousands", ["t [ms],gx,gy,gz", *(f'"{1e6 + k:,.3f}",1,2,3' for k in range(30))]),
        ("thousands", ["t [ms];gx;gy;gz", *(f"{k};1;2;1.234,5" for k in range(30))]),
        ("header_differs", ["t,gx,gy,gz", *(f"{k},5,0,1,0,2,0,3" for k in range(30))]),
    ],
)
def test_numbers_of_a_spreadsheet_that_are_ambiguous_are_named(
    tmp_path: Path, code: str, lines: list[str]
) -> None:
    (tmp_path / "a.csv").write_text("\n".join([*lines, ""]))
    with pytest.raises(RecordingError) as error:
        replayed(tmp_path / "a.csv")
    assert error.value.code == code


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_text_in_utf_16_has_a_command_that_converts_it(tmp_path: Path, encoding: str) -> None:
    path = csv(tmp_path / "a.csv", NAMES, T, GYRO, ACCEL)
    path.write_bytes(path.read_text().encode(encoding))
    reports = list(outcomes(path, ReplayOptions(path=str(path), guarded=False)))
    assert [report.session.samples for report in reports] == [len(T)]
