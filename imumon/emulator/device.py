"""The device: registers, commands and streams of a VN-100, as logic without a port or a clock.

`receive` takes what the host sent and `replies` gives the answers, when they are due; `advance` runs the
sensor to a tick of its 800 Hz loop and gives the messages made on the way, each with its tick. Rules:
a reply carries a check as long as the command's; numbers of registers are taken unpadded and answered
with two digits; a port number is 1 or 2, anything else is error 07; what does not fit the baud is error
0C; a reset echoes, then is silent, then starts from what was saved.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Literal, TypeAlias

import numpy as np

from imumon.emulator.readout import Estimator, Readout, Setup
from imumon.emulator.settings import EmulatorSettings
from imumon.emulator.signal import ACCEL, GYRO, Tape
from imumon.samples import Floats, Ints
from imumon.sensors.vn100 import ascii, binary
from imumon.sensors.vn100.registers import (
    BAD_CHECKSUM,
    BAD_COMMAND,
    BAD_PARAMETER,
    BAD_REGISTER,
    BAUD,
    BAUD_TOO_LOW,
    BINARY_OUTPUTS,
    IRON_CONTROL,
    LOOP_RATE,
    MEASUREMENTS,
    NOT_ALLOWED,
    OUTPUT_RATE,
    OUTPUT_TYPE,
    OUTPUT_TYPES,
    PROTOCOL,
    REGISTERS,
    ROTATION,
    STARTUP_BIAS,
    SYNC_CONTROL,
    SYNC_STATUS,
    TOO_FEW,
    TOO_MANY,
    Register,
    RegisterError,
)
from imumon.sensors.vn100.streams import WIDTHS

Check: TypeAlias = Literal["xor", "crc"]
Message: TypeAlias = tuple[int, bytes]
"""Tick at which a message was made, and its bytes."""
Store: TypeAlias = dict[tuple[int, int], tuple[str, ...]]
"""Fields by register and port; port 0 where the register is the same for both."""

INPUT_BUFFER = 256
SAVING_S = 0.45
BOOTING_S = 0.7
STARTUP_TICKS = 440
"""Age of the sensor's clock when its first message comes: 0.55 s."""

_CHECK = re.compile(rb"(?i:[0-9a-f]{2}|[0-9a-f]{4}|XX|XXXX)")
_BODY = re.compile(rb"[ -#%-)+-~]{5,}")
_FITTING = (BAUD, OUTPUT_TYPE, OUTPUT_RATE, *BINARY_OUTPUTS)
_INPUT_OVERFLOW = 0x02


@dataclass(frozen=True, slots=True)
class Stream:
    """One asynchronous output: a message every `divisor` ticks."""

    divisor: int
    length: int
    deltas: bool
    encode: Callable[[Readout], list[bytes]]


class Device:
    """One VN-100.

    Parameters
    ----------
    settings : identity, port and what it streams at power-up.
    tape : the signals it feels.
    """

    def __init__(self, settings: EmulatorSettings, tape: Tape) -> None:
        self._settings, self._tape = settings, tape
        self._generation = settings.generation
        self._port = settings.serial_port
        self._saved = self._factory()
        self._store = dict(self._saved)
        self._input = bytearray()
        self._inbox: deque[tuple[bytes, float]] = deque()
        self._outbox: list[bytes] = []
        self._busy: tuple[float, Callable[[], None]] | None = None
        self._saved_at = -1.0
        self._commands: dict[str, tuple[Callable[..., tuple[str, ...]], int, float]] = {
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
            "VNSFB": (self._keep_bias, 0, 0),
            "VNKMD": (self._magnetic_disturbance, 1, 1),
            "VNKAD": (self._acceleration_disturbance, 1, 1),
            "VNCMD": (self._echo, 0, 0),
        }
        self.tick = 0
        self.restarts = 0
        self._since_tick, self._since = 0, self._integrals(np.array([0]))[0]
        self._start()

    # ------------------------------------------------------------------ registers

    def _factory(self) -> Store:
        store: Store = {}
        for register in REGISTERS.values():
            if register.in_generation(self._generation) and register.access == "setting":
                for port in (1, 2) if register.ports else (0,):
                    store[register.id, port] = register.factory_values(self._generation)
        return store

    def _start(self) -> None:
        """Everything that a power-up or reset begins with."""
        self._store = dict(self._saved)
        rotation = np.array([float(text) for text in self.read(ROTATION)]).reshape(3, 3)
        self._rotation: Floats = rotation
        self._boot_tick, self._jump_ns = self.tick, 0
        self._estimator = Estimator(np.array([float(t) for t in self.read(STARTUP_BIAS)]), self.tick)
        self._paused = {1: False, 2: False}
        self._disturbed = 0
        self._sync_tick, self._sync_counts = self.tick, [0, 0, 0]
        self._changed()

    def read(self, register: int, port: int | None = None) -> tuple[str, ...]:
        """Fields of a register; those of the active port where ports differ."""
        number = (port or self._port) if REGISTERS[register].ports else 0
        return self._store[register, number]

    def set(self, register: int, *values: str) -> None:
        """Write a register as if it had been saved like this, on the active port."""
        number = self._port if REGISTERS[register].ports else 0
        self._saved[register, number] = REGISTERS[register].normalise(values, self._generation)
        self._store[register, number] = self._saved[register, number]
        self._changed()

    @property
    def baud(self) -> int:
        return int(self.read(BAUD)[0])

    @property
    def booting(self) -> bool:
        return self._busy is not None and self._busy[1] == self._boot

    def _changed(self) -> None:
        """A register was written: what is derived from them is derived anew."""
        iron = self.read(IRON_CONTROL)
        self._setup = Setup.of(self.read, self._rotation, iron[0] == "1" and iron[1] == "3")
        self._streams = self._make_streams(self._store, self._port)

    # ------------------------------------------------------------------ streams

    def _make_streams(self, store: Store, port: int) -> list[Stream]:
        """Streams of one port, ASCII first."""
        streams = []
        kind, rate = int(store[OUTPUT_TYPE, port][0]), int(store[OUTPUT_RATE, port][0])
        if kind and rate:
            message = OUTPUT_TYPES[kind]
            length = len(self._sentences(message, None)[0])
            encode = lambda readout: self._sentences(message, readout)  # noqa: E731
            streams.append(Stream(LOOP_RATE // rate, length, message == "VNDTV", encode))
        for number in BINARY_OUTPUTS:
            mode, divisor, *words = store[number, 0]
            if int(mode) & port and int(divisor) and int(words[0], 16):
                streams.append(_binary_stream(_layout(words), int(divisor)))
        return streams

    def load(self) -> float:
        """Bytes per second that the active port's streams need."""
        return self._load(self._store, self._port)

    def next_tick(self) -> int:
        """Tick of the next message, if there are no commands; far off without streams."""
        if self._paused[self._port]:
            return self.tick + LOOP_RATE
        return min(
            (-(-self.tick // s.divisor) * s.divisor for s in self._streams), default=self.tick + LOOP_RATE
        )

    def _load(self, store: Store, port: int) -> float:
        """Bytes per second that the streams of a port need."""
        return sum(stream.length * LOOP_RATE / stream.divisor for stream in self._make_streams(store, port))

    def _sentences(self, message: str, readout: Readout | None) -> list[bytes]:
        """Sentences of a readout, or one of zeros."""
        protocol = REGISTERS[PROTOCOL].parse(self.read(PROTOCOL))
        check: Check = "crc" if protocol["serial_checksum"] == 3 else "xor"
        columns = self._columns(message, readout)
        rows = len(columns)
        appended: list[list[str]] = []
        count, status = protocol["serial_count"], protocol["serial_status"]
        if count:
            name = "syncOutCnt" if count == 3 else "syncInCnt" if count == 1 else ""
            numbers = readout[name][:, 0] if readout is not None else np.zeros(rows)
            appended.append([f"T{int(number):010d}" for number in numbers])
        if status:
            words = readout["vpeStatus"][:, 0] if readout is not None and status == 1 else np.zeros(rows)
            appended.append([f"S{int(word):04X}" for word in words])
        extra = list(zip(*appended, strict=True)) if appended else [()] * rows
        return [
            ascii.encode(ascii.sentence(message, row, *more), check)
            for row, more in zip(columns.tolist(), extra, strict=True)
        ]

    def _columns(self, message: str, readout: Readout | None) -> Floats:
        """Numbers of a message, (n, f) in its own units."""
        quantities = ascii.MEASUREMENTS[message]
        if readout is None:
            return np.zeros((1, sum(WIDTHS[name] for name in quantities)))
        linear = {"VNYBA": "linAccelBody", "VNYIA": "linAccelNed"}
        names = [linear[message] if name == "linaccel" else name for name in quantities]
        return np.concatenate([readout[name] for name in names], axis=1)

    def advance(self, upto: int) -> list[Message]:
        """Run the sensor to tick `upto`; the messages it made on the way, in their order."""
        messages: list[Message] = []
        while self.tick < upto:
            stop = min(upto, self._tape.end)
            if stop > self.tick:
                messages += self._block(self.tick, stop)
                self.tick = stop
            else:
                self._tape.extend(max(LOOP_RATE, min(upto - self.tick, 1 << 14)))
        return messages

    def _block(self, first: int, stop: int) -> list[Message]:
        self._estimator.follow(self._tape, stop)
        if self.booting or self._paused[self._port]:
            return []
        due = [np.arange(-first % s.divisor + first, stop, s.divisor) for s in self._streams]
        resets = [ticks for stream, ticks in zip(self._streams, due, strict=True) if stream.deltas]
        events = np.unique(np.concatenate(resets)) if resets else np.empty(0, np.int64)
        increments = self._increments(events) if len(events) else np.empty((0, 7))
        messages: list[Message] = []
        for stream, ticks in zip(self._streams, due, strict=True):
            if len(ticks):
                since = increments[np.searchsorted(events, ticks)] if stream.deltas else None
                rows = stream.encode(self._readout(ticks, since))
                messages += zip(ticks.tolist(), rows, strict=True)
        if len(self._streams) > 1:
            messages.sort(key=lambda message: message[0])
        return messages

    def _increments(self, events: Ints) -> Floats:
        """Time and integrals between one reset of the increments and the next, (n, 7) s and unit * s."""
        ends = events + 1
        integrals = self._integrals(ends)
        before = np.concatenate((self._since[None, :], integrals[:-1]))
        spans = np.diff(ends, prepend=self._since_tick) / LOOP_RATE
        self._since_tick, self._since = int(ends[-1]), integrals[-1]
        return np.concatenate((spans[:, None], integrals - before), axis=1)

    def _integrals(self, ticks: Ints) -> Floats:
        return np.concatenate([self._tape.integral(ticks, GYRO), self._tape.integral(ticks, ACCEL)], axis=1)

    def _readout(self, ticks: Ints, since: Floats | None) -> Readout:
        age = (ticks - self._boot_tick + STARTUP_TICKS) / LOOP_RATE + self._tape.jitter(ticks)
        sync = REGISTERS[SYNC_CONTROL].parse(self.read(SYNC_CONTROL))
        pace = {1: 1, 2: 1, 3: 2}.get(int(sync["out_mode"]), 0) * (int(sync["out_skip"]) + 1)
        pulses = (ticks // pace - (self._sync_tick - 1) // pace) if pace else np.zeros(len(ticks), np.int64)
        counts: Mapping[str, Floats | Ints] = {
            "timeStartup": np.maximum(np.rint(age * 1e6).astype(np.int64) * 1000 + self._jump_ns, 0)[:, None],
            "vpeStatus": np.full((len(ticks), 1), self._disturbed, np.int64),
            "syncInCnt": np.full((len(ticks), 1), self._sync_counts[0], np.int64),
            "syncOutCnt": (pulses + self._sync_counts[2])[:, None],
        }
        return Readout(self._tape, self._setup, self._estimator, ticks, since, counts)

    def now(self, deltas: bool = False) -> Readout:
        """Readings of the newest tick; with `deltas`, their increments start anew."""
        if not self._tape.end:
            self._tape.extend(LOOP_RATE)
        ticks = np.array([max(self.tick - 1, 0)])
        return self._readout(ticks, self._increments(ticks) if deltas else None)

    # ------------------------------------------------------------------ commands

    def receive(self, data: bytes, now: float) -> None:
        """Bytes from the host, which arrived at `now` (s)."""
        if self.booting:
            return
        for byte in data.splitlines(keepends=True):
            self._input += byte
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
                raise RegisterError(
                    TOO_FEW if len(fields) < least else TOO_MANY, f"{command} takes other fields"
                )
            if command == "VNBOM":
                self._outbox.append(self._poll_binary(*fields))
            elif command == "VNWNV":
                self._save(form, arrived, now)
            else:
                answer = handler(*fields)
                self._outbox.append(ascii.encode(",".join((command, *answer)), form))
            if command in ("VNRST", "VNRFS"):
                self.restart(now)
        except RegisterError as error:
            self._error(error.code, form)

    def _error(self, code: int, form: Check) -> None:
        mode = REGISTERS[PROTOCOL].parse(self.read(PROTOCOL))["error_mode"]
        if mode:
            self._outbox.append(ascii.encode(f"VNERR,{code:02X}", form))
        if mode == 2:
            self._store[OUTPUT_TYPE, self._port] = ("0",)
            self._changed()

    def _register(self, text: str) -> Register:
        if not text.isdigit():
            raise RegisterError(BAD_PARAMETER, "the register is no number")
        register = REGISTERS.get(int(text))
        if register is None or not register.in_generation(self._generation):
            raise RegisterError(BAD_REGISTER, "no such register")
        return register

    def _read_register(self, which: str, *ports: str) -> tuple[str, ...]:
        register = self._register(which)
        number = f"{register.id:02d}"
        if len(ports) > register.ports:
            raise RegisterError(TOO_MANY, "no such parameter")
        if register.ports:
            port = self._port_number(ports[0]) if ports else self._port
            echoed = (str(port),) if ports else ()
            return (number, *self.read(register.id, port), *echoed)
        return (number, *self._values(register))

    def _port_number(self, text: str) -> int:
        if text == "?":
            return self._port
        if text not in ("1", "2"):
            raise RegisterError(BAD_PARAMETER, "there are ports 1 and 2")
        return int(text)

    def _values(self, register: Register) -> Sequence[str]:
        identity = {1: self._settings.model, 3: self._settings.serial, 4: self._settings.firmware}
        if register.id in identity:
            return (identity[register.id],)
        if register.access == "measurement":
            message = MEASUREMENTS[register.id]
            return ascii.numbers(message, self._columns(message, self.now(message == "VNDTV"))[0].tolist())
        if register.id == SYNC_STATUS:
            counts = self.now()
            return (
                str(counts["syncInCnt"][0, 0]),
                str(self._sync_counts[1]),
                str(counts["syncOutCnt"][0, 0]),
            )
        if register.access == "fixed":
            return register.factory_values(self._generation)
        return self.read(register.id)

    def _write_register(self, which: str, *values: str) -> tuple[str, ...]:
        register = self._register(which)
        if register.access != "setting":
            raise RegisterError(NOT_ALLOWED, "read only")
        port, echoed = (self._port if register.ports else 0), ""
        if register.ports and len(values) == 2:
            port = self._port_number(values[1])
            values, echoed = values[:1], str(port)
        kept = register.normalise(values, self._generation)
        if register.id in BINARY_OUTPUTS and int(kept[2], 16):
            _layout(kept[2:])
        self._write(register.id, port, kept)
        return (f"{register.id:02d}", *kept, *filter(None, (echoed,)))

    def _write(self, number: int, port: int, kept: tuple[str, ...]) -> None:
        trial = {**self._store, (number, port): kept}
        if number in _FITTING:
            for each in (1, 2) if number in BINARY_OUTPUTS else (port,):
                if self._load(trial, each) > int(trial[BAUD, each][0]) / 10:
                    raise RegisterError(BAUD_TOO_LOW, "the output does not fit the baud")
        if number in (SYNC_CONTROL, SYNC_STATUS):
            self._sync_tick = self.tick
            self._sync_counts = [int(text) for text in kept] if number == SYNC_STATUS else [0, 0, 0]
        self._store = trial
        self._changed()

    def _pause(self, state: str, port: str = "?") -> tuple[str, ...]:
        number, on = self._port_number(port), _switch(state)
        self._paused[number] = not on
        return (state,) if port == "?" else (state, port)

    def _poll_binary(self, which: str) -> bytes:
        if not which.isdigit() or not 1 <= int(which) <= 3:
            raise RegisterError(BAD_PARAMETER, "there are binary outputs 1 to 3")
        words = self.read(BINARY_OUTPUTS[int(which) - 1])[2:]
        if not int(words[0], 16):
            raise RegisterError(BAD_PARAMETER, "this output has no fields")
        stream = _binary_stream(_layout(words), 1)
        return stream.encode(self.now(stream.deltas))[0]

    def _tare(self) -> tuple[str, ...]:
        if self._generation == 3:
            raise RegisterError(BAD_COMMAND, "firmware 3 has VNSIH instead")
        self._estimator.heading = 0.0
        self._estimator.reset_bias()
        return ()

    def _set_heading(self, *angles: str) -> tuple[str, ...]:
        if self._generation == 2:
            raise RegisterError(BAD_COMMAND, "firmware 2 has VNTAR instead")
        if len(angles) == 2:
            raise RegisterError(TOO_FEW, "give a heading, three angles or a quaternion")
        numbers = [_number(text) for text in angles]
        if len(numbers) == 4:
            x, y, z, w = numbers
            numbers = [float(np.degrees(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))))]
        self._estimator.heading = numbers[0]
        return angles

    def _keep_bias(self) -> tuple[str, ...]:
        bias = [REGISTERS[STARTUP_BIAS].fields[0].format(float(value)) for value in self._estimator.bias[-1]]
        self._store[STARTUP_BIAS, 0] = tuple(bias)
        if (74, 0) in self._store:
            self._store[74, 0] = (*bias, *self._store[74, 0][3:])
        return ()

    def _magnetic_disturbance(self, state: str) -> tuple[str, ...]:
        return self._disturb(1 << 11, state)

    def _acceleration_disturbance(self, state: str) -> tuple[str, ...]:
        return self._disturb(1 << 12, state)

    def _disturb(self, bit: int, state: str) -> tuple[str, ...]:
        self._disturbed = self._disturbed | bit if _switch(state) else self._disturbed & ~bit
        return (state,)

    def _echo(self) -> tuple[str, ...]:
        return ()

    def _forget(self) -> tuple[str, ...]:
        self._saved = self._factory()
        return ()

    def _save(self, form: Check, arrived: float, now: float) -> None:
        def saved() -> None:
            self._saved, self._saved_at = dict(self._store), now + SAVING_S
            self._outbox.append(ascii.encode("VNWNV", form))

        if arrived < self._saved_at:  # a host that asks again before it was answered
            self._outbox.append(ascii.encode("VNWNV", form))
        else:
            self._busy = (now + SAVING_S, saved)

    def restart(self, now: float) -> None:
        """Reset or power cut: silence, then a start from what was saved."""
        self._inbox.clear()
        self._input.clear()
        self._busy = (now + BOOTING_S, self._boot)

    def _boot(self) -> None:
        self.restarts += 1
        self._start()

    def jump(self, seconds: float) -> None:
        """The sensor's clock leaps."""
        self._jump_ns += round(seconds * 1e6) * 1000


def _binary_stream(layout: binary.Layout, divisor: int) -> Stream:
    names = [name.partition(".")[2] for name in layout.fields]
    deltas = any(name in ("deltas", "deltaTheta", "deltaVel") for name in names)

    def encode(readout: Readout) -> list[bytes]:
        values = {name: readout[name] for name in names if readout.has(name)}
        data = layout.encode(values or {"timeStartup": readout["timeStartup"]})
        return [data[at : at + layout.length] for at in range(0, len(data), layout.length)]

    return Stream(divisor, layout.length, deltas, encode)


def _layout(words: Sequence[str]) -> binary.Layout:
    """Layout of the group byte and field words of registers 75-77."""
    groups = [group for group in range(1, 8) if int(words[0], 16) >> (group - 1) & 1]
    try:
        return binary.Layout.of({g: int(word, 16) for g, word in zip(groups, words[1:], strict=True)})
    except ValueError as error:
        raise RegisterError(BAD_PARAMETER, str(error)) from None


def _switch(text: str) -> bool:
    if text not in ("0", "1"):
        raise RegisterError(BAD_PARAMETER, "give 0 or 1")
    return text == "1"


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise RegisterError(BAD_PARAMETER, f"{text!r} is no number") from None
