"""DataFlash reader: inertial messages of an ArduPilot log (.BIN), indexed by pymavlink.

`IMU` has point samples behind the filter of the autopilot (INS_GYRO_FILTER), `GYR` and `ACC` those before it if raw
logging is on; the samples of `ACC` are joined to those of `GYR` if their times agree. Batches of raw samples have a
header, `ISBH`, and data, `ISBD`: 32 samples of one sensor in a message, with pauses between the batches. Only `IMU`
has the temperature; raw samples of the same sensor take it from there. Definitions of the messages: ArduPilot,
libraries/AP_InertialSensor/LogStructure.h.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from imumon.model.samples import AXES, Floats
from imumon.sources.files.base import ROWS
from imumon.sources.files.log_process.base import (
    Log,
    Topic,
    array_blocks,
    best_first,
    degrees_at,
    rows_at,
    step_s,
)

Rows: TypeAlias = npt.NDArray[Any]
"""Messages of one type as an array with a field for each column."""

TYPES = {
    "b": "i1", "B": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "q": "<i8", "Q": "<u8", "g": "<f2",
    "f": "<f4", "d": "<f8", "n": "S4", "N": "S16", "Z": "S64", "c": "<i2", "C": "<u2", "e": "<i4", "E": "<u4",
    "L": "<i4", "M": "u1", "a": "(32,)<i2",
}  # fmt: skip
"""Type of numpy for each character of a format (AP_Logger/LogStructure.h)."""

SCALES = {"c": 1e-2, "C": 1e-2, "e": 1e-2, "E": 1e-2, "L": 1e-7}
"""Factor of formats that count parts of a unit."""

BATCH_ROWS = 32
"""Samples in an `ISBD` message, by its format."""

HEADER_BYTES = 3
"""Bytes of a message before its fields, by the format."""

GYRO, ACCEL = ("GyrX", "GyrY", "GyrZ"), ("AccX", "AccY", "AccZ")
BATCHES = {0: ("accel", "m/s2"), 1: ("gyro", "rad/s")}
"""Sensor and unit of a batch by its type."""

TIMES = {"SampleUS": "us", "TimeUS": "us", "TimeMS": "ms"}
"""Columns of time, the best first, and their units."""

HEAT = "IMU.T"
"""Column of the temperature that raw samples have from the `IMU` messages of the same sensor."""

RAW = re.compile(r"(?:GYR|ACC|ISBD/\w+)(/?)(\d*)")
"""Names of raw samples, with the number of the sensor: from 0 after a slash, else from 1."""

BOARD = re.compile(r"^(\S+) [0-9A-F]{8} [0-9A-F]{8} [0-9A-F]{8}$")
"""Text with the name of the board and its number."""


@dataclass(frozen=True)
class _Messages:
    """Messages of one type.

    Attributes
    ----------
    data : bytes of the log.
    places : (n,) of their first fields.
    dtype : array with a field for each column.
    """

    data: npt.NDArray[np.uint8]
    places: npt.NDArray[np.int64]
    dtype: np.dtype[Any]
    scales: Mapping[str, float]

    def rows(self, start: int, end: int) -> Rows:
        """Return some of them."""
        places = self.places[start:end, None] + np.arange(self.dtype.itemsize)
        return np.ascontiguousarray(self.data[places]).view(self.dtype)[:, 0]

    def column(self, name: str) -> npt.NDArray[Any]:
        """Return (n,) or (n, k) values of one column."""
        parts = [self.rows(k, k + ROWS)[name] for k in range(0, max(len(self.places), 1), ROWS)]
        return np.concatenate(parts)

    @property
    def numeric(self) -> list[str]:
        """Names of the columns of numbers."""
        kinds = {c: self.dtype[c] for c in self.dtype.names or ()}
        return [c for c, kind in kinds.items() if kind.kind in "iuf" and not kind.shape]

    def numbers(self, rows: Rows, name: str) -> Floats:
        """Return (n,) values of one column of some rows, in its unit."""
        return rows[name].astype(np.float64) * self.scales.get(name, 1.0)

    def only(self, chosen: npt.NDArray[Any]) -> _Messages:
        return replace(self, places=self.places[chosen])


def _is_imu(topic: Topic) -> bool:
    """Return whether a topic has the values that the autopilot uses."""
    return topic.type.startswith("IMU") and {"gyro/x", "accel/x"} <= set(topic.map)


def _map_of(numbers: Sequence[str]) -> dict[str, str]:
    """Return the columns of the channels and of the time, with their units, among columns of numbers."""
    known: dict[str, str] = {}
    for sensor, columns, unit in (("gyro", GYRO, "rad/s"), ("accel", ACCEL, "m/s2")):
        if set(columns) <= set(numbers):
            known |= {f"{sensor}/{a}": f"{c}:{unit}" for a, c in zip(AXES, columns, strict=True)}
    if known and "T" in numbers:
        known["temperature"] = "T:degC"
    time = next((c for c in TIMES if c in numbers), None)
    return known if time is None else known | {"t": f"{time}:{TIMES[time]}"}


class DataFlashLog(Log):
    """Topics of a DataFlash log."""

    def __init__(self, path: Path) -> None:
        from pymavlink.DFReader import DFReader_binary

        self._log: Any = DFReader_binary(str(path))
        self._data = np.frombuffer(self._log.data_map, np.uint8)
        self._messages: dict[str, _Messages] = {}
        self._batches: dict[str, dict[str, npt.NDArray[Any]]] = {}
        self._joined: dict[str, tuple[_Messages, npt.NDArray[np.int64]]] = {}  # accelerometer, and its rows
        self._heat: dict[
            str, tuple[str, npt.NDArray[Any], Floats]
        ] = {}  # column of time; us and degC of the IMU
        self.facts = self._facts()
        if skipped := self._skipped_bytes():
            self.problem = f"is corrupt: {skipped:,} bytes between its messages belong to none"
        topics = [topic for name in list(self._log.name_to_id) for topic in self._topics(name)]
        raw = [*self._with_accelerometers(topics), *self._batch_topics()]
        best = best_first([self._with_temperature(topic) for topic in raw])
        self.topics = sorted(best, key=lambda topic: not _is_imu(topic))

    def blocks(self, topic: int, columns: Sequence[str]) -> Iterator[tuple[Floats, int]]:
        name = self.topics[topic].name
        time, *heat = self._heat.get(name, ("",))
        if name in self._batches:
            yield from array_blocks(self._batches[name], columns)
            return
        messages = self._messages[name]
        accel, matches = self._joined.get(name, (None, np.empty(0, np.int64)))
        for start in range(0, len(messages.places), ROWS):
            rows = messages.rows(start, start + ROWS)
            size = rows.nbytes
            by_column = {c: messages.numbers(rows, c) for c in columns if c in (rows.dtype.names or ())}
            if heat and HEAT in columns and (degrees := degrees_at(rows[time], *heat)) is not None:
                by_column[HEAT] = degrees
            if accel is not None:
                part = matches[start : start + ROWS]
                accel_rows = accel.only(part).rows(0, ROWS)
                size += accel_rows.nbytes
                for c in set(ACCEL) & set(columns):
                    by_column[c] = np.where(part >= 0, accel.numbers(accel_rows, c), np.nan)
            yield np.column_stack([by_column[c] for c in columns]), size

    def _skipped_bytes(self) -> int:
        """Return the bytes before the last message that belong to none; autopilots leave some after it."""
        starts = [np.array(self._log.offsets[number], np.int64) for number in self._log.formats]
        lengths = [form.len for form in self._log.formats.values()]
        ends = [int(places[-1]) + size for places, size in zip(starts, lengths, strict=True) if len(places)]
        used = sum(len(places) * size for places, size in zip(starts, lengths, strict=True))
        return int(max(ends, default=0) - used)

    def _of(self, name: str) -> _Messages | None:
        """Return the messages of a type; None if there are none, or their format is unknown."""
        number = self._log.name_to_id.get(name)
        form = None if number is None else self._log.formats[number]
        if form is None or len(form.columns) != len(form.format) or set(form.format) - set(TYPES):
            return None
        if "" in form.columns or len(set(form.columns)) != len(form.columns):
            return None
        dtype = np.dtype([(c, TYPES[f]) for c, f in zip(form.columns, form.format, strict=True)])
        scales = {c: SCALES[f] for c, f in zip(form.columns, form.format, strict=True) if f in SCALES}
        places = np.array(self._log.offsets[number], dtype=np.int64) + HEADER_BYTES
        places = places[places + form.len - HEADER_BYTES <= len(self._data)]  # the last one may be incomplete
        if not len(places) or dtype.itemsize != form.len - HEADER_BYTES:
            return None
        return _Messages(self._data, places, dtype, scales)

    def _topics(self, name: str) -> Iterator[Topic]:
        """Yield the topics of a message: of an IMU, one for each instance."""
        messages = self._of(name)
        if messages is None:
            return
        numbers = messages.numeric
        known = _map_of(numbers)
        time, _, unit = known.get("t", "").partition(":")
        instances: dict[str, _Messages] = {name: messages}
        if "I" in numbers:
            instance = messages.column("I")
            instances = {f"{name}/{k}": messages.only(instance == k) for k in np.unique(instance).tolist()}
        for type_name, chosen in instances.items():
            self._messages[type_name] = chosen
            step = step_s(chosen.column(time)) if time and len(known) > 1 else None
            rate_hz = None if step is None else (1e-3 if unit == "ms" else 1.0) / step
            yield Topic(
                name=type_name,
                type=name,
                count=len(chosen.places),
                columns=numbers,
                map=known,
                rate_hz=rate_hz,
            )

    def _with_accelerometers(self, topics: Sequence[Topic]) -> Iterator[Topic]:
        """Yield topics; a gyroscope gets the samples of its accelerometer, which stays a topic of its own."""
        by_name = {topic.name: topic for topic in topics}
        for topic in topics:
            other = by_name.get(topic.name.replace("GYR", "ACC", 1))
            alone = {"gyro/x", "accel/x", "t"} & set(topic.map) == {"gyro/x", "t"}
            if not topic.name.startswith("GYR") or other is None or not alone:
                yield topic
                continue
            gyro, accel = self._messages[topic.name], self._messages[other.name]
            times = [
                messages.column(known.map["t"].partition(":")[0])
                for messages, known in ((gyro, topic), (accel, other))
                if "t" in known.map
            ]
            matches = rows_at(*times) if len(times) == 2 and "accel/x" in other.map else None
            if matches is None:
                note = f"{other.name} not used: its samples are at other times; as the chosen topic it is read alone"
                yield replace(topic, note=note)
                continue
            self._joined[topic.name] = accel, matches
            known = {name: text for name, text in other.map.items() if name.startswith("accel")}
            yield replace(topic, columns=[*topic.columns, *ACCEL], map={**topic.map, **known})

    def _with_temperature(self, topic: Topic) -> Topic:
        """Return a topic; raw samples get the temperature of their IMU, between its messages."""
        named, (time, _, unit) = RAW.fullmatch(topic.name), topic.map.get("t", "").partition(":")
        if named is None or unit != "us":
            return topic
        number = int(named[2] or 1) - (not named[1])
        for name in (f"IMU/{number}", f"IMU{number + 1}" if number else "IMU"):
            imu = self._messages.get(name)
            if imu is not None and {"TimeUS", "T"} <= set(imu.numeric):
                degrees = imu.column("T") * imu.scales.get("T", 1.0)
                if not np.isfinite(degrees).any():
                    return topic
                self._heat[topic.name] = time, imu.column("TimeUS"), degrees
                if (batch := self._batches.get(topic.name)) is not None:
                    batch[HEAT] = np.asarray(degrees_at(batch[time], *self._heat[topic.name][1:]))
                return replace(
                    topic, columns=[*topic.columns, HEAT], map={**topic.map, "temperature": f"{HEAT}:degC"}
                )
        return topic

    def _batch_topics(self) -> Iterator[Topic]:
        """Yield a topic for the batches of each sensor."""
        headers, data = self._of("ISBH"), self._of("ISBD")
        if headers is None or data is None:
            return
        header, rows = headers.rows(0, len(headers.places)), data.rows(0, len(data.places))
        header_index = np.searchsorted(headers.places, data.places) - 1  # the header before each message
        # a logger that falls behind drops messages: without its header a message has neither rate nor scale
        paired = (header_index >= 0) & (header["N"][header_index] == rows["N"])
        if lost := int((~paired).sum()):
            self.remarks = [f"{lost:,} ISBD messages have no ISBH: they are left out"]
        for kind, instance in sorted({(int(h["type"]), int(h["instance"])) for h in header}):
            sensor, unit = BATCHES.get(kind, ("", ""))
            of_sensor = (header["type"] == kind) & (header["instance"] == instance)
            chosen = paired & of_sensor[header_index]
            if not sensor or not chosen.any():
                continue
            batch, part = header[header_index[chosen]], rows[chosen]
            place = part["seqno"].astype(np.int64)[:, None] * BATCH_ROWS + np.arange(BATCH_ROWS)
            # the last message of a batch is filled up
            valid = (place < batch["smp_cnt"][:, None]).ravel()
            times = batch["SampleUS"][:, None] + place * 1e6 / batch["smp_rate"].astype(np.float64)[:, None]
            arrays = {"SampleUS": times.ravel()[valid]}
            for axis in AXES:
                scaled = part[axis] / batch["mul"].astype(np.float64)[:, None]
                arrays[axis] = scaled.ravel()[valid]
            name = f"ISBD/{sensor}/{instance}"
            self._batches[name] = arrays
            yield Topic(
                name=name,
                type="ISBD",
                count=int(valid.sum()),
                columns=list(arrays),
                map={f"{sensor}/{a}": f"{a}:{unit}" for a in AXES} | {"t": "SampleUS:us"},
                rate_hz=float(np.median(batch["smp_rate"])),
                note="it has batches of raw samples: the pauses between them count as missing samples",
            )

    def _facts(self) -> dict[str, str]:
        """Return board and version of the firmware, which the log has as texts."""
        messages = self._of("MSG")
        if messages is None:
            return {}
        texts = [text.decode("utf-8", "replace") for text in messages.column("Message").tolist()]
        boards = [match[1] for text in texts if (match := BOARD.match(text))]
        versions = [text for text in texts if re.match(r"(Ardu|APM:|AntennaTracker|Blimp|Rover)\S* ", text)]
        facts = {"model": f"ArduPilot {boards[0]}"} if boards else {}
        return facts | ({"firmware": versions[0]} if versions else {})
