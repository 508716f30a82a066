"""Layouts as other programs write them: the score of reading a collection of inputs with known noise.

The collection lies beside the checkout; without it the test is skipped. Run the module to see the score by input.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import pytest

COLLECTION = Path(__file__).parents[3].parent / "shared"

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
    known : options that only the owner knows.
    """

    path: str
    gyro: tuple[float, ...] | None = GYRO
    accel: tuple[float, ...] | None = ACCEL
    stated: bool = False
    known: tuple[str, ...] = field(default=())


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
    Layout("cases/labelled_lines/serial.log", EVEN_GYRO, EVEN_ACCEL, known=("--rate", "100")),
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
    Layout(
        "printed_logs/sparkfun_icm20948/sparkfun.txt", (1e-3, 2e-3, 3e-3), accel=None, known=("--rate", "100")
    ),
    Layout("printed_logs/stated_rate_Fs/log.csv", stated=True),
    Layout("printed_logs/time_in_minutes/t_min.csv"),
    Layout("printed_logs/time_in_ticks/tick_bosch.csv", known=("--rate", "100")),
    Layout("printed_logs/two_time_columns/pair_p3.csv"),
    Layout("printed_logs/unit_in_words/firm_quiet.csv", tuple(n / 30.0 * 1.0 for n in GYRO), (), stated=True),
)


def outcome(layout: Layout, *options: str) -> str:
    """Return what a replay gives: ``right``, ``asks``, ``refuses`` with the error, or ``wrong`` with the channel."""
    command = [sys.executable, "-m", "imumon", "replay", str(COLLECTION / layout.path), "--json", *options]
    run = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False)
    if run.returncode:
        try:
            code = json.loads(run.stderr.strip().splitlines()[-1])["error"]["code"]
        except (ValueError, IndexError, KeyError):
            code = run.stderr[-300:]
        return "asks" if code in ("columns_unclear", "rate_required") else f"refuses: {code}"
    channels = json.loads(run.stdout)["channels"]
    for sensor, truth in (("gyro", layout.gyro), ("accel", layout.accel)):
        for axis, expected in zip("xyz", truth or (), strict=False):
            channel = channels.get(f"{sensor}/{axis}")
            if channel is None:
                return f"wrong: {sensor}/{axis} is missing"
            noise = channel["N"]
            low, high = noise["low"] or 0.0, noise["high"] or float("inf")
            if not low / 1.15 <= expected <= high * 1.15:
                return f"wrong: {sensor}/{axis} N {noise['value']} is not {expected:.3g}"
    return "right"


def score(layouts: tuple[Layout, ...] = LAYOUTS) -> list[tuple[Layout, str, str]]:
    """Return each layout with its outcome as it is, and with the proposal accepted."""
    return [(each, outcome(each), outcome(each, "--accept", *each.known)) for each in layouts]


@pytest.mark.slow
@pytest.mark.skipif(not (COLLECTION / "cases").exists(), reason="the collection of layouts is not there")
def test_no_layout_of_the_collection_gives_a_wrong_number() -> None:
    results = score()
    assert not [(e.path, plain) for e, plain, _ in results if plain.startswith("wrong")]
    accepted = [taken == "right" for _, _, taken in results]
    assert sum(accepted) >= 0.95 * len(accepted), [(e.path, t) for e, _, t in results if t != "right"]
    asked = [e.path for e, plain, _ in results if e.stated and plain != "right"]
    assert len(asked) <= 0.05 * len(results), asked


if __name__ == "__main__":
    for each, plain, taken in score():
        print(f"{each.path:70} {plain:40} {taken}", flush=True)
