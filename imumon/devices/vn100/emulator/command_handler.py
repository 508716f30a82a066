"""The device: the commands of a VN-100, as logic without a port or a clock.

`receive` takes what the host sent, `replies` gives the answers when they are due, and `advance` runs the
sensor. Rules: a reply carries a check as long as the command's; numbers of registers are taken unpadded and
answered with two digits; a port number is 1 or 2, anything else is error 07; what does not fit the baud is
error 0C; a reset echoes, then is silent, then starts from what was saved.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Sequence
from math import atan2, degrees, inf

from imumon.devices.vn100 import ascii
from imumon.devices.vn100.emulator.emulator_settings import EmulatorSettings
from imumon.devices.vn100.emulator.output_streams import Check, Message, OutputStreams, binary_layout
from imumon.devices.vn100.emulator.register_file import RegisterFile
from imumon.devices.vn100.emulator.sensor_model import SensorModel
from imumon.devices.vn100.registers import (
    BAD_CHECKSUM,
    BAD_COMMAND,
    BAD_PARAMETER,
    BAD_REGISTER,
    BAUD,
    BAUD_TOO_LOW,
    BINARY_OUTPUTS,
    MEASUREMENTS,
    NOT_ALLOWED,
    OUTPUT_RATE,
    OUTPUT_TYPE,
    PROTOCOL,
    REGISTERS,
    STARTUP_BIAS,
    SYNC_CONTROL,
    SYNC_STATUS,
    TOO_FEW,
    TOO_MANY,
    Register,
    RegisterError,
)

INPUT_BUFFER = 256
SAVING_S = 0.45
BOOTING_S = 0.7

_CHECK = re.compile(rb"(?i:[0-9a-f]{2}|[0-9a-f]{4}|XX|XXXX)")
_BODY = re.compile(rb"[ -#%-)+-~]{5,}")
_FITTING = (BAUD, OUTPUT_TYPE, OUTPUT_RATE, *BINARY_OUTPUTS)
_INPUT_OVERFLOW = 0x02
_STARTUP_FILTER_BIAS = 74


class CommandHandler:
    """One VN-100.

    Parameters
    ----------
    settings : identity, firmware and port.
    tape : the signals it feels.

    Attributes
    ----------
    memory : its registers.
    sensor : what measures and streams.
    restarts : how often it has started again.
    """

    def __init__(self, settings: EmulatorSettings, tape: SensorModel) -> None:
        self._settings = settings
        self.memory = RegisterFile(settings.generation, settings.serial_port)
        self.sensor = OutputStreams(tape, self.memory)
        self.restarts = 0
        self._input = bytearray()
        self._inbox: deque[tuple[bytes, float]] = deque()
        self._outbox: list[bytes] = []
        self._busy: tuple[float, Callable[[], None]] | None = None
        self._saved_at = -inf
        self._commands: dict[str, tuple[Callable[..., Sequence[str]], int, float]] = {
            "VNRRG": (self._read_register, 1, inf),
            "VNWRG": (self._write_register, 1, inf),
            "VNWNV": (self._echo, 0, 0),
            "VNRST": (self._echo, 0, 0),
            "VNRFS": (self._forget, 0, 0),
            "VNASY": (self._pause, 1, 2),
            "VNBOM": (self._echo, 1, 1),
            "VNTAR": (self._tare, 0, 0),
            "VNSIH": (self._set_heading, 1, 4),
            "VNSGB": (self._keep_bias, 0, 0),
            "VNSFB": (self._keep_bias, 0, 0),  # what newer hosts call it
            "VNKMD": (lambda state: self._disturb(1 << 11, state), 1, 1),
            "VNKAD": (lambda state: self._disturb(1 << 12, state), 1, 1),
            "VNCMD": (self._echo, 0, 0),
        }

    @property
    def baud(self) -> int:
        return int(self.memory.read(BAUD)[0])

    def set(self, register: int, *values: str) -> None:
        """Write a register as if it had been saved like this, on the active port."""
        self.memory.write(register, REGISTERS[register].normalise(values, self.memory.generation))
        self.memory.save()
        self.sensor.changed()

    def advance(self, upto: int) -> list[Message]:
        """Run the sensor to tick `upto`; the messages it made on the way, in their order."""
        booting = self._busy is not None and self._busy[1] == self._boot
        return self.sensor.advance(upto, silent=booting)

    # ------------------------------------------------------------------ the conversation

    def receive(self, data: bytes, now: float) -> None:
        """Bytes from the host, which arrived at `now` (s)."""
        if self._busy is not None and self._busy[1] == self._boot:
            return
        for part in data.splitlines(keepends=True):
            self._input += part
            if len(self._input) > INPUT_BUFFER:
                self._input.clear()
                self._error(_INPUT_OVERFLOW, "xor")
            elif self._input.endswith((b"\n", b"\r")):
                at = self._input.rfind(b"$")
                if at >= 0:
                    self._inbox.append((bytes(self._input[at:]).strip(), now))
                self._input.clear()

    def replies(self, now: float) -> list[bytes]:
        """Answers that are due by `now`; none while the sensor saves or starts."""
        if self._busy is not None and now >= self._busy[0]:
            done, self._busy = self._busy[1], None
            done()
        while self._inbox and self._busy is None:
            line, arrived = self._inbox.popleft()
            self._obey(line, arrived, now)
        out, self._outbox = self._outbox, []
        return out

    def due(self) -> float | None:
        """When `replies` is to be asked again without new input."""
        return None if self._busy is None else self._busy[0]

    def _obey(self, line: bytes, arrived: float, now: float) -> None:
        body, star, check = line[1:].partition(b"*")
        form: Check = "crc" if len(check) == 4 else "xor"
        whole = star and _CHECK.fullmatch(check) and _BODY.fullmatch(body)
        if not whole or (check[:1] not in b"Xx" and not ascii.intact(body, check)):
            self._error(BAD_CHECKSUM, form)
            return
        command, fields = ascii.split(body)
        try:
            if command not in self._commands:
                raise RegisterError(BAD_COMMAND, command)
            handler, least, most = self._commands[command]
            if not least <= len(fields) <= most:
                raise RegisterError(TOO_FEW if len(fields) < least else TOO_MANY, command)
            if command == "VNBOM":
                self._outbox.append(self._poll_binary(*fields))
            elif command == "VNWNV":
                self._save(form, arrived, now)
            else:
                self._outbox.append(ascii.encode(",".join((command, *handler(*fields))), form))
            if command in ("VNRST", "VNRFS"):
                self.restart(now)
        except RegisterError as error:
            self._error(error.code, form)

    def _error(self, code: int, form: Check) -> None:
        mode = self.memory.parse(PROTOCOL)["error_mode"]
        if mode:
            self._outbox.append(ascii.encode(f"VNERR,{code:02X}", form))
        if mode == 2:
            self.memory.write(OUTPUT_TYPE, ("0",))
            self.sensor.changed()

    # ------------------------------------------------------------------ registers

    def _register(self, text: str) -> Register:
        if not text.isdigit():
            raise RegisterError(BAD_PARAMETER, "the register is no number")
        register = REGISTERS.get(int(text))
        if register is None or not register.in_generation(self.memory.generation):
            raise RegisterError(BAD_REGISTER, "no such register")
        return register

    def _port_number(self, text: str) -> int:
        if text == "?":
            return self.memory.port
        if text not in ("1", "2"):
            raise RegisterError(BAD_PARAMETER, "there are ports 1 and 2")
        return int(text)

    def _read_register(self, which: str, *ports: str) -> Sequence[str]:
        register = self._register(which)
        if len(ports) > register.ports:
            raise RegisterError(TOO_MANY, "no such parameter")
        port = self._port_number(ports[0]) if ports else None
        echoed = () if port is None else (str(port),)
        return (f"{register.id:02d}", *self._values(register, port), *echoed)

    def _values(self, register: Register, port: int | None) -> Sequence[str]:
        identity = {1: self._settings.model, 3: self._settings.serial, 4: self._settings.firmware}
        if register.id in identity:
            return (identity[register.id],)
        if register.access == "measurement":
            message = MEASUREMENTS[register.id]
            readout = self.sensor.now(message == "VNDTV")
            return ascii.numbers(message, self.sensor.columns(message, readout)[0].tolist())
        if register.id == SYNC_STATUS:
            counts = self.sensor.now()
            return [str(counts[name][0, 0]) for name in ("syncInCnt", "syncInTime", "syncOutCnt")]
        if register.access == "fixed":
            return register.factory_values(self.memory.generation)
        return self.memory.read(register.id, port)

    def _write_register(self, which: str, *values: str) -> Sequence[str]:
        register = self._register(which)
        if register.access != "setting":
            raise RegisterError(NOT_ALLOWED, "read only")
        port, echoed = None, ""
        if register.ports and len(values) == 2:
            port = self._port_number(values[1])
            values, echoed = values[:1], f",{port}"
        kept = register.normalise(values, self.memory.generation)
        if register.id in BINARY_OUTPUTS and int(kept[2], 16):
            binary_layout(kept[2:])
        if register.id in _FITTING:
            trial = self.memory.changed(register.id, kept, port)
            for each in (1, 2) if register.id in BINARY_OUTPUTS else (port,):
                if self.sensor.load(trial, each) > int(trial.read(BAUD, each)[0]) / 10:
                    raise RegisterError(BAUD_TOO_LOW, "the output does not fit the baud")
        self.memory.write(register.id, kept, port)
        if register.id == SYNC_STATUS:
            self.sensor.count_from(*map(int, kept))
        elif register.id == SYNC_CONTROL:
            self.sensor.count_from(0, 0, 0)
        self.sensor.changed()
        return (f"{register.id:02d}", ",".join(kept) + echoed)

    # ------------------------------------------------------------------ other commands

    def _echo(self) -> Sequence[str]:
        return ()

    def _pause(self, state: str, port: str = "?") -> Sequence[str]:
        self.sensor.pause(self._port_number(port), not _switch(state))
        return (state,) if port == "?" else (state, port)

    def _poll_binary(self, which: str) -> bytes:
        if not which.isdigit() or not 1 <= int(which) <= 3:
            raise RegisterError(BAD_PARAMETER, "there are binary outputs 1 to 3")
        words = self.memory.read(BINARY_OUTPUTS[int(which) - 1])[2:]
        if not int(words[0], 16):
            raise RegisterError(BAD_PARAMETER, "this output has no fields")
        return self.sensor.packet(words)

    def _tare(self) -> Sequence[str]:
        if self.memory.generation == 3:
            raise RegisterError(BAD_COMMAND, "firmware 3 has VNSIH instead")
        self.sensor.estimator.heading = 0.0
        self.sensor.estimator.reset_bias()
        return ()

    def _set_heading(self, *angles: str) -> Sequence[str]:
        if self.memory.generation == 2:
            raise RegisterError(BAD_COMMAND, "firmware 2 has VNTAR instead")
        if len(angles) == 2:
            raise RegisterError(TOO_FEW, "give a heading, three angles or a quaternion")
        numbers = [_number(text) for text in angles]
        heading = numbers[0]
        if len(numbers) == 4:
            x, y, z, w = numbers
            heading = degrees(atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
        self.sensor.estimator.heading = heading
        return angles

    def _keep_bias(self) -> Sequence[str]:
        form = REGISTERS[STARTUP_BIAS].fields[0].format
        bias = [form(float(value)) for value in self.sensor.estimator.bias[-1]]
        self.memory.write(STARTUP_BIAS, bias)
        if _STARTUP_FILTER_BIAS in self.memory:
            rest = self.memory.read(_STARTUP_FILTER_BIAS)[3:]
            self.memory.write(_STARTUP_FILTER_BIAS, (*bias, *rest))
        return ()

    def _disturb(self, bit: int, state: str) -> Sequence[str]:
        self.sensor.disturbed = self.sensor.disturbed & ~bit | bit * _switch(state)
        return (state,)

    def _save(self, form: Check, arrived: float, now: float) -> None:
        def saved() -> None:
            self.memory.save()
            self._saved_at = now + SAVING_S
            self._outbox.append(ascii.encode("VNWNV", form))

        if arrived < self._saved_at:  # a host that asks again before it was answered
            self._outbox.append(ascii.encode("VNWNV", form))
        else:
            self._busy = (now + SAVING_S, saved)

    def _forget(self) -> Sequence[str]:
        self.memory.forget()
        return ()

    def restart(self, now: float) -> None:
        """Reset or power cut: silence, then a start from what was saved."""
        self._inbox.clear()
        self._input.clear()
        self._busy = (now + BOOTING_S, self._boot)

    def _boot(self) -> None:
        self.restarts += 1
        self.memory.restore()
        self.sensor.start()


def _switch(text: str) -> bool:
    if text not in ("0", "1"):
        raise RegisterError(BAD_PARAMETER, "give 0 or 1")
    return text == "1"


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise RegisterError(BAD_PARAMETER, f"{text!r} is no number") from None
