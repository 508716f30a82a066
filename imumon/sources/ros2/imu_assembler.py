"""Blocks of samples from the messages of an IMU topic, and of further topics of the same device.

The time of a sample is ``header.stamp``, which the driver sets; `LiveStamps` handles stamps of any quality. The
sequence number of the publisher shows which messages were lost on the way: the other missing samples were never
published. Samples of a separate accelerometer or magnetometer topic are paired by their stamps, within half an
interval; a topic that has none for most of them, such as one of another rate, is left out. A temperature holds until
the next one.

Counts add up: a message is a sample, waits, or is counted as invalid or of another publisher.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from imumon.grid.live_stamps import LiveStamps
from imumon.model.ledger import Ledger
from imumon.model.samples import (
    ACCEL,
    GYRO,
    LONGEST_NS,
    MAG,
    ChannelName,
    Floats,
    Ints,
    Item,
    SampleBlock,
    Stream,
    channel_names,
)
from imumon.ros2.node import QUEUE_MESSAGES, Received
from imumon.ros2.ros_messages import (
    IMU,
    MAGNETIC_FIELD,
    TEMPERATURE,
    CdrError,
    decode,
    imu_message,
    stamp_ns,
)
from imumon.ros2.topic_url import TopicUrl

GAUSS = 1e4
"""Gauss in a tesla, the unit of a MagneticField."""
USED_SHARE = 0.9
"""Share of the first rows that must have a quantity for it to be used."""
PARTNER_S = 1.0
"""s that a row waits for its partner in another topic."""
FIRST_S = 12.0
"""s that the first rows wait for a further topic, whose messages may be rare."""
SILENT_S = 0.5
"""s without a message of the publisher that is followed, after which another one may take its place."""
SILENT_MESSAGES = 3.0
"""Intervals of its messages that are needed as well, for slow topics."""
MOST_LOST = 1_000_000
"""Messages; a larger step of the sequence number is a new count."""

NONE = (math.nan,) * 3
SENSORS = (("gyro", GYRO), ("accel", ACCEL), ("mag", MAG), ("temperature", channel_names(["temperature"])))
"""Groups of columns of a row, in order."""
TYPES = {"accel": IMU, "mag": MAGNETIC_FIELD, "temperature": TEMPERATURE}
"""Type of each further topic."""


class PartnerTopic:
    """Samples of another topic, to be paired by their stamps."""

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self.stamps: Ints = np.empty(0, np.int64)
        self.values: Floats = np.empty((0, 3))

    def add(self, stamps: Sequence[int], values: Sequence[Sequence[float]]) -> None:
        if stamps:  # as many as a subscription holds: older ones cannot have a partner any more
            self.stamps = np.append(self.stamps, np.array(stamps, np.int64))[-QUEUE_MESSAGES:]
            self.values = np.append(self.values, np.array(values).reshape(-1, 3), axis=0)[-QUEUE_MESSAGES:]

    def match(self, stamps: Ints, interval: float | None) -> Floats:
        """Return (n, 3) the values whose stamps are nearest, within half an interval, ns; NaN: there are none."""
        if interval is None or not len(self.stamps):
            return np.full((len(stamps), 3), np.nan)
        order = np.argsort(self.stamps, kind="stable")  # another node may publish out of order
        known = self.stamps[order]
        after = np.clip(np.searchsorted(known, stamps), min(1, len(known) - 1), len(known) - 1)
        nearest = after - (stamps - known[after - 1] <= known[after] - stamps)
        matched = self.values[order[nearest]].copy()
        matched[np.abs(known[nearest] - stamps) > 0.5 * interval] = np.nan
        return matched


def mean_interval(stamps: Ints) -> float | None:
    """Return the mean step of stamps, ns; None: unknown."""
    return float(np.ptp(stamps)) / (len(stamps) - 1) if len(stamps) > 1 and np.ptp(stamps) > 0 else None


class ImuAssembler:
    """Assembles the messages of one connection to blocks of samples.

    Parameters
    ----------
    before : of the connection before; its stream continues, so that a record can.

    Attributes
    ----------
    stream : of the blocks; None until it is known.
    other_sender : of the invalid ones, messages of another publisher.
    other_heard_s : s of the host clock, when the last of them arrived.
    remarks : what is unknown or left out, one line each.
    messages, bytes : received, of all topics.
    invalid, invalid_bytes : of these, messages without a usable sample, or of another publisher.
    lost, losses : messages lost on the way, and times that some were.
    """

    def __init__(self, url: TopicUrl, before: ImuAssembler | None = None) -> None:
        self.stream: Stream | None = None
        self.remarks: list[str] = []
        self.other_sender, self.other_heard_s = 0, -math.inf
        self._ledger = Ledger()
        self.messages = self.bytes = self.invalid = self.invalid_bytes = self.lost = self.losses = 0
        self._url = url
        self._live = LiveStamps()
        self._partners = {
            name: PartnerTopic(topic) for name in ("accel", "mag") if (topic := getattr(url, name))
        }
        self._temperature = math.nan
        self._rows: list[tuple[float, ...]] = []  # wait for their partners: gyro, accel, temperature
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
        self._recent: Ints = np.empty(0, np.int64)  # stamps, which show the interval
        if before is not None and before.stream is not None:
            self.stream, self._columns = before.stream, before._columns
            self._partners = {name: PartnerTopic(partner.topic) for name, partner in before._partners.items()}
            self._temperature = before._temperature

    @property
    def ledger(self) -> dict[str, int]:
        """What became of all messages of the publisher but those that are samples, by reason."""
        return self._ledger.counts(
            pending=len(self._rows) + (0 if self._values is None else len(self._values))
        )

    # ------------------------------------------------------------------ messages

    def add(
        self, messages: Sequence[Received], others: Mapping[str, Sequence[Received]], now_ns: int
    ) -> list[Item]:
        """Add messages; return the blocks and notices that they complete.

        Parameters
        ----------
        others : messages of the further topics by parameter of the URL.
        now_ns : ns of the host clock, when they arrived.
        """
        items: list[Item] = []
        for name, received in others.items():
            self._add_others(name, received)
        now_s = now_ns * 1e-9
        # a busy host takes messages late: a publisher with one among them was not silent
        here = any(message.publisher == self._publisher for message in messages)
        for message in messages:
            self._add(message, now_s, here, items)
        return items + self._blocks(final=False)

    def finish(self) -> list[Item]:
        """Return what still waits, at the end of the stream."""
        return self._blocks(final=True)

    def _add(self, message: Received, now_s: float, here: bool, items: list[Item]) -> None:
        """Add a message of the main topic as a row; `here`: one of the publisher that is followed arrived with it."""
        self.messages += 1
        self.bytes += len(message.payload)
        if not self._is_followed(message, now_s, here):
            if not self.other_sender:
                self.remarks.append(f"several nodes publish {self._url.topic}: only the first is used")
            self.other_sender, self.other_heard_s = self.other_sender + 1, now_s
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

    def _add_others(self, name: str, received: Sequence[Received]) -> None:
        """Add messages of a further topic."""
        stamps: list[int] = []
        values: list[Sequence[float]] = []
        for message in received:
            self.messages += 1
            self.bytes += len(message.payload)
            self._ledger.receive()
            try:
                stamp, sample = _further_sample(name, message.payload)
            except CdrError:
                self._reject(message, "damaged")
                continue
            if sample is None or not all(map(math.isfinite, sample)):
                self._reject(message, "not_finite")
                continue
            self._ledger.add("part")
            if name == "temperature":
                self._temperature = sample[0]
            else:
                stamps.append(stamp)
                values.append(sample)
        if name in self._partners:
            self._partners[name].add(stamps, values)

    # ------------------------------------------------------------------ blocks

    def _blocks(self, *, final: bool) -> list[Item]:
        """Return the rows whose partners and times are known, as a block."""
        times = np.array(self._times, np.int64).reshape(-1, 4)
        ready = len(times) if final else self._ready(times)
        values = np.array(self._rows[:ready]).reshape(ready, 7)
        self._recent = np.append(self._recent, times[:ready, 0])[-QUEUE_MESSAGES:]
        interval = mean_interval(self._recent)
        pairs = [
            self._partners[name].match(times[:ready, 0], interval)
            if name in self._partners
            else (values[:, 3:6] if name == "accel" else np.full((ready, 3), np.nan))
            for name in ("accel", "mag")
        ]
        values = np.concatenate([values[:, :3], *pairs, values[:, 6:]], axis=1)
        del self._rows[:ready], self._times[:ready]
        self._values = values if self._values is None else np.concatenate([self._values, values])
        remark = self._live.remark
        placed = self._live.place(*times[:ready].T, final=final).times
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

    def _ready(self, times: Ints) -> int:
        """Return how many of the oldest rows need not wait for their partners, nor for the first temperature."""
        ready = len(times)
        for partner in self._partners.values():
            newest = int(partner.stamps.max()) if len(partner.stamps) else 0
            later = np.flatnonzero(times[:, 0] > newest)
            ready = min(ready, int(later[0])) if len(later) else ready
        if self._url.temperature and self.stream is None and math.isnan(self._temperature):
            ready = 0
        if not len(times) or ready == len(times):
            return ready
        # a temperature may come once in some seconds; partners come at once
        limit_s = PARTNER_S if self.stream is not None or not math.isnan(self._temperature) else FIRST_S
        return max(ready, int((times[:, 2] < times[-1, 2] - limit_s * 1e9).sum()))

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
            topic = getattr(self._url, name, "")
            if known.mean() < USED_SHARE:
                if topic:
                    self._leave_out(name, topic)
            elif name != "temperature" and not part[known].any():
                self.remarks.append(f"{name} is zero in all messages of {topic or self._url.topic}: left out")
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

    def _leave_out(self, name: str, topic: str) -> None:
        """Note that a further topic is not used."""
        partner = self._partners.pop(name, None)
        heard = partner is not None and len(partner.stamps)
        why = f"its stamps do not match those of {self._url.topic}" if heard else "no message arrives"
        self.remarks.append(f"{topic} is left out: {why}")


def _further_sample(name: str, payload: bytes) -> tuple[int, Sequence[float] | None]:
    """Return stamp and values of a message of a further topic, in the units of channels; None: no estimate."""
    if name == "accel":
        stamp, _, accel = imu_message(payload)
        return stamp, accel
    if name == "mag":
        message = decode(MAGNETIC_FIELD, payload)
        field = message.magnetic_field
        return stamp_ns(message), [GAUSS * tesla for tesla in (field.x, field.y, field.z)]
    message = decode(TEMPERATURE, payload)
    return stamp_ns(message), [message.temperature]
