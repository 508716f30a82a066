"""The sensor: it measures and streams, tick by tick, as its registers say.

Streams follow the 800 Hz loop: an output with divisor d sends at every tick that d divides, so messages of
several streams interleave whole and in time. The increments of angle and velocity count from their last
reset, which is every time that any message or poll takes them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from imumon.devices.vn100 import ascii, binary
from imumon.devices.vn100.emulator.measurement_output import (
    AttitudeEstimator,
    MeasurementOutput,
    OutputConfiguration,
)
from imumon.devices.vn100.emulator.register_file import RegisterFile
from imumon.devices.vn100.emulator.sensor_model import ACCEL, GYRO, SensorModel
from imumon.devices.vn100.measurements import WIDTHS
from imumon.devices.vn100.registers import (
    BAD_PARAMETER,
    BINARY_OUTPUTS,
    IRON_CONTROL,
    LOOP_RATE,
    OUTPUT_RATE,
    OUTPUT_TYPE,
    OUTPUT_TYPES,
    PROTOCOL,
    ROTATION,
    STARTUP_BIAS,
    SYNC_CONTROL,
    RegisterError,
)
from imumon.samples import Floats, Ints

Check: TypeAlias = Literal["xor", "crc"]
Message: TypeAlias = tuple[int, bytes]
"""Tick at which a message was made, and its bytes."""

STARTUP_TICKS = 440
"""Age of the sensor's clock when its first message comes: 0.55 s."""

_LINEAR = {"VNYBA": "linAccelBody", "VNYIA": "linAccelNed"}
_INCREMENTS = ("deltas", "deltaTheta", "deltaVel")


@dataclass(frozen=True, slots=True)
class OutputStream:
    """One asynchronous output: a message of `length` bytes every `divisor` ticks."""

    divisor: int
    length: int
    deltas: bool
    encode: Callable[[MeasurementOutput], list[bytes]]


class OutputStreams:
    """What a VN-100 measures and sends by itself.

    Parameters
    ----------
    tape : the signals it feels.
    memory : its registers; `changed` is to be called when one was written.

    Attributes
    ----------
    tick : of the next loop.
    estimator : the onboard filter.
    disturbed : bits of VpeStatus that the host has set.
    """

    def __init__(self, tape: SensorModel, memory: RegisterFile) -> None:
        self._tape, self._memory = tape, memory
        self.tick = 0
        self._since_tick, self._since = 0, self._integrals(np.array([0]))[0]
        self.start()

    def start(self) -> None:
        """Everything that a power-up or a reset begins with."""
        rotation = np.array([float(text) for text in self._memory.read(ROTATION)])
        self._rotation: Floats = rotation.reshape(3, 3)
        bias = np.array([float(text) for text in self._memory.read(STARTUP_BIAS)])
        self.estimator = AttitudeEstimator(bias, self.tick)
        self._boot_tick, self._jump_ns = self.tick, 0
        self._paused: set[int] = set()
        self.disturbed = 0
        self.count_from(0, 0, 0)
        self.changed()

    def changed(self) -> None:
        """A register was written: what is derived from them is derived anew."""
        iron = self._memory.read(IRON_CONTROL)
        self._setup = OutputConfiguration.of(
            self._memory.read, self._rotation, iron[0] == "1" and iron[1] == "3"
        )
        self._streams = self._make_streams(self._memory, self._memory.port)

    def pause(self, port: int, paused: bool) -> None:
        """Stop or go on with all streams of a port."""
        (self._paused.add if paused else self._paused.discard)(port)

    def jump(self, seconds: float) -> None:
        """The sensor's clock leaps."""
        self._jump_ns += round(seconds * 1e6) * 1000

    def count_from(self, sync_in: int, sync_in_time: int, sync_out: int) -> None:
        """Set the counters of the synchronisation pins."""
        self._sync_tick, self._sync_counts = self.tick, (sync_in, sync_in_time, sync_out)

    # ------------------------------------------------------------------ streams

    def _make_streams(self, memory: RegisterFile, port: int) -> list[OutputStream]:
        """Streams of one port, ASCII first."""
        streams = []
        kind, rate = int(memory.read(OUTPUT_TYPE, port)[0]), int(memory.read(OUTPUT_RATE, port)[0])
        if kind and rate:
            message = OUTPUT_TYPES[kind]
            length = len(self._sentences(message, None)[0])
            encode = lambda readout: self._sentences(message, readout)  # noqa: E731
            streams.append(OutputStream(LOOP_RATE // rate, length, message == "VNDTV", encode))
        for number in BINARY_OUTPUTS:
            mode, divisor, *words = memory.read(number)
            if int(mode) & port and int(divisor) and int(words[0], 16):
                streams.append(_binary_stream(binary_layout(words), int(divisor)))
        return streams

    def load(self, memory: RegisterFile | None = None, port: int | None = None) -> float:
        """Bytes per second that the streams of a port need, with another memory than its own perhaps."""
        streams = self._make_streams(memory or self._memory, port or self._memory.port)
        return sum(stream.length * LOOP_RATE / stream.divisor for stream in streams)

    def next_tick(self) -> int:
        """Tick of the next message, if there are no commands; far off without streams."""
        far = self.tick + LOOP_RATE
        if self._memory.port in self._paused:
            return far
        return min((-(-self.tick // s.divisor) * s.divisor for s in self._streams), default=far)

    def _sentences(self, message: str, readout: MeasurementOutput | None) -> list[bytes]:
        """Sentences of a readout, or one of zeros."""
        protocol = self._memory.parse(PROTOCOL)
        check: Check = "crc" if protocol["serial_checksum"] == 3 else "xor"
        columns = self.columns(message, readout)
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

    def columns(self, message: str, readout: MeasurementOutput | None) -> Floats:
        """Numbers of a message in its own units, (n, f); zeros without a readout."""
        quantities = ascii.MEASUREMENTS[message]
        if readout is None:
            return np.zeros((1, sum(WIDTHS[name] for name in quantities)))
        names = [_LINEAR[message] if name == "linaccel" else name for name in quantities]
        return np.concatenate([readout[name] for name in names], axis=1)

    def packet(self, words: Sequence[str]) -> bytes:
        """Binary packet of the present, with the groups and words of registers 75-77."""
        stream = _binary_stream(binary_layout(words), 1)
        return stream.encode(self.now(stream.deltas))[0]

    # ------------------------------------------------------------------ time

    def advance(self, upto: int, silent: bool = False) -> list[Message]:
        """Run to tick `upto`; the messages made on the way in their order, none of them when `silent`."""
        messages: list[Message] = []
        while self.tick < upto:
            stop = min(upto, self._tape.end)
            if stop > self.tick:
                messages += self._block(self.tick, stop, silent)
                self.tick = stop
            else:
                self._tape.extend(max(LOOP_RATE, min(upto - self.tick, 1 << 14)))
        return messages

    def _block(self, first: int, stop: int, silent: bool) -> list[Message]:
        self.estimator.follow(self._tape, stop)
        if silent or self._memory.port in self._paused:
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

    def _readout(self, ticks: Ints, since: Floats | None) -> MeasurementOutput:
        age = (ticks - self._boot_tick + STARTUP_TICKS) / LOOP_RATE + self._tape.jitter(ticks)
        stamps = np.rint(age * 1e6).astype(np.int64) * 1000 + self._jump_ns
        sync = self._memory.parse(SYNC_CONTROL)
        # Pulses at the start of the loop, when it is ready, or with the attitude at half its rate.
        pace = {1: 1, 2: 1, 3: 2}.get(int(sync["out_mode"]), 0) * (int(sync["out_skip"]) + 1)
        pulses = (ticks // pace - (self._sync_tick - 1) // pace) if pace else np.zeros(len(ticks), np.int64)
        counts: Mapping[str, Floats | Ints] = {
            "timeStartup": np.maximum(stamps, 0)[:, None],
            "vpeStatus": np.full((len(ticks), 1), self.disturbed, np.int64),
            "syncInCnt": np.full((len(ticks), 1), self._sync_counts[0], np.int64),
            "syncInTime": np.full((len(ticks), 1), self._sync_counts[1], np.int64),
            "syncOutCnt": (pulses + self._sync_counts[2])[:, None],
        }
        return MeasurementOutput(self._tape, self._setup, self.estimator, ticks, since, counts)

    def now(self, deltas: bool = False) -> MeasurementOutput:
        """Readings of the newest tick; with `deltas`, their increments start anew."""
        ticks = np.array([self.tick - 1])
        return self._readout(ticks, self._increments(ticks) if deltas else None)


def _binary_stream(layout: binary.BinaryLayout, divisor: int) -> OutputStream:
    names = [name.partition(".")[2] for name in layout.fields]

    def encode(readout: MeasurementOutput) -> list[bytes]:
        values = {name: readout[name] for name in names if readout.has(name)}
        data = layout.encode(values or {"timeStartup": readout["timeStartup"]})
        return [data[at : at + layout.length] for at in range(0, len(data), layout.length)]

    return OutputStream(divisor, layout.length, any(name in _INCREMENTS for name in names), encode)


def binary_layout(words: Sequence[str]) -> binary.BinaryLayout:
    """Layout of the group byte and field words of registers 75-77.

    Raises
    ------
    RegisterError
        A field that no VN-100 sends.
    """
    groups = [group for group in range(1, 8) if int(words[0], 16) >> (group - 1) & 1]
    try:
        return binary.BinaryLayout.of({g: int(word, 16) for g, word in zip(groups, words[1:], strict=True)})
    except ValueError as error:
        raise RegisterError(BAD_PARAMETER, str(error)) from None
