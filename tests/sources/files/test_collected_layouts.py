"""Layouts as other programs write them: the score of reading a collection of inputs with known noise.

The collection lies beside the checkout; without it the test is skipped.
"""

from __future__ import annotations

from dataclasses import dataclass

import pytest
from paths import RECORDINGS
from tables import replayed

from imumon.model.errors import ImumonError

COLLECTION = RECORDINGS.parent

Axes = tuple[float, float, float]
GYRO: Axes = (1.0e-4, 2.0e-4, 3.0e-4)
ACCEL: Axes = (1.0e-3, 1.5e-3, 2.0e-3)
EVEN_GYRO: Axes = (3.0e-4,) * 3
EVEN_ACCEL: Axes = (1.5e-3,) * 3
FOG = 0.01 / 60.0 * 0.017453292519943295
"""rad/s/sqrt(Hz) of 0.01 deg/sqrt(h)."""


@dataclass(frozen=True)
class Layout:
    """An input of the collection.

    Attributes
    ----------
    path : below the collection.
    gyro, accel : N in SI by axis; None: either way is right.
    stated : everything is stated in it, so that a question is a fault.
    rate_hz : that only the owner knows.
    """

    path: str
    gyro: tuple[float, ...] | None = GYRO
    accel: tuple[float, ...] | None = ACCEL
    stated: bool = False
    rate_hz: float | None = None


LAYOUTS = (
    Layout("cases/brackets/LOG00042.01.csv", accel=None),
    Layout("cases/capital_axis/dataLog00012.TXT"),
    Layout("cases/blank_separated_units/data.txt", (1e-4,) * 3, (8.43e-4,) * 3, stated=True),
    Layout("cases/one_sensor_mdps/ism330dhcx_gyro.csv", accel=(), stated=True),
    Layout("cases/celsius_sign/20240319164416.txt", stated=True),
    Layout("cases/zone_in_brackets/Accelerometer.csv", gyro=(), stated=True),
    Layout("cases/zone_in_brackets/Gyroscope.csv", accel=(), stated=True),
    Layout("cases/device_in_every_name/Session1_Shimmer_B1E5_Calibrated_SD.csv", accel=None, stated=True),
    Layout("cases/field_id_in_brackets/IMU_data.csv"),
    Layout("cases/phone_sensorlog/2024-03-01_10_00_00_my_iPhone.csv", stated=True),
    Layout("cases/json/imu.jsonl", accel=None),
    Layout("cases/json/mqtt.jsonl", EVEN_GYRO, EVEN_ACCEL),
    Layout("cases/one_row_per_event/sensors.sense", EVEN_GYRO, None),
    Layout("cases/rostopic_echo/imu.txt", None, None),
    Layout("cases/labelled_lines/labels1.log", EVEN_GYRO, EVEN_ACCEL),
    Layout("cases/labelled_lines/serial.log", EVEN_GYRO, EVEN_ACCEL, rate_hz=100.0),
    Layout("cases/millimetres/adxl345-20230101.csv", (), (3.0e-3,) * 3),
    Layout("cases/increments/stim.csv", None, None, stated=True),
    Layout("cases/increments/delta.csv", None, None, stated=True),
    Layout("printed_logs/bag_increments_px4/px4_vi", None, None, stated=True),
    Layout("printed_logs/csv_deltatheta_degrees/vn_group200.csv", (6e-5,) * 3, (1.4e-3,) * 3),
    Layout("printed_logs/first_row_cut/cut.csv"),
    Layout("printed_logs/gz_topic/gz_topic.txt"),
    Layout("printed_logs/iio_generic_buffer/iio_generic_buffer.txt"),
    Layout("printed_logs/mat_struct_fb_wb/navego_static.mat"),
    Layout("printed_logs/one_axis_fog/fog_f2.csv", (FOG,), (), stated=True),
    Layout("printed_logs/one_axis_fog/fog_f1.csv", (FOG,), ()),
    Layout("printed_logs/python_dicts/dicts.txt"),
    Layout("printed_logs/python_dicts/list_cells.csv"),
    Layout("printed_logs/sparkfun_icm20948/sparkfun.txt", (1e-3, 2e-3, 3e-3), accel=None, rate_hz=100.0),
    Layout("printed_logs/stated_rate_Fs/log.csv", stated=True),
    Layout("printed_logs/time_in_minutes/t_min.csv"),
    Layout("printed_logs/time_in_ticks/tick_bosch.csv", rate_hz=100.0),
    Layout("printed_logs/two_time_columns/pair_p3.csv"),
    Layout("printed_logs/unit_in_words/firm_quiet.csv", tuple(n / 30.0 * 1.0 for n in GYRO), (), stated=True),
)


def outcome(layout: Layout, **options: object) -> str:
    """Return what a replay gives: ``right``, ``asks``, ``refuses`` with the error, or ``wrong`` with the channel."""
    try:
        report, _ = replayed(COLLECTION / layout.path, **options)
    except ImumonError as error:
        return "asks" if error.code in ("columns_unclear", "rate_required") else f"refuses: {error.code}"
    for sensor, truth in (("gyro", layout.gyro), ("accel", layout.accel)):
        for axis, expected in zip("xyz", truth or (), strict=False):
            channel = report.channels.get(f"{sensor}/{axis}")
            if channel is None:
                return f"wrong: {sensor}/{axis} is missing"
            low, high = channel.N.low or 0.0, channel.N.high or float("inf")
            if not low / 1.15 <= expected <= high * 1.15:
                return f"wrong: {sensor}/{axis} N {channel.N.value} is not {expected:.3g}"
    return "right"


@pytest.mark.slow
@pytest.mark.skipif(not (COLLECTION / "cases").exists(), reason="the collection of layouts is not there")
def test_no_layout_of_the_collection_gives_a_wrong_number() -> None:
    plain = {each.path: outcome(each, accept=False) for each in LAYOUTS}
    assert not {path: result for path, result in plain.items() if result.startswith("wrong")}
    accepted = {each.path: outcome(each, rate_hz=each.rate_hz) for each in LAYOUTS}
    others = {path: result for path, result in accepted.items() if result != "right"}
    assert len(others) <= 0.05 * len(LAYOUTS), others
    asked = [each.path for each in LAYOUTS if each.stated and plain[each.path] != "right"]
    assert len(asked) <= 0.05 * len(LAYOUTS), asked
