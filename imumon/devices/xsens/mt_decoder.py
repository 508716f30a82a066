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

from imumon.devices.frame_decoder import FrameDecoder
from imumon.devices.xsens.mt_messages import (
    CLIPPED,
    PREAMBLE,
    TICK_S,
    DataId,
    Message,
    MessageId,
    fields,
    size_at,
)
from imumon.samples import ACCEL, GYRO, Clock, Ints, Kind, SampleBlock, Stream
from imumon.timebase.interval import CLOCK_SLACK_S

COUNTER, TICKS = 1 << 16, 1 << 32
"""Periods of the packet counter and of SampleTimeFine."""
CHANNELS = (*GYRO, *ACCEL, "temperature")


def stream_of(kind: Kind, clock: Clock) -> Stream:
    """Return the stream of a kind of samples."""
    source = "DeltaQ, DeltaV" if kind == "deltas" else "RateOfTurn, Acceleration"
    return Stream(kind, CHANNELS, source=f"MTData2 {source}", clock=clock)


def rotation(q: Sequence[float]) -> tuple[float, float, float]:
    """Return the rotation vector of a unit quaternion, rad.

    >>> round(rotation((1.0, 0.0, 5e-4, 0.0))[1], 9)
    0.001
    """
    sine = math.hypot(*q[1:])
    factor = 2.0 if sine < 1e-9 else 2.0 * math.atan2(sine, abs(q[0])) / sine
    factor = -factor if q[0] < 0.0 else factor
    return factor * q[1], factor * q[2], factor * q[3]


class MtDecoder(FrameDecoder[Message]):
    """Feed bytes, get samples and messages; see `imumon.devices.frame_decoder.FrameDecoder`."""

    start = re.compile(PREAMBLE[:1])

    def __init__(self) -> None:
        super().__init__()
        self._last_count: int | None = None  # packet counter of the last sample
        self._ticks: int | None = None  # of the last sample, continued over wraps
        self._raw_ticks = 0
        self._interval_s: float | None = None

    def finish(self) -> list[SampleBlock | Message]:
        """Settle the pending bytes, at the end of the stream."""
        items = super().finish()
        self._last_count = None
        return items

    def _read(self, data: bytes, at: int) -> int | None:
        found = size_at(data, at)
        if found is None or at + found[0] > len(data):
            return None
        size, header = found
        if not size or sum(data[at + 1 : at + size]) & 0xFF:
            self.bad_checksums += self.messages > 0 and size > 0
            return 0
        self._count(size)
        message = Message(data[at + 2], data[at + header : at + size - 1])
        item = self._sample(message.data) if message.id == MessageId.DATA else message
        self._items += [] if item is None else [item]
        return size

    def _sample(self, data: bytes) -> SampleBlock | None:
        """Return the sample of MTData2; None: it is none."""
        try:
            found = fields(data)
        except ValueError:
            return None
        deltas = DataId.DELTA_Q in found and DataId.DELTA_V in found
        if not deltas and not (DataId.RATE_OF_TURN in found and DataId.ACCELERATION in found):
            return None
        lost, interval_s = self._step(found)
        if deltas:
            if interval_s is None:
                return None  # the first one: its interval is not known
            values = [
                each / interval_s for each in (*rotation(found[DataId.DELTA_Q]), *found[DataId.DELTA_V])
            ]
        else:
            values = [*found[DataId.RATE_OF_TURN], *found[DataId.ACCELERATION]]
        values.append(found.get(DataId.TEMPERATURE, (math.nan,))[0])
        time_ns: Ints | None = None
        clock: Clock = "none"
        if self._ticks is not None:
            time_ns, clock = np.array([round(self._ticks * TICK_S * 1e9)]), "startup"
        status = found.get(DataId.STATUS_WORD)
        clipped = None if status is None else np.array([int(status[0]) & CLIPPED != 0])
        stream = stream_of("deltas" if deltas else "unknown", clock)
        return SampleBlock(stream, np.array([values]), time_ns, np.array([lost]), clipped)

    def _step(self, found: Mapping[int, tuple[float, ...]]) -> tuple[int, float | None]:
        """Note counter and time of a sample; return how many were lost before it, and the interval, s."""
        count = int(found[DataId.PACKET_COUNTER][0]) if DataId.PACKET_COUNTER in found else None
        packets = (
            (count - self._last_count) % COUNTER
            if count is not None and self._last_count is not None
            else None
        )
        self._last_count = count
        if DataId.SAMPLE_TIME_FINE in found:
            raw = int(found[DataId.SAMPLE_TIME_FINE][0])
            forward = (raw - self._raw_ticks) % TICKS
            if self._ticks is None or (raw < self._raw_ticks and forward * TICK_S > CLOCK_SLACK_S):
                self._ticks, packets = raw, None
            else:
                self._ticks += forward
                if packets == 1:
                    self._interval_s = forward * TICK_S or self._interval_s
            self._raw_ticks = raw
        return max(0, packets - 1) if packets else 0, self._interval_s
