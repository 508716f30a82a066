"""DataFlash reader: inertial messages of an ArduPilot log (.BIN), indexed by pymavlink.

`IMU` has point samples behind the filter of the autopilot (INS_GYRO_FILTER), `GYR` and `ACC` those before it if raw
logging is on; the samples of `ACC` are joined to those of `GYR` if their times agree. Only `IMU` has the temperature;
raw samples of the same sensor take it from there. Definitions of the messages: ArduPilot,
libraries/AP_InertialSensor/LogStructure.h.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from imumon.model.samples import AXES
from imumon.sources.files.base import ROWS
from imumon.sources.files.log_process.base import (
    ArrayLog,
    Arrays,
    Topic,
    add_matched,
    best_first,
    degrees_at,
    described,
)

TYPES = {
    "b": "i1", "B": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "q": "<i8", "Q": "<u8", "g": "<f2",
    "f": "<f4", "d": "<f8", "n": "S4", "N": "S16", "Z": "S64", "c": "<i2", "C": "<u2", "e": "<i4", "E": "<u4",
    "L": "<i4", "M": "u1", "a": "(32,)<i2",
}  # fmt: skip
"""Type of numpy for each character of a format (AP_Logger/LogStructure.h)."""

SCALES = {"c": 1e-2, "C": 1e-2, "e": 1e-2, "E": 1e-2, "L": 1e-7}
"""Factor of formats that count parts of a unit."""

HEADER_BYTES = 3
"""Bytes of a message before its fields, by the format."""

SENSORS = {
    "gyro": (("GyrX", "GyrY", "GyrZ"), "rad/s"),
    "accel": (("AccX", "AccY", "AccZ"), "m/s2"),
}
"""Columns and unit of a sensor."""

TIMES = {"SampleUS": "us", "TimeUS": "us", "TimeMS": "ms"}
"""Columns of time, the best first, and their units."""

HEAT = "IMU.T"
"""Column of the temperature that raw samples have from the `IMU` messages of the same sensor."""

RAW = re.compile(r"(?:GYR|ACC)(/?)(\d*)")
"""Names of raw samples, with the number of the sensor: from 0 after a slash, else from 1."""

BOARD = re.compile(r"^(\S+) [0-9A-F]{8} [0-9A-F]{8} [0-9A-F]{8}$")
"""Text with the name of the board and its number."""


def _is_imu(topic: Topic) -> bool:
    """Return whether a topic has the values that the autopilot uses."""
    return topic.type.startswith("IMU") and {"gyro/x", "accel/x"} <= set(topic.map)


def _map_of(arrays: Arrays) -> dict[str, str]:
    """Return the columns of the channels and of the time, with their units."""
    known: dict[str, str] = {}
    for sensor, (columns, unit) in SENSORS.items():
        if set(columns) <= set(arrays):
            known |= {f"{sensor}/{a}": f"{c}:{unit}" for a, c in zip(AXES, columns, strict=True)}
    if known and (heat := next((c for c in ("T", HEAT) if c in arrays), None)):
        known["temperature"] = f"{heat}:degC"
    time = _time_of(arrays)
    return known if time is None else known | {"t": f"{time}:{TIMES[time]}"}


def _time_of(arrays: Arrays) -> str | None:
    return next((c for c in TIMES if c in arrays), None)


class DataFlashLog(ArrayLog):
    """Topics of a DataFlash log."""

    def __init__(self, path: Path) -> None:
        from pymavlink.DFReader import DFReader_binary

        self._log: Any = DFReader_binary(str(path))
        self._data = np.frombuffer(self._log.data_map, np.uint8)
        self.facts = self._facts()
        if skipped := self._skipped_bytes():
            self.problem = f"is corrupt: {skipped:,} bytes between its messages belong to none"
        self.arrays = {name: a for kind in list(self._log.name_to_id) for name, a in self._series(kind)}
        best = best_first([self._topic(name, arrays) for name, arrays in self.arrays.items()])
        self.topics = sorted(best, key=lambda topic: not _is_imu(topic))

    def _skipped_bytes(self) -> int:
        """Return the bytes before the last message that belong to none; autopilots leave some after it."""
        starts = [np.array(self._log.offsets[number], np.int64) for number in self._log.formats]
        lengths = [form.len for form in self._log.formats.values()]
        ends = [int(places[-1]) + size for places, size in zip(starts, lengths, strict=True) if len(places)]
        used = sum(len(places) * size for places, size in zip(starts, lengths, strict=True))
        return int(max(ends, default=0) - used)

    def _columns(self, name: str) -> Arrays:
        """Return the columns of a type of messages; none: there are no such messages, or their format is unknown."""
        if (number := self._log.name_to_id.get(name)) is None:
            return {}
        form = self._log.formats[number]
        try:
            letters = dict(zip(form.columns, form.format, strict=True))
            dtype = np.dtype([(column, TYPES[letter]) for column, letter in letters.items()])
        except (KeyError, ValueError):
            return {}
        places = np.array(self._log.offsets[number], dtype=np.int64) + HEADER_BYTES
        places = places[places + dtype.itemsize <= len(self._data)]  # the last one may be incomplete
        if not len(places) or dtype.itemsize != form.len - HEADER_BYTES:
            return {}
        # in blocks: an index takes eight times as much as the bytes
        parts = [
            self._data[places[k : k + ROWS, None] + np.arange(dtype.itemsize)].view(dtype)[:, 0]
            for k in range(0, len(places), ROWS)
        ]
        rows = np.concatenate(parts)
        return {
            column: rows[column] * SCALES[letter] if letter in SCALES else rows[column]
            for column, letter in zip(dtype.names or (), letters.values(), strict=True)
        }

    def _series(self, name: str) -> Iterator[tuple[str, Arrays]]:
        """Yield the columns of numbers of a message: of an IMU, for each instance."""
        columns = self._columns(name).items()
        numbers = {
            column: values for column, values in columns if values.dtype.kind in "iuf" and values.ndim == 1
        }
        if not numbers:
            return
        if "I" not in numbers:
            yield name, numbers
            return
        for instance in np.unique(numbers["I"]).tolist():
            chosen = numbers["I"] == instance
            yield f"{name}/{instance}", {column: values[chosen] for column, values in numbers.items()}

    def _topic(self, name: str, arrays: Arrays) -> Topic:
        """Return a topic; raw samples get their accelerometer and the temperature of their IMU."""
        kind = name.partition("/")[0]
        note = self._add_accelerometer(name, arrays)
        if (named := RAW.fullmatch(name)) is not None:
            self._add_temperature(int(named[2] or 1) - (not named[1]), arrays)
        return described(name, kind, arrays, _map_of(arrays), note=note)

    def _add_accelerometer(self, name: str, arrays: Arrays) -> str:
        """Add the samples of the accelerometer to those of its gyroscope; return what is not used."""
        accel_name, time = name.replace("GYR", "ACC", 1), _time_of(arrays)
        if not name.startswith("GYR") or time is None:
            return ""
        columns = {column: column for column in SENSORS["accel"][0]}
        return add_matched(arrays, self.arrays.get(accel_name), accel_name, time, columns)

    def _add_temperature(self, number: int, arrays: Arrays) -> None:
        """Add the temperature that the `IMU` messages of a sensor have to its raw samples."""
        imu: Arrays = (
            self.arrays.get(f"IMU/{number}") or self.arrays.get(f"IMU{number + 1 if number else ''}") or {}
        )
        time = _time_of(arrays)
        if time is not None and {"TimeUS", "T"} <= set(imu):
            heat = degrees_at(arrays[time], imu["TimeUS"], imu["T"])
            arrays |= {} if heat is None else {HEAT: heat}

    def _facts(self) -> dict[str, str]:
        """Return board and version of the firmware, which the log has as texts."""
        messages = self._columns("MSG").get("Message", np.zeros(0))
        texts = [text.decode("utf-8", "replace") for text in messages.tolist()]
        boards = [match[1] for text in texts if (match := BOARD.match(text))]
        versions = [text for text in texts if re.match(r"(Ardu|APM:|AntennaTracker|Blimp|Rover)\S* ", text)]
        facts = {"model": f"ArduPilot {boards[0]}"} if boards else {}
        return facts | ({"firmware": versions[0]} if versions else {})
