"""Saved states with a damage each, and what a daemon makes of them.

A damage is to the content, not to the file: the checksums are right, as in a forged state or in that of a program with
a defect. Most damages keep type and shape of an array, because what is left to find is then the range of its numbers
and what must hold between them.
"""

from __future__ import annotations

import json
import random
import signal
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from imumon.checkpoint import Checkpoint, SavedState, decode
from imumon.clock import HostClock
from imumon.daemon.persistence import Persistence
from imumon.pipeline import Monitor, MonitorOptions
from imumon.report import DeviceDescription, Report, SessionCounters, from_json
from imumon.report_json import to_json
from imumon.samples import Clock, DeviceInfo, SampleBlock, Stream

Array = npt.NDArray[Any]
INFO = DeviceInfo(id="lab", serial="7")
FED = 4_000
"""Samples that a restored record must take."""
LONGEST_S = 60
"""s, for which a damaged state may keep a daemon busy; a good one takes a second or two."""

# ---------------------------------------------------------------------- good states


@dataclass(frozen=True)
class MadeStream:
    """A stream of samples that are computed from their number.

    Attributes
    ----------
    sensors : of the stream, in its order.
    clock : see `Stream`.
    rate_hz : Hz, sampling rate.
    length : samples until the state is saved.
    moves : whether the sensor is moved at the end of them.
    """

    sensors: tuple[str, ...]
    clock: Clock
    rate_hz: float
    length: int
    moves: bool = False

    @property
    def stream(self) -> Stream:
        """The stream; temperature has no axes."""
        names = [
            name
            for sensor in self.sensors
            for name in ((sensor,) if sensor == "temperature" else [f"{sensor}/{axis}" for axis in "xyz"])
        ]
        return Stream(kind="deltas", source="made", clock=self.clock, channels=tuple(names))

    def monitor(self) -> Monitor:
        """Return a monitor without samples."""
        return Monitor(MonitorOptions(periods=True), rate_hz=self.rate_hz)

    def block(self, first: int, n: int) -> SampleBlock:
        """Return n samples: noise that grows late in the record, gravity, and a temperature that settles."""
        channels, number = self.stream.channels, first + np.arange(n)
        values = np.random.default_rng(first).normal(size=(n, len(channels))) * 1e-3
        values[number > 0.7 * self.length] *= 1.5
        for column, name in enumerate(channels):
            values[:, column] += {"accel/z": 9.81, "mag/x": 0.2}.get(name, 0.0)
            if name == "temperature":
                values[:, column] += 30.0 - 10.0 * np.exp(-number / (0.2 * self.length))
        steps = np.ones(n) if self.clock == "dt" else number
        time_ns = np.round(steps * (1e9 / self.rate_hz)).astype(np.int64)
        return SampleBlock(self.stream, values, time_ns, np.zeros(n, dtype=np.int64), None)

    def feed(self, monitor: Monitor) -> None:
        """Feed a record with outliers, knocks, gaps of known and unknown length, and motion at its end."""
        rate = round(self.rate_hz)
        first, step = 0, 61 * rate
        while first < self.length:
            block, turn = self.block(first, min(step, self.length - first)), first // step
            if turn % 3 == 1:
                block.values[rate, 0] += 1.0
                block.values[9 * rate : 10 * rate] *= 30.0
            if turn == 5:
                monitor.gap()
            if self.moves and first + step >= self.length:
                block.values[-12 * rate :] += np.cumsum(block.values[-12 * rate :], axis=0)
            monitor.feed(block)
            first += len(block) + (17 if turn % 4 == 2 else 0)


STREAMS = {
    "first seconds": MadeStream(("gyro",), "startup", 100.0, 250),
    "a minute": MadeStream(("gyro",), "startup", 100.0, 6_000),
    "an hour": MadeStream(("gyro", "accel", "temperature"), "startup", 10.0, 36_100, moves=True),
    "hours with breaks": MadeStream(("gyro", "temperature"), "dt", 4.0, 30_000),
}
"""Records whose states differ: before the first assessment, with all kinds of arrays, with changes between hours."""


def saved_record(directory: Path, made: MadeStream) -> SavedState:
    """Return the state of a daemon that had these samples."""
    directory.mkdir()
    monitor = made.monitor()
    kept = Persistence(directory, "lab", monitor, HostClock())
    kept.restore(INFO)
    made.feed(monitor)
    kept.close(SessionCounters(started="2026-01-01T00:00:00.000Z"))
    return decode((directory / "lab.state").read_bytes())


# ---------------------------------------------------------------------- damages


def flipped_bits(rng: random.Random, array: Array) -> Array:
    """Return the array with up to eight bits flipped."""
    content = bytearray(array.tobytes())
    for _ in range(rng.randint(1, 8)):
        content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    return np.frombuffer(bytes(content), array.dtype).reshape(array.shape).copy()


def odd_number(rng: random.Random, array: Array) -> Any:
    """Return a number that an array of this type can hold, and a state should not."""
    if array.dtype.kind == "f":
        return rng.choice(
            (np.nan, np.inf, -np.inf, -1.0, -1e-300, 1e-300, 1e18, -1e18, 1e59, 1e61, 1e300, -1e300)
        )
    if array.dtype.kind == "i":
        most = np.iinfo(array.dtype).max
        return rng.choice((-1, most, -most - 1, most // 2, most >> 16, 1 << 20, 255)) % (most + 1)
    return rng.random() < 0.5


def with_number(rng: random.Random, array: Array) -> Array:
    """Return the array with one odd number."""
    out = array.copy()
    out.reshape(-1)[rng.randrange(out.size)] = odd_number(rng, array)
    return out


def beside(rng: random.Random, array: Array) -> Array:
    """Return the array with one number that is a little larger or smaller, or is that of its neighbour."""
    out = array.copy()
    flat = out.reshape(-1)
    place = rng.randrange(flat.size)
    if array.dtype.kind == "b":
        flat[place] = not flat[place]
    elif rng.random() < 0.3:
        flat[place] = flat[place - 1]
    elif array.dtype.kind == "i":
        flat[place] += rng.choice((-2, -1, 1, 2, 128, 256))
    else:
        flat[place] = rng.choice(
            (
                np.nextafter(flat[place], rng.choice((-np.inf, np.inf))),
                flat[place] * 1.001,
                flat[place] - 1.0,
                0.0,
            )
        )
    return out


def shuffled(rng: random.Random, array: Array) -> Array:
    """Return the array with its numbers in another order."""
    order = list(range(array.size))
    rng.shuffle(order)
    return np.asarray(array.reshape(-1)[order].reshape(array.shape))


def reshaped(rng: random.Random, array: Array) -> Array:
    """Return the array with another shape, and fewer or more numbers."""
    rows = array if array.ndim else array[None]
    return rng.choice(
        (array[None], array.T.copy(), rows[:-1], rows[: len(rows) // 2], np.concatenate([rows, rows]))
    )


def retyped(rng: random.Random, array: Array) -> Array:
    """Return the array with another type."""
    with np.errstate(all="ignore"):
        return array.astype(rng.choice(("<f4", "<f8", "<i8", "<i2", "<U5", "|b1")))


WAYS: Mapping[str, tuple[int, Callable[[random.Random, Array], Array]]] = {
    "bits": (4, flipped_bits),
    "one number": (4, with_number),
    "all numbers": (1, lambda rng, array: np.full_like(array, odd_number(rng, array))),
    "a number beside": (6, beside),
    "negative": (1, lambda rng, array: ~array if array.dtype == bool else -array),
    "shuffled": (2, shuffled),
    "reshaped": (2, reshaped),
    "retyped": (1, retyped),
}
"""Ways to damage an array of numbers, with their weights."""

ODD_VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 10**9, 10**30, 10**400, 1e308, -1e308, 1e-320, float("inf"), float("nan"), "", "\x1b[2J",
    "x" * 5000, [], [[]], {}, {"a": {}}, [1, "a"],
)  # fmt: skip
"""Of the JSON beside the arrays."""


def damaged(rng: random.Random, state: SavedState) -> tuple[SavedState, str]:
    """Return a state with one damage, and what was damaged."""
    meta = json.loads(json.dumps(state.meta))
    arrays = {name: array.copy() for name, array in state.arrays.items()}
    kind = rng.random()
    if kind < 0.1:
        return SavedState(meta, arrays), with_odd_value(rng, meta)
    # an object has dozens of marks with the same arrays: each object is as likely as another one
    by_object: dict[str, list[str]] = {}
    for name in arrays:
        by_object.setdefault("".join(c for c in name.rpartition(".")[0] if not c.isdigit()), []).append(name)
    name = rng.choice(by_object[rng.choice(sorted(by_object))])
    if kind < 0.15:
        del arrays[name]
        return SavedState(meta, arrays), f"{name} missing"
    if kind < 0.25:
        alike = [n for n in arrays if n != name and arrays[n].dtype == arrays[name].dtype]
        alike = [n for n in alike if arrays[n].shape == arrays[name].shape] or alike or list(arrays)
        other = rng.choice(alike)
        arrays[name], arrays[other] = arrays[other], arrays[name]
        return SavedState(meta, arrays), f"{name} and {other} swapped"
    way, change = "reshaped", reshaped
    if arrays[name].size and arrays[name].dtype.kind in "biuf":
        ways = [way for way, (weight, _) in WAYS.items() for _ in range(weight)]
        way = rng.choice(ways)
        change = WAYS[way][1]
    with np.errstate(all="ignore"):
        arrays[name] = change(rng, arrays[name])
    return SavedState(meta, arrays), f"{name}: {way}"


def with_odd_value(rng: random.Random, meta: dict[str, Any]) -> str:
    """Replace a value of JSON, and return its place."""
    node: Any = meta
    path = ""
    while True:
        key = rng.choice(list(node) if isinstance(node, dict) else range(len(node)))
        path += f"/{key}"
        if not isinstance(node[key], dict | list) or not node[key] or rng.random() < 0.1:
            break
        node = node[key]
    node[key] = json.loads(json.dumps(rng.choice(ODD_VALUES)))
    return path


# ---------------------------------------------------------------------- what becomes of them

SIGNED = (
    "mean", "min", "max", "last", "skewness", "excess_kurtosis", "recent_mean", "bias", "bias_low", "bias_high",
    "correlation", "modes", "start", "per_hour", "per_hour_low", "per_hour_high", "per_degC", "per_degC_low",
    "per_degC_high", "temperature_min", "temperature_max", "columns", "before", "now", "bias_curve",
    "filter", "lines",
)  # fmt: skip
"""Members of a report whose numbers may be negative, or those within them."""


def negative_numbers(node: Any, path: str = "") -> Iterator[str]:
    """Yield the places of numbers in JSON that are negative and must not be."""
    if isinstance(node, dict | list):
        for key, value in node.items() if isinstance(node, dict) else enumerate(node):
            if key not in SIGNED:
                yield from negative_numbers(value, f"{path}/{key}")
    elif isinstance(node, int | float) and node < 0:
        yield f"{path} = {node}"


@contextmanager
def time_limit(seconds: int) -> Iterator[None]:
    """Raise TimeoutError in a block that takes longer: a daemon would hang."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise TimeoutError(f"more than {seconds} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


@dataclass(frozen=True)
class Outcome:
    """What became of a damaged state.

    Attributes
    ----------
    decision : what the daemon says at its start.
    continues : whether the record goes on.
    fault : what went wrong later; empty: nothing.
    """

    decision: str
    continues: bool
    fault: str = ""


def outcome(directory: Path, made: MadeStream, state: SavedState, fed: int = FED) -> Outcome:
    """Start the record of a daemon with a state, and feed, report and save it if it goes on."""
    for old in directory.iterdir():
        old.unlink()
    (directory / "lab.state").touch()
    monitor = made.monitor()
    kept = Persistence(directory, "lab", monitor, HostClock())
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        patch.setattr(Checkpoint, "load", lambda self: (state, []))  # compression takes longer than all else
        ((decision, _),) = kept.restore(INFO)
        continues, fault = "continues" in decision, ""
        if continues:
            try:
                with time_limit(LONGEST_S):
                    fault = _go_on(monitor, made, fed)
            except Exception as error:
                fault = repr(error)
        kept._checkpoint.close()
    return Outcome(decision, continues, fault)


def _go_on(monitor: Monitor, made: MadeStream, fed: int) -> str:
    """Feed a restored record, and return what is wrong with its report."""
    for first in range(0, fed, fed // 4):
        monitor.feed(made.block(made.length + 40 + first, fed // 4))
        monitor.save()
    monitor.flush()
    text = to_json(
        monitor.report(datetime.now(UTC), DeviceDescription(id="lab"), "running", SessionCounters())
    )
    from_json(Report, text)  # as a viewer reads it
    for period in (*monitor.periods(), *monitor.periods_in_progress(force=True)):
        to_json(period)
    monitor.save()
    return "; ".join(negative_numbers(json.loads(text)))
