"""Decoder of an Xsens MTi: bytes in any chunks to samples and replies, without I/O and clock.

A message begins at ``FA FF``; every other byte between messages is discarded. If the checksum is wrong, one byte is
discarded and the search continues after it. Then fed = message_bytes + discarded + pending.

Delta angles and delta velocities are integrals over the interval of the output, so a sample is one of them divided by
that interval. It follows from SampleTimeFine and the packet counter of two messages. Rate of turn and acceleration are
point samples. A message with both has the deltas as samples.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import TypeAlias

import numpy as np

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
from imumon.samples import ACCEL, GYRO, Clock, Kind, SampleBlock, Stream
from imumon.timebase.interval import CLOCK_SLACK_S

COUNTER, TICKS = 1 << 16, 1 << 32
"""Periods of the packet counter and of SampleTimeFine."""
CHANNELS = (*GYRO, *ACCEL, "temperature")
_Row: TypeAlias = "tuple[Stream, list[float], int, int, bool | None]"
"""Stream, values, time in ns, samples lost before it, and saturation of a sample; None: unknown."""


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


class MtDecoder:
    """Feed bytes, get samples and messages; see `imumon.devices.base.RawDecoder`."""

    def __init__(self) -> None:
        self.fed = self.messages = self.message_bytes = self.discarded = self.bad_checksums = 0
        self._buffer = b""
        self._count: int | None = None  # packet counter of the last sample
        self._ticks: int | None = None  # of the last sample, continued over wraps
        self._raw_ticks = 0
        self._interval_s: float | None = None
        self._valid_before = False

    @property
    def pending(self) -> int:
        """Bytes kept until more bytes decide whether they are a message."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[SampleBlock | Message]:
        """Return the items that `data` completes."""
        self.fed += len(data)
        return self._scan(self._buffer + data, final=False)

    def finish(self) -> list[SampleBlock | Message]:
        """Settle the pending bytes, at the end of the stream."""
        items = self._scan(self._buffer, final=True)
        self._count = None
        return items

    def _scan(self, data: bytes, *, final: bool) -> list[SampleBlock | Message]:
        items: list[SampleBlock | Message] = []
        rows: list[_Row] = []
        at, end = 0, len(data)
        while at < end:
            begin = data.find(PREAMBLE[:1], at)
            begin = end if begin < 0 else begin
            self.discarded += begin - at
            at = begin
            found = size_at(data, at) if at < end else (0, 0)
            if at == end or ((found is None or at + found[0] > end) and not final):
                break
            size, header = found or (0, 0)
            size = 0 if at + size > end else size
            if not size or sum(data[at + 1 : at + size]) & 0xFF:
                self.bad_checksums += self._valid_before and size > 0
                self.discarded += 1
                at += 1
                continue
            self._valid_before = True
            message = Message(data[at + 2], data[at + header : at + size - 1])
            at += size
            self.messages += 1
            self.message_bytes += size
            if message.id != MessageId.DATA:
                items.append(message)
            elif (row := self._sample(message.data)) is not None:
                rows.append(row)
        self._buffer = data[at:]
        return [*items, *_blocks(rows)]

    def _sample(self, data: bytes) -> _Row | None:
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
        stream = stream_of("deltas" if deltas else "unknown", "none" if self._ticks is None else "startup")
        status = found.get(DataId.STATUS_WORD)
        clipped = None if status is None else bool(int(status[0]) & CLIPPED)
        time_ns = round((self._ticks or 0) * TICK_S * 1e9)
        return stream, values, time_ns, lost, clipped

    def _step(self, found: Mapping[int, tuple[float, ...]]) -> tuple[int, float | None]:
        """Note counter and time of a sample; return how many were lost before it, and the interval, s."""
        count = int(found[DataId.PACKET_COUNTER][0]) if DataId.PACKET_COUNTER in found else None
        packets = (count - self._count) % COUNTER if count is not None and self._count is not None else None
        self._count = count
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


def _blocks(rows: Sequence[_Row]) -> list[SampleBlock]:
    """Return consecutive samples of one stream as blocks."""
    blocks = []
    for _, same in groupby(rows, lambda row: (row[0], row[4] is None)):
        (stream, *_), values, times, lost, (clipped, *more) = zip(*same, strict=True)
        time_ns = None if stream.clock == "none" else np.array(times, np.int64)
        flags = None if clipped is None else np.array([clipped, *more], bool)
        blocks.append(SampleBlock(stream, np.array(values), time_ns, np.array(lost, np.int64), flags))
    return blocks
