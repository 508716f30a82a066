"""ULog reader: inertial topics of a PX4 log, read by pyulog.

`vehicle_imu` has true integrals of each IMU, and `sensor_combined` averages of the selected one. They are free of
aliasing if the integrals cover the time: a log often has only every hundredth of them. `sensor_gyro` and
`sensor_accel` are point samples, and `sensor_gyro_fifo` and `sensor_accel_fifo` all samples of the chip. Message
definitions: PX4-Autopilot, msg/.
"""

from __future__ import annotations

import mmap
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from imumon.grid.interval import SINGLE_EXCESS
from imumon.model.samples import AXES, Floats
from imumon.model.units import share_text
from imumon.sources.files.log_process.base import (
    ArrayLog,
    Arrays,
    Topic,
    add_matched,
    best_first,
    degrees_at,
    described,
)

HEADER_BYTES = 16
"""Bytes before the first message."""
TYPES = frozenset(b"BFIMPQARDLCSO")
"""Types of messages (PX4 user guide, ULog file format)."""
COVERED = 0.9
"""Share of the time that integrals must cover to be averages over the sampling interval."""


AVERAGES = {
    "vehicle_imu": (
        ("gyro", "delta_angle", "delta_angle_dt", "rad/s"),
        ("accel", "delta_velocity", "delta_velocity_dt", "m/s2"),
    ),
    "sensor_combined": (
        ("gyro", "gyro_rad", "gyro_integral_dt", "rad/s"),
        ("accel", "accelerometer_m_s2", "accelerometer_integral_dt", "m/s2"),
    ),
}
"""Topics with averages, of which those of `vehicle_imu` are integrals: sensor, field, field of the interval, unit."""

FIFO = {"sensor_gyro_fifo": ("gyro", "rad/s"), "sensor_accel_fifo": ("accel", "m/s2")}
"""Topics with all samples of a chip: sensor and unit."""


class ULogLog(ArrayLog):
    """Topics of a ULog file; all of it is in memory."""

    def __init__(self, path: Path) -> None:
        from pyulog.core import ULog

        log = ULog(str(path))
        data: dict[tuple[str, int], Arrays] = {}
        for dataset in log.data_list:
            data[dataset.name, dataset.multi_id] = dataset.data
        topics = [_topic(name, instance, data) for name, instance in data]
        self.arrays = {topic.name: arrays for topic, arrays in topics}
        self.topics = best_first([topic for topic, _ in topics], "vehicle_imu")
        self.facts = _facts(log.msg_info_dict)
        if log.file_corruption or not is_whole(path):
            self.problem = "is corrupt: only the messages that are intact are used"
        if log.dropouts:
            lost = sum(dropout.duration for dropout in log.dropouts) * 1e-3
            self.remarks = [f"its logger dropped messages for {lost:.3g} s in total"]


def is_whole(path: Path) -> bool:
    """Return whether the messages of a ULog file follow each other to its end, each of a known type.

    pyulog ends without a word at a message that would be longer than the rest of the file.
    """
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        place, size = HEADER_BYTES, len(data)
        while place + 3 <= size:
            if data[place + 2] not in TYPES:
                return False
            place += 3 + data[place] + (data[place + 1] << 8)
        return place == size


def _topic(name: str, instance: int, data: Mapping[tuple[str, int], Arrays]) -> tuple[Topic, Arrays]:
    """Return a topic and its arrays, with those that are derived."""
    arrays = dict(data[name, instance])
    if name in FIFO:
        return _fifo(name, instance, arrays, data)
    time = "timestamp_sample" if "timestamp_sample" in arrays else "timestamp"
    known, covered, note = _known_fields(name, arrays, time, data.get(("sensor_accel", instance)))
    if known and "temperature" not in known and (degrees := _temperature(arrays, time, data)) is not None:
        arrays["sensor_gyro.temperature"] = degrees
        known["temperature"] = "sensor_gyro.temperature:degC"
    # another version of PX4 may have other fields under the same name: then --map names them
    if not all(text.rpartition(":")[0] in arrays for text in known.values()):
        known = {}
    averaged = covered is not None and covered >= COVERED
    if covered is not None and not averaged:
        note = f"its integrals cover {share_text(covered)} of the time: each value is a short average"
    known_time = {**known, "t": f"{time}:us"}
    note = note if known else ""
    return described(f"{name}/{instance}", name, arrays, known_time, averaged=averaged, note=note), arrays


def _known_fields(
    name: str, arrays: Arrays, time: str, accel: Arrays | None
) -> tuple[dict[str, str], float | None, str]:
    """Return the fields of a known topic; the share of the time that its averages cover, if it has some; a note."""
    if name in AVERAGES:
        return *_averages(name, arrays, time), ""
    if name not in ("sensor_gyro", "sensor_accel"):
        return {}, None, ""
    sensor, unit = FIFO[f"{name}_fifo"]
    known = {f"{sensor}/{axis}": f"{axis}:{unit}" for axis in AXES}
    if "temperature" in arrays:
        known["temperature"] = "temperature:degC"
    if name == "sensor_accel":
        return known, None, ""
    columns = {f"sensor_accel.{axis}": axis for axis in AXES}
    note = add_matched(arrays, accel, "sensor_accel", time, columns)
    if set(columns) <= set(arrays):
        known |= {f"accel/{axis}": f"{column}:m/s2" for column, axis in columns.items()}
    return known, None, note


def _temperature(
    arrays: Arrays, time: str, data: Mapping[tuple[str, int], Arrays], source: str = "sensor_gyro"
) -> Floats | None:
    """Return the temperature of the sensor of these samples, between the rare messages that have it; None: unknown.

    The number of the chip chooses the sensor; `sensor_combined` has that of `sensor_selection`, if it never changes. A
    topic without one is that of the only sensor.
    """
    sources = [dataset for (name, _), dataset in data.items() if name == source and "temperature" in dataset]
    chip = arrays.get("gyro_device_id", arrays.get("device_id"))
    if chip is None and "gyro_rad[0]" in arrays:
        chip = np.unique(data.get(("sensor_selection", 0), {}).get("gyro_device_id", np.zeros(0)))
        # a selection that changes mixes the samples of several sensors: no temperature fits all of them
        chip = chip if len(chip) == 1 else None
    if chip is not None:
        same = chip[:1].tolist()
        sources = [dataset for dataset in sources if same == dataset.get("device_id", chip[:0])[:1].tolist()]
    if len(sources) != 1 or time not in arrays:
        return None
    return degrees_at(arrays[time], sources[0]["timestamp"], sources[0]["temperature"])


def _averages(name: str, arrays: Arrays, time: str) -> tuple[dict[str, str], float]:
    """Return the fields of averages, and the share of the time that they cover; divide integrals by their interval."""
    known: dict[str, str] = {}
    covered = 1.0
    for sensor, field, interval_field, unit in AVERAGES[name]:
        interval = arrays.get(interval_field, np.zeros(0))
        scale = 1.0 if interval.dtype.kind == "f" else 1e-6  # s in old logs, us since 2016
        interval_s = interval.astype(np.float64) * scale
        for k, axis in enumerate(AXES):
            column = f"{field}[{k}]"
            if name == "vehicle_imu" and column in arrays:
                with np.errstate(divide="ignore", invalid="ignore"):  # an empty interval is a missing value
                    arrays[f"{column}/{interval_field}"] = arrays[column].astype(np.float64) / interval_s
                column = f"{column}/{interval_field}"
            known[f"{sensor}/{axis}"] = f"{column}:{unit}"
        covered = min(covered, _coverage(interval_s, arrays[time]))
    return known, covered


def _coverage(interval_s: Floats, times_us: npt.NDArray[Any]) -> float:
    """Return the share of the time between consecutive messages that the intervals of integrals cover."""
    if len(times_us) < 2 or len(interval_s) != len(times_us):
        return 0.0
    steps = np.diff(times_us.astype(np.float64)) * 1e-6
    # only neighbours: a pause of the logger says nothing of how the integrals follow each other
    near = (steps > 0.0) & (steps < (1.0 + SINGLE_EXCESS) * float(np.median(steps)))
    return float(interval_s[1:][near].sum() / steps[near].sum()) if near.any() else 0.0


def _fifo(
    name: str, instance: int, arrays: Arrays, data: Mapping[tuple[str, int], Arrays]
) -> tuple[Topic, Arrays]:
    """Return all samples of a FIFO: the stamp of a message is that of its last sample, `dt` is in us."""
    sensor, unit = FIFO[name]
    known = {f"{sensor}/{axis}": f"{axis}:{unit}" for axis in AXES} | {"t": "timestamp_sample:us"}
    place = np.arange(sum(key.startswith("x[") for key in arrays))
    try:
        counts, dt, scale, stamps = (
            arrays[field].astype(np.float64)[:, None]
            for field in ("samples", "dt", "scale", "timestamp_sample")
        )
        raw = {axis: np.column_stack([arrays[f"{axis}[{k}]"] for k in place]) for axis in AXES}
    except (KeyError, ValueError):  # another version of PX4 has other fields, or none for a sample
        return Topic(name=f"{name}/{instance}", type=name, count=0), {}
    valid = place < counts
    integrals: Arrays = {"timestamp_sample": (stamps - (counts - 1 - place) * dt)[valid]}
    integrals |= {axis: (numbers * scale)[valid] for axis, numbers in raw.items()}
    source = f"sensor_{sensor}"
    if (degrees := _temperature({**arrays, **integrals}, "timestamp_sample", data, source)) is not None:
        integrals[f"{source}.temperature"] = degrees
        known["temperature"] = f"{source}.temperature:degC"
    return described(f"{name}/{instance}", name, integrals, known), integrals


def _facts(info: Mapping[str, Any]) -> dict[str, str]:
    """Return board and version of the firmware."""
    facts = {}
    if isinstance(board := info.get("ver_hw"), str):
        facts["model"] = f"PX4 {board}"
    if isinstance(release := info.get("ver_sw_release"), int):  # major, minor, patch, type: a byte each
        facts["firmware"] = ".".join(str(release >> shift & 0xFF) for shift in (24, 16, 8))
    elif isinstance(digest := info.get("ver_sw"), str):
        facts["firmware"] = digest[:12]
    return facts
