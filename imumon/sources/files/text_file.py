"""Text file: a printed log as blocks of samples.

`printed_log` finds the tables in the head of the text, `columns` says what their numbers are, and `table` makes samples
of the rows. Memory does not grow with the length of the text, and a line that never ends is no more than one invalid
row. JSON without ends of lines is divided between its objects.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator, Mapping, Sequence

from imumon.model.ledger import Ledger, merged
from imumon.model.samples import SampleBlock
from imumon.sources.files.base import (
    HEAD_LINES,
    LONGEST_LINE,
    ROWS,
    TABLE_BYTES,
    ReadOptions,
    RecordingError,
    RowSource,
)
from imumon.sources.files.printed_log import (
    TOO_LONG_BYTES,
    PrintedTable,
    line_count,
    tables,
)
from imumon.sources.files.raw_capture import RawCapture
from imumon.sources.files.record_reader import RecordReader, line_kind
from imumon.sources.files.table import Table
from imumon.sources.files.table_choice import chosen_table
from imumon.sources.files.text_cells import decoded

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
            table, reading = chosen_table(printed, text, self._options, self.path)
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

    # ------------------------------------------------------------ lines

    def _line_blocks(self) -> Iterator[tuple[bytes, int]]:
        """Yield the lines that end in each chunk of the file, and their number, in linear time."""
        rest = b""  # of the line that has begun, no more than shows that it is too long: it may never end
        begun = lines = 0  # bytes up to the line that has begun, and the lines before it
        for chunk in self._plain_chunks():
            first, end, more = chunk.partition(b"\n")
            rest = (rest + first)[: LONGEST_LINE + 1]
            if not end:
                continue
            whole = more.rfind(b"\n") + 1
            block = (TOO_LONG_BYTES if len(rest) > LONGEST_LINE else rest) + b"\n" + more[:whole]
            count = line_count(block)
            lines += count
            self._lines.receive(count)
            begun = self.fed - len(more) + whole
            yield block, count
            rest = more[whole:][: LONGEST_LINE + 1]
        self.problem = self._capture.problem
        is_long = len(rest) > LONGEST_LINE
        if is_long and lines < HEAD_LINES:  # within the head no table is before it
            self._lines.receive()
            yield TOO_LONG_BYTES + b"\n", 1
        elif is_long or not _may_be_row(rest):
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
