"""Registers of the VN-100: fields, factory values and allowed values.

A register has a number and comma-separated fields. The session uses this table to read and write registers,
the emulator to answer and to refuse. Values are kept as text, as sent, so that a register that is written
back exactly as read does not change; `Register.parse` converts them to numbers.

Firmware generations 2 (2.0, 2.1) and 3 (3.1) differ in register 44 (hard and soft iron estimation: on in 2,
off in 3), registers 74, 101, 102 and 206, and two ASCII output types.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Literal, TypeAlias

Generation: TypeAlias = Literal[2, 3]
Access: TypeAlias = Literal["setting", "fixed", "measurement"]
Value: TypeAlias = int | float | str

BAUDS = (9600, 19200, 38400, 57600, 115200, 128000, 230400, 460800, 921600)
FACTORY_BAUD = 115200
ASCII_RATES = (1, 2, 4, 5, 10, 20, 25, 40, 50, 100, 200)
"""Hz; rates that register 7 accepts. Firmware 3 accepts 0 as well."""
LOOP_RATE = 800
"""Hz; rate of the internal loop, the unit of the divisors of binary outputs and of the windows of register
85."""

OUTPUT_TYPES = {
    1: "VNYPR", 2: "VNQTN", 8: "VNQMR", 9: "VNDCM", 10: "VNMAG", 11: "VNACC", 12: "VNGYR", 13: "VNMAR",
    14: "VNYMR", 16: "VNYBA", 17: "VNYIA", 19: "VNIMU", 30: "VNDTV", 34: "VNHVE",
}  # fmt: skip
"""Message by the value of register 6; 0 is none. Only firmware 2 has VNDCM, only firmware 3 has VNHVE."""

MEASUREMENTS = {
    8: "VNYPR", 9: "VNQTN", 15: "VNQMR", 17: "VNMAG", 18: "VNACC", 19: "VNGYR", 20: "VNMAR", 27: "VNYMR",
    54: "VNIMU", 80: "VNDTV", 115: "VNHVE", 239: "VNYBA", 240: "VNYIA",
}  # fmt: skip
"""Message with the same fields as the response of a measurement register."""

BINARY_OUTPUTS = (75, 76, 77)


class RegisterNumber(IntEnum):
    """Numbers of the registers that the session or the emulator knows by name."""

    BAUD = 5
    OUTPUT_TYPE = 6
    OUTPUT_RATE = 7
    MAG_CALIBRATION = 23
    ACCEL_CALIBRATION = 25
    ROTATION = 26
    PROTOCOL = 30
    SYNC_CONTROL = 32
    SYNC_STATUS = 33
    STARTUP_BIAS = 43
    IRON_CONTROL = 44
    IRON_RESULT = 47
    STARTUP_FILTER_BIAS = 74
    DELTA_CONTROL = 82
    GYRO_CALIBRATION = 84
    IMU_FILTER = 85


class ErrorCode(IntEnum):
    """Codes of ``VNERR``: why the sensor refuses a command, or what has happened to it."""

    HARD_FAULT = 0x01
    SERIAL_INPUT_BUFFER_OVERFLOW = 0x02
    INVALID_CHECKSUM = 0x03
    INVALID_COMMAND = 0x04
    NOT_ENOUGH_PARAMETERS = 0x05
    TOO_MANY_PARAMETERS = 0x06
    INVALID_PARAMETER = 0x07
    INVALID_REGISTER = 0x08
    NOT_ALLOWED = 0x09
    WATCHDOG_RESET = 0x0A
    SERIAL_OUTPUT_BUFFER_OVERFLOW = 0x0B
    BAUD_RATE_TOO_LOW = 0x0C
    ERROR_BUFFER_OVERFLOW = 0xFF


class RegisterError(ValueError):
    """A register or its fields are refused; `code` is the error code of the sensor."""

    def __init__(self, code: int, reason: str) -> None:
        super().__init__(reason)
        self.code = code


@dataclass(frozen=True, slots=True)
class RegisterField:
    """One field of a register.

    Attributes
    ----------
    name : as in the table of the manual, in snake case.
    kind : type of its value.
    form : printf format of the stored text; empty: plain integers, and reals with up to 7 digits.
    low, high : smallest and largest allowed value; for text, `high` is the largest length.
    choices : allowed values, which replace the limits; empty: the limits apply.
    only : values that only one firmware generation has.
    """

    name: str
    kind: Literal["integer", "real", "hex", "text"] = "integer"
    form: str = ""
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[int, ...] = ()
    only: dict[int, Generation] = field(default_factory=dict)

    def parse(self, text: str) -> Value:
        """Return the value of a text.

        Raises
        ------
        RegisterError : 07, the text is not a value of this kind.
        """
        if self.kind == "text":
            return text
        try:
            number = int(text.strip(), 16) if self.kind == "hex" else float(text)
        except ValueError:
            number = math.nan
        if not math.isfinite(number) or (self.kind == "integer" and number != int(number)):
            raise RegisterError(
                ErrorCode.INVALID_PARAMETER, f"{self.name}: {text!r} is not of kind {self.kind}"
            )
        return number if self.kind == "real" else int(number)

    def normalise(self, text: str, generation: Generation) -> str:
        """Return the text as the sensor stores it; refuse values that are not allowed."""
        value = self.parse(text)
        if isinstance(value, str):
            if len(value) > self.high:
                raise RegisterError(
                    ErrorCode.INVALID_PARAMETER, f"{self.name}: longer than {self.high:.0f} characters"
                )
            return value
        allowed = value in self.choices if self.choices else self.low <= value <= self.high
        if not allowed or self.only.get(int(value), generation) != generation:
            raise RegisterError(ErrorCode.INVALID_PARAMETER, f"{self.name}: {text} is not allowed")
        return self.format(value)

    def format(self, value: Value) -> str:
        """Return the text of a value.

        >>> RegisterField("bias", "real", "%+010.6f").format(0.0)
        '+00.000000'
        """
        if isinstance(value, str):
            return value
        return self.form % value if self.form else f"{value:.7g}" if isinstance(value, float) else str(value)


@dataclass(frozen=True, slots=True)
class Register:
    """One register.

    Attributes
    ----------
    id : number.
    name : as in the manual.
    fields : in the order of transmission. Registers 75-77 repeat the last one for each set group.
    factory : factory values as sent, by firmware generation. A generation without an entry does not have the
        register. Those of measurements are empty.
    access : ``setting`` can be written, ``fixed`` is read-only, ``measurement`` is read-only and live.
    ports : whether a port number may follow the value (registers 5-7); each port has its own value.
    """

    id: int
    name: str
    fields: tuple[RegisterField, ...]
    factory: dict[Generation, str]
    access: Access = "setting"
    ports: bool = False

    def in_generation(self, generation: Generation) -> bool:
        return generation in self.factory

    def factory_values(self, generation: Generation) -> tuple[str, ...]:
        """Return the fields of a new sensor of this firmware generation.

        >>> REGISTERS[85].factory_values(3)
        ('0', '4', '4', '4', '0', '0', '3', '3', '3', '0')
        """
        return tuple(self.factory[generation].split(","))

    def parse(self, values: Sequence[str]) -> dict[str, Value]:
        """Return values by field name; a repeated last field (registers 75-77) is numbered from 1.

        >>> REGISTERS[75].parse(["1", "8", "05", "0001", "00C0"])
        {'async_mode': 1, 'divisor': 8, 'groups': 5, 'word1': 1, 'word2': 192}
        """
        return {entry.name: entry.parse(text) for entry, text in self._pairs(values)}

    def normalise(self, values: Sequence[str], generation: Generation) -> tuple[str, ...]:
        """Return the fields as the sensor stores them when they are written.

        Raises
        ------
        RegisterError : 05 too few fields, 06 too many, 07 a value is not allowed, 09 read-only.
        """
        if self.access != "setting":
            raise RegisterError(ErrorCode.NOT_ALLOWED, f"register {self.id} cannot be written")
        return tuple(entry.normalise(text, generation) for entry, text in self._pairs(values))

    def _pairs(self, values: Sequence[str]) -> Iterable[tuple[RegisterField, str]]:
        """Return each field with its text; refuse a wrong number of fields."""
        layout = [*self.fields]
        if self.id in BINARY_OUTPUTS:
            word = layout.pop()
            if len(values) >= 3:
                count = int(layout[2].parse(values[2])).bit_count()
                if len(values) != 3 + count:
                    text = f"register {self.id} needs one field word for each set group"
                    raise RegisterError(ErrorCode.INVALID_PARAMETER, text)
                layout += [replace(word, name=f"word{i + 1}") for i in range(count)]
        if len(values) != len(layout):
            code = (
                ErrorCode.NOT_ENOUGH_PARAMETERS
                if len(values) < len(layout)
                else ErrorCode.TOO_MANY_PARAMETERS
            )
            raise RegisterError(code, f"register {self.id} has {len(layout)} fields, not {len(values)}")
        return zip(layout, values, strict=True)


def _integers(names: str, low: float = 0, high: float = 255) -> tuple[RegisterField, ...]:
    return tuple(RegisterField(name, "integer", "", low, high) for name in names.split())


def _reals(names: str, form: str = "") -> tuple[RegisterField, ...]:
    return tuple(RegisterField(name, "real", form) for name in names.split())


def _both(values: str) -> dict[Generation, str]:
    return {2: values, 3: values}


_MATRIX = "c00 c01 c02 c10 c11 c12 c20 c21 c22"
_IDENTITY = "1,0,0,0,1,0,0,0,1"
_TUNING = " ".join(f"{name}_{axis}" for name in ("base", "adaptive", "filtering") for axis in "xyz")
_NMEA = (
    RegisterField("port", choices=(0, 1, 2, 3)),
    RegisterField("rate", choices=(0, 1, 5, 10, 20)),
    RegisterField("mode", choices=(0, 1, 2)),
    RegisterField("receiver", choices=(0, 1)),
    RegisterField("messages", "hex", "%08X", 0, 0xFFFFFFFF),
)
# A VN-100 has neither GNSS nor INS, but accepts their groups (4, 6, 7) and fields and sends zeros for them.
_BINARY = (
    RegisterField("async_mode", choices=(0, 1, 2, 3)),
    RegisterField("divisor", low=0, high=65535),
    RegisterField("groups", "hex", "%02X", 0, 0x7F),
    RegisterField("word", "hex", "%04X", 0, 0x7FFF),
)
_SYNC = (
    RegisterField("in_mode", choices=(3, 4, 5, 6)),
    RegisterField("in_edge", low=0, high=1),
    RegisterField("in_skip", low=0, high=65535),
    RegisterField("reserved_1", low=0, high=2**32 - 1),
    RegisterField("out_mode", choices=(0, 1, 2, 3, 6)),
    RegisterField("out_polarity", low=0, high=1),
    RegisterField("out_skip", low=0, high=65535),
    RegisterField("pulse_width", low=0, high=500_000_000),
    RegisterField("reserved_2", low=0, high=2**32 - 1),
)
# the largest window that a sensor accepts is not known: one second, that of 1 Hz, is assumed
_FILTER = (
    *_integers("mag_window accel_window gyro_window temperature_window pressure_window", 0, LOOP_RATE),
    *_integers("mag_mode accel_mode gyro_mode temperature_mode pressure_mode", 0, 3),
)

_PROTOCOL = (
    *_integers("serial_count", 0, 4),
    *_integers("serial_status", 0, 2),
    *_integers("spi_count", 0, 4),
    *_integers("spi_status", 0, 2),
    RegisterField("serial_checksum", choices=(1, 3)),
    RegisterField("spi_checksum", choices=(0, 1, 3)),
    *_integers("error_mode", 0, 2),
)


def _settings() -> Iterable[Register]:
    """Yield the registers that can be written."""
    yield Register(0, "user tag", (RegisterField("tag", "text", high=20),), _both(""))
    baud = RegisterField("baud", choices=BAUDS)
    yield Register(RegisterNumber.BAUD, "serial baud rate", (baud,), _both("115200"), ports=True)
    kinds = RegisterField("type", choices=(0, *OUTPUT_TYPES), only={9: 2, 34: 3})
    # 14 is VNYMR, as captures of new sensors show; a table of the manual prints another type, a misprint
    yield Register(RegisterNumber.OUTPUT_TYPE, "async data output type", (kinds,), _both("14"), ports=True)
    rates = RegisterField("rate", choices=(0, *ASCII_RATES), only={0: 3})
    yield Register(
        RegisterNumber.OUTPUT_RATE, "async data output frequency", (rates,), _both("40"), ports=True
    )
    vectors = _reals("mag_n mag_e mag_d gravity_n gravity_e gravity_d")
    yield Register(21, "magnetic and gravity reference vectors", vectors, _both("1,0,1.8,0,0,-9.793746"))
    calibration = _reals(f"{_MATRIX} b0 b1 b2")
    sensors: dict[int, str] = {
        RegisterNumber.MAG_CALIBRATION: "magnetometer",
        RegisterNumber.ACCEL_CALIBRATION: "accelerometer",
    }
    for number, what in sensors.items():
        yield Register(number, f"{what} compensation", calibration, _both(f"{_IDENTITY},0,0,0"))
    yield Register(RegisterNumber.ROTATION, "reference frame rotation", _reals(_MATRIX), _both(_IDENTITY))
    yield Register(
        RegisterNumber.PROTOCOL, "communication protocol control", _PROTOCOL, _both("0,0,0,0,1,0,1")
    )
    yield Register(
        RegisterNumber.SYNC_CONTROL, "synchronization control", _SYNC, _both("3,0,0,0,6,1,0,100000000,0")
    )
    counts = _integers("sync_in_count sync_in_time sync_out_count", 0, 2**32 - 1)
    yield Register(RegisterNumber.SYNC_STATUS, "synchronization status", counts, _both("0,0,0"))
    basic = (*_integers("enable", 0, 1), *_integers("heading filtering tuning", 0, 2))
    yield Register(35, "VPE basic control", basic, _both("1,1,1,1"))
    yield Register(36, "VPE magnetometer tuning", _reals(_TUNING), _both("4,4,4,5,5,5,5.5,5.5,5.5"))
    yield Register(38, "VPE accelerometer tuning", _reals(_TUNING), _both("6,6,6,3,3,3,5,5,5"))
    yield Register(40, "VPE gyro tuning", _reals(_TUNING), _both("8,8,8,4,4,4,0,0,0"))
    zero = "+00.000000,+00.000000,+00.000000"
    bias = _reals("bias_x bias_y bias_z", "%+010.6f")
    yield Register(RegisterNumber.STARTUP_BIAS, "startup gyro bias", bias, _both(zero))
    iron = (*_integers("mode", 0, 2), *_integers("output", 1, 3), *_integers("converge_rate", 1, 5))
    yield Register(
        RegisterNumber.IRON_CONTROL, "magnetometer calibration control", iron, {2: "1,3,5", 3: "0,1,5"}
    )
    yield Register(50, "velocity aiding measurement", _reals("v_x v_y v_z"), _both("0,0,0"))
    aiding = (*_integers("mode", 0, 1), *_reals("uncertainty_tuning filter_tuning"))
    yield Register(51, "velocity aiding control", aiding, _both("1,0.1,0.01"))
    # where VNSGB puts the estimated bias: here in the text of the manual of firmware 2, in 43 in its table
    filter_bias = (*bias, *_reals("accel_x accel_y accel_z", "%+07.3f"), *_reals("pressure", "%+010.3f"))
    yield Register(
        RegisterNumber.STARTUP_FILTER_BIAS,
        "startup filter bias",
        filter_bias,
        {2: f"{zero},+00.000,+00.000,+00.000,+00000.000"},
    )
    for number in BINARY_OUTPUTS:
        yield Register(number, f"binary output {number - 74}", _BINARY, _both("0,0,00"))
    delta = (*_integers("frame", 0, 1), *_integers("gyro_compensation accel_compensation", 0, 3))
    delta = (*delta, *_integers("reserved_1 reserved_2", 0, 65535))
    yield Register(RegisterNumber.DELTA_CONTROL, "delta theta and delta velocity", delta, _both("0,0,0,0,0"))
    models = (*_integers("mag_model gravity_model", 0, 1), *_integers("reserved_1 reserved_2", 0, 65535))
    models += (*_integers("recalculation", 0, 2**32 - 1), *_reals("year", "%.3f"))
    models += (*_reals("latitude", "%+012.8f"), *_reals("longitude", "%+013.8f"))
    models += _reals("altitude", "%+010.3f")
    place = "1,1,0,0,1000,0.000,+00.00000000,+000.00000000,+00000.000"
    yield Register(83, "reference model configuration", models, _both(place))
    yield Register(
        RegisterNumber.GYRO_CALIBRATION, "gyro compensation", calibration, _both(f"{_IDENTITY},0,0,0")
    )
    yield Register(RegisterNumber.IMU_FILTER, "IMU filtering", _FILTER, _both("0,4,4,4,0,0,3,3,3,0"))
    yield Register(101, "NMEA output 1", _NMEA, {3: "0,0,0,0,00000000"})
    yield Register(102, "NMEA output 2", _NMEA, {3: "0,0,0,0,00000000"})
    legacy = _integers("ins_legacy gnss_legacy imu_legacy hardware_legacy")
    yield Register(206, "legacy compatibility settings", legacy, {3: "0,0,0,0"})


def _readings() -> Iterable[Register]:
    """Yield the registers that can only be read."""
    text = RegisterField("text", "text")
    yield Register(1, "model", (text,), _both("VN-100T-CR"), "fixed")
    yield Register(2, "hardware revision", _integers("revision"), _both("7"), "fixed")
    yield Register(3, "serial number", (text,), _both("0100056785"), "fixed")
    yield Register(4, "firmware version", (text,), {2: "2.1.0.0", 3: "3.1.0.0"}, "fixed")
    iron = _reals(f"{_MATRIX} b0 b1 b2")
    yield Register(
        RegisterNumber.IRON_RESULT,
        "magnetometer calibration result",
        iron,
        _both(f"{_IDENTITY},0,0,0"),
        "fixed",
    )
    ypr, quaternion = "yaw pitch roll", "q_x q_y q_z q_w"
    mag, accel, gyro = "mag_x mag_y mag_z", "accel_x accel_y accel_z", "gyro_x gyro_y gyro_z"
    measured = {
        8: ("attitude", ypr),
        9: ("quaternion", quaternion),
        15: ("quaternion, magnetic, acceleration and rates", f"{quaternion} {mag} {accel} {gyro}"),
        17: ("magnetic", mag),
        18: ("acceleration", accel),
        19: ("angular rates", gyro),
        20: ("magnetic, acceleration and rates", f"{mag} {accel} {gyro}"),
        27: ("attitude, magnetic, acceleration and rates", f"{ypr} {mag} {accel} {gyro}"),
        54: ("IMU measurements", f"{mag} {accel} {gyro} temperature pressure"),
        80: ("delta theta and delta velocity", "dt theta_x theta_y theta_z v_x v_y v_z"),
        115: ("heave", "heave heave_rate delayed_heave"),
        239: ("attitude, linear acceleration and rates", f"{ypr} {accel} {gyro}"),
        240: ("attitude, inertial acceleration and rates", f"{ypr} {accel} {gyro}"),
    }
    for number, (name, fields) in measured.items():
        factory: dict[Generation, str] = {3: ""} if number == 115 else _both("")
        yield Register(number, name, _reals(fields), factory, "measurement")


REGISTERS = {r.id: r for r in sorted((*_settings(), *_readings()), key=lambda r: r.id)}
"""Every register of a VN-100 of either firmware generation, by number."""

DATA_REGISTERS = (26, 35, 43, 44, 82, 85, 23, 25, 84)
"""Registers that change what the samples mean: with another value they begin another record."""

CHANGE_THE_DATA = (
    *DATA_REGISTERS,
    RegisterNumber.PROTOCOL,
    RegisterNumber.SYNC_CONTROL,
    RegisterNumber.BAUD,
    RegisterNumber.OUTPUT_TYPE,
    RegisterNumber.OUTPUT_RATE,
    *BINARY_OUTPUTS,
)
"""Registers that the report contains: those, and the outputs, which make another stream: the pipeline sees that."""
