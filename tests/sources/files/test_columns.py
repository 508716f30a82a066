"""Laws of columns: what is stated is certain, what physics shows is certain, anything else is a question."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from imumon.model.errors import ImumonError
from imumon.model.samples import Floats
from imumon.sources.files.base import ReadOptions, RecordingError
from imumon.sources.files.column_names import split_unit
from imumon.sources.files.column_reader import read_columns
from imumon.sources.files.columns import ColumnsUnclear, Reading, parse_map
from imumon.sources.files.unit_grammar import StatedRate, known_unit, stated_rate

DEG, G = np.pi / 180.0, 9.80665
RNG = np.random.default_rng(63)
GYRO = RNG.normal([0.004, -0.003, 0.002], 1e-3, (2000, 3))
ACCEL = RNG.normal([0.12, -0.23, 9.79], 0.02, (2000, 3))
STEP = np.arange(2000.0)


def read(header: str, *columns: Floats, **options: object) -> Reading:
    """Return what columns below a header are."""
    return read_columns(header.split(","), (), np.column_stack(columns), ReadOptions(**options))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("texts", "quantity", "factor"),
    [
        (
            ("rad/s", "rad s^-1", "rad.s-1", "RadPerSec", "rads", "radians per second", "rad_per_s"),
            "gyro",
            1.0,
        ),
        (("deg/s", "°/s", "º/s", "dps", "degree/sec", "deg.s^-1", "d/s", "degs"), "gyro", DEG),
        (("mdps", "mdeg/s", "millideg/s"), "gyro", DEG * 1e-3),
        (("deg/h", "°/hr", "dph"), "gyro", DEG / 3600.0),
        (("m/s^2", "m/s²", "m/(s^2)", "m/s/s", "mps2", "ms-2", "m.s^-2"), "accel", 1.0),
        (("g", "G", "gs"), "accel", G),
        (("mg", "mG"), "accel", G * 1e-3),
        (("cm/s^2", "Gal"), "accel", 1e-2),
        (("deg", "°", "degrees"), "angle", DEG),
        (("m/s",), "velocity", 1.0),
        (("g*s", "g.s"), "velocity", G),
        (("min", "minutes"), "t", 60.0),
        (("10us", "10 µs"), "t", 1e-5),
        (("100ns",), "t", 1e-7),
    ],
)
def test_units_are_a_grammar(texts: Sequence[str], quantity: str, factor: float) -> None:
    for text in texts:
        unit = known_unit(text)
        assert unit is not None, text
        assert (unit.quantity, unit.factor) == (quantity, pytest.approx(factor)), text


@pytest.mark.parametrize("text", ["ticks", "furlong", "x8004", "LSB", "", "WGS84", "m/", "/s", "s2s"])
def test_what_is_no_unit_is_none(text: str) -> None:
    assert known_unit(text) is None


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("gyro_x [rad/s]", "rad/s"), ("gx_dps", "dps"), ("gyro_rps_x", "rad/s"), ("ax_g", "g"), ("acc_x_mg", "mg"),
        ("raw_angular_rate_x_deg_per_s", "deg/s"), ("t_ms", "ms"), ("timestamp_seconds", "s"), ("accel_m_s2_x", "m/s2"),
        ("gyroADC[0]", ""), ("gyro_dps[0]", "dps"), ("X Accel [x8004]", ""), ("a_s", ""), ("Accel-X (g)", "g"),
        ("time [ticks]", "ticks"), ('"AccelX"|"G"|-3.0|3.0|50', "g"), ('"Yaw"|"Deg/Sec"|-120|120|50', "deg/s"),
    ],
)  # fmt: skip
def test_a_name_states_its_unit_in_brackets_or_as_a_suffix(name: str, unit: str) -> None:
    stated = split_unit(name)[1]
    assert bool(stated) == bool(unit)
    assert known_unit(stated) == known_unit(unit)


def test_a_name_and_a_unit_of_different_sensors_are_a_question() -> None:
    """A phone computes gravity, which hardly moves: gx to gz in m/s^2 are no gyroscope, and not the accelerometer."""
    gravity = ACCEL.mean(axis=0) + 1e-5 * ACCEL
    names = "t_ms,gx [m/s^2],gy [m/s^2],gz [m/s^2]"
    assert not read(names, 10 * STEP, gravity).certain
    both = read(names + ",ax [m/s^2],ay [m/s^2],az [m/s^2]", 10 * STEP, gravity, ACCEL)
    assert (both.map, both.certain) == ("accel=ax,ay,az:m/s^2,t=t:ms", True)


def test_further_samples_in_a_row_are_a_question() -> None:
    """Rows of a chip that has a queue: the rate is that of the samples, and not that of the rows."""
    names = "t_ms,gx0 [dps],gy0 [dps],gz0 [dps],gx1 [dps],gy1 [dps],gz1 [dps]"
    rows = np.random.default_rng(1).normal(0.2, 0.1, (800, 3))
    assert not read(names, 10 * STEP[:400], rows[::2], rows[1::2]).certain
    assert read(
        names, 10 * STEP[:400], rows[::2], rows[1::2] + 0.1
    ).certain  # two sensors differ by their bias


def test_what_has_one_length_is_a_direction() -> None:
    unit = ACCEL / np.linalg.norm(ACCEL, axis=1, keepdims=True)
    with pytest.raises(RecordingError):
        read("t_ms,dx,dy,dz", 10 * STEP, unit)


def test_what_is_stated_is_certain() -> None:
    reading = read("t_ms,gx_dps,gy_dps,gz_dps,ax_g,ay_g,az_g", 10 * STEP, GYRO / DEG, ACCEL / G)
    assert reading.certain
    layout = reading.layout()
    assert [c.factor for c in layout.columns[:4]] == pytest.approx([DEG, DEG, DEG, G])
    assert layout.times[0].factor == 1e6


@pytest.mark.parametrize(
    ("scale", "unit", "certain"),
    [(1.0, "m/s^2", True), (1 / G, "g", True), (1e3, "mm/s^2", True), (1e3 / G, "mg", False)],
)
def test_one_g_in_exactly_one_unit_is_certain(scale: float, unit: str, certain: bool) -> None:
    """In mg and in cm/s^2, one g is nearly the same number."""
    reading = read("t_ms,ax,ay,az", 10 * STEP, ACCEL * scale)
    assert (reading.uses[0].unit, reading.uses[0].certain) == (unit, certain)


@pytest.mark.parametrize(("scale", "unit"), [(1.0, "rad/s"), (1 / DEG, "deg/s")])
def test_a_gyroscope_without_a_unit_is_a_question_with_the_usual_one(scale: float, unit: str) -> None:
    reading = read("t_ms,gx,gy,gz", 10 * STEP, GYRO * scale)
    assert not reading.certain
    assert reading.uses[0].unit == unit
    with pytest.raises(ColumnsUnclear) as unclear:
        reading.checked("a.csv", accept=False)
    assert unclear.value.proposal == f"gyro=gx,gy,gz:{unit},t=t:ms"
    assert reading.checked("a.csv", accept=True).layout().caveats == ("assumed_unit",)
    nameless = read("t_ms,ch1,ch2,ch3,ch4,ch5,ch6", 10 * STEP, np.hstack([GYRO * scale, ACCEL]))
    assert {*nameless.checked("a.csv", accept=True).layout().caveats} == {"assumed_columns", "assumed_unit"}


@pytest.mark.parametrize("noise", [1e-4, 1e-3, 1e-2])
@pytest.mark.parametrize("ratio", [0.03, 0.3])
@pytest.mark.parametrize("gravity", [1.0, G])
def test_the_accelerometer_shows_the_grade_of_a_gyroscope(noise: float, ratio: float, gravity: float) -> None:
    """Quiet numbers in deg/s are those of noisy ones in rad/s, but an accelerometer of their grade differs."""
    gyro = RNG.normal([0.004, -0.003, 0.002], noise, (2000, 3))
    accel = RNG.normal([0.12, -0.23, 9.79], noise / ratio, (2000, 3)) / gravity
    for unit, of_unit in (("rad/s", 1.0), ("deg/s", DEG)):
        reading = read("t_ms,gx,gy,gz,ax,ay,az", 10 * STEP, gyro / of_unit, accel)
        assert reading.uses[0].unit == unit


def test_an_estimate_of_gravity_shows_no_grade() -> None:
    """It is quieter than any sensor."""
    gravity = RNG.normal([0.01, -0.02, 1.0], 1e-6, (2000, 3))
    reading = read("t_ms,gx,gy,gz,gravity_x,gravity_y,gravity_z", 10 * STEP, GYRO, gravity)
    assert reading.uses[0].unit == "rad/s"


@pytest.mark.parametrize("start", [1.7e9, 1.7e12, 1.7e15, 1.7e18])
def test_a_clock_that_counts_from_1970_is_certain(start: float) -> None:
    unit = start / 1.7e9
    reading = read("time,ax,ay,az", start + 0.01 * unit * STEP, ACCEL)
    assert reading.certain
    assert read("index,ax,ay,az", start + 0.01 * unit * STEP, ACCEL).certain
    assert reading.layout().times[0].factor == pytest.approx(1e9 / unit)


def test_a_clock_in_days_is_proposed_where_no_other_unit_shows_a_rate() -> None:
    """Dates of MATLAB and of spreadsheets are numbers of days."""
    reading = read("stamp,ax,ay,az", 739330.4 + 0.01 * STEP / 86400.0, ACCEL)
    assert (reading.uses[1].unit, reading.certain) == ("day", False)


def test_a_clock_that_never_falls_is_before_one_that_starts_again() -> None:
    """Rows that are late by less than the reader sorts are no new start."""
    reading = read("offset_time_ms,ts_ms,ax,ay,az", 10 * (STEP % 250), 10 * STEP, ACCEL)
    assert reading.uses[1].columns == (1,)
    swapped = STEP.reshape(-1, 40)[:, [*range(38), 39, 38]].ravel()
    reading = read("sensor_time_ms,host_time_ms,ax,ay,az", 10 * swapped, 10 * STEP, ACCEL)
    assert reading.uses[1].columns == (0,)


@pytest.mark.parametrize(
    ("step", "use"), [(10.0, (0, "ms")), (1e7, (0, "ns")), (4.5e4, (1, "s")), (10.24, (1, "s"))]
)
def test_a_clock_without_a_unit_has_that_in_which_it_runs_as_a_stated_one(
    step: float, use: tuple[int, str]
) -> None:
    """Ticks of its own have none: the stated clock is the time then, although it jitters."""
    host = 0.01 * STEP + RNG.exponential(2e-3, len(STEP))
    reading = read("sensor_time,host_time_s,ax,ay,az", step * STEP, host, ACCEL)
    assert reading.certain
    assert (reading.uses[1].columns[0], reading.uses[1].unit) == use


def test_a_time_is_proposed_before_ticks() -> None:
    reading = read("tick,offset_time,ax,ay,az", 45000.0 * STEP, 0.01 * STEP, ACCEL)
    assert (reading.uses[1].columns, reading.uses[1].unit) == ((1,), "s")


@pytest.mark.parametrize("first", [True, False])
def test_clocks_of_one_name_are_those_of_the_channels_behind_them(first: bool) -> None:
    emg = [("X[s]", 0.001 * STEP), ("EMG [Volts]", GYRO[:, 0])]
    accel = [each for k in range(3) for each in (("X[s]", 0.01 * STEP), (f"{'XYZ'[k]} [m/s^2]", ACCEL[:, k]))]
    header, columns = zip(*(emg + accel if first else accel + emg), strict=True)
    reading = read(",".join(header), *columns)
    assert reading.certain
    assert reading.uses[1].columns == (2 * first,)


@pytest.mark.parametrize("step", [0.01, 10.0, 256.0, 1e7])
def test_a_clock_without_a_unit_is_a_question_and_a_given_rate_answers_it(step: float) -> None:
    assert not read("time,ax,ay,az", step * STEP, ACCEL).certain
    reading = read("time,ax,ay,az", step * STEP, ACCEL, rate_hz=100.0)
    assert reading.certain
    assert reading.layout().times[0].factor * step == pytest.approx(1e7)


@pytest.mark.parametrize(
    "header", ["t [ticks],ax,ay,az", "t_ms,gx [furlong/s],gy [furlong/s],gz [furlong/s]"]
)
def test_a_unit_that_is_stated_and_not_known_is_never_replaced_by_a_guess(header: str) -> None:
    with pytest.raises(ImumonError) as unknown:
        read(header, 10 * STEP, ACCEL)
    assert unknown.value.code == "unknown_unit"


def test_a_unit_that_physics_contradicts_is_a_question() -> None:
    assert not read("t_ms,ax [m/s^2],ay [m/s^2],az [m/s^2]", 10 * STEP, ACCEL / G).certain


def test_an_axis_in_brackets_is_no_unit_and_the_letter_g_is_of_both_sensors() -> None:
    assert read("t_ms,G(x),G(y),G(z)", 10 * STEP, GYRO / DEG).uses[0].key == "gyro"
    reading = read("t_ms,G(x),G(y),G(z)", 10 * STEP, ACCEL / G)
    assert (reading.uses[0].key, reading.uses[0].unit, reading.certain) == ("accel", "g", False)


@pytest.mark.parametrize("name", ["x_speed,y_speed,z_speed", "x,y,z"])
def test_the_text_before_a_table_says_the_sensor_if_no_name_does(name: str) -> None:
    reading = read_columns(f"t_ms,{name}".split(","), (), np.column_stack([10 * STEP, GYRO]), source="gyro 1")
    assert reading.uses[0].key == "gyro"


def test_the_speed_of_an_engine_is_no_gyroscope() -> None:
    reading = read("t_ms,ax_g,ay_g,az_g,Engine Speed(rpm)", 10 * STEP, ACCEL / G, 800.0 + GYRO[:, 0])
    assert [use.key for use in reading.uses] == ["accel", "t"]
    for name, certain in (("steering [deg/s]", False), ("rate [deg/s]", True)):
        assert read(f"t_ms,{name}", 10 * STEP, GYRO[:, 0] / DEG).certain == certain


def test_constant_columns_and_orientations_are_no_sensor() -> None:
    orientation = "roll [deg],pitch [deg],yaw [deg]"
    names = f"t_ms,{orientation},gx [dps],gy [dps],gz [dps]"
    reading = read(names, 10 * STEP, 1.0 + 0.01 * GYRO, GYRO / DEG)
    assert reading.map == "gyro=gx,gy,gz:dps,t=t:ms"
    with pytest.raises(ImumonError):
        read("t_ms,ax,ay,az", 10 * STEP, np.ones((2000, 3)))


def test_samples_one_behind_the_other_in_a_record_are_no_sensor() -> None:
    """Which three of thirty numbers without a name are the axes, nothing says: not even a proposal does."""
    with pytest.raises(ImumonError) as raised:
        read(",".join([""] * 30), *np.tile(GYRO, 10).T)
    assert raised.value.code == "no_sensor"


def test_columns_without_names_are_divided_where_the_noise_changes() -> None:
    """An orientation of four numbers is before the sensors, so that they begin at any column."""
    attitude = RNG.normal([0.1, 0.2, 0.3, 0.9], 1e-6, (2000, 4))
    reading = read(",,,,,,,,,,", 1.7e18 + 1e7 * STEP, attitude, GYRO, ACCEL)
    assert reading.map == "gyro=6,7,8:rad/s,accel=9,10,11:m/s^2,t=1:ns"


def test_names_that_differ_only_by_the_unit_are_two_sensors() -> None:
    names = "t [s],S X [g],S Y [g],S Z [g],S X [deg/s],S Y [deg/s],S Z [deg/s]"
    reading = read(names, STEP * 0.01, ACCEL / G, GYRO / DEG)
    assert reading.certain
    assert {use.key: use.columns for use in reading.uses} == {
        "accel": (1, 2, 3),
        "gyro": (4, 5, 6),
        "t": (0,),
    }


def test_increments_are_divided_by_their_interval() -> None:
    names = "time [s],dtheta_x [deg],dtheta_y [deg],dtheta_z [deg],dvel_x,dvel_y,dvel_z"
    reading = read(names, 0.01 * STEP, GYRO / DEG / 100.0, ACCEL / 100.0)
    assert reading.certain  # over its interval, the velocity is 1 g in m/s
    assert reading.layout().kind == "deltas"


def test_two_streams_of_one_sensor_show_the_unit_by_their_ratio() -> None:
    names = "t_ms,gx,gy,gz,dtheta_x,dtheta_y,dtheta_z,ax,ay,az"
    reading = read(names, 10 * STEP, GYRO, GYRO / DEG / 100.0, ACCEL)
    gyro = next(use for use in reading.uses if use.key == "gyro")
    assert gyro.unit == "rad/s"
    assert "57.3" in gyro.reason


def test_the_proposal_can_be_given_back_and_is_certain_then() -> None:
    header = "time,gyr x,gyr y,gyr z,acc:x,acc:y,acc:z"
    columns = (10 * STEP, GYRO / DEG, ACCEL / G)
    proposal = read(header, *columns)
    again = read(header, *columns, columns=parse_map(proposal.map))
    assert again.certain
    assert again.layout().columns == proposal.layout().columns


def test_each_axis_has_the_scale_that_the_map_gives_it() -> None:
    given = parse_map("gyro/x=a*2:deg/s,gyro/y=b*-1:deg/s,gyro/z=c/4:deg/s")
    reading = read("a,b,c", GYRO, columns=given, rate_hz=100.0)
    assert [column.factor / DEG for column in reading.layout().columns] == pytest.approx([2.0, -1.0, 0.25])
    assert parse_map(reading.map) == {**given, "gyro/z": "c*0.25:deg/s", "rate": "100"}
    with pytest.raises(ImumonError) as wrong:
        read("a,b,c", GYRO, columns=given | {"gyro/y": "b:rad/s"})
    assert wrong.value.code == "map_syntax"


def test_counts_need_the_number_of_the_data_sheet() -> None:
    counts = np.rint(np.hstack([GYRO / DEG * 131.0, ACCEL / G * 16384.0]))
    reading = read("t_ms,gx,gy,gz,ax,ay,az", 10 * STEP, counts)
    with pytest.raises(ColumnsUnclear) as unclear:
        reading.checked("a.csv", accept=False)
    assert "SCALE" in unclear.value.proposal
    accepted = reading.checked("a.csv", accept=True).layout()
    assert {channel[:5] for channel in accepted.channels} == {"accel"}  # 1 g shows its counts
    given = read(
        "t_ms,gx,gy,gz", 10 * STEP, counts[:, :3], columns=parse_map("gyro=gx/131,gy/131,gz/131:deg/s")
    )
    assert given.layout().columns[0].factor == pytest.approx(DEG / 131.0)


def test_whole_numbers_are_in_the_unit_that_is_nearest_to_1_g() -> None:
    gyro, accel = np.rint(GYRO / DEG * 1e3), ACCEL / np.linalg.norm(ACCEL.mean(axis=0))
    in_mg = read("t_ms,gx,gy,gz,ax,ay,az", 10 * STEP, gyro, np.rint(1000.0 * accel))
    assert not in_mg.certain
    assert {use.key: use.unit for use in in_mg.uses} == {"gyro": "mdeg/s", "accel": "mg", "t": "ms"}
    in_counts = read("t_ms,gx,gy,gz,ax,ay,az", 10 * STEP, gyro, np.rint(1024.0 * accel))
    assert [use.scales[:1] for use in in_counts.uses] == [(0.0,), (1.0 / 1024.0,), ()]
    beside_others = read("t_ms,gx,gy,gz,ax,ay,az", 10 * STEP, gyro, 1000.0 * accel)
    assert beside_others.uses[0].scales == (0.0,) * 3


@pytest.mark.parametrize(
    ("text", "rate"),
    [
        ("Fs,100", 100.0), ("# Sample Rate = 250 Hz", 250.0), ("Update Rate: 100.0Hz", 100.0), ("Fs 1.6 kHz", 1600.0),
        ("data_rate = 100.0 Hz, filter = 488 Hz", 100.0), ("baud rate: 115200", None), ("range 8", None),
        ("baudrate 9600, sample rate 50", 50.0), ("EMG sampling frequency: 1111\nACC sampling frequency: 148", None),
        ("GPS update rate: 10 Hz", None), ("gyro rate 500dps, 4g", None), ("Max angular rate: 2000 deg/s", None),
        ("frame rate: 30", None), ("low pass filter frequency: 40 Hz", None), ("control loop rate: 250 Hz", None),
        ("odr: 104\nrate: 100", None), ("Rate 50", 50.0), ("sample_rate_hz: 100", 100.0),
        ("Sample interval (s): 0.01", 100.0), ("ODR: 1000 Hz", None), ("output data rate 1000 Hz", None),
        ("sample rate 1000 Hz, every 10th row", None), ("Fs 1000, decimation 10", None), ("ODR 100\nFs 100", 100.0),
        ("Sensor rate: 1000 Hz\nLogging interval: 10 ms", None), ("logged every 10 ms, ODR 1000 Hz", None),
    ],
)  # fmt: skip
def test_a_rate_of_the_rows_beside_the_word_rate_is_stated(text: str, rate: float | None) -> None:
    stated = stated_rate(text)
    assert (stated.hz if stated is not None and stated.of_rows else None) == rate


@pytest.mark.parametrize(
    ("text", "hz"),
    [
        ("ODR: 104 Hz", 104.0),
        ("Output data rate: 1.6 kHz", 1600.0),
        ("ODR 1000 Hz, every 10th is logged", None),
    ],
)
def test_the_rate_of_a_chip_is_proposed_and_not_taken(text: str, hz: float | None) -> None:
    (rate,) = (
        u for u in read_columns(["ax", "ay", "az"], (), ACCEL, rate=stated_rate(text)).uses if u.key == "rate"
    )
    assert not rate.certain
    assert (None if rate.known is None else rate.known.factor) == hz


@pytest.mark.parametrize(("step", "certain"), [(10.0, True), (1.0, True), (100.0, False)])
def test_a_comment_states_the_unit_of_a_clock_only_if_that_is_usual(step: float, certain: bool) -> None:
    rows = np.column_stack([step * STEP, ACCEL])
    assert read_columns(["t", "ax", "ay", "az"], (), rows, rate=StatedRate(100.0)).certain == certain
    assert read_columns(["t", "ax", "ay", "az"], (), rows, ReadOptions(rate_hz=100.0)).certain


@pytest.mark.parametrize("text", ["gyro", "gx=1", "gyro=1,2", "t=1,2,3", "=1"])
def test_a_map_that_is_none_is_an_error(text: str) -> None:
    with pytest.raises(ImumonError) as wrong:
        parse_map(text)
    assert wrong.value.code == "map_syntax"


def test_the_rate_of_a_map_is_that_of_the_table() -> None:
    layout = read("ax,ay,az", ACCEL, columns=parse_map("accel=ax,ay,az:m/s^2,rate=100")).layout()
    assert layout.rate_hz == 100.0


def test_the_axes_of_a_ship_have_an_order() -> None:
    header = "t_ms," + ",".join(f"{name} acc [mg]" for name in ("heave", "surge", "sway"))
    reading = read(header, 10 * STEP, ACCEL[:, [2, 0, 1]] / G * 1e3)
    assert reading.certain
    assert reading.uses[0].columns == (2, 3, 1)


@pytest.mark.parametrize("shift", [-1, 1])
def test_units_that_are_beside_their_names_state_nothing(shift: int) -> None:
    names, units = ["n", "t", "gx", "gy", "gz"], ["", "ms", "deg/s", "deg/s", "deg/s"]
    rows = np.column_stack([STEP, 10 * STEP, GYRO / DEG])
    shifted = [*units[-shift:], *units[:-shift]]
    unclear = {use.key: use.unit for use in read_columns(names, shifted, rows).uses if not use.certain}
    assert unclear == {"gyro": "deg/s", "t": "ms"}
    assert read_columns(names, units, rows).certain
