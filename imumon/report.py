"""Report: what is published, as frozen dataclasses, and its JSON.

Standard library only, so that any tool may read a report with this file alone. The fields are the
contract of the project (docs/ZENOH.md): extended now and then, never bent. Unknown is None with a
reason, never 0 and never NaN; units are SI unless a name says otherwise.
"""

from __future__ import annotations

import json
import math
import re
import types
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from datetime import UTC, datetime
from functools import cache
from typing import Any, Literal, TypeAlias

SCHEMA = "imumon.report/1"

State: TypeAlias = Literal["starting", "running", "waiting", "stopped"]
Status: TypeAlias = Literal["measured", "upper_bound", "pending"]
GradeName: TypeAlias = Literal["navigation", "tactical", "industrial", "consumer"]
COEFFICIENTS = ("N", "B", "K")


@dataclass(frozen=True, slots=True, kw_only=True)
class Device:
    """Whose numbers these are, and what they describe."""

    id: str
    model: str | None = None
    serial: str | None = None
    firmware: str | None = None
    port: str | None = None
    baud: int | None = None
    stream: str | None = None
    sample_rate_hz: float | None = None
    alias_factor: float | None = None
    source: str | None = None  # the message the samples are taken from
    clock: str | None = None  # where their time comes from
    settings: Mapping[str, str] = field(default_factory=dict)  # registers that change the data
    remarks: tuple[str, ...] = ()  # what is not known or not as it should be, one line each


@dataclass(frozen=True, slots=True, kw_only=True)
class Session:
    """What was received, lost and left out since the first sample; the counts add up."""

    started: str | None = None  # null where nobody knows: of a recording that does not say
    elapsed_s: float = 0.0
    samples: int = 0
    missing: int = 0
    gaps: int = 0
    discarded_bytes: int = 0
    bad_checksums: int = 0
    disturbances: int = 0
    excluded_s: float = 0.0
    warmup_s: float = 0.0
    restarts: int = 0
    duplicates: int = 0  # samples that came twice and were counted once
    received_bytes: int = 0
    overruns: int = 0  # times the kernel or the queue had to drop bytes
    kernel_overruns: int | None = None  # of these the kernel's; null: its driver counts none
    most_queued_bytes: int | None = None  # most that ever waited for the daemon at once
    excluded_by: Mapping[str, float] = field(default_factory=dict)  # seconds by reason


@dataclass(frozen=True, slots=True, kw_only=True)
class Readable:
    value: float | None
    low: float | None
    high: float | None
    unit: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Coefficient:
    """N, B or K with its 95 % limits; `value` is None unless measured."""

    value: float | None
    low: float | None
    high: float | None
    status: Status
    unit: str
    readable: Readable
    reason: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Grading:
    nearest: GradeName | None = None
    meets: GradeName | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelGrade:
    N: Grading = Grading()
    B: Grading = Grading()
    nearest: GradeName | None = None
    meets: GradeName | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class DecidedBy:
    axis: str
    coefficient: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorGrade:
    """Headline grade of a sensor: the worst of its axes."""

    nearest: GradeName | None = None
    meets: GradeName | None = None
    decided_by: DecidedBy | None = None
    provisional: bool = True
    reason: str | None = None  # why there is none


@dataclass(frozen=True, slots=True, kw_only=True)
class Readings:
    """Classical slope readings of the curve; None where the curve has none."""

    N: float | None = None
    B: float | None = None
    K: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeTo:
    """Sensor seconds until the asked precision; None when it will not come."""

    N: float | None = None
    B: float | None = None
    K: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class FitQuality:
    chi2: float | None = None
    dof: int | None = None
    p_value: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Allan:
    """The curve, one entry an octave: measured points, their limits, and the fitted model."""

    tau_s: tuple[float, ...] = ()
    sigma: tuple[float, ...] = ()
    low: tuple[float | None, ...] = ()
    high: tuple[float | None, ...] = ()
    edf: tuple[float | None, ...] = ()
    model: tuple[float | None, ...] = ()
    used: tuple[bool, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Histogram:
    """Counts in equal bins from `start`, with the Gaussian of the same mean and deviation."""

    start: float
    width: float
    counts: tuple[int, ...]
    gaussian: tuple[float, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Distribution:
    """Shape of the values: verdict in words, modes found, the last minute beside everything."""

    verdict: str | None = None  # "Gaussian" or "not Gaussian, because ..."
    gaussian: bool | None = None
    modes: tuple[float, ...] = ()
    recent_mean: float | None = None  # of the last minute
    recent_std: float | None = None
    bias: float | None = None  # mean against what a sensor at rest reads
    bias_low: float | None = None
    bias_high: float | None = None
    bias_reason: str | None = None  # why there is none where there might be one
    correlation: Mapping[str, float] = field(default_factory=dict)  # with the sensor's other axes


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """A spectral line: amplitude is that of the sinusoid, in the channel's unit."""

    frequency_hz: float
    amplitude: float
    aliases_hz: tuple[float, ...] = ()  # true frequencies that would fold to here
    name: str | None = None  # "50 Hz mains", where one fits


@dataclass(frozen=True, slots=True, kw_only=True)
class Spectrum:
    """One-sided power spectral density, unit^2/Hz, with the averages behind each bin."""

    frequency_hz: tuple[float, ...]
    density: tuple[float, ...]
    averages: tuple[int, ...]
    lines: tuple[Line, ...] = ()
    white: float | None = None  # N read from the white level


@dataclass(frozen=True, slots=True, kw_only=True)
class Drift:
    """Slope of the mean, with 95 % limits against the fitted noise."""

    per_hour: float | None = None
    per_hour_low: float | None = None
    per_hour_high: float | None = None
    significant: bool | None = None
    per_degC: float | None = None
    per_degC_low: float | None = None
    per_degC_high: float | None = None
    explained: float | None = None  # share of the long-tau variance that temperature explains
    steady_N: Coefficient | None = None  # as it would be had the temperature stood still, where that matters;
    steady_B: Coefficient | None = None  # the channel's own N, B, K are with the temperature's part
    steady_K: Coefficient | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """N, B or bias against the hours before, before a step, or against a baseline."""

    against: str  # "hours before", "time before" (a step of the bias) or "baseline"
    quantity: str  # "N", "B" or "bias"
    before: float
    now: float
    ratio: float | None
    sigma: float  # by how many standard errors they differ


@dataclass(frozen=True, slots=True, kw_only=True)
class Strip:
    """Least and greatest value in equal columns of time, oldest first; None where nothing came."""

    start_s: float  # seconds since the first sample
    column_s: float
    low: tuple[float | None, ...]
    high: tuple[float | None, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Signal:
    """What a signal view draws of one channel; published beside the report, one key a channel."""

    channel: str
    unit: str
    minute: Strip | None = None
    hour: Strip | None = None
    everything: Strip | None = None
    histogram: Histogram | None = None
    spectrum: Spectrum | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Channel:
    unit: str
    count: int = 0
    mean: float | None = None
    std: float | None = None
    min: float | None = None
    max: float | None = None
    skewness: float | None = None
    excess_kurtosis: float | None = None
    last: float | None = None
    N: Coefficient | None = None
    B: Coefficient | None = None
    K: Coefficient | None = None
    grade: ChannelGrade | None = None
    readings: Readings | None = None
    time_to: TimeTo | None = None
    fit: FitQuality | None = None
    caveats: tuple[str, ...] = ()
    allan: Allan | None = None
    distribution: Distribution | None = None
    histogram: Histogram | None = None
    spectrum: Spectrum | None = None
    drift: Drift | None = None
    changes: tuple[Change, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """Something that happened: `kind` is one word, `text` a line for people."""

    time: str
    kind: str
    text: str
    device: str
    elapsed_s: float | None = None
    channel: str | None = None
    length_s: float | None = None
    size: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    schema: str = SCHEMA
    time: str
    device: Device
    state: State
    session: Session
    grade: Mapping[str, SensorGrade] = field(default_factory=dict)
    channels: Mapping[str, Channel] = field(default_factory=dict)
    caveats: tuple[str, ...] = ()  # those that hold for the whole record
    period_s: float = 1.0  # between two reports
    speed: float = 1.0  # sensor seconds in a second of the room, other than 1 in a time-lapse
    limits: Mapping[str, Mapping[str, Mapping[str, float]]] = field(default_factory=dict)


def stamp(moment: datetime) -> str:
    """ISO 8601 in UTC, with Z.

    >>> stamp(datetime(2026, 1, 2, 3, 4, 5, 678000, tzinfo=UTC))
    '2026-01-02T03:04:05.678Z'
    """
    return moment.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


_PLAIN = {str, int, bool, type(None)}


def to_dict(part: Any) -> Any:
    """Plain dicts, lists and numbers of a report or any part of one.

    Raises
    ------
    ValueError : a number is not finite.
    """
    kind: Any = type(part)
    if kind in _PLAIN:
        return part
    if isinstance(part, float):
        if not math.isfinite(part):
            raise ValueError("a report holds finite numbers or None")
        return part
    if names := _names(kind):
        return {name: to_dict(getattr(part, name)) for name in names}
    if isinstance(part, Mapping):
        return {str(key): to_dict(value) for key, value in part.items()}
    return [to_dict(value) for value in part]


@cache
def _names(cls: type) -> tuple[str, ...]:
    """Fields of a dataclass; none of anything else."""
    return tuple(f.name for f in fields(cls)) if is_dataclass(cls) else ()


def to_json(part: Any, *, indent: int | None = None) -> str:
    """JSON text of a report or any part of one: UTF-8, finite numbers or null.

    Raises
    ------
    ValueError : a number is not finite.
    """
    if indent is None:
        return _COMPACT.encode(to_dict(part))
    return json.dumps(to_dict(part), allow_nan=False, ensure_ascii=False, indent=indent)


_COMPACT = json.JSONEncoder(allow_nan=False, ensure_ascii=False, separators=(",", ":"))


T = typing.TypeVar("T")


_CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
_BESIDE: Mapping[type, tuple[str, ...]] = {
    Allan: ("tau_s", "sigma", "low", "high", "edf", "model", "used"),
    Histogram: ("counts", "gaussian"),
    Spectrum: ("frequency_hz", "density", "averages"),
    Strip: ("low", "high"),
}
"""Arrays that lie beside one another: as long as each other, or not there."""


def plain(text: str) -> str:
    """Text without what would steer a terminal or turn the direction of writing.

    >>> plain("VN-100\\x1b[2J T\\u202e")
    'VN-100[2J T'
    """
    return text if text.isascii() and text.isprintable() else _CONTROL.sub("", text)


def from_json(cls: type[T], text: str | bytes) -> T:
    """Read JSON as `cls` (`Report`, `Event`, `Signal` ...); what it does not know is passed over.

    Strangers write reports too: text is taken as `plain`.

    Raises
    ------
    ValueError : not JSON, or not of that shape.
    """
    try:
        return typing.cast(T, _reader(typing.cast(Any, cls))(json.loads(text)))
    except (TypeError, AttributeError, KeyError, RecursionError) as error:
        raise ValueError(f"not a {cls.__name__.lower()} of {SCHEMA}: {error}") from None


@cache
def _reader(hint: Any) -> Callable[[Any], Any]:
    """Function that makes a value of type `hint` of plain JSON data."""
    origin, words = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        inner = _reader(next(word for word in words if word is not type(None)))
        return lambda data: None if data is None else inner(data)
    if isinstance(hint, type) and is_dataclass(hint):
        readers = {name: _reader(word) for name, word in typing.get_type_hints(hint).items()}
        beside = _BESIDE.get(hint, ())

        def make(data: Any) -> Any:
            made = hint(**{n: readers[n](value) for n, value in data.items() if n in readers})
            if len({len(getattr(made, name)) for name in beside} - {0}) > 1:
                raise TypeError(f"arrays of different lengths in {hint.__name__}")
            return made

        return make
    if origin is tuple:
        inner = _reader(words[0])
        return lambda data: tuple(map(inner, _checked(data, list)))
    if origin is Mapping:
        inner = _reader(words[1])
        return lambda data: {plain(key): inner(value) for key, value in data.items()}
    kind = str if origin is Literal else hint
    if kind is str:
        return lambda data: plain(_checked(data, str))
    return lambda data: data if type(data) is kind and kind is not float else _checked(data, kind)


def _checked(data: Any, kind: Any) -> Any:
    """Data of that type: a whole number may stand for a number and the other way round, NaN for none."""
    if type(data) is kind and (kind is not float or math.isfinite(data)):
        return data
    if kind is float and type(data) is int:
        return data
    if kind is int and type(data) is float and data.is_integer():
        return int(data)
    raise TypeError(f"{str(data)[:40]!r} where {kind.__name__} belongs")
