"""Registers of the VN-100: names and factory values.

A register has a number and comma-separated fields. The session uses this table to name registers and to restore
their factory values, the emulator to answer. Values are kept as text, as sent, so that a register that is written
back exactly as read does not change.

The table is that of firmware 3.1. Firmware 2 has estimation of hard and soft iron on (register 44), register 74, and no
registers 101, 102 and 206.
"""

from __future__ import annotations

import re
from collections.abc import Container, Iterator, Mapping, Sequence
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
    """

    id: int
    name: str
    factory: str
    access: Access = "setting"

    @property
    def ports(self) -> bool:
        """Whether a port number may follow the value; each port has its own value."""
        return self.id in (RegisterNumber.BAUD, RegisterNumber.OUTPUT_TYPE, RegisterNumber.OUTPUT_RATE)

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
        allowed = _ALLOWED.get(self.id)
        for text in values if self.id != USER_TAG else ():
            valid = text.isdigit() and int(text) in allowed if allowed else _NUMBER.fullmatch(text)
            if not valid:
                raise RegisterError(
                    ErrorCode.INVALID_PARAMETER, f"register {self.id}: {text!r} is not allowed"
                )


_TABLE = """
  0 user tag:
  1 model: VN-100T-CR
  2 hardware revision: 7
  3 serial number: 0100056785
  4 firmware version: 3.1.0.0
  5 serial baud rate: 115200
  6 async data output type: 14
  7 async data output frequency: 40
 21 magnetic and gravity reference vectors: 1,0,1.8,0,0,-9.793746
 23 magnetometer compensation: 1,0,0,0,1,0,0,0,1,0,0,0
 25 accelerometer compensation: 1,0,0,0,1,0,0,0,1,0,0,0
 26 reference frame rotation: 1,0,0,0,1,0,0,0,1
 30 communication protocol control: 0,0,0,0,1,0,1
 32 synchronization control: 3,0,0,0,6,1,0,100000000,0
 33 synchronization status: 0,0,0
 35 VPE basic control: 1,1,1,1
 36 VPE magnetometer tuning: 4,4,4,5,5,5,5.5,5.5,5.5
 38 VPE accelerometer tuning: 6,6,6,3,3,3,5,5,5
 40 VPE gyro tuning: 8,8,8,4,4,4,0,0,0
 43 startup gyro bias: +00.000000,+00.000000,+00.000000
 44 magnetometer calibration control: 0,1,5
 47 magnetometer calibration result: 1,0,0,0,1,0,0,0,1,0,0,0
 50 velocity aiding measurement: 0,0,0
 51 velocity aiding control: 1,0.1,0.01
 75 binary output 1: 0,0,00
 76 binary output 2: 0,0,00
 77 binary output 3: 0,0,00
 82 delta theta and delta velocity: 0,0,0,0,0
 83 reference model configuration: 1,1,0,0,1000,0.000,+00.00000000,+000.00000000,+00000.000
 84 gyro compensation: 1,0,0,0,1,0,0,0,1,0,0,0
 85 IMU filtering: 0,4,4,4,0,0,3,3,3,0
101 NMEA output 1: 0,0,0,0,00000000
102 NMEA output 2: 0,0,0,0,00000000
206 legacy compatibility settings: 0,0,0,0
"""
"""Registers with a value of their own: number, name and factory values. Type 14 is VNYMR, as captures of new sensors
show; a table of the manual prints another type, a misprint."""

_READ_ONLY = (1, 2, 3, 4, 47)
"""Those of them that cannot be written."""

_ALLOWED: Mapping[int, Container[int]] = {
    RegisterNumber.BAUD: BAUDS,
    RegisterNumber.OUTPUT_TYPE: (0, *OUTPUT_TYPES),
    RegisterNumber.OUTPUT_RATE: (0, *ASCII_RATES),
    RegisterNumber.PROTOCOL: range(5),
    RegisterNumber.IMU_FILTER: range(LOOP_RATE + 1),
}
"""Values of each field of a register that the emulator acts on; of others, any number. The largest window that a sensor
accepts is not known: one second, that of 1 Hz, is assumed."""


def _registers() -> Iterator[Register]:
    """Yield every register, in any order."""
    for number, name, factory in re.findall(r"(\d+) (.+): ?(.*)", _TABLE):
        access: Access = "fixed" if int(number) in _READ_ONLY else "setting"
        yield Register(int(number), name, factory, access)
    for register, message in MEASUREMENTS.items():
        yield Register(register, f"measurements of {message}", "", "measurement")


REGISTERS = {r.id: r for r in sorted(_registers(), key=lambda r: r.id)}
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
