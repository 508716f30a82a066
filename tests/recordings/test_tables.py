"""Tables of other programs: CSV of many dialects, NumPy archives and bags become the same samples."""

from __future__ import annotations

import json
import textwrap
import tracemalloc
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from bags import BAGS, write_bag2
from commands import imumon
from paths import RECORDINGS, needs_recordings
from tables import DEG, RATE, G, csv, read, truth

from imumon.api.replay import replay
from imumon.api.replay_options import ReplayOptions
from imumon.cli.exit_codes import FAILURE, NOT_FOUND, WITHOUT_SAMPLES
from imumon.grid.stamp_kinds import stamp_interval
from imumon.grid.stamp_placement import HostStamps
from imumon.model.errors import RateRequired
from imumon.model.samples import SampleBlock
from imumon.sources.column_names import parse_name
from imumon.sources.files import ReadOptions, RecordingError, open_recording
from imumon.sources.files import csv as csv_module
from imumon.sources.files.csv import CsvFile

HEADER = ["t", "wx", "wy", "wz", "ax", "ay", "az"]
GYRO, ACCEL = slice(0, 3), slice(3, 6)
SPELLINGS = [
    ("time [s],gyro_x [rad/s],gyro_y [rad/s],gyro_z [rad/s],acc_x [m/s^2],acc_y [m/s²],acc_z (mps2)",
     1, 1, 1),
    ("t,wx,wy,wz,ax,ay,az", 1, 1, 1),
    ("timestamp_us,gx_dps,gy_dps,gz_dps,ax_g,ay_g,az_g", 1e6, 1 / DEG, 1 / G),
    ("#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],"
     "a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]", 1e9, 1, 1),
    ("%time,field.angular_velocity.x,field.angular_velocity.y,field.angular_velocity.z,"
     "field.linear_acceleration.x,field.linear_acceleration.y,field.linear_acceleration.z", 1e9, 1, 1),
    ("Time (ms),GyroX (°/s),GyroY (°/s),GyroZ (°/s),AccX (mg),AccY (mg),AccZ (mg)", 1e3, 1 / DEG, 1000 / G),
    ("Time::TimeStartup [ns],IMU::UncompGyro::X [rad/s],IMU::UncompGyro::Y [rad/s],"
     "IMU::UncompGyro::Z [rad/s],IMU::UncompAccel::X [m/s^2],IMU::UncompAccel::Y [m/s^2],"
     "IMU::UncompAccel::Z [m/s^2]", 1e9, 1, 1),
]  # fmt: skip


@pytest.mark.parametrize(("header", "time", "rate", "force"), SPELLINGS, ids=[s[0][:24] for s in SPELLINGS])
@pytest.mark.parametrize("sep", [",", ";", "\t"])
def test_every_spelling_gives_the_same_samples(
    tmp_path: Path, header: str, time: float, rate: float, force: float, sep: str
) -> None:
    t, gyro, accel = truth()
    path = csv(tmp_path / "a.csv", header.split(","), t * time, gyro * rate, accel * force, sep=sep)
    found = read(path)
    np.testing.assert_allclose(found.values[:, GYRO], gyro, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.values[:, ACCEL], accel, rtol=1e-9)
    assert found.stream.clock == "startup"
    assert found.stream.kind == ("uncompensated" if "Uncomp" in header else "unknown")
    assert found.stream.interval_s == pytest.approx(1 / RATE, rel=1e-9)
    assert found.time_ns is not None
    np.testing.assert_allclose(np.diff(found.time_ns), 1e9 / RATE, atol=2)


def test_seconds_and_nanoseconds_in_two_columns_are_added(tmp_path: Path) -> None:
    t, gyro, accel = truth()
    stamp = 1_700_000_000_000_000_000 + np.rint(t * 1e9).astype(np.int64)
    names = ["Time", "header.stamp.secs", "header.stamp.nsecs"]
    names += [f"angular_velocity.{a}" for a in "xyz"] + [f"linear_acceleration.{a}" for a in "xyz"]
    rng = np.random.default_rng(1)
    arrival = stamp * 1e-9 + rng.uniform(0, 0.02, len(t))
    rows = zip(arrival, stamp // 10**9, stamp % 10**9, *gyro.T, *accel.T, strict=True)
    path = tmp_path / "a.csv"
    path.write_text("\n".join([",".join(names), *(",".join(map(str, row)) for row in rows)]))
    found = read(path)
    assert found.time_ns is not None
    np.testing.assert_array_equal(np.diff(found.time_ns), np.full(len(t) - 1, 10_000_000))


def test_the_best_stream_is_used_and_another_can_be_selected(tmp_path: Path) -> None:
    t, gyro, accel = truth()
    names = ["t [s]", "dt [s]"]
    for group in ("DeltaTheta", "DeltaVel", "UncompGyro", "AngularRate", "Accel"):
        names += [f"{group}::{axis}" for axis in "XYZ"]
    names[2] = "DeltaTheta::X [deg]"
    names[3:5] = ["DeltaTheta::Y [deg]", "DeltaTheta::Z [deg]"]
    dt = np.full(len(t), 1 / RATE)
    path = csv(
        tmp_path / "a.csv", names, t, dt, gyro / RATE / DEG, accel / RATE, gyro + 1.0, gyro + 2.0, accel + 3.0
    )
    expected = {"deltas": (0.0, 0.0), "uncompensated": (1.0, 3.0), "compensated": (2.0, 3.0)}
    assert read(path).stream.kind == "deltas"
    for kind, (more_gyro, more_accel) in expected.items():
        found = read(path, kind=kind)
        assert found.stream.kind == kind
        np.testing.assert_allclose(found.values[:, GYRO], gyro + more_gyro, atol=1e-9)
        np.testing.assert_allclose(found.values[:, ACCEL], accel + more_accel, atol=1e-9)


def test_columns_can_be_assigned_by_name_or_number(tmp_path: Path) -> None:
    t, gyro, accel = truth()
    path = csv(tmp_path / "a.csv", ["tic", "p", "q", "r", "u", "v", "w1"], t * 1e3, gyro / DEG, accel)
    option = "gyro/x=p:deg/s,gyro/y=q:deg/s,gyro/z=4:deg/s,accel/x=u,accel/y=v,accel/z=w1:m/s^2,t=tic:ms"
    shown = json.loads(imumon("replay", path, "--map", option, "--json"))
    assert shown["channels"]["gyro/z"]["mean"] == pytest.approx(gyro[:, 2].mean(), rel=1e-9)
    assert shown["device"]["sample_rate_hz"] == pytest.approx(RATE)
    bare = tmp_path / "bare.txt"
    bare.write_text("\n".join(path.read_text().splitlines()[1:]))
    assert "7 columns" in imumon("replay", bare.rename(tmp_path / "bare.csv"), code=1)
    by_number = option.replace("=p", "=2").replace("=q", "=3").replace("=u", "=5").replace("=v", "=6")
    by_number = by_number.replace("=w1", "=7").replace("=tic", "=1")
    again = json.loads(imumon("replay", tmp_path / "bare.csv", "--map", by_number, "--json"))
    assert again["channels"]["accel/y"]["mean"] == shown["channels"]["accel/y"]["mean"]


def test_without_time_the_rate_is_required(tmp_path: Path) -> None:
    _, gyro, accel = truth()
    path = csv(tmp_path / "a.csv.gz", HEADER[1:], gyro, accel)
    with pytest.raises(RateRequired):
        read(path)
    assert "--rate" in imumon("replay", path, code=2)
    assert json.loads(imumon("replay", path, "--rate", "50", "--json"))["session"]["elapsed_s"] == 8.0


def test_missing_rows_are_gaps_of_their_length(tmp_path: Path) -> None:
    t, gyro, accel = truth()
    keep = np.ones(len(t), dtype=bool)
    keep[100:107] = False
    path = csv(tmp_path / "a.csv", HEADER, t[keep], gyro[keep], accel[keep])
    lines = path.read_text().splitlines()
    lines[201] = lines[201].rpartition(",")[0] + ","  # a cell that was not filled
    path.write_text("\n".join(lines))
    session = replay(ReplayOptions(path=str(path), guarded=False)).session
    assert (session.samples, session.missing, session.gaps) == (len(t) - 8, 8, 2)


def test_times_of_arrival_are_no_clock(tmp_path: Path) -> None:
    t, gyro, accel = truth()
    arrival = np.repeat(t[::2], 2)  # in pairs, as USB delivers
    path = csv(tmp_path / "a.csv", HEADER, arrival, gyro, accel)
    found = read(path)
    assert found.stream.clock == "none"
    assert found.stream.interval_s == pytest.approx(1 / RATE, rel=0.01)
    assert len(found) == len(t)
    remarks: list[str] = []
    replay(ReplayOptions(path=str(path)), remark=remarks.append)
    assert "those of a host" in "".join(remarks)


DELAYS = {
    "scheduler": lambda rng, n: rng.exponential(0.3, n),
    "rounded": lambda rng, n: np.zeros(n),
    "pairs": lambda rng, n: 1.0 - np.arange(n) % 2 + rng.exponential(0.02, n),
    "batches": lambda rng, n: 15.0 - np.arange(n) % 16 + rng.exponential(0.02, n),
    "stalls": lambda rng, n: np.maximum(rng.exponential(0.1, n), 40.0 - (np.arange(n) + 500) % 1000),
}


@pytest.mark.parametrize("kind", DELAYS)
@pytest.mark.parametrize("piece", [1000, 50_000])
def test_stamps_of_a_host_show_rate_and_lost_samples(kind: str, piece: int) -> None:
    rng = np.random.default_rng(5)
    n, rate = 30_000, 399.3
    kept = rng.random(n) >= 0.002
    kept[[0, -1]] = True
    kept[20_000:20_777] = False
    times = np.maximum.accumulate((np.arange(n) + DELAYS[kind](rng, n)) / rate * 1e9)[kept]
    if kind == "rounded":
        times = np.rint(times / 1e6) * 1e6
    times -= times[0]
    tick, steady = stamp_interval(times[:20_000])
    assert not steady
    assert 1e9 / tick == pytest.approx(rate, rel=2e-5)
    stamps, nothing = np.rint(times).astype(np.int64), np.zeros(n, np.int64)
    host = HostStamps(stamps[:20_000], tick)
    parts = [slice(begin, begin + piece) for begin in range(0, n, piece)]
    placed = [host.place(part := stamps[rows], nothing[: len(part)]) for rows in parts]
    placed.append(host.place(nothing[:0], nothing[:0], final=True))
    index = np.cumsum(np.concatenate([rows.steps for rows in placed])) - 1
    assert not host.hides_losses
    # samples lost within a batch count before it: their place in it is unknown
    assert np.abs(index - np.flatnonzero(kept)).max() <= (16 if kind == "batches" else 2)
    assert index[-1] == n - 1


@pytest.mark.parametrize("haste_s", [0.0, 2e-5])
@pytest.mark.parametrize(("rate", "read_s"), [(40, 0.25), (100, 0.1), (200, 0.05), (800, 0.016), (800, 0.1)])
def test_stamps_of_rows_read_in_bursts_show_the_rate(rate: int, read_s: float, haste_s: float) -> None:
    t = np.arange(40 * rate) / rate
    begin = np.ceil((t + 1e-4) / read_s)
    place = np.arange(len(t)) - np.searchsorted(begin, begin)  # in its burst
    times = np.rint((begin * read_s + place * haste_s) * 1e9)
    tick, steady = stamp_interval(times)
    assert not steady
    assert 1e9 / tick == pytest.approx(rate, rel=1e-4)
    stamps = times.astype(np.int64)
    placed = HostStamps(stamps, tick).place(stamps, np.zeros(len(stamps), np.int64), final=True)
    assert int((placed.steps - 1).sum()) <= 1


HEAD = "t,wx,wy,wz,ax,ay,az\n"
ROWS = [f"{k / 100},0.001,0.002,{k % 7}e-4,0.1,0.2,-9.8" for k in range(200)]


@pytest.mark.parametrize(
    ("text", "code", "names"),
    [
        (
            HEAD + "\n".join([*ROWS[:99], *["0.99,oops,0,0,0,0,-9.8"] * 40, ROWS[150]]),
            "too_many_invalid_rows",
            ("line 101", "oops", "40 of 140"),
        ),
        (
            HEAD + "\n".join([*ROWS[:99], *["0.99,0.1"] * 40]),
            "too_many_invalid_rows",
            ("line 101", "2 columns"),
        ),
        ("t,wx,wy,speed\n" + "\n".join("0.1,2,3,4" for _ in ROWS), "sensor_incomplete", ("wx, wy", "--map")),
        ("t,gyroo_x,b,c\n" + "\n".join("0.1,2,3,4" for _ in ROWS), "no_sensor", ("gyroo_x", "--map")),
        (HEAD.replace("wx", "wx [furlong]") + "\n".join(ROWS), "unknown_unit", ("furlong", "deg/s")),
        (HEAD + "\n".join(row.replace("-9.8", "-1.0") for row in ROWS), "wrong_unit", ("[g]",)),
        (HEAD + "\n".join(row.replace("0.001", "150.0") for row in ROWS), "wrong_unit", ("[deg/s]",)),
        (HEAD + "\n".join("1.0" + row[row.index(",") :] for row in ROWS), "time_constant", ()),
        (
            HEAD + "\n".join("noon" + row[row.index(",") :] for row in ROWS),
            "time_not_readable",
            ("'noon'", "--rate", "--map"),
        ),
        (HEAD, "no_rows", ()),
        ("", "empty", ()),
    ],
    ids=["word", "short", "axes", "near", "unit", "g", "deg", "time", "noon", "rows", "empty"],
)
def test_a_bad_file_is_one_line_with_a_code(
    tmp_path: Path, text: str, code: str, names: tuple[str, ...]
) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(RecordingError) as error:
        replay(ReplayOptions(path=str(path)))
    assert error.value.code == code
    expected = NOT_FOUND if code in WITHOUT_SAMPLES else FAILURE
    assert imumon("replay", path, code=expected).strip() == f"imumon: {error.value}"
    for name in ("bad.csv", *names):
        assert name in str(error.value)


@pytest.mark.parametrize(
    "form",
    [
        "%Y-%m-%dT%H:%M:%S.%fZ",
        "%Y-%m-%d %H:%M:%S.%f",
        "%H:%M:%S.%f",
        '"%H:%M:%S,%f"',
        "%Y-%-m-%-d %-H:%M:%S:%f",
        "%Y-%m-%dT%H.%M.%S.%f",
    ],
    ids=["iso", "blank", "day", "comma", "colon", "dots"],
)
def test_times_may_be_dates(tmp_path: Path, form: str) -> None:
    begun, path = datetime(2026, 1, 31, 23, 59, 59), tmp_path / "a.csv"
    rows = [
        f"{begun + timedelta(seconds=k / 100):{form}}{row[row.index(',') :]}" for k, row in enumerate(ROWS)
    ]
    path.write_text(HEAD + "\n".join([*rows[:120], *rows[121:]]) + "\n")  # past midnight, one is lost
    found = read(path)
    assert found.time_ns is not None
    assert found.time_ns.tolist() == [10_000_000 * k for k in range(200) if k != 120]


def test_a_sensor_without_numbers_is_left_out_with_a_remark(tmp_path: Path) -> None:
    path = tmp_path / "half.csv"
    path.write_text(HEAD + "\n".join(row.replace(",0.1,", ",nan,") for row in ROWS))
    done = imumon("replay", path, "--json")
    assert set(json.loads(done)["channels"]) == {"gyro/x", "gyro/y", "gyro/z"}
    file = open_recording(str(path), ReadOptions())
    assert isinstance(file, CsvFile)
    assert sum(len(block) for some in file for block in some) == len(ROWS)
    assert [text for text in file.remarks if "ax holds no numbers: accel is left out" in text]


def test_utf_16_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "wide.csv"
    path.write_text(HEAD + "\n".join(ROWS), encoding="utf-16")
    with pytest.raises(RecordingError) as error:
        read(path)
    assert error.value.code == "utf_16"


@pytest.mark.parametrize(
    ("row", "shown"),
    [("0.99,oops,0,0,0,0,-9.8", "'oops'"), ("0.99,0.1", "2 columns"), ("\x00\x7f garbage", "line 101")],
    ids=["word", "short", "garbage"],
)
def test_an_invalid_row_is_a_lost_sample_and_is_named(tmp_path: Path, row: str, shown: str) -> None:
    path = tmp_path / "invalid.csv"
    path.write_text(HEAD + "\n".join([*ROWS[:99], row, *ROWS[100:150], HEAD.strip(), "# note", *ROWS[150:]]))
    remarks: list[str] = []
    session = replay(ReplayOptions(path=str(path), guarded=False), remark=remarks.append).session
    assert (session.samples, session.missing, session.gaps, session.bad_checksums) == (199, 1, 1, 1)
    assert not [text for text in remarks if "lacks a number" in text]
    (text,) = (text for text in remarks if "1 row is invalid" in text)
    assert "line 101" in text
    assert shown in text


UNITLESS = "t,wx,wy,wz,ax,ay,az"
IN_DEGREES = [
    f"{k / 100},{np.degrees(0.001)},{np.degrees(0.002)},{np.degrees(k % 7 * 1e-4)},0.1,0.2,-9.8"
    for k in range(200)
]


@pytest.mark.parametrize(
    "text",
    [
        "\r".join([UNITLESS, *ROWS]),
        "\r\n".join([UNITLESS, *ROWS]),
        "\n".join(["# by someone, in spring, at home", "# more, of it", UNITLESS, *ROWS]),
        "\n".join(["Device,VN-100", "Serial,0100", "Rate,100", "", UNITLESS, *ROWS]),
        "\n".join([UNITLESS.replace(",", "\t"), *(row.replace(",", "\t").replace(".", ",") for row in ROWS)]),
        "\n".join([UNITLESS, "s,deg/s,deg/s,deg/s,m/s^2,m/s^2,m/s^2", *IN_DEGREES]),
        "\n".join(["t,wx [°/s],wy [°/s],wz [°/s],ax,ay,az", *IN_DEGREES]),
        "\n".join([UNITLESS, *ROWS[:100], ROWS[100].replace("-9.8", "1e9"), *ROWS[101:]]),
        "\n".join([UNITLESS, *ROWS[:100], ROWS[100].replace("-9.8", "inf"), *ROWS[101:]]),
        "\n".join([UNITLESS, *ROWS[:100], ROWS[100].replace("-9.8", "1e300"), *ROWS[101:]]),
    ],
    ids=["cr", "crlf", "comments", "facts", "tabs", "units", "latin", "spike", "inf", "absurd"],
)
@pytest.mark.parametrize("reader", ["pyarrow", "numpy"])
def test_the_dialect_does_not_change_the_numbers(
    tmp_path: Path, text: str, reader: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if reader == "numpy":
        monkeypatch.setattr("imumon.sources.files.csv._arrow", lambda: None)
    path = tmp_path / "a.csv"
    path.write_bytes(text.encode("latin-1"))
    found = read(path)
    assert found.stream.interval_s == pytest.approx(0.01)
    assert len(found) in (199, 200)
    assert found.values[:100, 1] == pytest.approx(0.002)
    assert found.values[:7, 2] == pytest.approx(np.arange(7) * 1e-4)


def test_the_fast_reader_is_used_and_gives_the_same_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cells that are empty, quoted, far away or of another column; the second half ends its lines with CR LF."""
    csv_reader = pytest.importorskip("pyarrow.csv", reason="pyarrow is not installed (extra fast)")
    t, gyro, accel = truth(4000)
    path = csv(tmp_path / "a.csv", [*HEADER, "note"], t, gyro, accel, t)
    lines = path.read_bytes().splitlines()
    lines[1:] = [line.rpartition(b",")[0] + b',"a, b"' for line in lines[1:]]
    lines[70] = lines[70].replace(lines[70].split(b",")[2], b"")
    lines[90] = lines[90].replace(lines[90].split(b",")[3], b'"0.5e-3"')
    path.write_bytes(b"\n".join(lines[:2000]) + b"\n" + b"\r\n".join(lines[2000:]) + b"\r\n")
    calls = []
    original = csv_reader.read_csv
    monkeypatch.setattr(csv_reader, "read_csv", lambda *a, **k: calls.append(1) or original(*a, **k))
    fast = read(path)
    assert calls
    monkeypatch.setattr("imumon.sources.files.csv._arrow", lambda: None)
    plain = read(path)
    np.testing.assert_array_equal(fast.values, plain.values)
    np.testing.assert_array_equal(fast.lost, plain.lost)
    assert (len(fast), fast.lost.sum()) == (3999, 1)


def test_a_truncated_last_line_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "cut.csv"
    path.write_text(HEAD + "\n".join(ROWS) + "\n2.00,0.0")
    assert len(read(path)) == len(ROWS)


@pytest.mark.slow
def test_memory_does_not_grow_with_the_length(tmp_path: Path) -> None:
    def peak(rows: int) -> int:
        path = tmp_path / f"{rows}.csv"
        with path.open("w") as file:
            file.write(HEAD)
            for k in range(rows):
                file.write(f"{k / 100},0.001,0.002,{k % 7}e-4,0.1,0.2,-9.8\n")
        tracemalloc.start()
        count = sum(len(block) for some in ReplayOptions(path=str(path)).open() for block in some)
        assert count == rows
        top = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return top

    peak(100)  # modules that are imported now
    assert peak(160_000) < 1.1 * peak(80_000)


def test_archive_is_the_same_as_csv(tmp_path: Path) -> None:
    t, gyro, accel = truth()
    np.savez(tmp_path / "a.npz", t=t, gyro=gyro, accel=accel, temp_C=np.full(len(t), 21.0), name="x")
    one = read(tmp_path / "a.npz")
    other = read(csv(tmp_path / "a.csv", HEADER, t, gyro, accel))
    np.testing.assert_allclose(one.values[:, :6], other.values, rtol=1e-9, atol=1e-12)
    assert one.stream.channels[-1] == "temperature"
    np.testing.assert_array_equal(one.time_ns, other.time_ns)
    np.savez(tmp_path / "b.npz", position=gyro)
    with pytest.raises(RecordingError) as error:
        read(tmp_path / "b.npz")
    assert error.value.code == "no_sensor"


@pytest.mark.parametrize("kind", BAGS)
def test_bags_give_the_stamps_and_values_of_their_messages(tmp_path: Path, kind: str) -> None:
    t, gyro, accel = truth(200)
    stamps = 1_700_000_000_000_000_000 + np.rint(t * 1e9).astype(np.int64)
    keep = [k for k in range(200) if k not in (50, 51)]
    messages = [(int(stamps[k]), gyro[k], accel[k]) for k in keep]
    path = BAGS[kind](tmp_path / "bag", messages)
    found = read(path)
    np.testing.assert_allclose(found.values, np.hstack([gyro, accel])[keep], rtol=1e-12)
    report = replay(ReplayOptions(path=str(path), guarded=False))
    assert (report.session.samples, report.session.missing, report.session.gaps) == (198, 2, 1)
    with pytest.raises(RecordingError, match="/imu/data") as error:
        read(path, topic="/gps")
    assert error.value.code == "unknown_topic"


def test_a_corrupt_bag_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "a.bag"
    path.write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
    with pytest.raises(RecordingError, match=r"a\.bag") as error:
        read(path)
    assert error.value.code == "bag_corrupt"


@pytest.mark.parametrize(
    ("name", "quantity", "axis"),
    [
        ("angular_velocity_covariance[0]", None, None),
        ("orientation.x", None, None),
        ("gyro_bias_x", None, None),
        ("magnetic_field.z", "mag", "z"),
        ("gyroscope_y", "gyro", "y"),
        ("accelerometer[2]", "accel", "z"),
        ("baro_pressure [hPa]", "pressure", None),
    ],
)
def test_names_are_parsed(name: str, quantity: str | None, axis: str | None) -> None:
    column = parse_name(0, name)
    assert (column.quantity, column.axis if quantity else None) == (quantity, axis)


@needs_recordings
def test_real_table_shows_the_aliasing_of_the_sensors_filter() -> None:
    path = RECORDINGS / "instinct_vn310_static.orig.csv.gz"
    deltas, points = read(path), read(path, kind="uncompensated")
    assert deltas.stream.kind == "deltas"
    assert deltas.stream.interval_s == pytest.approx(0.05)
    ratio = points.values[:, :6].std(axis=0) / deltas.values[:, :6].std(axis=0)
    # at 20 Hz behind a boxcar of 5 ms: sqrt(200 / 20) = 3.2, each a little off, quantised and few
    assert np.all((ratio > 2.0) & (ratio < 6.0))
    np.testing.assert_allclose(
        points.values[:, :3].mean(axis=0), deltas.values[:, :3].mean(axis=0), atol=5e-5
    )


@needs_recordings
@pytest.mark.parametrize(
    ("name", "samples", "missing", "rate"),
    [
        ("pelka_zup.npz", 794, 5, 160.0),
        ("lwi_F00294.npz", 99, 0, 10.0),
        ("instinct_vn310_lckf.npz", 1612, 0, 50.0),
        ("instinct_vn310_lckf.orig.csv.gz", 1612, 0, 50.0),
    ],
)
def test_real_tables(name: str, samples: int, missing: int, rate: float) -> None:
    report = replay(ReplayOptions(path=str(RECORDINGS / name), guarded=False))
    assert (report.session.samples, report.session.missing) == (samples, missing)
    assert report.device.sample_rate_hz == pytest.approx(rate, rel=1e-3)


@needs_recordings
def test_real_irregular_times_are_put_on_a_grid() -> None:
    report = replay(ReplayOptions(path=str(RECORDINGS / "rob_static2.npz"), guarded=False))
    assert report.session.samples == 1264
    assert report.session.elapsed_s == pytest.approx(82.6, rel=0.02)
    assert 15.0 < (report.device.sample_rate_hz or 0.0) < 16.0


def test_the_settings_name_the_topic_of_the_bag_and_the_rate(tmp_path: Path) -> None:
    t, gyro, accel = truth(500)
    stamps = 1_700_000_000_000_000_000 + np.rint(t * 1e9).astype(np.int64)
    rows = list(zip(stamps.tolist(), gyro, accel, strict=True))
    bag = write_bag2(tmp_path / "bag", rows, topic="/imu/raw")
    table = csv(tmp_path / "a.csv", ["t [s]", "gx", "gy", "gz", "ax", "ay", "az"], t, gyro, accel)

    def settings(*words: str | Path, form: str = "kalibr") -> str:
        return imumon("report", *words, "--format", form)

    assert "rostopic: /imu/raw\nupdate_rate: 100\n" in settings(bag)
    assert "rostopic: /imu/data\nupdate_rate: 100\n" in settings(table)
    assert "rostopic: /a\nupdate_rate: 100\n" in settings(table, "--topic", "/a")
    assert "  rostopic: /imu/raw\n" in settings(bag, form="openvins")


def test_the_example_of_the_csv_module_is_read_as_it_says(tmp_path: Path) -> None:
    example = (csv_module.__doc__ or "").split("::\n\n")[1].split("\n\n")[0]
    (path := tmp_path / "a.csv").write_text(textwrap.dedent(example))
    recording = open_recording(str(path), ReadOptions())
    (block,) = (block for blocks in recording for block in blocks)
    assert isinstance(block, SampleBlock)
    np.testing.assert_allclose(block.values[:, 0], np.array([0.012, 0.013, 0.012]) * DEG, rtol=1e-12)
    assert block.lost.tolist() == [0, 1, 0]
    assert [text.partition("; ")[0] for text in recording.remarks] == [
        "1 row lacks a number and counts as lost"
    ]
