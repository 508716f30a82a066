"""What a table leaves open or has wrong: inferred if possible, else an error; assumptions are remarked."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import numpy as np
import pytest
from commands import imumon
from tables import DEG, RATE, G, csv, read, replayed, truth

from imumon.api.replay import replay
from imumon.api.replay_options import ReplayOptions
from imumon.grid.stamp_kinds import stamp_interval, typical_step
from imumon.model.errors import RateRequired
from imumon.sources.files import OptionNotApplicable, RecordingError
from imumon.sources.files.columns import layout, parse_map

AXES = ["gx [rad/s]", "gy [rad/s]", "gz [rad/s]", "ax", "ay", "az"]
BARE = ["time", "gx", "gy", "gz", "ax", "ay", "az"]


def timed(path: Path, stamps: np.ndarray, name: str = "time") -> Path:
    """Write a sensor at rest with these stamps; only their unit may be unknown."""
    _, gyro, accel = truth(len(stamps))
    rows = (
        f"{stamp:.12g}," + ",".join(f"{value:.6g}" for value in row)
        for stamp, row in zip(stamps.tolist(), np.hstack([gyro, accel]), strict=True)
    )
    path.write_text("\n".join([",".join([name, *AXES]), *rows]) + "\n")
    return path


def seen_rate(path: Path, **options: object) -> float:
    """Return the rate of the stamps of a file, Hz."""
    stamps = read(path, **options).time_ns
    assert stamps is not None
    return float(1e9 / np.median(np.diff(stamps)))


# ---------------------------------------------------------------- the unit of a time

K = np.arange(2000)


@pytest.mark.parametrize(
    ("stamps", "rate", "unit"),
    [
        (K / 100, 100.0, "s"),
        (K // 100, 100.0, "s"),
        (1_700_000_000 + K // 100, 100.0, "s"),
        (1_700_000_000 + K, 1.0, "s"),
        (1_700_000_000_000 + K * 10, 100.0, "ms"),
        (1_700_000_000_000 + K * 1000, 1.0, "ms"),
        (K * 10, 100.0, "ms"),
        (K * 10 + 0.25, 100.0, "ms"),
        (K * 10_000, 100.0, "us"),
        (K * 1e7, 100.0, "ns"),
        (2e11 + K * 1e7, 100.0, "ns"),  # 200 s behind power-up: no year is meant
        (K / 5, 5.0, "s"),
        (K / 5000, 5000.0, "s"),
    ],
)
def test_a_time_without_a_unit_has_the_only_plausible_one(
    tmp_path: Path, stamps: np.ndarray, rate: float, unit: str
) -> None:
    report, remarks = replayed(timed(tmp_path / "a.csv", stamps))
    assert report.device.sample_rate_hz == pytest.approx(rate, rel=1e-3)
    assert (report.session.samples, report.session.missing) == (len(stamps), 0)
    assert (f"{unit} is assumed" in remarks) == (unit != "s" and abs(stamps[0]) < 1.6e12)


@pytest.mark.parametrize(
    ("stamps", "units"), [(K, ("s", "ms")), (K * 1000, ("ms", "us")), (K * 1e6, ("us", "ns"))]
)
def test_two_plausible_units_are_an_error_that_names_both_and_its_cure_works(
    tmp_path: Path, stamps: np.ndarray, units: tuple[str, str]
) -> None:
    path = timed(tmp_path / "a.csv", stamps)
    with pytest.raises(RecordingError) as error:
        replayed(path)
    assert error.value.code == "ambiguous_time_unit"
    for text in ("1 Hz if that is", "1000 Hz if that is", f"--map t=time:{units[0]}", *units):
        assert text in error.value.cure
    for unit, rate in zip(units, (1.0, 1000.0), strict=True):
        assert seen_rate(path, columns={"t": f"time:{unit}"}) == rate
        assert seen_rate(path, rate_hz=rate) == rate
        assert seen_rate(timed(tmp_path / "b.csv", stamps, f"time [{unit}]")) == rate


@pytest.mark.parametrize(
    ("stamps", "name", "code", "cures"),
    [
        (1.7e18 + K * 1e7, "time [s]", "wrong_time_unit", ("100 Hz if that is ns", "--map t=time:ns")),
        (K * 10, "time [ns]", "wrong_time_unit", ("100 Hz if that is ms",)),
        (K // 1000, "time [s]", "time_too_coarse", ("more digits", "--rate")),
        ((1.7e9 + K / 100).astype(np.float32), "time", "time_constant", ("more digits", "--rate")),
        (-K / 100, "time [s]", "time_descending", ("sort",)),
    ],
    ids=["ns", "ms", "onestep", "float32", "descending"],
)
def test_impossible_stamps_are_an_error_with_a_cure(
    tmp_path: Path, stamps: np.ndarray, name: str, code: str, cures: tuple[str, ...]
) -> None:
    with pytest.raises(RecordingError) as error:
        replayed(timed(tmp_path / "a.csv", stamps, name))
    assert error.value.code == code
    for text in cures:
        assert text in error.value.cure


def test_a_configured_rate_replaces_stamps_without_one(tmp_path: Path) -> None:
    report, remarks = replayed(timed(tmp_path / "a.csv", K // 1000, "time [s]"), rate_hz=200.0)
    assert (report.device.sample_rate_hz, report.session.samples) == (200.0, len(K))
    assert "--rate 200 is used" in remarks


@pytest.mark.parametrize("rate", [3.7, 99.3, 100.0, 400.0, 801.0])
def test_stamps_in_whole_seconds_show_the_mean_rate(rate: float) -> None:
    times = np.floor(np.arange(int(60 * rate)) / rate)
    assert 1.0 / typical_step(times) == pytest.approx(rate, rel=0.5)
    assert 1e9 / stamp_interval(times * 1e9)[0] == pytest.approx(rate, rel=0.02)


def test_a_configured_rate_overrides_the_stamps_of_a_host_only(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    own = timed(tmp_path / "own.csv", K / 100, "time [s]")
    host = timed(tmp_path / "host.csv", K / 100 + rng.exponential(4e-3, len(K)), "time [s]")
    for rate in (50.0, 1000.0):  # also one that is a whole multiple of the right one
        report, remarks = replayed(own, rate_hz=rate)
        assert report.device.sample_rate_hz == pytest.approx(100.0)
        assert (report.session.samples, report.session.missing) == (len(K), 0)
        assert (
            f"its time stamps show 100 Hz and are those of a sample clock: --rate {rate:g} is not used"
            in remarks
        )
        report, remarks = replayed(host, rate_hz=rate)
        assert (report.device.sample_rate_hz, report.session.samples) == (rate, len(K))
        assert f"but are those of a host: --rate {rate:g} is used" in remarks
    assert "--rate" not in replayed(own, rate_hz=100.0)[1]


def test_a_step_back_of_a_clock_is_remarked_with_its_line(tmp_path: Path) -> None:
    stamps = K / 100.0
    stamps[1200:] -= 7.0
    report, remarks = replayed(timed(tmp_path / "a.csv", stamps, "time [s]"))
    assert (report.session.samples, report.session.gaps, report.session.restarts) == (len(K), 1, 1)
    assert "steps back once; first by 6.99 s at line 1202: a gap of unknown length" in remarks
    late = stamps + np.random.default_rng(4).exponential(4e-3, len(K))
    assert "its clock steps back by 6.9" in replayed(timed(tmp_path / "b.csv", late, "time [s]"))[1]


# ---------------------------------------------------------------- units of the sensors


def test_a_rate_without_a_unit_is_remarked_on(tmp_path: Path) -> None:
    t, gyro, accel = truth()
    path = csv(tmp_path / "a.csv", BARE, t, gyro, accel)
    report, remarks = replayed(path)
    cure = "gyro/x=gx:deg/s,gyro/y=gy:deg/s,gyro/z=gz:deg/s"
    assert "gx, gy, gz without a unit: rad/s is assumed" in remarks
    assert cure in remarks
    cured, remarks = replayed(path, columns=parse_map(cure))
    assert cured.channels["gyro/x"].std == pytest.approx(report.channels["gyro/x"].std * DEG)
    assert "gyro" not in remarks
    for name in ("gyro", "gyro_dps"):
        np.savez(tmp_path / "a.npz", t=t, **{name: gyro, "accel": accel})
        assert ("end with _dps" in replayed(tmp_path / "a.npz")[1]) == (name == "gyro")


def map_of(cure: str) -> dict[str, str]:
    """Return the columns of a printed ``--map``, as a shell and the parser read it."""
    words = shlex.split(cure.partition("--map ")[2].partition("; ")[0])
    return parse_map(words[0].rstrip(","))


NOISIEST_DEG = 0.6
"""deg/s, noise of a sample of an L3G4200D at 800 Hz: 0.03 deg/s/sqrt(Hz) over 400 Hz."""


@pytest.mark.parametrize("bias", [0.0, 0.1, 0.35])
def test_the_bias_of_a_mems_gyroscope_is_no_reason_to_doubt_its_unit(tmp_path: Path, bias: float) -> None:
    t, gyro, accel = truth()
    noisy = bias + gyro * (NOISIEST_DEG * DEG / gyro.std())
    report, _ = replayed(csv(tmp_path / "a.csv", BARE, t, noisy, accel))
    assert report.channels["gyro/x"].mean == pytest.approx(noisy[:, 0].mean(), rel=1e-6)


@pytest.mark.parametrize(
    "names", [BARE[1:4], ["gyroADC[0]", "gyroADC[1]", "gyroADC[2]"], ["G X", "G Y", "G Z"]]
)
@pytest.mark.parametrize("accel_unit", ["m/s2", "g", "mg", "mm/s2", "counts"])
def test_one_cure_gives_the_units_of_all_sensors(tmp_path: Path, names: list[str], accel_unit: str) -> None:
    t, gyro, accel = truth(2000)
    size = {"m/s2": 1.0, "g": 1 / G, "mg": 1e3 / G, "mm/s2": 1e3, "counts": 2048 / G}[accel_unit]
    numbers = np.rint(accel * size) if accel_unit == "counts" else accel * size
    path = csv(tmp_path / "a.csv", ["t", *names, *BARE[4:]], t, gyro / DEG, numbers)
    with pytest.raises(RecordingError) as error:
        replayed(path)
    assert error.value.code == "wrong_unit"
    report, _ = replayed(path, columns=map_of(error.value.cure))
    for axis, mean in zip("xyz", gyro.mean(axis=0), strict=True):
        assert report.channels[f"gyro/{axis}"].mean == pytest.approx(mean, rel=1e-6)
    assert report.channels["accel/z"].mean == pytest.approx(accel[:, 2].mean(), rel=1e-3)


def test_a_map_may_be_repeated_and_a_cure_keeps_what_was_given(tmp_path: Path) -> None:
    t, gyro, accel = truth(2000)
    path = csv(tmp_path / "a.csv", ["t", "p q", "q", "r", *BARE[4:]], t, gyro / DEG, accel / G)
    first = "gyro/x=p q:deg/s,gyro/y=q:deg/s,gyro/z=r:deg/s"
    with pytest.raises(RecordingError) as error:
        replayed(path, columns=parse_map(first))
    assert map_of(error.value.cure).items() > parse_map(first).items()
    option = "accel/x=ax:g,accel/y=ay:g,accel/z=az:g"
    shown = json.loads(imumon("replay", path, "--map", first, "--map", option, "--json"))
    assert shown["channels"]["accel/z"]["mean"] == pytest.approx(accel[:, 2].mean(), rel=1e-6)


@pytest.mark.parametrize(
    ("option", "code"),
    [
        ("gyro/x=p,gyro/y=p,gyro/z=q", "column_twice"),
        ("gyro/x=s,gyro/y=p,gyro/z=q", "ambiguous_column"),
        ("gyro/x=p/131x:deg/s,gyro/y=q,gyro/z=4", "unknown_column"),
    ],
)
def test_a_column_serves_one_axis_and_a_name_means_one_column(option: str, code: str) -> None:
    with pytest.raises(RecordingError) as error:
        layout(["t", "p", "q", "s [deg/s]", "s [g]"], None, parse_map(option))
    assert error.value.code == code
    assert (
        layout(["m[0]", "m[1]", "m[2]"], None, parse_map("gyro/x=m[1]:deg/s,gyro/y=m[0],gyro/z=m[2]"))
        .columns[0]
        .index
        == 1
    )


def test_counts_have_a_scale(tmp_path: Path) -> None:
    t, gyro, accel = truth(2000)
    path = csv(tmp_path / "a.csv", BARE, t, np.rint(gyro / DEG * 1310.7), accel)
    with pytest.raises(RecordingError) as error:
        replayed(path)
    assert error.value.code == "raw_counts"
    with pytest.raises(RecordingError, match="'COUNTS' in --map gx/COUNTS is no number"):
        replayed(path, columns=map_of(error.value.cure))
    axes = {f"gyro/{axis}": f"g{axis}/1310.7:deg/s" for axis in "xyz"}
    report, _ = replayed(path, columns=axes)
    assert report.channels["gyro/y"].mean == pytest.approx(gyro[:, 1].mean(), rel=1e-2)


@pytest.mark.parametrize("suffix", ["csv", "npz"])
def test_the_cure_of_a_wrong_unit_works(tmp_path: Path, suffix: str) -> None:
    t, gyro, accel = truth()
    path = tmp_path / f"a.{suffix}"
    if suffix == "csv":
        csv(path, BARE, t, gyro, accel / G)
    else:
        np.savez(path, t=t, gyro=gyro, accel=accel / G)
    with pytest.raises(RecordingError) as error:
        replayed(path)
    assert error.value.code == "wrong_unit"
    assert ("in the header" in error.value.cure) == (suffix == "csv")
    assert ("end with _g" in error.value.cure) == (suffix == "npz")
    cure = error.value.cure.partition("--map ")[2]
    report, _ = replayed(path, columns=parse_map(cure))
    assert set(report.channels) == {f"{s}/{a}" for s in ("gyro", "accel") for a in "xyz"}
    assert report.channels["accel/z"].mean == pytest.approx(accel[:, 2].mean(), rel=1e-6)
    assert report.device.sample_rate_hz == pytest.approx(RATE)


def test_axes_may_have_different_units(tmp_path: Path) -> None:
    t, gyro, accel = truth()
    accel[:, :2] /= G
    report, _ = replayed(
        csv(tmp_path / "a.csv", [*BARE[:4], "ax [g]", "ay [g]", "az [m/s2]"], t, gyro, accel)
    )
    assert report.channels["accel/y"].mean == pytest.approx(accel[:, 1].mean() * G, rel=1e-6)


def test_raw_counts_are_recognised(tmp_path: Path) -> None:
    t, gyro, accel = truth()
    with pytest.raises(RecordingError) as error:
        replayed(csv(tmp_path / "a.csv", BARE, t, gyro, np.rint(accel / G * 16384)))
    assert error.value.code == "raw_counts"
    assert ":mg" not in error.value.cure


def test_transposed_arrays_are_an_error(tmp_path: Path) -> None:
    t, gyro, _ = truth()
    np.savez(tmp_path / "a.npz", t=t, gyro=gyro.T)
    with pytest.raises(RecordingError) as error:
        replayed(tmp_path / "a.npz")
    assert error.value.code == "array_transposed"


# ---------------------------------------------------------------- columns that are not used


@pytest.mark.parametrize(
    ("names", "sensors", "texts"),
    [
        ("t,gx,gy,ax,ay,az", {"accel"}, ("gx, gy not used: gyro/z is missing", "--map gyro/z=")),
        ("t,gx,gy,gz,ax,az", {"gyro"}, ("ax, az not used: accel/y is missing",)),
        ("t,wx,wy,wz,f_x,f_y,f_z", {"gyro", "accel"}, ()),
        ("t,wx,wy,wz,mx,my", {"gyro"}, ("mx, my not used: mag/z is missing",)),
        ("t,wx,wy,wz,gyro_norm", {"gyro"}, ("gyro_norm not used: the name has no axis",)),
        ("t,wx,wy,wz,gyro_x", {"gyro"}, ("gyro_x not used: another column is the same axis",)),
        (
            "t,wx,wy,wz,UncompMagX,UncompMagY,UncompMagZ,MagX,MagY,MagZ",
            {"gyro", "mag"},
            ("MagX, MagY, MagZ not used: another column is the same axis",),
        ),
        (
            "t,DeltaThetaX,DeltaThetaY,DeltaThetaZ,UncompGyroX,UncompGyroY,UncompGyroZ",
            {"gyro"},
            ("UncompGyroX, UncompGyroY, UncompGyroZ not used: the stream used is deltas", "--stream"),
        ),
    ],
)
def test_every_column_of_a_sensor_is_used_or_named(
    names: str, sensors: set[str], texts: tuple[str, ...]
) -> None:
    found = layout(names.split(","))
    assert {channel.partition("/")[0] for channel in found.channels} == sensors
    assert len(found.remarks) == bool(texts)
    for text in texts:
        assert text in found.remarks[0]


def test_remarks_are_in_the_json_of_the_report(tmp_path: Path) -> None:
    t, gyro, accel = truth()
    path = csv(tmp_path / "a.csv", ["t", "gx", "gy", "ax", "ay", "az"], t, gyro[:, :2], accel)
    remarks = json.loads(imumon("replay", path, "--json"))["device"]["remarks"]
    assert [text for text in remarks if text.startswith("gx, gy not used")]


@pytest.mark.parametrize(
    ("names", "option", "channels", "times"),
    [
        ("t,gx,gy,gz,ax,ay,az", "accel/x=ax:g", "gx gy gz ax ay az", ["t"]),
        ("t,gx,gy,gz", "t=t:ms", "gx gy gz", ["t"]),
        ("t,u,gx,gy,gz", "t=u:ms", "gx gy gz", ["u"]),
        ("t,gx,gy,q [deg/s]", "gyro/z=q", "gx gy q", ["t"]),
        ("t,UncompGyroX,UncompGyroY,q", "gyro/z=q", "UncompGyroX UncompGyroY q", ["t"]),
        ("t,DeltaThetaX,DeltaThetaY,DeltaThetaZ,p,q,r", "gyro/x=p,gyro/y=q,gyro/z=r", "p q r", ["t"]),
    ],
)
def test_a_map_overrides_what_it_names_and_nothing_else(
    names: str, option: str, channels: str, times: list[str]
) -> None:
    found = layout(names.split(","), None, parse_map(option))
    assert [column.name.partition(" ")[0] for column in found.columns] == channels.split()
    assert [column.name for column in found.times] == times
    for column in found.columns:
        assert column.unit == {"ax": "g", "q [deg/s]": "deg/s"}.get(column.name)


def test_a_map_of_a_part_of_a_sensor_is_an_error() -> None:
    with pytest.raises(RecordingError, match="gyro/z is missing") as error:
        layout(["t", "p", "q", "ax", "ay", "az"], None, parse_map("gyro/x=p,gyro/y=q"))
    assert error.value.code == "map_incomplete"


# ---------------------------------------------------------------- rows


@pytest.mark.parametrize("empty", ["nan", ""])
def test_incomplete_rows_are_counted_and_the_first_is_named(tmp_path: Path, empty: str) -> None:
    lines = timed(tmp_path / "a.csv", K / 100, "time [s]").read_text().splitlines()
    for k in range(3, len(lines), 5):
        cells = lines[k].split(",")
        lines[k] = ",".join([*cells[:2], empty, *cells[3:]])
    lines.insert(2, "")  # blank lines count
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    report, remarks = replayed(tmp_path / "a.csv")
    assert report.session.bad_checksums == 400
    assert "400 rows lack a number and count as lost; first line 5: gy" in remarks
    shown = imumon("replay", tmp_path / "a.csv")
    assert "400 invalid rows" in shown
    assert "checksum" not in shown


def test_the_source_names_the_sensors_and_an_error_the_other_columns(tmp_path: Path) -> None:
    t, gyro, accel = truth()
    path = csv(tmp_path / "a.csv", ["Hora (s)", *BARE[1:]], t, gyro, accel)
    with pytest.raises(RateRequired, match=r"Hora \(s\)") as error:
        replayed(path)
    assert error.value.code == "rate_required"
    assert "--map t=Hora:s" in error.value.cure
    report, _ = replayed(path, columns={"t": "Hora (s)"})
    assert report.device.source == "csv (gyro, accel)"
    assert report.device.sample_rate_hz == pytest.approx(RATE)


def test_a_table_has_no_topic(tmp_path: Path) -> None:
    t, gyro, accel = truth()
    path = csv(tmp_path / "a.csv", BARE, t, gyro, accel)
    with pytest.raises(OptionNotApplicable) as error:
        replay(ReplayOptions(path=str(path), topic="/imu"))
    assert error.value.code == "topic_not_applicable"
    assert "--topic" in imumon("replay", path, "--topic", "/imu", code=2)


@pytest.mark.parametrize("stamp", [1e25, 1e9, -3.0])
def test_an_invalid_stamp_is_one_lost_sample_and_no_step_back(tmp_path: Path, stamp: float) -> None:
    stamps = K / 100.0
    stamps[1200] = stamp
    report, remarks = replayed(timed(tmp_path / "a.csv", stamps, "time [s]"))
    assert (report.session.samples, report.session.missing, report.device.clock) == (len(K) - 1, 1, "startup")
    assert not remarks


def test_a_record_that_is_excluded_as_a_whole_names_the_unit(tmp_path: Path) -> None:
    t, gyro, accel = truth(4000)
    turning = gyro + 5.0 * np.sin(t)[:, None]
    path = csv(tmp_path / "a.csv", ["t [s]", *BARE[1:4], *AXES[3:]], t, turning, accel)
    remarks: list[str] = []
    report = replay(ReplayOptions(path=str(path)), remark=remarks.append)
    (doubt,) = [text for text in remarks if "most of it is excluded, as with a wrong unit" in text]
    assert "--map gyro/x=gx:deg/s" in doubt
    assert report.channels["gyro/x"].coefficients["N"].reason_code == "excluded"
    assert "too short" not in imumon("replay", path)


def test_a_directory_is_no_recording(tmp_path: Path) -> None:
    with pytest.raises(RecordingError) as error:
        replayed(tmp_path)
    assert error.value.code == "is_directory"
    assert "ros2 bag reindex" in error.value.cure


def test_a_temperature_that_some_rows_lack_is_used_where_it_is_known(tmp_path: Path) -> None:
    """In a column, or in rows of its own."""
    names = ["t [s]", "gx [rad/s]", "gy [rad/s]", "gz [rad/s]", "temp [degC]"]
    t, gyro, _ = truth(8000)
    warm = 30.0 + 3.0 * np.sin(t / 12.0)
    gyro[:, 0] += 2e-3 * (warm - 30.0)
    rows = np.column_stack([t, gyro, warm])
    few, most = rows.copy(), rows.copy()
    few[np.arange(len(t)) % 100 != 7, -1] = np.nan
    most[::10, -1] = np.nan
    rows[:, -1] = np.nan
    own = np.column_stack([t[7::100] + 1e-3, np.full((len(t) // 100, 3), np.nan), warm[7::100]])
    apart = np.concatenate([rows, own])[np.argsort(np.concatenate([t, own[:, 0]]))]
    for table, share in ((few, "99 %"), (most, "10 %"), (apart, "99 %")):
        report, remarks = replayed(csv(tmp_path / "a.csv", names, table))
        assert f"{share} of the rows lack temp [degC]: the one before is held" in remarks
        session = report.session
        assert (session.samples, session.missing, session.bad_checksums) == (len(t), 0, 0)
        assert "temperature" in report.channels["gyro/x"].caveats
    assert "80 rows have no number of gyro: they are no samples of it" in remarks
    report, remarks = replayed(csv(tmp_path / "a.csv", names, rows))
    assert "no row has a number in temp [degC]: not used" in remarks
    assert "temperature" not in report.channels


@pytest.mark.parametrize(("given", "actual", "factor"), [("m/s2", "g", 1 / G), ("g", "m/s2", 1.0)])
def test_an_acceleration_that_is_one_g_in_another_unit_is_an_error(
    tmp_path: Path, given: str, actual: str, factor: float
) -> None:
    t, gyro, accel = truth()
    names = ["t [s]", *(f"w{axis} [rad/s]" for axis in "xyz"), *(f"a{axis} [{given}]" for axis in "xyz")]
    path = csv(tmp_path / "a.csv", names, t, gyro, accel * factor)
    with pytest.raises(RecordingError, match=f"is in {given}, but its size is") as error:
        replayed(path)
    assert error.value.code == "wrong_unit"
    assert f"--map accel/x=ax:{actual}" in error.value.cure
    axes = {f"accel/{axis}": f"a{axis}:{given}" for axis in "xyz"}
    with pytest.raises(RecordingError, match=f"is in {given}, but its size is"):
        replayed(path, columns=axes)  # a unit that the user gives is checked as any other


def test_a_line_before_the_header_may_have_another_separator(tmp_path: Path) -> None:
    path = csv(tmp_path / "a.csv", ["t", "wx", "wy", "wz"], *truth()[:2])
    path.write_text("Device;X\n\n" + path.read_text())
    assert replayed(path)[0].session.samples == 400


def test_a_time_that_ends_where_it_began_has_an_interval() -> None:
    assert stamp_interval(np.array([1.0, 2.0, 1.0]) * 1e9)[0] == pytest.approx(1e9)
