"""Output streams of the emulated device: messages at each tick, as configured by its registers.

Streams follow the 800 Hz loop: an output with divisor d sends at every tick that d divides, so messages of
several streams interleave whole and in time. The increments of angle and velocity start at their last reset,
which is every message or poll that contains them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from operator import itemgetter
from typing import Literal, TypeAlias

import numpy as np

from imumon.model.samples import Floats, Ints
from imumon.sources.vn100 import ascii, binary
from imumon.sources.vn100.emulator.measurement_output import (
    MeasurementOutput,
)
from imumon.sources.vn100.emulator.register_file import RegisterFile
from imumon.sources.vn100.emulator.sensor_model import ACCEL, GYRO, SensorModel
from imumon.sources.vn100.measurements import WIDTHS
from imumon.sources.vn100.registers import (
    BINARY_OUTPUTS,
    LOOP_RATE,
    OUTPUT_TYPES,
    ErrorCode,
    RegisterError,
    RegisterNumber,
)

ChecksumKind: TypeAlias = Literal["xor", "crc"]
Message: TypeAlias = tuple[int, bytes]
"""Tick at which a message was made, and its bytes."""

STARTUP_TICKS = 440
"""Age of the sensor clock at its first message: 0.55 s."""

MOST_TICKS = 1 << 14
"""Ticks that the sensor model computes at once, and one step in time-lapse, at most."""

_INCREMENTS = ("deltas", "deltaTheta", "deltaVel")


@dataclass(frozen=True, slots=True)
class OutputStream:
    """One asynchronous output: a message of `length` bytes every `divisor` ticks."""

    divisor: int
    length: int
    deltas: bool
    encode: Callable[[MeasurementOutput], list[bytes]]


class OutputStreams:
    """Messages that a VN-100 sends without a request.

    Parameters
    ----------
    sensor_model : signals of the sensor elements.
    registers : of the device; call `update` after writing one.
    port : of the sensor that these streams leave, 1 or 2.

    Attributes
    ----------
    tick : of the next loop.
    paused : send nothing.
    start_tick : at which the sensor clock began.
    """

    def __init__(self, sensor_model: SensorModel, registers: RegisterFile, port: int) -> None:
        self._model, self._registers, self._port = sensor_model, registers, port
        self.tick = 0
        self._reset_tick, self._reset_integrals = 0, self._integrals(np.array([0]))[0]
        self.start()

    def start(self) -> None:
        """Set the state after power-up or a reset."""
        self.start_tick = self.tick
        self.paused = False
        self.update()

    def update(self) -> None:
        """Derive the filter and the streams from the registers."""
        self._averages = self._registers.numbers(RegisterNumber.IMU_FILTER)
        self._streams = self._make_streams()

    # ------------------------------------------------------------------ streams

    def _make_streams(self) -> list[OutputStream]:
        """Return the streams of the port by the registers, ASCII first."""
        registers, streams = self._registers, []
        (kind,) = registers.numbers(RegisterNumber.OUTPUT_TYPE)
        (rate,) = registers.numbers(RegisterNumber.OUTPUT_RATE)
        if kind and rate:
            message = OUTPUT_TYPES[kind]
            length = len(self._sentences(message, None)[0])
            encode = partial(self._sentences, message)
            streams.append(OutputStream(LOOP_RATE // rate, length, message == "VNDTV", encode))
        for number in BINARY_OUTPUTS:
            mode, divisor, *words = registers[number]
            if int(mode) & self._port and int(divisor) and int(words[0], 16):
                streams.append(_binary_stream(binary_layout(words), int(divisor)))
        return streams

    def bytes_per_second(self) -> float:
        """Return the load of the streams."""
        return sum(stream.length * LOOP_RATE / stream.divisor for stream in self._make_streams())

    def next_tick(self) -> int:
        """Return the tick of the next message if no command arrives; a distant one without streams."""
        distant = self.tick + LOOP_RATE
        if self.paused:
            return distant
        return min((-(-self.tick // s.divisor) * s.divisor for s in self._streams), default=distant)

    def _sentences(self, message: str, measurements: MeasurementOutput | None) -> list[bytes]:
        """Return one sentence per row of `measurements`; one of zeros without them."""
        checksum = self._registers.numbers(RegisterNumber.PROTOCOL)[4]
        kind: ChecksumKind = "crc" if checksum == 3 else "xor"
        columns = self.columns(message, measurements)
        return [ascii.encode(ascii.sentence(message, row), kind) for row in columns.tolist()]

    def columns(self, message: str, measurements: MeasurementOutput | None) -> Floats:
        """Return the numbers of a message in its own units, (n, f); zeros without measurements."""
        quantities = ascii.MEASUREMENTS[message]
        if measurements is None:
            return np.zeros((1, sum(WIDTHS[name] for name in quantities)))
        return np.concatenate([measurements[name] for name in quantities], axis=1)

    # ------------------------------------------------------------------ time

    def advance(self, upto: int, silent: bool = False) -> list[Message]:
        """Run to tick `upto`; return the messages in order, none of them when `silent`."""
        messages: list[Message] = []
        while self.tick < upto:
            if self._model.end <= self.tick:
                self._model.extend(max(LOOP_RATE, min(upto - self.tick, MOST_TICKS)))
            stop = min(upto, self._model.end)
            messages += self._run(self.tick, stop, silent)
            self.tick = stop
        return messages

    def _run(self, first: int, stop: int, silent: bool) -> list[Message]:
        """Return the messages of the ticks from `first` to before `stop`, in order; none when `silent`."""
        if silent or self.paused:
            return []
        due = [np.arange(-first % s.divisor + first, stop, s.divisor) for s in self._streams]
        # Increments have one integrator: a message that contains them resets it, whichever output sends it. So two
        # outputs with increments take them from one another, as on the real sensor.
        resets = [ticks for stream, ticks in zip(self._streams, due, strict=True) if stream.deltas]
        reset_ticks = np.unique(np.concatenate(resets)) if resets else np.empty(0, np.int64)
        increments = self._increments(reset_ticks) if len(reset_ticks) else np.empty((0, 7))
        messages: list[Message] = []
        for stream, ticks in zip(self._streams, due, strict=True):
            if len(ticks):
                rows = increments[np.searchsorted(reset_ticks, ticks)] if stream.deltas else None
                encoded = stream.encode(self._measure(ticks, rows))
                messages += zip(ticks.tolist(), encoded, strict=True)
        return sorted(messages, key=itemgetter(0)) if len(self._streams) > 1 else messages

    def _increments(self, reset_ticks: Ints) -> Floats:
        """Return time and integrals from each reset of the increments to the next, (n, 7) s and unit * s."""
        ends = reset_ticks + 1  # the sample of the tick of a message is part of its increment
        integrals = self._integrals(ends)
        before = np.concatenate((self._reset_integrals[None, :], integrals[:-1]))
        spans = np.diff(ends, prepend=self._reset_tick) / LOOP_RATE
        self._reset_tick, self._reset_integrals = int(ends[-1]), integrals[-1]
        return np.concatenate((spans[:, None], integrals - before), axis=1)

    def _integrals(self, ticks: Ints) -> Floats:
        return np.concatenate([self._model.integral(ticks, GYRO), self._model.integral(ticks, ACCEL)], axis=1)

    def _measure(self, ticks: Ints, increments: Floats | None) -> MeasurementOutput:
        """Return the measurements at some ticks, with their time stamps."""
        age = (ticks - self.start_tick + STARTUP_TICKS) / LOOP_RATE + self._model.jitter(ticks)
        time_ns = np.rint(age * 1e6).astype(np.int64) * 1000  # whole µs, the resolution of the stamps
        return MeasurementOutput(self._model, self._averages, ticks, increments, time_ns)

    def latest(self, deltas: bool = False) -> MeasurementOutput:
        """Return the measurements of the newest tick; with `deltas`, reset the increments."""
        ticks = np.array([self.tick - 1])
        return self._measure(ticks, self._increments(ticks) if deltas else None)


def _binary_stream(layout: binary.BinaryLayout, divisor: int) -> OutputStream:
    """Return the output of packets of a layout, one every `divisor` ticks."""
    names = [name.partition(".")[2] for name in layout.fields]

    def encode(measurements: MeasurementOutput) -> list[bytes]:
        data = layout.encode({name: measurements[name] for name in names})
        return [data[start : start + layout.length] for start in range(0, len(data), layout.length)]

    return OutputStream(divisor, layout.length, any(name in _INCREMENTS for name in names), encode)


def binary_layout(words: Sequence[str]) -> binary.BinaryLayout:
    """Return the layout of the group byte and field words of registers 75 to 77.

    Raises
    ------
    RegisterError : a field that no VN-100 sends.
    """
    groups = [group for group in range(1, 8) if int(words[0], 16) >> (group - 1) & 1]
    try:
        return binary.BinaryLayout.of({g: int(word, 16) for g, word in zip(groups, words[1:], strict=True)})
    except ValueError as error:
        raise RegisterError(ErrorCode.INVALID_PARAMETER, str(error)) from None
