"""Streams: which of a message's quantities become samples, and how.

A message carries named quantities, whichever way it was coded. From each message one stream is taken:
true increments before uncompensated before compensated readings, gyroscope and accelerometer of the
same kind where the message has both in one kind. Where it has not, the stream is called by the worse of
the two kinds, and says which each is. This file knows quantities, not bytes.

Increments are divided by their own interval: a delta angle over its interval is the mean rate, a true
cluster average in the sense of IEEE Std 952-2020, C.1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from math import pi
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from imumon.samples import ACCEL, GYRO, MAG, Bools, Clock, Floats, Ints, Kind, Stream

Get: TypeAlias = Callable[[str], npt.NDArray[Any]]
"""Quantity by name: (n, k), k its number of components."""

WIDTHS = {
    "ypr": 3, "quat": 4, "mag": 3, "accel": 3, "gyro": 3, "linaccel": 3, "umag": 3, "uaccel": 3, "ugyro": 3,
    "temp": 1, "pres": 1, "dt": 1, "dtheta": 3, "dvel": 3, "dcm": 9, "heave": 3,
}  # fmt: skip
"""Components of a quantity. Units: deg, gauss, m/s^2, rad/s, degC, kPa; dt s, dtheta deg, dvel m/s."""

_KINDS: tuple[tuple[Kind, str, str], ...] = (
    ("deltas", "dtheta", "dvel"),
    ("uncompensated", "ugyro", "uaccel"),
    ("compensated", "gyro", "accel"),
)
"""Kind, and what the gyroscope and the accelerometer are read from, best first."""

_OVER_DT = {"dtheta": pi / 180.0, "dvel": 1.0}
"""Increments, and the factor that makes their rate SI."""

TICK_S = 1.0 / 800.0
"""s, period of the inner loop of a VN-100: its output intervals are multiples of it."""

_LONGEST = 1e6
"""An interval beyond it, s, is none."""

_LARGEST = 1e9
"""No sensor measures so much in any channel's unit. A damaged float that passed its check may say 1e38: its
fourth power is no number any more, and one alone would spoil every moment for good."""

_VPE_SATURATED = 0x0204
"""Bits of VpeStatus: gyroscope saturated (2), accelerometer saturated (9)."""


@dataclass(frozen=True, slots=True)
class Batch:
    """Samples of one run of equal messages, before those that are none are taken out.

    Attributes
    ----------
    values : (n, c) channel unit.
    time_ns : (n,) what the stream's clock says, None without one.
    saturated : (n,) the sensor's own word, None where it has none.
    usable : (n,) every number finite and one that can be, every interval positive, every time stamp
        possible; None where all are.
    """

    values: Floats
    time_ns: Ints | None
    saturated: Bools | None
    usable: Bools | None

    def rows(self, kept: npt.NDArray[np.intp]) -> Batch:
        """Those rows alone."""
        time = None if self.time_ns is None else self.time_ns[kept]
        saturated = None if self.saturated is None else self.saturated[kept]
        return Batch(self.values[kept], time, saturated, None)


@dataclass(frozen=True, slots=True)
class Recipe:
    """How samples of one stream are made from a message's quantities.

    Attributes
    ----------
    stream : what comes out.
    parts : quantities and the columns they fill.
    timed : increments are among the parts, or dt is the clock.
    flags : those of the quantities ``vpe`` and ``sat`` that tell saturation.
    """

    stream: Stream
    parts: tuple[tuple[str, slice], ...]
    timed: bool
    flags: tuple[str, ...]

    def batch(self, get: Get, count: int) -> Batch:
        """Samples from the quantities of `count` messages; floating-point errors are the caller's."""
        values = np.empty((len(self.stream.channels), count)).T  # one channel behind the other
        dt = get("dt").astype(np.float64) if self.timed else None
        for part, columns in self.parts:
            if dt is not None and part in _OVER_DT:
                values[:, columns] = get(part) / dt * _OVER_DT[part]
            else:
                values[:, columns] = get(part)
        time: Ints | None = None
        if self.stream.clock == "dt" and dt is not None:
            time = _nanoseconds(dt[:, 0])
        elif self.stream.clock != "none":
            time = get(self.stream.clock)[:, 0].astype(np.int64)
        saturated: Bools | None = None
        for flag in self.flags:
            word = get(flag)[:, 0]
            says = (word & _VPE_SATURATED if flag == "vpe" else word) != 0
            saturated = says if saturated is None else saturated | says
        return Batch(values, time, saturated, _usable(values, dt, time))


def _nanoseconds(dt: Floats) -> Ints:
    """Intervals, (n,) s, as whole ns; 0 for one that is none."""
    return np.rint(np.where((dt > 0.0) & (dt < _LONGEST), dt, 0.0) * 1e9).astype(np.int64)


def _usable(values: Floats, dt: Floats | None, time: Ints | None) -> Bools | None:
    """(n,) which rows are samples; None for all, which is nearly always so and quickly seen."""
    timed = dt is None or (dt.min() > 0.0 and dt.max() < _LONGEST)
    if timed and (time is None or time.min() >= 0) and values.min() > -_LARGEST and values.max() < _LARGEST:
        return None
    usable: Bools = np.logical_and.reduce(np.abs(values) < _LARGEST, axis=1)
    if dt is not None:
        usable = usable & (dt[:, 0] > 0.0) & (dt[:, 0] < _LONGEST)
    if time is not None:
        usable = usable & (time >= 0)
    return usable


@lru_cache(maxsize=256)
def recipe(quantities: frozenset[str], source: str) -> Recipe | None:
    """The best stream of a message with these quantities; None where it has no sensor in it.

    Two quantities beyond `WIDTHS` are clocks: ``startup`` (ns) and ``counter``; two are flags:
    ``vpe`` (VpeStatus) and ``sat`` (SensSat).

    >>> recipe(frozenset({"ypr", "mag", "accel", "gyro"}), "$VNYMR").stream.kind
    'compensated'
    >>> recipe(frozenset({"ypr"}), "$VNYPR") is None
    True
    """
    have = {q for q in quantities if q not in _OVER_DT or "dt" in quantities}
    kinds = [entry for entry in _KINDS if entry[1] in have and entry[2] in have]
    gyro = kinds[:1] or [entry for entry in _KINDS if entry[1] in have]
    accel = kinds[:1] or [entry for entry in _KINDS if entry[2] in have]
    mag = [q for q in ("umag", "mag") if q in have]
    found: dict[str, Kind] = {"gyro": gyro[0][0]} if gyro else {}
    found |= {"accel": accel[0][0]} if accel else {}
    if found:
        kind = max(found.values(), key=[entry[0] for entry in _KINDS].index)
    elif mag:
        kind = "uncompensated" if mag[0] == "umag" else "compensated"
    else:
        return None
    parts: list[tuple[str, slice]] = []
    channels: tuple[str, ...] = ()
    for names, choice in (
        (GYRO, [entry[1] for entry in gyro]),
        (ACCEL, [entry[2] for entry in accel]),
        (MAG, mag),
        (("temperature",), [q for q in ("temp",) if q in have]),
        (("pressure",), [q for q in ("pres",) if q in have]),
    ):
        if choice:
            parts.append((choice[0], slice(len(channels), len(channels) + len(names))))
            channels += names
    clocks: tuple[Clock, ...] = ("startup", "counter", "dt")
    clock: Clock = next((c for c in clocks if c in have), "none")
    timed = clock == "dt" or any(part in _OVER_DT for part, _ in parts)
    flags = tuple(flag for flag in ("vpe", "sat") if flag in have)
    better = {sensor: its for sensor, its in found.items() if its != kind}
    stream = Stream(
        kind,
        channels,
        source,
        clock,
        gyro=better.get("gyro"),
        accel=better.get("accel"),
        tick_s=TICK_S,
    )
    return Recipe(stream, tuple(parts), timed, flags)
