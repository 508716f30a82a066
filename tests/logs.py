"""Logs of autopilots for tests, written byte for byte as their formats say."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

ULOG_TYPES = {"uint64_t": "Q", "uint32_t": "I", "uint16_t": "H", "uint8_t": "B", "int16_t": "h", "float": "f"}

VEHICLE_IMU = (
    "uint64_t timestamp;uint64_t timestamp_sample;float[3] delta_angle;float[3] delta_velocity;"
    "uint32_t delta_angle_dt;uint32_t delta_velocity_dt"
)
SENSOR = "uint64_t timestamp;uint64_t timestamp_sample;float x;float y;float z;float temperature"
COMBINED = (
    "uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;float[3] accelerometer_m_s2;"
    "uint32_t accelerometer_integral_dt"
)
FIFO = (
    "uint64_t timestamp;uint64_t timestamp_sample;float dt;float scale;uint8_t samples;int16_t[4] x;int16_t[4] y;"
    "int16_t[4] z"
)


def ulog(path: Path, topics: Sequence[tuple[str, int, str, Iterable[Sequence[float]]]]) -> Path:
    """Write a ULog file: name, instance, fields and rows of each topic.

    Format: https://docs.px4.io/main/en/dev_log/ulog_file_format.html
    """

    def message(kind: bytes, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), kind[0]) + body

    out = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0), message(b"B", bytes(40))]
    for name, fields in {name: fields for name, _, fields, _ in topics}.items():
        out.append(message(b"F", f"{name}:{fields};".encode()))
    key = b"char[9] ver_hw"
    out.append(message(b"I", bytes([len(key)]) + key + b"TEST_UNIT"))
    for number, (name, instance, _, _) in enumerate(topics):
        out.append(message(b"A", struct.pack("<BH", instance, number) + name.encode()))
    for number, (_, _, fields, rows) in enumerate(topics):
        form = "<H"
        for part in fields.split(";"):
            kind, _, count = part.split(" ")[0].partition("[")
            form += (count.rstrip("]") or "") + ULOG_TYPES[kind]
        out += [message(b"D", struct.pack(form, number, *row)) for row in rows]
    path.write_bytes(b"".join(out))
    return path


class DataFlash:
    """Writer of a DataFlash log of ArduPilot (libraries/AP_Logger/LogStructure.h)."""

    SIZES: ClassVar = {
        "B": "B",
        "H": "H",
        "I": "I",
        "Q": "Q",
        "f": "f",
        "a": "32h",
        "n": "4s",
        "N": "16s",
        "Z": "64s",
    }

    def __init__(self) -> None:
        self._forms: dict[str, tuple[int, struct.Struct]] = {}
        self._out: list[bytes] = []
        self.define("FMT", "BBnNZ", "Type,Length,Name,Format,Columns", 128)
        self.define("MSG", "QZ", "TimeUS,Message")

    def define(self, name: str, form: str, columns: str, number: int | None = None) -> None:
        packed = struct.Struct("<" + "".join(self.SIZES[c] for c in form))
        number = len(self._forms) if number is None else number
        self._forms[name] = (number, packed)
        self.add("FMT", number, packed.size + 3, name.encode(), form.encode(), columns.encode())

    def add(self, name: str, *values: Any) -> None:
        number, packed = self._forms[name]
        self._out.append(bytes((0xA3, 0x95, number)) + packed.pack(*values))

    def raw(self, data: bytes) -> None:
        self._out.append(data)

    def imu(
        self,
        gyro: np.ndarray,
        accel: np.ndarray,
        *,
        step_us: int = 5000,
        instances: int = 1,
        define: bool = True,
        degrees: float = 30.0,
    ) -> None:
        """Add `IMU` messages of (n, 3) values; instance k has k rad/s and k degC more, and a message 1 mdegC."""
        if define:
            self.define("IMU", "QBfffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,T")
        for k in range(len(gyro)):
            for instance in range(instances):
                self.add(
                    "IMU",
                    10**6 + k * step_us,
                    instance,
                    *(gyro[k] + instance),
                    *accel[k],
                    degrees + instance + 1e-3 * k,
                )

    def raw_samples(
        self,
        gyro: np.ndarray,
        accel: np.ndarray,
        *,
        step_us: int = 1000,
        accel_us: int = 0,
        accel_every: int = 1,
        suffix: str = "",
        instances: int = 1,
    ) -> None:
        """Add `GYR` and `ACC` messages, as with raw logging.

        Parameters
        ----------
        accel_us : by which the accelerometer is later.
        accel_every : it has a sample with each so many of the gyroscope.
        suffix : "1" makes `GYR1` and `ACC1` without an instance, as the logs had until 2020.
        """
        form, columns = ("QBQfff", "TimeUS,I,SampleUS") if not suffix else ("QQfff", "TimeUS,SampleUS")
        self.define(f"ACC{suffix}", form, f"{columns},AccX,AccY,AccZ")
        self.define(f"GYR{suffix}", form, f"{columns},GyrX,GyrY,GyrZ")
        for k in range(len(gyro)):
            sampled = 10**6 + k * step_us
            for instance in range(instances):
                start = (sampled + 700, instance) if not suffix else (sampled + 700,)
                self.add(f"GYR{suffix}", *start, sampled, *(gyro[k] + instance))
                if k % accel_every == 0:
                    self.add(f"ACC{suffix}", *start, sampled + accel_us, *(accel[k] + instance))

    def write(self, path: Path) -> Path:
        path.write_bytes(b"".join(self._out))
        return path
