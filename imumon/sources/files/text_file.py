"""Text file: a printed log as blocks of samples.

`printed_log` finds the tables in the head of the text, `columns` says what their numbers are, and `table` makes samples
of the rows. Memory does not grow with the length of the text, and a line that never ends is no more than one invalid
row. JSON without ends of lines is divided between its objects.
"""

from __future__ import annotations

import codecs
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from imumon.model.cures import option_text
from imumon.model.ledger import Ledger, merged
from imumon.model.samples import INERTIAL, SampleBlock
from imumon.sources.files.base import (
    HEAD_LINES,
    LONGEST_LINE,
    ROWS,
    TABLE_BYTES,
    ReadOptions,
    RecordingError,
    RowSource,
)
from imumon.sources.files.column_reader import read_columns
from imumon.sources.files.columns import Reading, Use, parse_map
from imumon.sources.files.formats import known_format
from imumon.sources.files.printed_log import (
    TOO_LONG_BYTES,
    PrintedTable,
    line_count,
    tables,
)
from imumon.sources.files.raw_capture import RawCapture
from imumon.sources.files.record_reader import RecordReader, line_kind
from imumon.sources.files.table import Table
from imumon.sources.files.text_cells import decoded, number_of
from imumon.sources.files.unit_grammar import Unit

SHOWN_BYTES = 1 << 17
"""Bytes at the start of a text from which its form is found, and the rest of their chunk: half a minute of samples."""

COLOUR = re.compile(rb"\x1b\[[0-9;]*m")
"""Colours that programs print for a terminal; one that a chunk splits stays."""

HEXADECIMAL = re.compile(
    r"(?:\b0x[0-9A-Fa-f]+\b\W{1,4}(?:\w+\W{1,3})?){3}|(?:\b(?=\d{0,3}[A-F])[0-9A-F]{4}\b\W{1,3}){3}"
)
"""Three hexadecimal numbers, or words that are them."""

COMPLETE = "check that it is complete"
"""Cure for a text without records."""


class TextFile(Table):
    """A text, gzip or not, as blocks of samples.

    Iterating raises `RecordingError` if its columns are not those of an inertial sensor.
    """

    def __init__(self, capture: RawCapture, options: ReadOptions) -> None:
        self._capture, self._options, self.path = capture, options, capture.path
        self._lines = Ledger()
        self._reader: RecordReader | None = None
        self._others: list[PrintedTable] = []

    def __iter__(self) -> Iterator[list[SampleBlock]]:
        blocks = self._line_blocks()
        head = b""
        for block, _ in blocks:
            head += block
            if len(head) > SHOWN_BYTES:
                break
        table = self._open(head)
        before = table.begin
        parts = head.split(b"\n", before)
        for line in parts[:before]:
            self._lines.add(line_kind(line, table.header) or "header")
        waiting = [parts[-1]]
        count, size = line_count(parts[-1]), len(parts[-1])
        for block, lines in blocks:
            # a block is handed on when the next one is there: only then it is known not to be the last one
            if size > TABLE_BYTES or count >= ROWS:
                yield self._parsed(b"".join(waiting), before, last=False)
                before += count
                waiting, count, size = [], 0, 0
            waiting.append(block)
            count += lines
            size += len(block)
        yield self._parsed(b"".join(waiting), before, last=True)
        yield self._finish()

    def _parsed(self, block: bytes, before: int, *, last: bool) -> list[SampleBlock]:
        assert self._reader is not None
        rows, places = self._reader.read(block, before + 1, last=last)
        self.problem = self._reader.problem or self.problem
        return self._blocks(rows, places)

    # ------------------------------------------------------------ the head

    def _open(self, head: bytes) -> PrintedTable:
        """Find the table and its columns, and prepare to read it."""
        text = "\n".join(map(decoded, head.split(b"\n")))
        for place, line in enumerate(head.split(b"\n")[:HEAD_LINES], 1):
            if line == TOO_LONG_BYTES or len(line) > LONGEST_LINE:
                message = f"{self.path} line {place} is longer than {LONGEST_LINE:,} bytes"
                raise RecordingError(
                    "line_too_long", message, "check that it is a table with one row per line"
                )
        try:
            printed = tables(text)
            if not printed:
                raise RecordingError("no_rows", "it has no records with numbers", COMPLETE)
            table, reading = self._chosen(printed, text)
        except RecordingError as error:
            are_hexadecimal = 10 * len(HEXADECIMAL.findall(text)) > text.count("\n")
            if error.code in ("no_rows", "no_sensor") and are_hexadecimal:
                cure = "write them as decimal numbers"
                error = RecordingError(error.code, "its numbers are hexadecimal", cure)
            raise error.of(self.path) from None
        layout = reading.checked(self.path, accept=self._options.accept).layout(self._options.kind)
        stated_hz = table.rate.hz if table.rate is not None and table.rate.of_rows else None
        source = RowSource(self.path, "csv", reading.names, stated_hz=stated_hz)
        columns = self._begin(source, layout, self._options)
        self._reader = RecordReader(
            self.path, table, columns, [each for each in printed if each is not table]
        )
        return table

    def _chosen(self, printed: Sequence[PrintedTable], text: str) -> tuple[PrintedTable, Reading]:
        """Return the table that is read, and what its columns are."""
        wanted = self._options.where or {}
        labels = [_labels(k, each) for k, each in enumerate(printed)]
        places = [k for k, of in enumerate(labels) if _are_chosen(of, wanted)]
        if not places:
            listed = ", ".join(code for each in printed for _, code in each.codes)
            message = f"no row of the first has {option_text(where=wanted)}"
            raise RecordingError("no_such_rows", message, f"there are {listed or 'no such columns'}")
        readings = self._readings({k: printed[k] for k in places}, text)
        sensors = {k: [use.key for use in each.uses if use.key in INERTIAL] for k, each in readings.items()}
        best = min(readings, key=lambda k: (len(sensors[k]) < len(INERTIAL), "gyro" not in sensors[k], k))
        if len(readings) == 1 or wanted:
            return printed[best], readings[best]
        choices = {k: _choice(k, printed, [*readings]) for k in readings}
        texts = {k: f"{option_text(where=choice)} ({'+'.join(sensors[k])})" for k, choice in choices.items()}
        others = ", ".join(text for k, text in texts.items() if k != best)
        reason = (
            f"the rows are of several sensors: {option_text(where=choices[best])} is proposed; others are "
        )
        known = Unit("rows", 1.0)
        question = Use("rows", known=known, reason=reason + others, assumptions=("assumed_columns",))
        where = tuple(choices[best].items())
        return printed[best], replace(readings[best], uses=(*readings[best].uses, question), where=where)

    def _readings(self, wanted: Mapping[int, PrintedTable], text: str) -> dict[int, Reading]:
        """Return what the columns of tables are, of those that have a sensor; raise `RecordingError` if none has."""
        readings: dict[int, Reading] = {}
        faults: list[RecordingError] = []
        for k, table in wanted.items():
            try:
                readings[k] = self._reading(table, text)
            except RecordingError as error:
                faults.append(error)
        if not readings:
            raise max(faults, key=lambda error: error.code != "no_sensor")
        return readings

    def _reading(self, table: PrintedTable, text: str) -> Reading:
        """Return what the columns of a table are, with what is known of its format."""
        options, names = self._options, table.names
        top = "\n".join(text.split("\n", table.begin + 3)[: table.begin + 3])
        known = known_format(top, names)
        if known is not None and (not known.columns or len(names) >= len(known.columns)):
            if known.columns:
                kept = len(names) - len(known.columns)
                names = (*(name or f"column {k + 1}" for k, name in enumerate(names[:kept])), *known.columns)
            stated = parse_map(known.filled_map(top)) if known.map else {}
            options = replace(
                options, columns=stated | dict(options.columns or {}), units={**known.units, **options.units}
            )
        place = f"{table.source} {os.path.basename(self.path).partition('.')[0]}"
        return read_columns(
            names,
            table.units,
            table.rows,
            options,
            source=place,
            rate=table.rate,
            dates=table.dates,
        )

    # ------------------------------------------------------------ lines

    def _line_blocks(self) -> Iterator[tuple[bytes, int]]:
        """Yield the lines that end in each chunk of the file, and their number, in linear time."""
        rest, skipping = b"", False  # the line that has begun; whether it is too long, and waits for its end
        begun = lines = 0  # bytes up to the line that has begun, and the lines before it
        for chunk in self._plain_chunks():
            first, end, more = chunk.partition(b"\n")
            if not skipping:
                rest += first
            # of a file without ends of lines, such as binary data, no more than this is in memory
            skipping = skipping or len(rest) > LONGEST_LINE
            if not end:
                rest = b"" if skipping else rest
                continue
            whole = more.rfind(b"\n") + 1
            block = (TOO_LONG_BYTES if skipping else rest) + b"\n" + more[:whole]
            count = line_count(block)
            lines += count
            self._lines.receive(count)
            begun = self.fed - len(more) + whole
            yield block, count
            rest, skipping = more[whole:], False
        self.problem = self._capture.problem
        if skipping and lines < HEAD_LINES:  # within the head no table is before it
            self._lines.receive()
            yield TOO_LONG_BYTES + b"\n", 1
        elif skipping or not _may_be_row(rest):
            # a file that was made longer than its rows, a disk that was not written, data of another kind
            text = f"{self.path} has {self.fed - begun:,} bytes behind its last line that are no row"
            self.problem = self.problem or f"{text}: only the part before is used"
        elif rest.strip():
            self._lines.receive()
            yield rest + b"\n", 1

    def _plain_chunks(self) -> Iterator[bytes]:
        """Yield the chunks of the file with one kind of end of lines, without colours, and one object in a line."""
        carriage = b""  # at the end of a chunk: its line feed may follow
        joined = _has_joined_objects(self._capture.head[:LONGEST_LINE])
        encoding = utf_16(self._capture.head)
        decoder = None if encoding is None else codecs.getincrementaldecoder(encoding)("replace")
        for chunk in self._capture:
            self.fed += len(chunk)
            if decoder is not None:
                chunk = decoder.decode(chunk).encode()
            self.problem, self.progress = self._capture.problem, self._capture.progress
            if carriage or b"\r" in chunk:
                # all ends of lines become \n: Windows writes \r\n, which a chunk may split, and old programs \r
                chunk = carriage + chunk
                carriage = b"\r" if chunk.endswith(b"\r") else b""
                chunk = chunk.removesuffix(b"\r").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
            if b"\x1b" in chunk:  # colours of a terminal
                chunk = COLOUR.sub(b"", chunk)
            if joined:
                chunk = chunk.replace(b"}, {", b"},\n{").replace(b"},{", b"},\n{")
            yield chunk

    def _line_remarks(self) -> Sequence[str]:
        return [] if self._reader is None else self._reader.remarks

    def _line_ledger(self) -> Mapping[str, int]:
        return merged(self._lines.counts(), {} if self._reader is None else self._reader.ledger)

    def no_samples(self) -> RecordingError:
        return RecordingError("no_rows", f"{self.path} has no row of numbers", COMPLETE)


def _labels(place: int, table: PrintedTable) -> dict[str, str]:
    """Return by which column and value the rows of a table are chosen, the best last."""
    labels = {"table": str(place + 1)}
    for k, code in table.codes[::-1]:
        labels |= {str(k + 1): code, table.names[k].strip() or str(k + 1): code}
    return labels


def _choice(place: int, printed: Sequence[PrintedTable], places: Sequence[int]) -> dict[str, str]:
    """Return by which columns and values one of some tables is chosen."""
    codes = {
        printed[place].names[k].strip() or str(k + 1): code
        for k, code in printed[place].codes
        if any((k, code) not in printed[other].codes for other in places)
    }
    return codes or {"table": str(place + 1)}


def _are_chosen(labels: Mapping[str, str], wanted: Mapping[str, str]) -> bool:
    return all(_same(labels.get(column), value) for column, value in wanted.items())


def _same(value: str | None, other: str) -> bool:
    """Return whether two values of a code are the same text or number."""
    if value is None or value.lower() == other.lower():
        return value is not None
    number = number_of(value)
    return number is not None and number == number_of(other)


def _has_joined_objects(head: bytes) -> bool:
    """Return whether a text is JSON with several objects in a line."""
    # objects one behind the other in a line, and lines of several objects
    objects = head.count(b"}, {") + head.count(b"},{")
    return head.lstrip()[:1] in (b"[", b"{") and objects > 4 * head.count(b"\n")


def _may_be_row(rest: bytes) -> bool:
    """Return whether the bytes behind the last end of a line may be a line, or the begin of one."""
    return all(character.isprintable() or character in "\t\v\f\x1a" for character in decoded(rest))


JUDGED_BYTES = 40
"""Bytes by which UTF-16 is recognised; a file with less than half of them is not judged."""


def utf_16(head: bytes) -> str | None:
    """Return the name of an encoding in which every second byte of a Latin text is 0; None: it is not so.

    >>> utf_16("t,gx,gy,gz,ax,ay,az".encode("utf-16-le")), utf_16(b"t,gx,gy"), utf_16(bytes(40))
    ('UTF-16LE', None, None)
    """
    few = head[:JUDGED_BYTES]
    if head.startswith((b"\xff\xfe", b"\xfe\xff")) and b"\0" in few:
        return "UTF-16"
    even, odd = few[::2], few[1::2]
    if len(few) < JUDGED_BYTES // 2 or any(even) == any(odd):
        return None
    return "UTF-16LE" if any(even) and all(even) else "UTF-16BE" if all(odd) else None
