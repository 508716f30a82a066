"""Registers of the VN-100: names and factory values.

A register has a number and comma-separated fields. The session uses this table to name registers and to restore
their factory values, the emulator to answer. Values are kept as text, as sent, so that a register that is written
back exactly as read does not change.

The table is that of firmware 3.1. Firmware 2 has estimation of hard and soft iron on (register 44), register 74, and no
registers 101, 102 and 206.
"""

from __future__ import annotations

import re
from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal, TypeAlias

Access: TypeAlias = Literal["setting", "fixed", "measurement"]

BAUDS = (9600, 19200, 38400, 57600, 115200, 128000, 230400, 460800, 921600)
FACTORY_BAUD = 115200
ASCII_RATES = (1, 2, 4, 5, 10, 20, 25, 40, 50, 100, 200)
"""Hz; rates that register 7 accepts. 0 is none."""
LOOP_RATE = 800
"""Hz; rate of the internal loop, the unit of the divisors of binary outputs and of the windows of register
85."""

OUTPUT_TYPES = {
    1: "VNYPR", 2: "VNQTN", 8: "VNQMR", 9: "VNDCM", 10: "VNMAG", 11: "VNACC", 12: "VNGYR", 13: "VNMAR",
    14: "VNYMR", 16: "VNYBA", 17: "VNYIA", 19: "VNIMU", 30: "VNDTV", 34: "VNHVE",
}  # fmt: skip
"""Message by the value of register 6; 0 is none."""

MEASUREMENTS = {
    8: "VNYPR", 9: "VNQTN", 15: "VNQMR", 17: "VNMAG", 18: "VNACC", 19: "VNGYR", 20: "VNMAR", 27: "VNYMR",
    54: "VNIMU", 80: "VNDTV", 115: "VNHVE", 239: "VNYBA", 240: "VNYIA",
}  # fmt: skip
"""Message with the same fields as the response of a measurement register."""

FILTERED = ("mag", "accel", "gyro", "temperature", "pressure")
"""Sensors of register 85: first the window of each, then the mode of each."""
BINARY_OUTPUTS = (75, 76, 77)
USER_TAG = 0

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", re.IGNORECASE)
_OUTPUT = re.compile(r"[0-3],\d{1,5}(,[0-9A-F]{1,4})+", re.IGNORECASE)
"""Registers 75 to 77: port, divisor, groups, and a word for each group."""


class RegisterNumber(IntEnum):
    """Numbers of the registers that the session or the emulator knows by name."""

    BAUD = 5
    OUTPUT_TYPE = 6
    OUTPUT_RATE = 7
    PROTOCOL = 30
    SYNC_CONTROL = 32
    DELTA_CONTROL = 82
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
class Register:
    """One register.

    Attributes
    ----------
    id : number.
    name : as in the manual.
    factory : factory values as sent; those of measurements are empty.
    access : ``setting`` can be written, ``fixed`` is read-only, ``measurement`` is read-only and live.
    ports : whether a port number may follow the value (registers 5-7); each port has its own value.
    allowed : values of each field, of a register that the emulator acts on; empty: any number, or any text.
    """

    id: int
    name: str
    factory: str
    access: Access = "setting"
    ports: bool = False
    allowed: Container[int] = ()

    @property
    def factory_values(self) -> tuple[str, ...]:
        """Fields of a new sensor.

        >>> REGISTERS[85].factory_values
        ('0', '4', '4', '4', '0', '0', '3', '3', '3', '0')
        """
        return tuple(self.factory.split(","))

    def check(self, values: Sequence[str]) -> None:
        """Check fields that a client writes.

        Raises
        ------
        RegisterError : 05 too few fields, 06 too many, 07 a value is not allowed, 09 read-only.
        """
        if self.access != "setting":
            raise RegisterError(ErrorCode.NOT_ALLOWED, f"register {self.id} cannot be written")
        count = len(self.factory_values)
        if self.id in BINARY_OUTPUTS and len(values) >= count:
            if _OUTPUT.fullmatch(",".join(values)) is None:
                raise RegisterError(ErrorCode.INVALID_PARAMETER, f"register {self.id} has hexadecimal words")
            if len(values) != count + int(values[2], 16).bit_count():
                text = f"register {self.id} needs one field word for each set group"
                raise RegisterError(ErrorCode.INVALID_PARAMETER, text)
            return
        if len(values) != count:
            few = len(values) < count
            code = ErrorCode.NOT_ENOUGH_PARAMETERS if few else ErrorCode.TOO_MANY_PARAMETERS
            raise RegisterError(code, f"register {self.id} has {count} fields, not {len(values)}")
        for text in values if self.id != USER_TAG else ():
            valid = text.isdigit() and int(text) in self.allowed if self.allowed else _NUMBER.fullmatch(text)
            if not valid:
                raise RegisterError(
                    ErrorCode.INVALID_PARAMETER, f"register {self.id}: {text!r} is not allowed"
                )


_IDENTITY = "1,0,0,0,1,0,0,0,1"
_ZERO = "+00.000000,+00.000000,+00.000000"


def _settings() -> Iterable[Register]:
    """Yield the registers that can be written."""
    yield Register(USER_TAG, "user tag", "")
    yield Register(RegisterNumber.BAUD, "serial baud rate", "115200", ports=True, allowed=BAUDS)
    # 14 is VNYMR, as captures of new sensors show; a table of the manual prints another type, a misprint
    types = (0, *OUTPUT_TYPES)
    yield Register(RegisterNumber.OUTPUT_TYPE, "async data output type", "14", ports=True, allowed=types)
    rates = (0, *ASCII_RATES)
    yield Register(RegisterNumber.OUTPUT_RATE, "async data output frequency", "40", ports=True, allowed=rates)
    yield Register(21, "magnetic and gravity reference vectors", "1,0,1.8,0,0,-9.793746")
    for number, sensor in ((23, "magnetometer"), (25, "accelerometer"), (84, "gyro")):
        yield Register(number, f"{sensor} compensation", f"{_IDENTITY},0,0,0")
    yield Register(26, "reference frame rotation", _IDENTITY)
    protocol = "0,0,0,0,1,0,1"
    yield Register(RegisterNumber.PROTOCOL, "communication protocol control", protocol, allowed=range(5))
    yield Register(RegisterNumber.SYNC_CONTROL, "synchronization control", "3,0,0,0,6,1,0,100000000,0")
    yield Register(33, "synchronization status", "0,0,0")
    yield Register(35, "VPE basic control", "1,1,1,1")
    yield Register(36, "VPE magnetometer tuning", "4,4,4,5,5,5,5.5,5.5,5.5")
    yield Register(38, "VPE accelerometer tuning", "6,6,6,3,3,3,5,5,5")
    yield Register(40, "VPE gyro tuning", "8,8,8,4,4,4,0,0,0")
    yield Register(43, "startup gyro bias", _ZERO)
    yield Register(44, "magnetometer calibration control", "0,1,5")
    yield Register(50, "velocity aiding measurement", "0,0,0")
    yield Register(51, "velocity aiding control", "1,0.1,0.01")
    for output in BINARY_OUTPUTS:
        yield Register(output, f"binary output {output - 74}", "0,0,00")
    yield Register(RegisterNumber.DELTA_CONTROL, "delta theta and delta velocity", "0,0,0,0,0")
    place = "1,1,0,0,1000,0.000,+00.00000000,+000.00000000,+00000.000"
    yield Register(83, "reference model configuration", place)
    # the largest window that a sensor accepts is not known: one second, that of 1 Hz, is assumed
    windows = range(LOOP_RATE + 1)
    yield Register(RegisterNumber.IMU_FILTER, "IMU filtering", "0,4,4,4,0,0,3,3,3,0", allowed=windows)
    yield Register(101, "NMEA output 1", "0,0,0,0,00000000")
    yield Register(102, "NMEA output 2", "0,0,0,0,00000000")
    yield Register(206, "legacy compatibility settings", "0,0,0,0")


def _readings() -> Iterable[Register]:
    """Yield the registers that can only be read."""
    yield Register(1, "model", "VN-100T-CR", "fixed")
    yield Register(2, "hardware revision", "7", "fixed")
    yield Register(3, "serial number", "0100056785", "fixed")
    yield Register(4, "firmware version", "3.1.0.0", "fixed")
    result = f"{_IDENTITY},0,0,0"
    yield Register(47, "magnetometer calibration result", result, "fixed")
    for number, message in MEASUREMENTS.items():
        yield Register(number, f"measurements of {message}", "", "measurement")


REGISTERS = {r.id: r for r in sorted((*_settings(), *_readings()), key=lambda r: r.id)}
"""Every register of a VN-100, by number."""

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
