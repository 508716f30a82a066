"""Sentence table: a table one of whose columns has the raw sentences of a device, usually beside a time.

Loggers write the time at which a sentence arrived, and the sentence: ``1700000000.123,$VNYMR,...*4F``, with or without
quotes. The sentence has the separator of the table in it, so it is taken out first; its decoder gives the samples, and
the other cells the time. Stamps of a host show lost samples, which the sentences alone do not. Sentences without a
time need a rate; bare ones, each a line, are a raw capture.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from imumon.model.ledger import ColumnUse
from imumon.model.report_json import plain
from imumon.model.samples import SampleBlock, Stream, sensor_of
from imumon.sources.column_names import Column, parse_name
from imumon.sources.device import RawDecoder, sample_blocks
from imumon.sources.files.base import HEAD_BYTES, HEAD_LINES, ReadOptions, RecordingError, RowSource
from imumon.sources.files.column_meaning import check_nothing_stated
from imumon.sources.files.columns import ColumnLayout
from imumon.sources.files.csv import TextTable, decoded
from imumon.sources.files.date_reader import DateReader
from imumon.sources.files.raw_capture import RawCapture
from imumon.sources.files.table_header import separator_of, split

SENTENCE = re.compile(rb'"?\$[^$"\r\n]*\*[0-9A-Fa-f]{2,4}"?')
"""Sentence with its check at the end, in quotes or not."""

SI = {"gyro": "rad/s", "accel": "m/s2", "mag": "gauss", "temperature": "degc", "pressure": "kpa"}
"""Units of samples, as `column_names` spells them."""


class SentenceTable(TextTable):
    """A table with a column of sentences, and one of times or a rate.

    Parameters
    ----------
    scheme : URL scheme of the driver whose decoder it is.
    decoder : of the driver.
    stream : of the sentences that are used.
    time : column of the time, without the sentence; None: there is none.
    """

    def __init__(
        self,
        capture: RawCapture,
        options: ReadOptions,
        decoder: RawDecoder,
        scheme: str,
        stream: Stream,
        time: Column | None,
    ) -> None:
        check_nothing_stated(capture.path, options)
        self.path, self.driver = capture.path, scheme
        self._capture, self._decoder, self._stream, self._time = capture, decoder, stream, time
        self._dates = DateReader()
        columns = tuple(
            Column(k, name, sensor_of(name), name.partition("/")[2] or None, unit=SI[sensor_of(name)])
            for k, name in enumerate(stream.channels)
        )
        table_layout = ColumnLayout(
            stream.kind, stream.channels, columns, (time,) if time is not None else ()
        )
        source = RowSource(self.path, "csv", title=f"csv of {stream.source}")
        self._begin(source, table_layout, options)
        self._column_names = ()
        self._other = self._invalid = 0
        self._first_invalid = 0

    def _parsed(self, block: bytes, places: range, *, last: bool = False) -> list[SampleBlock]:
        rows: list[list[float]] = []
        used: list[int] = []
        for line, place in zip(block.split(b"\n"), places, strict=False):
            match = SENTENCE.search(line)
            if match is None:  # a header, a comment, or the end of a truncated file
                self._lines.add(self._without_sentence(line))
                continue
            values = self._values(match[0].strip(b'"') + b"\r\n")
            if values is None:
                self._other += 1
                self._lines.add("other_message")
                continue
            if not values:
                self._invalid += 1
                self._lines.add("damaged")
                self._first_invalid = self._first_invalid or place
            row = values or [math.nan] * len(self._stream.channels)
            if self._time is not None:
                cells = cells_of(decoded(line[: match.start()] + line[match.end() :]))
                row = [*row, cell_time(cells, self._time.index, self._dates)]
            rows.append(row)
            # 0: `_line_remarks` reports an invalid sentence, and the row counts as lost without a remark of its own
            used.append(place if values else 0)
        return self._blocks(np.array(rows), used) if rows else []

    def _without_sentence(self, line: bytes) -> str:
        """Return what a line without a sentence is, as in the ledger."""
        if not line.strip():
            return "blank"
        return "comment" if line.lstrip()[:1] in (b"#", b"%") else "damaged" if b"$" in line else "header"

    def _line_ledger(self) -> Mapping[str, int]:
        return self._lines.counts()

    def _noted(self, blocks: list[SampleBlock]) -> list[SampleBlock]:
        blocks = super()._noted(blocks)
        time = [] if self._time is None else [ColumnUse(name=self._time.name, use="time")]
        # the columns of a sentence are those of the device
        self.columns = (*time, ColumnUse(name=self._stream.source, use=", ".join(self._stream.channels)))
        return blocks

    def _line_remarks(self) -> Sequence[str]:
        remarks = []
        if self._invalid:
            text = f"{self._invalid:,} sentences fail their check and count as lost"
            remarks.append(f"{text}; first line {self._first_invalid}")
        if self._other:
            remarks.append(
                f"{self._other:,} sentences of another type are not used, only {self._stream.source}"
            )
        return remarks

    def _values(self, sentence: bytes) -> list[float] | None:
        """Return the sample of a sentence; nothing of an invalid one, None of one of another type."""
        messages = self._decoder.messages
        blocks = sample_blocks(self._decoder.feed(sentence))
        # the decoder counts valid messages: this one failed its check
        if self._decoder.messages == messages:
            return []
        if not blocks or blocks[-1].stream != self._stream:
            return None
        values: list[float] = blocks[-1].values[-1].tolist()
        return values

    def no_samples(self) -> RecordingError:
        beside = "" if self._time is None else " beside a time"
        return RecordingError("no_rows", f"{self.path} has no valid sentence{beside}", "record it again")


def sentence_table(
    capture: RawCapture, options: ReadOptions, decoder: RawDecoder, scheme: str
) -> SentenceTable | None:
    """Return a capture as a table of sentences; None if they are bare, or have a better clock in them.

    Parameters
    ----------
    decoder : of the driver of `scheme`, with nothing in it yet.
    """
    lines = re.split(rb"\r\n?|\n", capture.head[:HEAD_BYTES])[:HEAD_LINES]
    matches = [SENTENCE.search(line) for line in lines]
    beside = [
        cells_of(decoded(line[: match.start()] + line[match.end() :]))
        for line, match in zip(lines, matches, strict=True)
        if match is not None
    ]
    first = next((k for k, match in enumerate(matches) if match is not None), 0)
    blocks = [
        b for m in matches if m is not None for b in sample_blocks(decoder.feed(m[0].strip(b'"') + b"\r\n"))
    ]
    # a sample clock in the sentences is better than the time beside them
    if not blocks or blocks[0].stream.clock != "none":
        return None
    time = _time_column(cells_of(decoded(lines[first - 1])) if first else [], beside)
    bare = all(
        match is None or not (match[0].endswith(b'"') or line[match.end() :].strip())
        for line, match in zip(lines, matches, strict=True)
    )
    if time is None and bare:
        return None
    return SentenceTable(capture, options, decoder, scheme, blocks[0].stream, time)


def _time_column(header: Sequence[str], rows: Sequence[Sequence[str]]) -> Column | None:
    """Return the best column of time beside the sentences; None: there is none."""
    names = [plain(header[k]) if k < len(header) else f"column {k + 1}" for k in range(len(rows[0]))]
    columns = [replace(parse_name(k, name), index=k) for k, name in enumerate(names)]
    dates = DateReader()
    # the columns of loggers often have no names: numbers that grow are a time, too
    readable = [k for k in range(len(names)) if _is_time([cell_time(cells, k, dates) for cells in rows])]
    times = [column for column in columns if column.quantity == "t" and column.index in readable]
    best = min(times or [columns[k] for k in readable], key=lambda column: column.rank, default=None)
    if best is None:
        return None
    return Column(best.index, best.name, "t", unit="s" if ":" in rows[0][best.index] else best.unit)


def cells_of(text: str) -> list[str]:
    """Return the cells of a line without its sentence, of which a separator is left."""
    return split(text, separator_of(text))


def cell_time(cells: Sequence[str], index: int, dates: DateReader) -> float:
    """Return the time in a cell; NaN if it is none."""
    cell = cells[index] if index < len(cells) else ""
    try:
        return float(cell)
    except ValueError:
        pass
    try:
        return dates.seconds(cell)
    except ValueError:
        return math.nan


def _is_time(values: Sequence[float]) -> bool:
    """Return whether some values can be times: each is there, and they grow."""
    return all(map(math.isfinite, values)) and values[-1] > values[0] and list(values) == sorted(values)
