"""Blocks of samples from the messages of an IMU topic, and the temperature of the same device from another topic.

The time of a sample is ``header.stamp``, which the driver sets; `LiveStamps` handles stamps of any quality. The
sequence number of the publisher shows which messages were lost on the way: the other missing samples were never
published. A temperature holds until the next one.

Counts add up: a message is a sample, waits, or is counted as invalid or of another publisher.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imumon.grid.live_stamps import LiveStamps
from imumon.model.ledger import Ledger
from imumon.model.samples import (
    ACCEL,
    GYRO,
    LONGEST_NS,
    ChannelName,
    Floats,
    Ints,
    Item,
    SampleBlock,
    Stream,
    channel_names,
)
from imumon.ros2.node import Received
from imumon.ros2.ros_messages import (
    IMU,
    TEMPERATURE,
    CdrError,
    decode,
    imu_message,
)
from imumon.ros2.topic_url import TopicUrl

USED_SHARE = 0.9
"""Share of the first rows that must have a quantity for it to be used."""
FIRST_S = 12.0
"""s that the first rows wait for the first temperature: its messages may be rare."""
SILENT_S = 0.5
"""s without a message of the publisher that is followed, after which another one may take its place."""
SILENT_MESSAGES = 3.0
"""Intervals of its messages that are needed as well, for slow topics."""
MOST_LOST = 1_000_000
"""Messages; a larger step of the sequence number is a new count."""

NONE = (math.nan,) * 3
SENSORS = (("gyro", GYRO), ("accel", ACCEL), ("temperature", channel_names(["temperature"])))
"""Groups of columns of a row, in order."""


class ImuAssembler:
    """Assembles the messages of one connection to blocks of samples.

    Parameters
    ----------
    before : of the connection before; its stream continues, so that a record can.

    Attributes
    ----------
    stream : of the blocks; None until it is known.
    other_sender : of the invalid ones, messages of another publisher.
    remarks : what is unknown or left out, one line each.
    messages, bytes : received, of all topics.
    invalid, invalid_bytes : of these, messages without a usable sample, or of another publisher.
    lost, losses : messages lost on the way, and times that some were.
    """

    def __init__(self, url: TopicUrl, before: ImuAssembler | None = None) -> None:
        self.stream: Stream | None = None
        self.remarks: list[str] = []
        self.other_sender = 0
        self._ledger = Ledger()
        self.messages = self.bytes = self.invalid = self.invalid_bytes = self.lost = self.losses = 0
        self._url = url
        self._live = LiveStamps()
        self._temperature = math.nan
        self._rows: list[tuple[float, ...]] = []  # wait for the first temperature: gyro, accel, temperature
        self._times: list[
            tuple[int, int, int, int]
        ] = []  # of these: stamp, publication, arrival, lost before
        self._values: Floats | None = None  # rows that wait for their times
        self._columns: list[int] = []
        self._publisher: bytes | None = None
        self._heard_s = 0.0  # when the publisher that is followed was heard last
        self._interval_s = 0.0  # between its messages, roughly
        self._sequence: int | None = None
        self._lost_before = 0  # of the next row
        if before is not None and before.stream is not None:
            self.stream, self._columns = before.stream, before._columns
            self._temperature = before._temperature

    @property
    def ledger(self) -> dict[str, int]:
        """What became of all messages of the publisher but those that are samples, by reason."""
        return self._ledger.counts(
            pending=len(self._rows) + (0 if self._values is None else len(self._values))
        )

    # ------------------------------------------------------------------ messages

    def add(self, messages: Sequence[Received], temperatures: Sequence[Received], now_ns: int) -> list[Item]:
        """Add messages; return the blocks that they complete.

        Parameters
        ----------
        temperatures : messages of the topic of the temperature.
        now_ns : ns of the host clock, when they arrived.
        """
        self._add_temperatures(temperatures)
        now_s = now_ns * 1e-9
        # a busy host takes messages late: a publisher with one among them was not silent
        here = any(message.publisher == self._publisher for message in messages)
        for message in messages:
            self._add(message, now_s, here)
        return self._blocks(final=False)

    def finish(self) -> list[Item]:
        """Return what still waits, at the end of the stream."""
        return self._blocks(final=True)

    def _add(self, message: Received, now_s: float, here: bool) -> None:
        """Add a message of the main topic as a row; `here`: one of the publisher that is followed arrived with it."""
        self.messages += 1
        self.bytes += len(message.payload)
        if not self._is_followed(message, now_s, here):
            if not self.other_sender:
                self.remarks.append(f"several nodes publish {self._url.topic}: only the first is used")
            self.other_sender += 1
            self._reject(message)
            return
        self._ledger.receive()
        if message.sequence is not None:
            if message.sequence == self._sequence:  # the same message again
                self._reject(message, "repeated")
                return
            self._count_lost(message.sequence)
        try:
            stamp, gyro, accel = imu_message(message.payload)
        except CdrError:
            self._reject(message, "damaged")
            return
        numbers = (
            *(gyro or NONE),
            *(accel or NONE),
            self._temperature,
        )  # None: covariance[0] is -1, no estimate
        arrived = round(now_s * 1e9)
        longest = int(LONGEST_NS)  # a publisher may send any time
        published = arrived if message.source_ns is None else message.source_ns
        self._rows.append(numbers)
        self._times.append((stamp, max(-longest, min(published, longest)), arrived, self._lost_before))
        self._lost_before = 0

    def _is_followed(self, message: Received, now_s: float, here: bool) -> bool:
        """Return whether a message is of the publisher that is followed: the first, until it is silent."""
        if message.publisher != self._publisher:
            silent = now_s - self._heard_s > max(SILENT_S, SILENT_MESSAGES * self._interval_s)
            if self._publisher is not None and (here or not silent):
                return False
            self._publisher, self._sequence = message.publisher, None
        elif now_s > self._heard_s:  # messages of one batch have one time of arrival
            self._interval_s += 0.1 * (now_s - self._heard_s - self._interval_s)
        self._heard_s = now_s
        return True

    def _count_lost(self, sequence: int) -> None:
        """Count the messages lost before one; a number that falls is a new count."""
        if self._sequence is not None and 1 < sequence - self._sequence <= MOST_LOST:
            # counted only: the stamps show how long the gap is, also where the driver published nothing
            lost = sequence - self._sequence - 1
            self._lost_before += lost
            self.lost += lost
            self.losses += 1
        self._sequence = sequence

    def _reject(self, message: Received, reason: str | None = None) -> None:
        """Count a message without a usable sample; the reason is that of the ledger, None: of another publisher."""
        if reason is not None:
            self._ledger.add(reason)
        self.invalid += 1
        self.invalid_bytes += len(message.payload)

    def _add_temperatures(self, received: Sequence[Received]) -> None:
        for message in received:
            self.messages += 1
            self.bytes += len(message.payload)
            self._ledger.receive()
            try:
                temperature = decode(TEMPERATURE, message.payload).temperature
            except CdrError:
                self._reject(message, "damaged")
                continue
            if not math.isfinite(temperature):
                self._reject(message, "not_finite")
                continue
            self._ledger.add("part")
            self._temperature = temperature

    # ------------------------------------------------------------------ blocks

    def _blocks(self, *, final: bool) -> list[Item]:
        """Return the rows whose times are known, as a block."""
        times = np.array(self._times, np.int64).reshape(-1, 4)
        if not final and self._waits(times):
            return []
        values = np.array(self._rows).reshape(len(times), 7)
        self._rows.clear()
        self._times.clear()
        self._values = values if self._values is None else np.concatenate([self._values, values])
        remark = self._live.remark
        placed = self._live.place(*times.T, final=final).times
        if self._live.remark not in (None, remark):
            self.remarks.append(f"{self._url.topic}: {self._live.remark}")
        if not len(placed):
            return []
        if self.stream is None:  # once: a record cannot gain or lose a channel
            self._choose_columns(self._values)
        rows, self._values = self._values[: len(placed)], self._values[len(placed) :]
        if self.stream is None:
            self.invalid += len(rows)
            self._ledger.add("other_message", len(rows))
            return []
        rows = rows[:, self._columns]
        good = np.isfinite(rows).all(axis=1)
        self.invalid += int((~good).sum())
        self._ledger.add("not_finite", int((~good).sum()))
        rows, placed = rows[good], placed[good]
        return [SampleBlock(self.stream, rows, placed, np.zeros(len(rows), np.int64))] if len(rows) else []

    def _waits(self, times: Ints) -> bool:
        """Return whether the first rows wait for the first temperature."""
        if not self._url.temperature or self.stream is not None or not math.isnan(self._temperature):
            return False
        return not len(times) or bool(times[-1, 2] - times[0, 2] < FIRST_S * 1e9)

    def _choose_columns(self, values: Floats) -> None:
        """Decide which sensors the stream has, from its first rows."""
        channels: list[ChannelName] = []
        start = 0
        for name, columns in SENSORS:
            part = values[:, start : start + len(columns)]
            known = np.asarray(np.isfinite(part).all(axis=1))
            if name == "temperature" and known.any():  # the rows before the first one
                values[~known, start] = part[known][0]
                known[:] = True
            if known.mean() < USED_SHARE:
                if name == "temperature" and self._url.temperature:
                    self.remarks.append(f"{self._url.temperature} is left out: no message arrives")
            elif name != "temperature" and not part[known].any():
                self.remarks.append(f"{name} is zero in all messages of {self._url.topic}: left out")
            else:
                channels += columns
                self._columns += range(start, start + len(columns))
            start += len(columns)
        if any(name.startswith(("gyro", "accel")) for name in channels):
            self.stream = Stream("unknown", tuple(channels), f"{IMU} on {self._url.topic}", "startup")
        else:
            text = f"{self._url.topic} has neither angular velocity nor linear acceleration"
            self.remarks += [] if text in self.remarks else [text]
            self._columns = []
