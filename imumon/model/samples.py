"""Samples, and what else a device or a recording delivers: the types between sources and the pipeline.

A device or a recording produces items in the order in which they happened: `SampleBlock` (consecutive samples
of one `Stream`, in SI units, with what is known of their time), `Gap`, `Notice`, `RawBytes`, `DeviceInfo` and
`DeviceCounters`. Nothing downstream knows which device an item comes from: what differs between devices is
data in these types.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from imumon.model.ledger import ColumnUse

if TYPE_CHECKING:  # the parser of the command line needs the names of channels, not numpy
    import numpy as np
    import numpy.typing as npt

Kind: TypeAlias = Literal["deltas", "uncompensated", "compensated", "unknown"]
Clock: TypeAlias = Literal["startup", "counter", "dt", "none"]
Level: TypeAlias = Literal["debug", "info", "notice", "warning", "error"]

AXES = ("x", "y", "z")
INERTIAL = ("gyro", "accel")
"""Sensors whose mean is that of the motion, and that have grades."""
WITH_CURVE = (*INERTIAL, "mag")
"""Sensors with an Allan curve; the others have running statistics only."""
UNITS = {"gyro": "rad/s", "accel": "m/s^2", "mag": "gauss", "temperature": "degC", "pressure": "kPa"}
"""Unit of a channel by its sensor."""


class ChannelName(str):
    """Name of a channel. It is taken apart here, once, where a stream is declared or a message is read.

    Attributes
    ----------
    sensor, axis : that the channel belongs to; the axis is empty for a channel that is a sensor by itself.

    >>> name = ChannelName("gyro/x")
    >>> name, name.sensor, name.axis, ChannelName("temperature").axis
    ('gyro/x', 'gyro', 'x', '')
    """

    __slots__ = ("axis", "sensor")
    sensor: str
    axis: str

    def __new__(cls, text: str) -> ChannelName:
        name = super().__new__(cls, text)
        name.sensor, _, name.axis = text.partition("/")
        return name


def channel_names(texts: Iterable[str]) -> tuple[ChannelName, ...]:
    """Return the channels of a stream by their names."""
    return tuple(map(ChannelName, texts))


GYRO = channel_names(f"gyro/{axis}" for axis in AXES)
ACCEL = channel_names(f"accel/{axis}" for axis in AXES)
MAG = channel_names(f"mag/{axis}" for axis in AXES)
TEMPERATURE = ChannelName("temperature")
CHANNELS = (*GYRO, *ACCEL, *MAG, TEMPERATURE, ChannelName("pressure"))
"""Channels of a stream, in their order: those with an Allan curve first."""

SLOWEST_HZ, FASTEST_HZ = 1e-4, 1e5
"""Limits of a sample rate, Hz: no inertial sensor is slower or faster."""

LONGEST_NS = 4e18
"""ns of the longest time: the difference of two fits 64 bits."""

ALIASED = 1.001
"""Alias factor above which N counts as raised, beyond rounding errors."""


@dataclass(frozen=True, slots=True)
class Stream:
    """One of the streams on a line: which fields it takes and what they mean.

    Attributes
    ----------
    kind : what the numbers describe. ``deltas`` are true cluster averages (delta angle or velocity
        over its interval), the others are point samples behind the sensor's own filter; ``unknown`` are point
        samples of which nothing shows whether they are compensated.
    channels : names of the columns, in the order gyro, accel, mag, temperature, pressure.
    source : message it is taken from, for people: ``$VNYMR``, ``binary 01:0739``.
    clock : ``startup`` nanoseconds since the sensor's power-up; ``counter`` a count of the sensor's
        800 Hz loop or of microseconds, appended to a sentence; ``dt`` the length of each
        sample's own interval; ``none``: the rate must be known from elsewhere.
    interval_s : nominal sampling interval where the codec knows it (``dt``), else None.
    gyro, accel : kind of the gyroscope's and the accelerometer's numbers where it is not `kind`, which
        is then the worse of the two.
    tick_s : s, period of the device's sample clock if all its intervals are multiples of one; a measured
        interval near a multiple is that multiple. None: the device has no such clock.
    """

    kind: Kind
    channels: tuple[ChannelName, ...]
    source: str
    clock: Clock
    interval_s: float | None = None
    gyro: Kind | None = None
    accel: Kind | None = None
    tick_s: float | None = field(default=None, compare=False)  # two streams do not differ by it

    def __post_init__(self) -> None:
        object.__setattr__(self, "channels", channel_names(self.channels))  # a driver may give plain text

    @property
    def sensors(self) -> tuple[str, ...]:
        """Sensor of each channel.

        >>> Stream("deltas", (*GYRO[:2], TEMPERATURE), "binary", "startup").sensors
        ('gyro', 'gyro', 'temperature')
        """
        return tuple(name.sensor for name in self.channels)

    @property
    def groups(self) -> tuple[int, ...]:
        """Number of the sensor of each channel, from 0 on: the channels of a sensor miss the same samples.

        >>> Stream("deltas", (*GYRO[:2], TEMPERATURE), "binary", "startup").groups
        (0, 0, 1)
        """
        sensors = self.sensors
        return tuple(list(dict.fromkeys(sensors)).index(sensor) for sensor in sensors)

    def kind_of(self, sensor: str) -> Kind:
        """Kind of the numbers of ``gyro`` or ``accel``."""
        return {"gyro": self.gyro, "accel": self.accel}.get(sensor) or self.kind

    @property
    def facts(self) -> dict[str, Any]:
        """Fields of `DeviceInfo` that the stream gives, if the settings of the sensor are unknown."""
        return {"stream": self.kind, "source": self.source, "clock": self.clock, "caveats": self.caveats}

    @property
    def averaged(self) -> tuple[bool, ...]:
        """Which channels are true averages over their interval: only increments are, never a magnetometer.

        >>> Stream("deltas", (GYRO[0], MAG[0], TEMPERATURE), "binary", "startup").averaged
        (True, False, False)
        """
        return tuple(s in INERTIAL and self.kind_of(s) == "deltas" for s in self.sensors)

    @property
    def caveats(self) -> tuple[str, ...]:
        """Return the caveats of the stream if the settings of the sensor are unknown.

        >>> Stream("deltas", GYRO, "binary", "startup").caveats
        ('unknown_compensation',)
        >>> Stream("unknown", GYRO, "csv", "startup").caveats
        ('unknown_compensation',)
        """
        if self.kind == "compensated":
            return ("compensated",)
        unknown = self.kind == "unknown" or any(self.averaged)
        return ("unknown_compensation",) if unknown else ()


Floats: TypeAlias = "npt.NDArray[np.float64]"
Ints: TypeAlias = "npt.NDArray[np.int64]"
Bools: TypeAlias = "npt.NDArray[np.bool_]"


@dataclass(frozen=True, slots=True)
class SampleBlock:
    """Consecutive samples of one stream, in the order they arrived.

    Attributes
    ----------
    stream : Stream
    values : (n, c) channel unit (SI; gauss, degC, kPa), one column for each of `stream.channels`.
    time_ns : (n,) ns, the sensor's clock at each sample (``startup``), its count (``counter``), or
        the length of the sample's own interval (``dt``); None without a clock.
    lost : (n,) messages that were damaged on the line directly before each sample, as far as
        framing shows; what a stream without an absolute clock knows of its gaps.
    saturated : (n, s) the device said itself that a sensor exceeded its range, one column for each sensor in the
        order of `stream.channels`; (n,): it does not say which sensor; None: it does not say.
    """

    stream: Stream
    values: Floats
    time_ns: Ints | None
    lost: Ints
    saturated: Bools | None = field(default=None)

    def __len__(self) -> int:
        return int(self.values.shape[0])


@dataclass(frozen=True, slots=True)
class Gap:
    """The stream was interrupted here.

    Attributes
    ----------
    length_s : s of the sample clock, about; None if unknown. A stream with an absolute clock shows the exact
        length itself.
    """

    length_s: float | None


@dataclass(frozen=True, slots=True)
class Notice:
    """Something that the user should know: `kind` is an event kind, `text` is one line; level None: of the kind."""

    kind: str
    text: str
    level: Level | None = None


@dataclass(frozen=True, slots=True)
class RawBytes:
    """Bytes as they came from the device, for recordings; they precede the samples decoded from them."""

    data: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceInfo:
    """What is known of a device and its stream; None is unknown, and `remarks` say why.

    Attributes
    ----------
    id : default name of the device in keys and files.
    driver : URL scheme of the driver.
    kind : noun for the device in messages, such as "VN-100".
    port : path or URL that it was opened by.
    baud : bit/s; None for devices without a baud rate.
    stream : kind of the samples; None before the first one if the device does not say.
    source : message that the samples are taken from.
    topic : in ROS, that supplies the samples.
    clock : see `Stream.clock`.
    sample_rate_hz : Hz, nominal.
    alias_factor : factor by which the filter of the sensor inflates N, the worse of gyroscope and
        accelerometer; 1 is none.
    settings : settings that change the data, by name, as text.
    data_settings : those settings of which another value makes another record.
    caveats : ``compensated``, ``unknown_compensation``, ``aliased``.
    remarks : what is unknown or not as it should be, one line each.
    columns : of lines, what became of each.
    """

    id: str
    driver: str | None = None
    kind: str = "sensor"
    model: str | None = None
    serial: str | None = None
    firmware: str | None = None
    port: str | None = None
    baud: int | None = None
    stream: Kind | None = None
    source: str | None = None
    topic: str | None = None
    clock: str | None = None
    sample_rate_hz: float | None = None
    alias_factor: float | None = None
    settings: Mapping[str, str] = field(default_factory=dict)
    data_settings: tuple[str, ...] = ()
    caveats: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    columns: tuple[ColumnUse, ...] = ()

    @property
    def title(self) -> str:
        """Model and serial number for messages.

        >>> DeviceInfo(id="a", model="VN-100T-CR", serial="0100056785").title, DeviceInfo(id="a").title
        ('VN-100T-CR 0100056785', 'the sensor')
        """
        return f"{self.model} {self.serial or ''}".strip() if self.model else f"the {self.kind}"


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceCounters:
    """What was received and lost on the way, over all connections of one device object.

    Attributes
    ----------
    received_bytes : bytes that reached the decoder; 0 for devices without bytes.
    messages : valid messages of any type; 0 for devices without bytes.
    discarded_bytes : bytes that belong to no valid message.
    bad_checksums : messages that were framed correctly and failed their check.
    overruns : times that data were lost on this side, in the kernel or at a full queue.
    kernel_overruns : of these, in the kernel; None if the driver does not count.
    most_queued_bytes : most bytes that ever waited for the decoder; None if there is no byte queue.
    other_sender : lines or messages of others on the way of this sensor, which are ignored.
    ledger : what became of all other messages or lines but those that are samples (`ledger`); empty: the device
        counts none.
    """

    received_bytes: int = 0
    messages: int = 0
    discarded_bytes: int = 0
    bad_checksums: int = 0
    overruns: int = 0
    kernel_overruns: int | None = None
    most_queued_bytes: int | None = None
    other_sender: int = 0
    ledger: Mapping[str, int] = field(default_factory=dict)


Item: TypeAlias = SampleBlock | Gap | Notice | RawBytes | DeviceInfo | DeviceCounters


def selected(block: SampleBlock, rows: Bools | slice) -> SampleBlock:
    """Some of the samples of a block."""
    time = None if block.time_ns is None else block.time_ns[rows]
    saturated = None if block.saturated is None else block.saturated[rows]
    return SampleBlock(block.stream, block.values[rows], time, block.lost[rows], saturated)


def concatenated(blocks: Sequence[SampleBlock]) -> SampleBlock:
    """Blocks of one stream that follow one another, as one; where a block does not say, nothing saturated."""
    import numpy as np

    if len(blocks) == 1:
        return blocks[0]
    times = [block.time_ns for block in blocks if block.time_ns is not None]
    shape = next((block.saturated.shape[1:] for block in blocks if block.saturated is not None), ())
    flags = [
        np.zeros((len(block), *shape), bool) if block.saturated is None else block.saturated
        for block in blocks
    ]
    return SampleBlock(
        blocks[0].stream,
        np.concatenate([block.values for block in blocks]),
        np.concatenate(times) if times else None,
        np.concatenate([block.lost for block in blocks]),
        np.concatenate(flags) if any(block.saturated is not None for block in blocks) else None,
    )
