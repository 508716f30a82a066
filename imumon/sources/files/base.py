"""Recording contract: what every kind of recording offers, how it is read, and its errors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

from imumon.model.cures import option_text
from imumon.model.errors import ImumonError
from imumon.model.ledger import ColumnUse
from imumon.model.report_json import plain
from imumon.model.samples import Gap, Kind, SampleBlock
from imumon.model.units import share_text

HEAD_BYTES, HEAD_LINES = 1 << 14, 30
"""Bytes and lines at the start of a text that show its form: the header of a table must come within them."""
LONGEST_LINE = 1 << 16
"""Bytes of a line of text: a longer one is an invalid row, or data."""
SQLITE = b"SQLite format 3"
"""First bytes of a database: a bag of ROS 2, a history, or that of any program."""
BLOCK_BYTES = 1 << 20
"""Bytes of a raw capture that are decoded at once: enough samples to make work on arrays fast."""
ROWS, TABLE_BYTES = 1 << 14, 1 << 22
"""Rows in a block of a table, at most, and bytes of its lines or messages."""

Samples: TypeAlias = Literal["point", "average", "increment"]
"""What a number of a gyroscope or an accelerometer is: an output at an instant, a mean, or an integral."""

ROW_NOUNS = {
    **dict.fromkeys(("npz", "npy", "mat", "parquet", "json", "octave", "arrays"), "sample"),
    **dict.fromkeys(("bag", "px4", "ardupilot"), "message"),
}
"""Word for a row of a table in messages, by its form, where it is no line."""


class RecordingError(ImumonError):
    """A recording cannot be read, holds nothing that can be characterised, or cannot be written.

    The texts may quote the file: they have no control characters.
    """

    def __init__(self, code: str, message: str, cure: str = "") -> None:
        super().__init__(code, plain(message), plain(cure))

    def of(self, path: str) -> RecordingError:
        """Return the same error with the path of the recording in front of its message."""
        return RecordingError(self.code, f"{path}: {self.message}", self.cure)


def different_rates(text: str) -> RecordingError:
    """Return the error for two sensors in one table that have samples of their own."""
    alone = f"read each alone, {option_text(sensor='gyro')} and {option_text(sensor='accel')}"
    return RecordingError("different_rates", text, alone)


def not_in_order(name: str, back: float) -> RecordingError:
    """Return the error for rows in no order: of the steps of a time, a share goes back."""
    text = f"its rows are not in the order of {name}: {share_text(back)} of the steps go back"
    return RecordingError("rows_not_sorted", text, f"sort the rows by {name}")


class OptionError(ImumonError):
    """An option for reading is malformed or does not fit."""


class OptionNotApplicable(OptionError):
    """An option was given that this kind of recording does not have."""


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """How to read a recording.

    Attributes
    ----------
    kind : stream of a table that has several; None: the best.
    columns : channel to ``COLUMN`` or ``COLUMN:UNIT`` of a table; other channels are found by the names.
    rate_hz : Hz, configured sample rate; None: not configured.
    topic : of a bag or log; None: the only or best one.
    sensor : of a table, ``gyro`` or ``accel``, the only one that is read; None: all.
    where : by column of a table, the value of the rows that are read; empty: all rows.
    block_bytes : bytes of a raw capture that are decoded at once.
    units : unit by sensor, also of ``time``, of a table; others are found by the names.
    samples : ``point``, ``average`` or ``increment``, what a number of a table is; None: by the names.
    definitions : path of a ``.msg`` file, or of a directory of them, for messages that a bag does not define.
    accept : take what is proposed for columns that are not certain.
    """

    kind: Kind | None = None
    columns: Mapping[str, str] | None = None
    rate_hz: float | None = None
    topic: str | None = None
    sensor: str | None = None
    where: Mapping[str, str] | None = None
    block_bytes: int = BLOCK_BYTES
    units: Mapping[str, str] = field(default_factory=dict)
    samples: Samples | None = None
    definitions: str | None = None
    accept: bool = False


@dataclass(frozen=True, slots=True)
class RowSource:
    """Where rows of numbers come from: what messages about them need.

    Attributes
    ----------
    name : path of the file, or what else messages call the table.
    form : ``csv`` (text), ``npz``, ``npy``, ``mat``, ``parquet``, ``arrays`` (in
        memory), ``bag``, ``px4``, ``ardupilot``. How a unit is given and what a row is called depend on it.
    column_names : of all columns, also of those that are not used.
    title : what the samples are taken from, for people; empty: the form.
    stated_hz : Hz, rate that a comment before the table states; None: none does.
    """

    name: str
    form: str
    column_names: Sequence[str] = ()
    title: str = ""
    stated_hz: float | None = None

    @property
    def row(self) -> str:
        """Word for a row."""
        return ROW_NOUNS.get(self.form, "line")


class Recording:
    """Base class of recordings: iterate to get sample blocks, and the gaps between them.

    Attributes
    ----------
    header : what is known of the device, or None.
    started : ISO 8601 in UTC, date of the first sample; None: its clock shows no date.
    driver : URL scheme of the driver whose format it has; None: a format of no device.
    topic : of a bag, that is read; None: it has no topics of ROS.
    problem : why reading ended early, or None.
    remarks : what was left out or is doubtful, one line each.
    caveats : what limits the meaning of all numbers, codes of `imumon.model.messages.CAVEATS`.
    fed, discarded, bad_checksums : bytes read, bytes of no message, messages or rows that were invalid.
    ledger : what became of all rows or messages but those that are samples (`imumon.model.ledger`).
    columns : what became of each column, where it has any.
    progress : share that has been read, 0 to 1; None: unknown.
    """

    header: Mapping[str, Any] | None = None
    started: str | None = None
    driver: str | None = None
    topic: str | None = None
    problem: str | None = None
    remarks: Sequence[str] = ()
    caveats: Sequence[str] = ()
    fed = discarded = bad_checksums = 0
    ledger: Mapping[str, int] = {}
    columns: Sequence[ColumnUse] = ()
    progress: float | None = None

    def __iter__(self) -> Iterator[Sequence[SampleBlock | Gap]]:
        raise NotImplementedError

    def no_samples(self) -> RecordingError:
        """Return the error that says why the recording has no samples."""
        raise NotImplementedError
