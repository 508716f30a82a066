"""Emulated VN-100 device: its commands, without a port or a clock.

`CommandHandler.receive` takes bytes from the host, `replies` returns the replies that are due, `advance` runs
the sensor. A reply has the same kind of checksum as its command. Register numbers may be unpadded and are
answered with two digits. A port number other than 1 or 2 is error 07; output that does not fit the baud is
error 0C. A reset is echoed; then the device is silent, then it starts with the saved registers.
"""

from __future__ import annotations

import re
from collections import deque
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

SAVING_S = 0.45
"""s that the device takes to write its flash."""

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
        self.registers = RegisterFile(settings.serial_port)
        self.outputs = OutputStreams(sensor_model, self.registers)
        self.restarts = 0
        self._input = bytearray()
        self._received: deque[tuple[bytes, float]] = deque()
        self._replies: list[bytes] = []
        self._pending: tuple[float, Callable[[], None]] | None = None  # when it ends, what then happens
        self._saved_at = -inf
        self._commands: dict[str, tuple[Callable[..., Sequence[str]], int, float]] = {
            "VNRRG": (self._read_register, 1, inf),
            "VNWRG": (self._write_register, 1, inf),
            "VNWNV": (self._acknowledge, 0, 0),
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
        return int(self.registers.read(RegisterNumber.BAUD)[0])

    def set_register(self, register: int, *values: str) -> None:
        """Write a register of the active port and save it."""
        REGISTERS[register].check(values)
        self.registers.write(register, values)
        self.registers.save()
        self.outputs.update()

    def advance(self, upto: int) -> list[Message]:
        """Run the sensor to tick `upto`; return its messages in order."""
        return self.outputs.advance(upto, silent=self._booting)

    # ------------------------------------------------------------------ commands and replies

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes from the host that arrived at `now` (s)."""
        if self._booting:
            return
        for part in data.splitlines(keepends=True):
            self._input += part
            if len(self._input) > INPUT_BUFFER:
                self._input.clear()
                self._error(ErrorCode.SERIAL_INPUT_BUFFER_OVERFLOW, "xor")
            elif self._input.endswith((b"\n", b"\r")):
                dollar = self._input.rfind(b"$")  # a sensor ignores garbage before a command
                if dollar >= 0:
                    self._received.append((bytes(self._input[dollar:]).strip(), now))
                self._input.clear()

    def replies(self, now: float) -> list[bytes]:
        """Return the replies that are due by `now` (s); none while the device saves or boots."""
        if self._pending is not None and now >= self._pending[0]:
            complete, self._pending = self._pending[1], None
            complete()
        while self._received and self._pending is None:
            line, arrived = self._received.popleft()
            self._execute(line, arrived, now)
        replies, self._replies = self._replies, []
        return replies

    def next_reply(self) -> float | None:
        """Return when (s) to call `replies` if nothing is received before; None: then not at all."""
        return None if self._pending is None else self._pending[0]

    @property
    def _booting(self) -> bool:
        # while it saves, it sends and receives, and only its replies are late
        return self._pending is not None and self._pending[1] == self._boot

    def _execute(self, line: bytes, arrived: float, now: float) -> None:
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
            if command == "VNWNV":
                self._save(kind, arrived, now)
            else:
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
        """Reply with an error, as register 30 configures it."""
        *_, mode = self.registers.numbers(RegisterNumber.PROTOCOL)
        if mode:
            self._replies.append(ascii.encode(f"VNERR,{code:02X}", kind))
        if (
            mode == 2
        ):  # send and switch the asynchronous output off; modes 0 and 1 are silence and sending alone
            self.registers.write(RegisterNumber.OUTPUT_TYPE, ("0",))
            self.outputs.update()

    # ------------------------------------------------------------------ registers

    def _register(self, text: str) -> Register:
        if not text.isdigit():
            raise RegisterError(ErrorCode.INVALID_PARAMETER, "the register is not a number")
        register = REGISTERS.get(int(text))
        if register is None:
            raise RegisterError(ErrorCode.INVALID_REGISTER, "no such register")
        return register

    def _port_number(self, text: str) -> int:
        if text == "?":
            return self.registers.port
        if text not in ("1", "2"):
            raise RegisterError(ErrorCode.INVALID_PARAMETER, "choose port 1 or 2")
        return int(text)

    def _read_register(self, number: str, *ports: str) -> Sequence[str]:
        register = self._register(number)
        if len(ports) > register.ports:
            raise RegisterError(ErrorCode.TOO_MANY_PARAMETERS, "no such parameter")
        port = self._port_number(ports[0]) if ports else None
        echoed = () if port is None else (str(port),)
        return (f"{register.id:02d}", *self._values(register, port), *echoed)

    def _values(self, register: Register, port: int | None) -> Sequence[str]:
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
        return self.registers.read(register.id, port)

    def _write_register(self, number: str, *values: str) -> Sequence[str]:
        """Write a register; refuse what the sensor refuses."""
        register = self._register(number)
        port, echoed = None, ""
        if register.ports and len(values) == 2:
            port = self._port_number(values[1])
            values, echoed = values[:1], f",{port}"
        register.check(values)
        if register.id in registers.BINARY_OUTPUTS and int(values[2], 16):
            binary_layout(values[2:])
        if register.id in _AFFECT_LOAD:
            # the sum of all streams of a port has to fit; a binary output may be on both ports
            trial = self.registers.with_values(register.id, values, port)
            for loaded_port in (1, 2) if register.id in registers.BINARY_OUTPUTS else (port,):
                if (
                    self.outputs.bytes_per_second(trial, loaded_port)
                    > int(trial.read(RegisterNumber.BAUD, loaded_port)[0]) / 10
                ):
                    raise RegisterError(ErrorCode.BAUD_RATE_TOO_LOW, "the output does not fit the baud")
        self.registers.write(register.id, values, port)
        self.outputs.update()
        return (f"{register.id:02d}", ",".join(values) + echoed)

    # ------------------------------------------------------------------ other commands

    def _acknowledge(self, *fields: str) -> Sequence[str]:
        """Echo a command that changes nothing here: those of the attitude, which is fixed, among them."""
        return fields

    def _enable_outputs(self, state: str, port: str = "?") -> Sequence[str]:
        self.outputs.set_paused(self._port_number(port), not _flag(state))
        return (state,) if port == "?" else (state, port)

    def _save(self, kind: ChecksumKind, arrived: float, now: float) -> None:
        """Begin to write the flash; the reply comes when that is done."""

        def saved() -> None:
            self.registers.save()
            self._saved_at = now + SAVING_S
            self._replies.append(ascii.encode("VNWNV", kind))

        if arrived < self._saved_at:  # the host repeated the command before the first reply
            self._replies.append(ascii.encode("VNWNV", kind))
        else:
            self._pending = (now + SAVING_S, saved)

    def _restore_factory_settings(self) -> Sequence[str]:
        self.registers.reset_saved()
        return ()

    def restart(self, now: float) -> None:
        """Reset or interrupt the power: silence, then a start with the saved registers."""
        self._received.clear()
        self._input.clear()
        self._pending = (now + BOOTING_S, self._boot)

    def _boot(self) -> None:
        self.restarts += 1
        self.registers.load_saved()
        self.outputs.start()


def _flag(text: str) -> bool:
    if text not in ("0", "1"):
        raise RegisterError(ErrorCode.INVALID_PARAMETER, "give 0 or 1")
    return text == "1"
