"""Ledger: what became of everything that was received.

A row of a file, a line, a datagram or a message is received, and then it is a sample, or it is none for one reason. A
ledger counts both sides where they happen, so that each is a check of the other:

    received = samples + the sum of all reasons

What counts as one unit depends on the source:

==================  ============================================================================================
source              unit
==================  ============================================================================================
text                line, with header, comments and blank lines; of records (JSON, YAML, labelled lines) a record
arrays              row
bag, log            message of the topic that is read
bytes of a device   message with a frame, also one that fails its check; of `lines:` a line
topic               message, also of the further topics that are joined with it
==================  ============================================================================================

Each stage counts what it leaves out, once: what the reader reports as invalid, the stages behind it do not count again.
`samples` are those of the record that a report describes; those of a record before it are `earlier_record`.

>>> reader, monitor = Ledger(), Ledger()
>>> reader.receive(5)
>>> reader.add("header")
>>> monitor.add("samples", 3)
>>> monitor.add("repeated")
>>> total = merged(reader.counts(), monitor.counts())
>>> total, imbalance(total)
({'received': 5, 'samples': 3, 'header': 1, 'repeated': 1}, 0)
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

RECEIVED = "received"

SAMPLES = "samples"

REASONS: Mapping[str, str] = {
    SAMPLES: "samples of the record",
    "header": "lines that name columns, or stand before them",
    "comment": "comments",
    "blank": "blank lines",
    "not_numbers": "without a number where one is needed",
    "wrong_columns": "with another number of columns",
    "not_finite": "with a number that is not finite, or beyond any sensor",
    "repeated": "that repeat a sample",
    "wrong_time": "with a time that the time of their neighbours refutes",
    "out_of_order": "with a time before that of the sample before, and no restart",
    "other_sensor": "of another sensor",
    "other_sender": "of another sender",
    "damaged": "damaged: a check fails, or the form is wrong",
    "other_message": "of another type",
    "part": "that are a part of a sample together with others",
    "start": "before the first sample",
    "earlier_record": "samples of a record that has ended",
    "pending": "that wait for what follows them, or whose end is missing",
}
"""What becomes of something that is received, by its stable code."""


MOST_COLUMNS = 256
"""Columns that an account lists: a report has no longer list."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnUse:
    """What became of a column of a file or of lines."""

    name: str  # as in the file, with its unit
    use: str | None = None  # "time", "interval", or a channel such as "gyro/x"; null: it is not used
    reason: str | None = None  # why it is not used


def column_account(columns: Sequence[ColumnUse]) -> tuple[ColumnUse, ...]:
    """Return as many columns as a report lists: those that are used, then the first others."""
    if len(columns) <= MOST_COLUMNS:
        return tuple(columns)
    used = [column for column in columns if column.use is not None]
    others = [column for column in columns if column.use is None]
    return tuple([*used, *others][:MOST_COLUMNS])


class Ledger:
    """Counts of one stage: `receive` and `add`, then `counts`."""

    def __init__(self) -> None:
        self._received = 0
        self._counts: Counter[str] = Counter()

    def receive(self, count: int = 1) -> None:
        """Count what has been received."""
        self._received += count

    def add(self, reason: str, count: int = 1) -> None:
        """Count what has become of some of it; KeyError: the reason is none of `REASONS`."""
        if reason not in REASONS:
            raise KeyError(reason)
        self._counts[reason] += count

    def counts(self, **more: int) -> dict[str, int]:
        """Return the counts, with those that the caller holds; none that is 0."""
        counts = Counter(self._counts)
        counts.update(more)
        return _sorted(self._received, counts)


def merged(*ledgers: Mapping[str, int]) -> dict[str, int]:
    """Return the sum of ledgers of stages that follow each other, or of parts of a record."""
    counts: Counter[str] = Counter()
    for ledger in ledgers:
        counts.update(ledger)
    return _sorted(counts.pop(RECEIVED, 0), counts)


def _sorted(received: int, counts: Mapping[str, int]) -> dict[str, int]:
    """Return a ledger in the order of `REASONS`, without what did not occur."""
    return {RECEIVED: received} | {name: counts[name] for name in REASONS if counts.get(name)}


def imbalance(ledger: Mapping[str, int]) -> int:
    """Return what was received less what became of it: 0."""
    return 2 * ledger.get(RECEIVED, 0) - sum(ledger.values())


def with_received(ledger: Mapping[str, int]) -> dict[str, int]:
    """Return a ledger of samples whose source counts nothing: it received what the ledger has."""
    counts = {name: count for name, count in ledger.items() if name != RECEIVED}
    return _sorted(sum(counts.values()), counts)


def ledger_text(ledger: Mapping[str, int]) -> str:
    """Return a ledger in one line; empty: nothing was received.

    >>> ledger_text({"received": 1200, "samples": 1198, "header": 1, "repeated": 1})
    '1,200 received: 1,198 samples, 1 header, 1 repeated'
    """
    if not ledger.get(RECEIVED):
        return ""
    parts = [
        f"{count:,} {name.replace('_', ' ')}" for name, count in ledger.items() if name != RECEIVED and count
    ]
    return f"{ledger[RECEIVED]:,} received: {', '.join(parts)}"
