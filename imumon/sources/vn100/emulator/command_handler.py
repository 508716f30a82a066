"""Emulated VN-100 device: its commands, without a port or a clock.

`CommandHandler.receive` takes bytes from the host, `replies` returns the replies, `advance` runs the sensor. A reply
has the same kind of checksum as its command. Register numbers may be unpadded and are answered with two digits. A port
number other than 1 or 2 is error 07; output that does not fit the baud is error 0C. A reset is echoed; then the device
is silent, then it starts with the saved registers.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from math import inf

from imumon.sources.vn100 import ascii, registers
from imumon.sources.vn100.emulator.emulator_settings import EmulatorSettings
from imumon.sources.vn100.emulator.output_streams import ChecksumKind, Message, OutputStreams, binary_layout
from imumon.sources.vn100.emulator.register_file import RegisterFile
from imumon.sources.vn100.emulator.sensor_model import SensorModel
from imumon.sources.vn100.registers import REGISTERS, ErrorCode, Register, RegisterError, RegisterNumber

INPUT_BUFFER = 256
"""bytes of a command that the device buffers."""

BOOTING_S = 0.7
"""s that the device is silent after a reset."""

_CHECKSUM = re.compile(rb"(?i:[0-9a-f]{2}|[0-9a-f]{4}|XX|XXXX)")
_BODY = re.compile(rb"[ -#%-)+-~]{5,}")
_AFFECT_LOAD = (
    RegisterNumber.BAUD,
    RegisterNumber.OUTPUT_TYPE,
    RegisterNumber.OUTPUT_RATE,
    *registers.BINARY_OUTPUTS,
)


class CommandHandler:
    """One VN-100.

    Parameters
    ----------
    settings : identity, firmware and port.
    sensor_model : signals of the sensor elements.

    Attributes
    ----------
    registers : its register file.
    outputs : its output streams.
    restarts : number of resets.
    """

    def __init__(self, settings: EmulatorSettings, sensor_model: SensorModel) -> None:
        self._settings = settings
        self.registers = RegisterFile()
        self.outputs = OutputStreams(sensor_model, self.registers, settings.serial_port)
        self.restarts = 0
        self._input = bytearray()
        self._replies: list[bytes] = []
        self._boots_at: float | None = None  # s, end of the silence after a reset
        self._commands: dict[str, tuple[Callable[..., Sequence[str]], int, float]] = {
            "VNRRG": (self._read_register, 1, inf),
            "VNWRG": (self._write_register, 1, inf),
            "VNWNV": (self._save, 0, 0),
            "VNRST": (self._acknowledge, 0, 0),
            "VNRFS": (self._restore_factory_settings, 0, 0),
            "VNASY": (self._enable_outputs, 1, 2),
            "VNSIH": (self._acknowledge, 1, 4),
            "VNSGB": (self._acknowledge, 0, 0),
            "VNSFB": (self._acknowledge, 0, 0),  # its name in newer software
            "VNKMD": (self._acknowledge, 1, 1),
            "VNKAD": (self._acknowledge, 1, 1),
            "VNCMD": (self._acknowledge, 0, 0),
        }

    @property
    def baud(self) -> int:
        return int(self.registers[RegisterNumber.BAUD][0])

    def set_register(self, register: int, *values: str) -> None:
        """Write a register of the active port and save it."""
        REGISTERS[register].check(values)
        self.registers[register] = values
        self.registers.save()
        self.outputs.update()

    def advance(self, upto: int) -> list[Message]:
        """Run the sensor to tick `upto`; return its messages in order."""
        return self.outputs.advance(upto, silent=self._boots_at is not None)

    # ------------------------------------------------------------------ commands and replies

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes from the host that arrived at `now` (s)."""
        for part in data.splitlines(keepends=True):
            if self._boots_at is not None:
                return
            self._input += part
            if len(self._input) > INPUT_BUFFER:
                self._input.clear()
                self._error(ErrorCode.SERIAL_INPUT_BUFFER_OVERFLOW, "xor")
            elif self._input.endswith((b"\n", b"\r")):
                dollar = self._input.rfind(b"$")  # a sensor ignores garbage before a command
                line = bytes(self._input[dollar:]).strip() if dollar >= 0 else b""
                self._input.clear()
                if line:
                    self._execute(line, now)

    def replies(self, now: float) -> list[bytes]:
        """Return the replies to what was received; start at the end of the silence after a reset."""
        if self._boots_at is not None and now >= self._boots_at:
            self._boots_at = None
            self.restarts += 1
            self.registers.load_saved()
            self.outputs.start()
        replies, self._replies = self._replies, []
        return replies

    def _execute(self, line: bytes, now: float) -> None:
        """Reply to a line that begins with ``$``, or report why it is no valid command."""
        body, star, checksum = line[1:].partition(b"*")
        kind: ChecksumKind = "crc" if len(checksum) == 4 else "xor"
        complete = star and _CHECKSUM.fullmatch(checksum) and _BODY.fullmatch(body)
        # a checksum of XX or XXXX is not checked, so that a person can type commands
        if not complete or (checksum[:1] not in b"Xx" and not ascii.intact(body, checksum)):
            self._error(ErrorCode.INVALID_CHECKSUM, kind)
            return
        command, fields = ascii.split(body)
        try:
            handler = self._handler(command, len(fields))
            self._replies.append(ascii.encode(",".join((command, *handler(*fields))), kind))
            if command in ("VNRST", "VNRFS"):
                self.restart(now)
        except RegisterError as error:
            self._error(error.code, kind)

    def _handler(self, command: str, count: int) -> Callable[..., Sequence[str]]:
        """Return what executes a command with `count` fields; refuse an unknown one, or a wrong number."""
        if command not in self._commands:
            raise RegisterError(ErrorCode.INVALID_COMMAND, command)
        handler, least, most = self._commands[command]
        if count < least:
            raise RegisterError(ErrorCode.NOT_ENOUGH_PARAMETERS, command)
        if count > most:
            raise RegisterError(ErrorCode.TOO_MANY_PARAMETERS, command)
        return handler

    def _error(self, code: int, kind: ChecksumKind) -> None:
        self._replies.append(ascii.encode(f"VNERR,{code:02X}", kind))

    # ------------------------------------------------------------------ registers

    def _register(self, text: str) -> Register:
        if not text.isdigit():
            raise RegisterError(ErrorCode.INVALID_PARAMETER, "the register is not a number")
        register = REGISTERS.get(int(text))
        if register is None:
            raise RegisterError(ErrorCode.INVALID_REGISTER, "no such register")
        return register

    def _check_port(self, *ports: str) -> None:
        """Raise `RegisterError` if a port is none of the sensor."""
        if not set(ports) <= {"1", "2", "?"}:
            raise RegisterError(ErrorCode.INVALID_PARAMETER, "choose port 1 or 2")

    def _read_register(self, number: str, *ports: str) -> Sequence[str]:
        register = self._register(number)
        if len(ports) > register.ports:
            raise RegisterError(ErrorCode.TOO_MANY_PARAMETERS, "no such parameter")
        self._check_port(*ports)
        echoed = [str(self._settings.serial_port) if port == "?" else port for port in ports]
        return (f"{register.id:02d}", *self._values(register), *echoed)

    def _values(self, register: Register) -> Sequence[str]:
        """Return the fields of a register as they are now."""
        identity = {1: self._settings.model, 3: self._settings.serial, 4: self._settings.firmware}
        if register.id in identity:
            return (identity[register.id],)
        if register.access == "measurement":
            message = registers.MEASUREMENTS[register.id]
            measurements = self.outputs.latest(message == "VNDTV")
            return ascii.numbers(message, self.outputs.columns(message, measurements)[0].tolist())
        if register.access == "fixed":
            return register.factory_values
        return self.registers[register.id]

    def _write_register(self, number: str, *values: str) -> Sequence[str]:
        """Write a register; refuse what the sensor refuses."""
        register = self._register(number)
        ports: Sequence[str] = ()
        if register.ports and len(values) == 2:
            values, ports = values[:1], values[1:]
        self._check_port(*ports)
        register.check(values)
        if register.id in registers.BINARY_OUTPUTS and int(values[2], 16):
            binary_layout(values[2:])
        before = self.registers[register.id]
        self.registers[register.id] = tuple(values)
        if register.id in _AFFECT_LOAD and self.outputs.bytes_per_second() > self.baud / 10:
            self.registers[register.id] = before
            raise RegisterError(ErrorCode.BAUD_RATE_TOO_LOW, "the output does not fit the baud")
        self.outputs.update()
        return (f"{register.id:02d}", *values, *ports)

    # ------------------------------------------------------------------ other commands

    def _acknowledge(self, *fields: str) -> Sequence[str]:
        """Echo a command that changes nothing here: those of the attitude, which is fixed, among them."""
        return fields

    def _enable_outputs(self, state: str, *ports: str) -> Sequence[str]:
        if state not in ("0", "1"):
            raise RegisterError(ErrorCode.INVALID_PARAMETER, "give 0 or 1")
        self._check_port(*ports)
        self.outputs.paused = state == "0"
        return (state, *ports)

    def _save(self) -> Sequence[str]:
        self.registers.save()
        return ()

    def _restore_factory_settings(self) -> Sequence[str]:
        self.registers.reset_saved()
        return ()

    def restart(self, now: float) -> None:
        """Reset or interrupt the power: silence, then a start with the saved registers."""
        self._input.clear()
        self._boots_at = now + BOOTING_S
