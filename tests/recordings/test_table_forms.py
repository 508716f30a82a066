"""Forms of tables that loggers of many countries and programs write."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from commands import imumon
from tables import DEG, RATE, G, csv, read, replayed, sentences, truth

from imumon.grid.stamp_kinds import stamp_interval
from imumon.model.errors import RateRequired
from imumon.model.samples import sensor_of
from imumon.sources.column_names import parse_name, triples
from imumon.sources.files import RecordingError
from imumon.sources.files.base import OptionError
from imumon.sources.files.columns import layout, parse_map

# ---------------------------------------------------------------- sentences beside a time


@pytest.mark.parametrize(
    ("form", "header"),
    [
        ("{t:.6f},{s}", ""),
        ("{t:.6f},{s}", "time,raw\n"),
        ('{n};{iso};"{s}"', "nr;Zeitstempel;Satz\n"),
        ('"{s}",{ms}', "sentence,time [ms]\n"),
        ("[INFO] {ms} {s}\r", ""),
    ],
    ids=["bare", "header", "quoted", "behind", "words"],
)
def test_sentences_beside_a_time_are_read_with_both(tmp_path: Path, form: str, header: str) -> None:
    n = 600
    rng = np.random.default_rng(3)
    values, lines = sentences(n)
    times = 1.7e9 + np.arange(n) / 40 + rng.exponential(2e-3, n)
    lines[100] = lines[100].replace("9.7", "9.1")
    rows = [
        form.format(t=t, s=s, n=k, ms=round(t * 1e3), iso=datetime.fromtimestamp(t, UTC).isoformat())
        for k, (t, s) in enumerate(zip(times, lines, strict=True))
        if k not in (300, 301)
    ]
    path = tmp_path / "a.csv"
    path.write_text(header + "\n".join(rows) + "\n")
    report, remarks = replayed(path)
    assert (report.session.samples, report.session.missing, report.session.bad_checksums) == (n - 3, 3, 1)
    assert report.device.sample_rate_hz == pytest.approx(40.0, rel=1e-3)
    assert report.device.stream == "compensated"
    assert f"1 sentences fail their check and count as lost; first line {101 + bool(header)}" in remarks
    kept = [k for k in range(n) if k not in (100, 300, 301)]
    found = read(path)
    np.testing.assert_allclose(found.values[:, :3], values[kept, 6:], atol=1e-6)
    np.testing.assert_allclose(found.values[:, 3:6], values[kept, 3:6], atol=1e-3)


def test_sentences_without_a_time_are_a_raw_capture(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("\r\n".join(sentences(300)[1]) + "\r\n")
    assert replayed(path, rate_hz=40.0)[0].session.samples == 300


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_every_line_end_separates_sentences_beside_a_time(tmp_path: Path, end: str) -> None:
    values, lines = sentences(300)
    path = tmp_path / "a.csv"
    path.write_text("".join(f"{k / 40:.3f},{s}{end}" for k, s in enumerate(lines)), newline="")
    assert replayed(path)[0].session.samples == 300
    np.testing.assert_allclose(read(path).values[:, :3], values[:, 6:], atol=1e-6)


@pytest.mark.parametrize(
    ("form", "header"),
    [('"{s}"', "data\n"), ('"{s}"', ""), ("{s},ok", "data,state\n")],
    ids=["quoted", "bare", "behind"],
)
def test_sentences_in_cells_without_a_time_need_a_rate(tmp_path: Path, form: str, header: str) -> None:
    values, lines = sentences(300)
    lines[100] = lines[100].replace("9.7", "9.1")
    path = tmp_path / "a.csv"
    path.write_text(header + "\n".join(form.format(s=line) for line in lines) + "\n")
    report, remarks = replayed(path, rate_hz=40.0)
    assert (report.session.samples, report.session.missing, report.device.sample_rate_hz) == (299, 1, 40.0)
    assert f"1 sentences fail their check and count as lost; first line {101 + bool(header)}" in remarks
    found = read(path, rate_hz=40.0)
    np.testing.assert_allclose(found.values[:, :3], np.delete(values, 100, axis=0)[:, 6:], atol=1e-6)
    with pytest.raises(RateRequired) as caught:
        replayed(path)
    assert caught.value.cure == "give the sample rate with --rate"


# ---------------------------------------------------------------- doubled rows


@pytest.mark.parametrize("share", [1.0, 0.01])
@pytest.mark.parametrize("late", [False, True])
def test_a_row_that_is_written_twice_counts_once(tmp_path: Path, share: float, late: bool) -> None:
    t, gyro, accel = truth(3000)
    rng = np.random.default_rng(5)
    t = t + (rng.exponential(2e-3, len(t)) if late else 0.0)
    times = 1 + (rng.random(len(t)) < share)
    columns = (np.repeat(each, times, axis=0) for each in (t, gyro, accel))
    path = csv(tmp_path / "a.csv", ["t", "wx", "wy", "wz", "ax", "ay", "az"], *columns)
    report, remarks = replayed(path)
    assert (report.session.samples, report.session.missing) == (3000, 0)
    assert report.device.sample_rate_hz == pytest.approx(RATE, rel=1e-3)
    assert f"{(times - 1).sum():,} rows repeat the row before with its stamp" in remarks


def test_samples_that_arrive_at_once_and_a_constant_output_are_no_copies(tmp_path: Path) -> None:
    t, gyro, accel = truth(2000)
    arrival = np.repeat(t[::2], 2)
    names = ["t", "wx", "wy", "wz", "ax", "ay", "az"]
    for values in (gyro, np.full_like(gyro, 0.001)):
        still = accel if values is gyro else np.full_like(accel, -5.7)
        report, remarks = replayed(csv(tmp_path / "a.csv", names, arrival, values, still))
        assert report.session.samples == 2000
        assert "repeat" not in remarks
    assert not stamp_interval(arrival * 1e9)[1]


# ---------------------------------------------------------------- one axis


@pytest.mark.parametrize(
    ("names", "option", "channels"),
    [
        ("t,gyro_z [rad/s]", None, {"gyro/z"}),
        ("t,ax [m/s2]", None, {"accel/x"}),
        ("t,p", "gyro/x=p:rad/s", {"gyro/x"}),
        ("t,gz,ax,ay,az", None, {"gyro/z", "accel/x", "accel/y", "accel/z"}),
        ("t,DeltaThetaZ [rad]", None, {"gyro/z"}),
    ],
)
def test_one_axis_alone_is_read(tmp_path: Path, names: str, option: str | None, channels: set[str]) -> None:
    t, gyro, accel = truth(600)
    count = names.count(",")
    values = gyro[:, :1] if count == 1 else np.hstack([gyro[:, :1], accel])
    path = csv(tmp_path / "a.csv", names.split(","), t, values)
    report, remarks = replayed(path, columns=parse_map(option) if option else {})
    assert set(report.channels) == channels
    assert report.session.samples == 600
    assert "has one axis only" in remarks


# ---------------------------------------------------------------- no header

SIX_AXES = [(f"{sensor}/{a}", unit) for sensor, unit in (("gyro", "rad/s"), ("accel", "m/s2")) for a in "xyz"]


@pytest.mark.parametrize(("name", "sep"), [("a.csv", ","), ("a.txt", " "), ("a.dat", ";")])
def test_numbers_without_a_header_are_an_error_with_a_map_that_works(
    tmp_path: Path, name: str, sep: str
) -> None:
    t, gyro, accel = truth()
    path = csv(tmp_path / name, ["x"] * 7, t, gyro, accel, sep=sep)
    path.write_text("\n".join(path.read_text().splitlines()[1:]) + "\n")
    with pytest.raises(RecordingError, match="no line that names its 7 columns") as error:
        read(path)
    assert error.value.code == "no_header"
    axes = ",".join(f"{s}={k + 2}:{u}" for k, (s, u) in enumerate(SIX_AXES))
    assert f"--map t=1,{axes}; check it" in error.value.cure
    shown = json.loads(imumon("replay", path, "--map", f"t=1,{axes}", "--json"))
    assert shown["session"]["samples"] == len(t)


# ---------------------------------------------------------------- names


@pytest.mark.parametrize(
    "header",
    [
        "Zeit [ms];Drehrate X (°/s);Drehrate Y (°/s);Drehrate Z (°/s);Beschleunigung X [g];Beschleunigung Y [g];"
        "Beschleunigung Z [g]",
        "Zeitstempel [ms];Winkelgeschwindigkeit_x [°/s];Winkelgeschwindigkeit_y [°/s];Winkelgeschwindigkeit_z [°/s];"
        "X-Beschleunigung [g];Y-Beschleunigung [g];Z-Beschleunigung [g]",
        "temps (ms);vitesse angulaire x (°/s);vitesse angulaire y (°/s);vitesse angulaire z (°/s);"
        "accélération x (g);accélération y (g);accélération z (g)",
        "Horodatage [ms];gyromètre_x [°/s];gyromètre_y [°/s];gyromètre_z [°/s];accéléromètre_x [g];"
        "accéléromètre_y [g];accéléromètre_z [g]",
    ],
    ids=["de", "de2", "fr", "fr2"],
)
@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
def test_german_and_french_tables_are_read(tmp_path: Path, header: str, encoding: str) -> None:
    t, gyro, accel = truth()
    path = csv(tmp_path / "a.csv", header.split(";"), t * 1e3, np.degrees(gyro), accel / G, sep=";")
    path.write_bytes(path.read_text().replace(".", ",").encode(encoding))
    found = read(path)
    np.testing.assert_allclose(found.values, np.hstack([gyro, accel]), rtol=1e-9, atol=1e-12)
    assert found.stream.interval_s == pytest.approx(1 / RATE)


@pytest.mark.parametrize(
    ("name", "quantity"),
    [("Temperatur [°C]", "temperature"), ("pression (kPa)", "pressure"), ("champ magnétique x (µT)", "mag"),
     ("Magnetfeld Z [µT]", "mag"), ("vitesse x", None), ("Winkel x", None), ("Delta-Winkel x [rad]", "angle")],
)  # fmt: skip
def test_german_and_french_names_are_parsed(name: str, quantity: str | None) -> None:
    assert parse_name(0, name).quantity == quantity


@pytest.mark.parametrize(
    ("given", "meant"),
    [("gx=wx", "gyro/x"), ("gx", "gyro/x"), ("ay=3", "accel/y"), ("wz=4", "gyro/z"), ("mag_z=2", "mag/z"),
     ("time=t", "t"), ("temp=4", "temperature"), ("gyr/x=2", "gyro/x"), ("acel/y=2", "accel/y")],
)  # fmt: skip
def test_a_wrong_channel_of_a_map_suggests_the_one_that_is_meant(given: str, meant: str) -> None:
    with pytest.raises(OptionError) as error:
        parse_map(given)
    assert error.value.code == "map_syntax"
    assert error.value.cure == f"write {meant}=COLUMN:UNIT"


# ---------------------------------------------------------------- few columns, and none with a name


@pytest.mark.parametrize(
    ("header", "options", "unit"),
    [
        ("gyro_z", (), 1.0),
        ("gyro z (deg/s)", (), DEG),
        ("p", ("--map", "gyro/z=p:deg/s"), DEG),
        ("", ("--map", "gyro/z=1"), 1.0),
    ],
)
@pytest.mark.parametrize("name", ["a.csv", "a.txt"])
def test_a_table_of_one_column_is_read(
    tmp_path: Path, header: str, options: tuple[str, ...], unit: float, name: str
) -> None:
    values = np.random.default_rng(1).normal(0.0, 1e-3, 500)
    lines = [*([header] if header else []), *(f"{v:.9g}" for v in values)]
    (tmp_path / name).write_text("\n".join(lines) + "\n")
    report = json.loads(imumon("replay", tmp_path / name, *options, "--rate", "100", "--json"))
    assert report["session"]["samples"] == 500
    assert report["channels"]["gyro/z"]["std"] == pytest.approx(unit * values.std(ddof=1), rel=1e-6)


def test_a_column_without_a_name_is_asked_for_by_number(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("\n".join(["0.001"] * 30) + "\n")
    with pytest.raises(RecordingError) as error:
        replayed(tmp_path / "a.txt")
    assert (error.value.code, error.value.cure) == (
        "no_header",
        "add one, or --map gyro/x=1:rad/s,... by number",
    )


@pytest.mark.parametrize("frame", ["imu_link", "", "7"])
def test_the_output_of_ros2_topic_echo_is_known(tmp_path: Path, frame: str) -> None:
    _, gyro, accel = truth(500)
    rows = [
        [
            1_700_000_000 + k // 100,
            k % 100 * 10**7,
            frame,
            0.0,
            0.0,
            0.0,
            1.0,
            *[0.0] * 9,
            *g,
            *[0.0] * 9,
            *a,
            *[0.0] * 9,
        ]
        for k, (g, a) in enumerate(zip(gyro.tolist(), accel.tolist(), strict=True))
    ]
    for name in ("a.csv", "a.log"):
        text = "A message was lost!!!\n" + "\n".join(",".join(map(str, row)) for row in rows) + "\n"
        (tmp_path / name).write_text(text)
        report, remarks = replayed(tmp_path / name)
        assert (report.device.sample_rate_hz, report.session.samples, report.session.missing) == (
            100.0,
            500,
            0,
        )
        assert report.channels["accel/y"].mean == pytest.approx(accel[:, 1].mean())
        assert remarks == ""


# ---------------------------------------------------------------- what new users bring


@pytest.mark.parametrize(
    ("name", "unit_s"), [("ms", 1e-3), ("millis", 1e-3), ("micros", 1e-6), ("Microseconds", 1e-6)]
)
def test_a_time_may_have_the_name_of_its_unit(tmp_path: Path, name: str, unit_s: float) -> None:
    t, gyro, accel = truth()
    report, remarks = replayed(
        csv(tmp_path / "a.csv", [name, "gx", "gy", "gz", "ax", "ay", "az"], t / unit_s, gyro, accel)
    )
    assert report.device.sample_rate_hz == 100.0
    assert f"{name} without a unit" not in remarks


def test_the_fine_time_of_an_xsens_counts_its_ticks(tmp_path: Path) -> None:
    t, gyro, accel = truth()
    names = ["SampleTimeFine", "Acc_X", "Acc_Y", "Acc_Z", "Gyr_X", "Gyr_Y", "Gyr_Z"]
    report, remarks = replayed(csv(tmp_path / "a.csv", names, np.rint(t * 1e4), accel, gyro))
    assert (report.device.sample_rate_hz, report.session.samples) == (100.0, len(t))
    assert "SampleTimeFine" not in remarks


# ---------------------------------------------------------------- triples


@pytest.mark.parametrize(
    "names",
    [
        "gyroADC[0],gyroADC[1],gyroADC[2],accSmooth[0],accSmooth[1],accSmooth[2]",
        "xgyro,ygyro,zgyro,xacc,yacc,zacc",
        "gyro1,gyro2,gyro3,acc1,acc2,acc3",
        "rollspeed,pitchspeed,yawspeed,a_x,a_y,a_z",
        "gX,gY,gZ,aX,aY,aZ",
        "S1_Gyro_X_CAL,S1_Gyro_Y_CAL,S1_Gyro_Z_CAL,S1_Accel_X_CAL,S1_Accel_Y_CAL,S1_Accel_Z_CAL",
        "X Gyro [x8005],Y Gyro [x8005],Z Gyro [x8005],X Accel [x8004],Y Accel [x8004],Z Accel [x8004]",
        "x (rad/s),y (rad/s),z (rad/s),u x (m/s²),u y (m/s²),u z (m/s²)",
        "motionRotationRateX,motionRotationRateY,motionRotationRateZ,AccelerationX,AccelerationY,AccelerationZ",
        "RateRoll,RatePitch,RateYaw,AccRoll,AccPitch,AccYaw",
    ],
)
def test_three_names_that_differ_by_the_axis_are_a_sensor(tmp_path: Path, names: str) -> None:
    t, gyro, accel = truth()
    others = ["status", "battery [V]", "x8007 [txt]", "loop [bananas]"]
    path = csv(tmp_path / "a.txt", ["t", *names.split(","), *others], t, gyro, accel, np.ones((len(t), 4)))
    found = read(path)
    np.testing.assert_allclose(found.values, np.hstack([gyro, accel]), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("names", "channels"),
    [
        ("w_x [g],w_y [g],w_z [g]", "accel"),  # the unit decides, and the conflict is a remark
        ("G_X [mdps],G_Y [mdps],G_Z [mdps]", "gyro"),
        ("p_x [deg],p_y [deg],p_z [deg],gx,gy,gz", "gyro"),
        ("incremental_angle_x [mdeg],incremental_angle_y [mdeg],incremental_angle_z [mdeg]", "gyro"),
        ("gx,gy,gz,mag_x [G],mag_y [G],mag_z [G]", "gyro mag"),
    ],
)
def test_the_quantity_of_a_triple_follows_from_its_unit_before_its_name(names: str, channels: str) -> None:
    columns = layout(names.split(","))
    assert list(dict.fromkeys(sensor_of(channel) for channel in columns.channels)) == channels.split()
    assert ("the unit decides" in "".join(c.doubt for c in columns.columns)) == names.startswith("w_x")


@pytest.mark.parametrize(
    "names", ["q_x,q_y,q_z,q_w", "m[0],m[1],m[2],m[3]", "rxx,rxy,rxz,ryx,ryy,ryz,rzx,rzy,rzz"]
)
def test_quaternions_lists_and_matrices_are_no_triples(names: str) -> None:
    assert not triples(names.split(","))


def test_a_triple_without_a_name_is_an_accelerometer_if_it_is_one_g(tmp_path: Path) -> None:
    t, gyro, accel = truth()
    path = csv(tmp_path / "a.txt", ["t", "x", "y", "z"], t, accel)
    report, remarks = replayed(path)
    assert report.channels["accel/z"].mean == pytest.approx(accel[:, 2].mean())
    assert "x, y, z have no name of a sensor: their size is one g in m/s2" in remarks
    with pytest.raises(RecordingError) as error:
        replayed(csv(tmp_path / "b.txt", ["t", "x", "y", "z"], t, gyro / DEG))
    assert error.value.code == "no_sensor"
    cure = error.value.cure.partition("--map ")[2].partition(", with")[0]
    report, _ = replayed(tmp_path / "b.txt", columns=parse_map(cure))
    assert report.channels["gyro/x"].mean == pytest.approx(gyro[:, 0].mean(), rel=1e-6)


def test_a_triple_that_is_not_used_is_named_with_how_to_use_it(tmp_path: Path) -> None:
    t, gyro, accel = truth()
    names = ["t", *(f"g{a}" for a in "xyz"), *(f"Angle {a} (°)" for a in "XYZ")]
    _, remarks = replayed(csv(tmp_path / "a.csv", names, t, gyro, accel))
    assert "Angle X (°), Angle Y (°), Angle Z (°) not used: no name or unit of a sensor" in remarks
    assert "--map 'gyro/x=Angle X:UNIT,gyro/y=Angle Y:UNIT,gyro/z=Angle Z:UNIT'" in remarks


def test_increments_of_one_sensor_beside_samples_of_the_other(tmp_path: Path) -> None:
    t, gyro, accel = truth(2000)
    names = ["t", *(f"incremental_angle_{a} [mdeg]" for a in "xyz"), *(f"acc_{a} [m/s2]" for a in "xyz")]
    path = csv(tmp_path / "a.csv", names, t, gyro / DEG * 1e3 / RATE, accel)
    found = read(path)
    np.testing.assert_allclose(found.values, np.hstack([gyro, accel]), rtol=1e-9, atol=1e-12)
    assert found.stream.averaged == (True,) * 3 + (False,) * 3
    given = {f"gyro/{a}": f"incremental_angle_{a}:mdeg" for a in "xyz"}
    np.testing.assert_allclose(read(path, columns=given).values[:, :3], gyro, rtol=1e-9, atol=1e-12)


def test_the_time_is_the_one_that_is_even(tmp_path: Path) -> None:
    t, gyro, accel = truth(2000)
    late = t + np.random.default_rng(1).exponential(4e-3, len(t))
    names = ["time [s]", "sensor time [ms]", *(f"g{a}" for a in "xyz"), *(f"a{a}" for a in "xyz")]
    report, remarks = replayed(csv(tmp_path / "a.csv", names, late, 1e3 * t, gyro, accel))
    assert (report.device.clock, report.device.sample_rate_hz) == ("startup", 100.0)
    assert "the time is sensor time [ms], which is even, and not time [s]" in remarks


def test_names_apart_by_blanks_may_have_units(tmp_path: Path) -> None:
    t, gyro, accel = truth()
    names = ["T[ms]", *(f"G_{a} [mdps]" for a in "XYZ"), *(f"A_{a} [mg]" for a in "XYZ")]
    path = csv(tmp_path / "a.txt", names, t * 1e3, gyro / DEG * 1e3, accel / G * 1e3, sep=" ")
    np.testing.assert_allclose(read(path).values, np.hstack([gyro, accel]), rtol=1e-9, atol=1e-12)


def test_a_bar_separates_cells(tmp_path: Path) -> None:
    t, gyro, accel = truth()
    path = csv(tmp_path / "a.txt", ["t", "gx", "gy", "gz", "ax", "ay", "az"], t, gyro, accel, sep="|")
    assert replayed(path)[0].session.samples == len(t)


@pytest.mark.parametrize(
    ("line", "cure"),
    [
        ("It was a dark and stormy night", "one line of names"),
        (
            "%RAWIMUSXA,2200,300000.0;00,13,2200,300000.0,00000000,52567055,1,6,-1,-3,2*595b19cf",
            "--stream deltas",
        ),
    ],
)
def test_text_that_is_no_table_is_not_called_a_capture(tmp_path: Path, line: str, cure: str) -> None:
    (tmp_path / "a.txt").write_text("\n".join([line] * 100))
    with pytest.raises(RecordingError) as error:
        replayed(tmp_path / "a.txt")
    assert error.value.code == "no_messages"
    assert cure in error.value.cure
    assert "bytes" not in error.value.message
