"""Samples: what crosses from a sensor's codec to the monitor.

A codec finds samples in bytes; the monitor puts them on the sensor's time grid. Between the two
goes a `SampleBlock`: some consecutive samples of one stream, in SI units, with what is known
of their time. This file knows neither ports nor statistics.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

Kind: TypeAlias = Literal["deltas", "uncompensated", "compensated"]
Clock: TypeAlias = Literal["startup", "counter", "dt", "none"]

AXES = ("x", "y", "z")
GYRO = ("gyro/x", "gyro/y", "gyro/z")
ACCEL = ("accel/x", "accel/y", "accel/z")
MAG = ("mag/x", "mag/y", "mag/z")

UNITS = {"gyro": "rad/s", "accel": "m/s^2", "mag": "gauss", "temperature": "degC", "pressure": "kPa"}
"""Unit of a channel by its sensor (the part of its name before the slash)."""


def sensor_of(channel: str) -> str:
    """Sensor a channel belongs to.

    >>> sensor_of("gyro/x"), sensor_of("temperature")
    ('gyro', 'temperature')
    """
    return channel.partition("/")[0]


@dataclass(frozen=True, slots=True)
class Stream:
    """One of the streams on a line: which fields it takes and what they mean.

    Attributes
    ----------
    kind : what the numbers describe. ``deltas`` are true cluster averages (delta angle or velocity
        over its interval), the others are point samples behind the sensor's own filter.
    channels : names of the columns, in the order gyro, accel, mag, temperature, pressure.
    source : message it is taken from, for people: ``$VNYMR``, ``binary 01:0739``.
    clock : ``startup`` nanoseconds since the sensor's power-up; ``counter`` a count of the sensor's
        800 Hz loop or of microseconds, appended to a sentence; ``dt`` the length of each
        sample's own interval; ``none``: the rate must be known from elsewhere.
    interval_s : nominal sampling interval where the codec knows it (``dt``), else None.
    gyro, accel : kind of the gyroscope's and the accelerometer's numbers where it is not `kind`, which
        is then the worse of the two.
    """

    kind: Kind
    channels: tuple[str, ...]
    source: str
    clock: Clock
    interval_s: float | None = None
    gyro: Kind | None = None
    accel: Kind | None = None

    def kind_of(self, sensor: str) -> Kind:
        """Kind of the numbers of ``gyro`` or ``accel``."""
        return {"gyro": self.gyro, "accel": self.accel}.get(sensor) or self.kind

    @property
    def averaged(self) -> tuple[bool, ...]:
        """Which channels are true averages over their interval: only increments are, never a magnetometer.

        >>> Stream("deltas", ("gyro/x", "mag/x", "temperature"), "binary", "startup").averaged
        (True, False, False)
        """
        sensors = map(sensor_of, self.channels)
        return tuple(s in ("gyro", "accel") and self.kind_of(s) == "deltas" for s in sensors)

    @property
    def caveats(self) -> tuple[str, ...]:
        """What must be said of the stream where nobody knows the sensor's settings.

        >>> Stream("deltas", ("gyro/x",), "binary", "startup").caveats
        ('unknown_compensation',)
        """
        if self.kind == "compensated":
            return ("compensated",)
        return ("unknown_compensation",) if any(self.averaged) else ()


Floats: TypeAlias = npt.NDArray[np.float64]
Ints: TypeAlias = npt.NDArray[np.int64]
Bools: TypeAlias = npt.NDArray[np.bool_]


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
    saturated : (n,) the sensor said itself that a range was exceeded; None when it does not say.
    """

    stream: Stream
    values: Floats
    time_ns: Ints | None
    lost: Ints
    saturated: Bools | None = field(default=None)

    def __len__(self) -> int:
        return int(self.values.shape[0])


def concatenated(blocks: Sequence[SampleBlock]) -> SampleBlock:
    """Blocks of one stream that follow one another, as one; where a block does not say, nothing saturated."""
    if len(blocks) == 1:
        return blocks[0]
    times = [block.time_ns for block in blocks if block.time_ns is not None]
    flags = [np.zeros(len(block), bool) if block.saturated is None else block.saturated for block in blocks]
    return SampleBlock(
        blocks[0].stream,
        np.concatenate([block.values for block in blocks]),
        np.concatenate(times) if times else None,
        np.concatenate([block.lost for block in blocks]),
        np.concatenate(flags) if any(block.saturated is not None for block in blocks) else None,
    )
