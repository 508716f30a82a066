"""Topics of a log: what `log_file` can ask for."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from imumon.model.samples import Floats
from imumon.sources.files.base import ROWS, TABLE_BYTES

LOG_TIME = "log_time"
"""Column of the time, ns, at which the recorder got a message."""

MATCHED = 0.99
"""Share of the samples of a gyroscope that must have one of the accelerometer at the same time, and the reverse."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Topic:
    """One series of messages of one type.

    Attributes
    ----------
    name : as in the log; of an autopilot with the number of the instance, ``sensor_gyro/0``.
    type : of its messages.
    count : rows.
    columns : names of its columns.
    map : channel to ``COLUMN:UNIT`` as far as it is known; without gyroscope and accelerometer, the topic is no IMU.
    averaged : its values are averages over the whole sampling interval.
    rate_hz : Hz, about; None: unknown.
    note : one line on what was derived or left out; empty: nothing.
    """

    name: str
    type: str
    count: int
    columns: Sequence[str] = ()
    map: Mapping[str, str] = field(default_factory=dict)
    averaged: bool = False
    rate_hz: float | None = None
    note: str = ""


Arrays: TypeAlias = dict[str, npt.NDArray[Any]]
"""(n,) of each column of a topic."""


class Log:
    """Base class of logs.

    Attributes
    ----------
    topics : the best first, if the log has an order.
    facts : fields of the header of a recording: model, firmware.
    remarks : what was left out or is doubtful, one line each.
    problem : why it was not read to its end, or None.
    """

    topics: Sequence[Topic] = ()
    facts: Mapping[str, str] = {}
    remarks: Sequence[str] = ()
    problem: str | None = None

    def blocks(self, topic: int, columns: Sequence[str]) -> Iterator[tuple[Floats, int]]:
        """Yield rows, (n, k) with a column for each name, NaN is missing, and the bytes read for them.

        Parameters
        ----------
        topic : index in `topics`.
        columns : of its names. Times of ROS are ns since the first message.
        """
        raise NotImplementedError


class ArrayLog(Log):
    """Log whose topics are arrays in memory.

    Attributes
    ----------
    arrays : (n,) of each column, by topic.
    """

    arrays: Mapping[str, Arrays]

    def blocks(self, topic: int, columns: Sequence[str]) -> Iterator[tuple[Floats, int]]:
        arrays = self.arrays[self.topics[topic].name]
        chosen = [arrays[name] for name in columns]
        for start in range(0, len(chosen[0]), ROWS):
            parts = [array[start : start + ROWS] for array in chosen]
            yield np.column_stack([part.astype(np.float64) for part in parts]), sum(p.nbytes for p in parts)


def batches(messages: Iterable[tuple[int, bytes]]) -> Iterator[tuple[list[tuple[int, bytes]], int]]:
    """Yield messages, each with its time, in blocks, and the bytes of each block."""
    batch: list[tuple[int, bytes]] = []
    size = 0
    for message in messages:
        batch.append(message)
        size += len(message[1])
        if len(batch) == ROWS or size > TABLE_BYTES:
            yield batch, size
            batch, size = [], 0
    if batch:
        yield batch, size


def described(
    name: str,
    kind: str,
    arrays: Arrays,
    known: Mapping[str, str],
    *,
    averaged: bool = False,
    note: str = "",
) -> Topic:
    """Return the description of a topic of arrays; `known` is its map, in which ``t`` has ms or us."""
    time, _, unit = known.get("t", "").partition(":")
    times = arrays.get(time, np.zeros(0))
    step = step_s(times)
    return Topic(
        name=name,
        type=kind,
        count=len(next(iter(arrays.values()), times)),
        columns=list(arrays),
        map=known,
        averaged=averaged,
        rate_hz=None if step is None else (1e-3 if unit == "ms" else 1.0) / step,
        note=note,
    )


def best_first(topics: Sequence[Topic], preferred: str = "") -> list[Topic]:
    """Return the topics of an autopilot, the best first.

    Those with both sensors come before those with one, then averages, then the fastest, then a gyroscope.

    Parameters
    ----------
    preferred : type of messages whose averages come first.

    >>> slow = Topic(name="a", type="a", count=9, map={"gyro/x": "x", "accel/x": "y"}, rate_hz=2.0)
    >>> fast = Topic(name="b", type="b", count=9, map={"gyro/x": "x"}, rate_hz=8000.0)
    >>> [topic.name for topic in best_first([fast, slow])]
    ['a', 'b']
    """
    rates: dict[str, float] = {}  # the instances of a type stay in their order
    for topic in topics:
        rates[topic.type] = max(rates.get(topic.type, 0.0), topic.rate_hz or 0.0)

    def rank(topic: Topic) -> tuple[bool, bool, bool, bool, float, bool, str]:
        gyro, accel = "gyro/x" in topic.map, "accel/x" in topic.map
        first = topic.averaged and topic.type == preferred
        neither, one = not (gyro or accel), not (gyro and accel)
        return neither, one, not topic.averaged, not first, -rates[topic.type], not gyro, topic.name

    return sorted(topics, key=rank)


def step_s(times_us: npt.NDArray[Any]) -> float | None:
    """Return the median step of some times in us, s; None if there is none above zero."""
    if len(times_us) < 2:
        return None
    step = float(np.median(np.diff(times_us.astype(np.float64)))) * 1e-6
    return step if step > 0.0 else None


def degrees_at(
    times_us: npt.NDArray[Any], source_us: npt.NDArray[Any], source: npt.NDArray[Any]
) -> Floats | None:
    """Return a temperature (n,) at the times of some samples, between those of its source; None: it has none."""
    degrees = source.astype(np.float64)
    known = np.isfinite(degrees)
    if not known.any():
        return None
    return np.interp(times_us.astype(np.float64), source_us.astype(np.float64)[known], degrees[known])


def rows_at(times_us: npt.NDArray[Any], other_us: npt.NDArray[Any]) -> npt.NDArray[np.int64] | None:
    """Return (n,) the row of another series at some times, -1 where it has none; None: its times are others.

    >>> rows_at(np.arange(5) * 10, np.arange(5) * 10 + 1).tolist()
    [0, 1, 2, 3, 4]
    >>> rows_at(np.arange(5) * 10, np.arange(3) * 20) is None
    True
    >>> rows_at(np.arange(3) * 20, np.arange(5) * 10) is None  # all of these times, but half of the other ones
    True
    """
    step = step_s(times_us)
    if step is None or not len(other_us):
        return None
    stamps, other_stamps = times_us.astype(np.float64), other_us.astype(np.float64)
    half = step * 0.5e6  # us either way: the stamps of two sensors of one chip differ by some
    nearest = np.clip(np.searchsorted(other_stamps, stamps - half), 0, len(other_stamps) - 1)
    near = np.abs(other_stamps[nearest] - stamps) < half
    meanwhile = (other_stamps > stamps[0] - half) & (other_stamps < stamps[-1] + half)
    # one to one, and neither has many rows that the other lacks: else one of them is slower
    matched = len(np.unique(nearest[near]))
    same = matched == near.sum() and matched >= MATCHED * max(len(stamps), meanwhile.sum())
    return np.where(near, nearest, -1) if same else None


def add_matched(
    arrays: Arrays, other: Arrays | None, name: str, time: str, columns: Mapping[str, str]
) -> str:
    """Add the samples of another series, if they are at the same times; return what is left out.

    Parameters
    ----------
    name : of the other series, for people.
    time : column of the times, us, in both.
    columns : name of a column in `arrays` to that in `other`. It has NaN where `other` has no row.
    """
    if other is None or not {time, *columns.values()} <= set(other):
        return ""
    rows = rows_at(arrays[time], other[time])
    if rows is None:
        return f"{name} not used: its samples are at other times; as the chosen topic it is read alone"
    for added, column in columns.items():
        arrays[added] = np.where(rows >= 0, other[column].astype(np.float64)[rows], np.nan)
    return ""
