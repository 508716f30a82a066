"""Decoder of an Xsens MTi: bytes in any chunks to samples and replies, without I/O and clock.

Delta angles and delta velocities are integrals over the interval of the output, so a sample is one of them divided by
that interval. It follows from SampleTimeFine and the packet counter of two messages. Rate of turn and acceleration are
point samples. A message with both has the deltas as samples.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

import numpy as np

from imumon.grid.interval import CLOCK_SLACK_S
from imumon.model.samples import (
    ACCEL,
    GYRO,
    TEMPERATURE,
    Bools,
    Clock,
    Ints,
    Kind,
    SampleBlock,
    Stream,
)
from imumon.sources.frame_decoder import FrameDecoder
from imumon.sources.xsens.mt_messages import (
    CLIPPED,
    PREAMBLE,
    TICK_S,
    DataId,
    Message,
    MessageId,
    fields,
    size_at,
)

COUNTER, TICKS = 1 << 16, 1 << 32
"""Periods of the packet counter and of SampleTimeFine."""
CHANNELS = (*GYRO, *ACCEL, TEMPERATURE)
DELTAS = (DataId.DELTA_Q, DataId.DELTA_V)
POINTS = (DataId.RATE_OF_TURN, DataId.ACCELERATION)
"""Fields of a sample: increments over the interval of the output, or values at one time."""


def stream_of(kind: Kind, clock: Clock) -> Stream:
    """Return the stream of a kind of samples."""
    source = "DeltaQ, DeltaV" if kind == "deltas" else "RateOfTurn, Acceleration"
    return Stream(kind, CHANNELS, source=f"MTData2 {source}", clock=clock)


LARGEST = 1e6
"""rad/s, m/s^2, degC: no sensor measures so much, and the square of a float near its end is infinite."""


def rotation(q: Sequence[float]) -> tuple[float, float, float]:
    """Return the rotation vector of a unit quaternion, rad.

    >>> round(rotation((1.0, 0.0, 5e-4, 0.0))[1], 9)
    0.001
    """
    sine = math.hypot(*q[1:])
    # 2 for the small angles of one interval, where the quotient is 0 / 0
    factor = 2.0 if sine < 1e-9 else 2.0 * math.atan2(sine, abs(q[0])) / sine
    factor = -factor if q[0] < 0.0 else factor  # q and -q are one rotation: the shorter way
    return factor * q[1], factor * q[2], factor * q[3]


def mean_rates(numbers: Mapping[int, tuple[float, ...]], interval_s: float) -> list[float]:
    """Return (6,) rad/s and m/s^2, the mean over the interval, from its increments."""
    increments = (*rotation(numbers[DataId.DELTA_Q]), *numbers[DataId.DELTA_V])
    return [increment / interval_s for increment in increments]


def clipped_sensors(numbers: Mapping[int, tuple[float, ...]]) -> Bools | None:
    """Return (1, sensors) whether each was at the end of its range, in the order of `CHANNELS`; None: unknown."""
    status = numbers.get(DataId.STATUS_WORD)
    if status is None:
        return None
    sensors = dict.fromkeys(name.sensor for name in CHANNELS)
    return np.array([[int(status[0]) & CLIPPED.get(sensor, 0) != 0 for sensor in sensors]])


class MtDecoder(FrameDecoder[Message]):
    """Feed bytes, get samples and messages; see `imumon.sources.frame_decoder.FrameDecoder`."""

    start = re.compile(PREAMBLE[:1])

    def __init__(self) -> None:
        super().__init__()
        # a message says neither its interval nor how many were lost: both follow from the one before
        self._last_count: int | None = None  # packet counter of the last sample
        self._ticks: int | None = None  # of the last sample, continued over wraps
        self._raw_ticks = 0
        self._interval_s: float | None = None

    def finish(self) -> list[SampleBlock | Message]:
        """Settle the pending bytes, at the end of the stream."""
        items = super().finish()
        self._last_count = None
        return items

    def _read(self, data: bytes, begin: int) -> int | None:
        frame = size_at(data, begin)
        if frame is None or begin + frame[0] > len(data):
            return None
        size, header = frame
        if not size or sum(data[begin + 1 : begin + size]) & 0xFF:
            # before the first valid message, FA FF may be in the middle of one
            if self.messages > 0 and size > 0:
                self._count_damaged()
            return 0
        self._count(size)
        message = Message(data[begin + 2], data[begin + header : begin + size - 1])
        if message.id != MessageId.DATA:
            self.leave_out("other_message")
            self._items.append(message)
            return size
        sample = self._sample(message.data)
        if isinstance(sample, SampleBlock):
            self._items.append(sample)
        else:
            self.leave_out(sample)
        return size

    def _sample(self, data: bytes) -> SampleBlock | str:
        """Return the sample of MTData2, or why it is none, as in the ledger."""
        try:
            numbers = fields(data)
        except ValueError:
            return "damaged"
        deltas = numbers.keys() >= {*DELTAS}
        if not deltas and not numbers.keys() >= {*POINTS}:
            return "other_message"
        names = DELTAS if deltas else POINTS
        # a checksum says that the sensor has sent it: a filter that has failed in it sends NaN. The counters are not
        # noted, so that the next sample shows this one as lost.
        if not all(abs(number) < LARGEST for name in names for number in numbers[name]):
            self.bad_checksums += 1
            return "not_finite"
        lost, interval_s = self._step(numbers)
        if deltas:
            if interval_s is None:
                return "start"  # its interval is not known
            values = mean_rates(numbers, interval_s)
        else:
            values = [*numbers[DataId.RATE_OF_TURN], *numbers[DataId.ACCELERATION]]
        temperature = numbers.get(DataId.TEMPERATURE, (math.nan,))[0]
        values.append(temperature if abs(temperature) < LARGEST else math.nan)
        time_ns: Ints | None = None
        clock: Clock = "none"
        if self._ticks is not None:
            time_ns, clock = np.array([round(self._ticks * TICK_S * 1e9)]), "startup"
        stream = stream_of("deltas" if deltas else "unknown", clock)
        return SampleBlock(stream, np.array([values]), time_ns, np.array([lost]), clipped_sensors(numbers))

    def _step(self, numbers: Mapping[int, tuple[float, ...]]) -> tuple[int, float | None]:
        """Note counter and time of a sample; return how many were lost before it, and the interval, s."""
        count = int(numbers[DataId.PACKET_COUNTER][0]) if DataId.PACKET_COUNTER in numbers else None
        packets = (
            (count - self._last_count) % COUNTER
            if count is not None and self._last_count is not None
            else None
        )
        self._last_count = count
        if DataId.SAMPLE_TIME_FINE in numbers:
            # 32 bits of 0.1 ms wrap after five days. A time that goes back has wrapped if the step over it is short;
            # else the sensor was restarted, with its packet counter: how many are missing is unknown.
            raw = int(numbers[DataId.SAMPLE_TIME_FINE][0])
            forward = (raw - self._raw_ticks) % TICKS
            if self._ticks is None or (raw < self._raw_ticks and forward * TICK_S > CLOCK_SLACK_S):
                self._ticks, packets = raw, None
            else:
                self._ticks += forward
                if packets == 1:  # over a gap, the time is that of several intervals
                    self._interval_s = forward * TICK_S or self._interval_s
            self._raw_ticks = raw
        return max(0, packets - 1) if packets else 0, self._interval_s
