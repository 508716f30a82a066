"""Text records: text in which the names are beside the numbers, as a table.

Programs write a sample as JSON, as lines with labels (`text_fields`), or as documents of ``rostopic echo``::

    header:
      stamp:
        secs: 1700000000
    angular_velocity:
      x: 0.005
    ---

`RecordText` turns records into the lines of a table with a header, so that everything that is known of tables holds:
names, units, dates, rows of several sensors. The first records give the header. A record that cannot be read becomes a
line that is no row, and is counted as one.

>>> list(yaml_records(["a:", "  x: 1", "  y: [1, 2]", "---", "a:", "  x: 2"]))
[{'a.x': '1'}, {'a.x': '2'}]
>>> [*json_records([b'[{"x": 1},', b' {"x": 2}]'])], [*json_records([b'{"x": [1, 2], "n": [3, 4],', b'"k": "a"}'])]
([{'x': '1'}, {'x': '2'}], [{'x[0]': '1', 'x[1]': '2', 'n[0]': '3', 'n[1]': '4', 'k': 'a'}])
"""

from __future__ import annotations

import codecs
import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import chain, islice
from typing import Any

from imumon.model.ledger import RECEIVED, Ledger, merged
from imumon.model.samples import INERTIAL
from imumon.sources.column_names import parse_names, triples
from imumon.sources.files.base import HEAD_BYTES, LONGEST_LINE, RecordingError
from imumon.sources.files.raw_capture import RawCapture
from imumon.sources.text_fields import LONGEST_LIST, RecordAssembler, fields_of, json_fields

HEADER_RECORDS = 200
"""Records whose names are the header."""

LONGEST_RECORD = 1 << 24
"""Bytes of a record in JSON: one object may hold a whole recording in lists."""

HEAD_LINES = 60
"""Lines that show the form of a text."""

LABELLED = 0.5
"""Share of the lines with characters that must have labelled numbers."""

INVALID_RECORD = "no record"
"""Line of the table in the place of a record that cannot be read."""

SEPARATOR = "\t"
CHUNK = 1 << 16
"""Bytes that are handed on at once."""

Record = Mapping[str, str]


class RecordText:
    """The records of a capture as lines of a table; read as a `RawCapture`.

    Attributes
    ----------
    form : what the text is, for people.
    ledger : of the lines beside the records, and less the line of names, which no file has.
    """

    header = None

    def __init__(self, capture: RawCapture, form: str) -> None:
        self.path, self.form = capture.path, form
        self._capture = capture
        self._beside = Ledger()

    @property
    def problem(self) -> str | None:
        """Why reading ended early."""
        return self._capture.problem

    @property
    def progress(self) -> float | None:
        """Share of the bytes on disk that has been read."""
        return self._capture.progress

    @property
    def ledger(self) -> dict[str, int]:
        """What became of the lines that belong to no record."""
        return merged(self._beside.counts(), {RECEIVED: -1, "header": -1})

    def __iter__(self) -> Iterator[bytes]:
        records = _READERS[self.form](self._capture, self._beside)
        first = list(islice(records, HEADER_RECORDS))
        names = list(dict.fromkeys(name for record in first if record for name in record))
        if not names:
            raise RecordingError(
                "no_rows", f"{self.path} has no record with numbers", "check that it is complete"
            )
        yield f"{SEPARATOR.join(names)}{SEPARATOR}\n".encode()
        waiting: list[bytes] = []
        size = 0
        for record in chain(first, records):
            waiting.append(_line(record, names) if record else f"{INVALID_RECORD}\n".encode())
            size += len(waiting[-1])
            if size > CHUNK:
                yield b"".join(waiting)
                waiting, size = [], 0
        yield b"".join(waiting)


def _line(record: Record, names: Sequence[str]) -> bytes:
    # without an end of its own, a table of one column would have no separator
    cells = (record.get(name, "").translate(_NO_SEPARATOR) for name in names)
    return f"{SEPARATOR.join(cells)}{SEPARATOR}\n".encode()


_NO_SEPARATOR = str.maketrans('\t\r\n"', "    ")


def record_text(capture: RawCapture) -> RecordText | None:
    """Return a capture as a table of its records; None: its text has none with the names of a sensor."""
    head = capture.head[:HEAD_BYTES]
    if b"\0" in head:
        return None
    text = head.decode("utf-8-sig", "replace")
    if text.lstrip()[:1] in ("{", "["):
        return RecordText(capture, "json")
    lines = [line for line in text.splitlines()[:-1][:HEAD_LINES] if line.strip()]
    # lists of covariances are longer than the head
    if any(line.strip() == "---" for line in text.splitlines()) and _names_sensor(
        yaml_records(text.splitlines())
    ):
        return RecordText(capture, "yaml")
    labelled = [fields for line in lines if (fields := fields_of(line))]
    # the greeting of a library comes before the first sample
    if len(labelled) >= max(2, LABELLED * len(lines)) and _names_sensor(labelled_records(lines)):
        return RecordText(capture, "labelled")
    return None


def _names_sensor(records: Iterable[Record]) -> bool:
    """Return whether the names of some records are those of a sensor, or of three axes."""
    names = list(dict.fromkeys(name for record in islice(records, HEAD_LINES) for name in record))
    return bool(triples(names)) or any(column.quantity in INERTIAL for column in parse_names(names))


def lines_of_chunks(chunks: Iterable[bytes]) -> Iterator[str]:
    """Yield the lines of some chunks; of one that is too long, nothing."""
    rest, skipping = b"", False
    for chunk in chunks:
        *lines, rest = (rest + chunk.replace(b"\r", b"\n")).split(b"\n")
        for line in lines:
            if not skipping and len(line) <= LONGEST_LINE:
                yield line.decode("utf-8", "replace")
            skipping = False
        if len(rest) > LONGEST_LINE:
            rest, skipping = b"", True
    if rest and not skipping:
        yield rest.decode("utf-8", "replace")


def labelled_records(lines: Iterable[str], beside: Ledger | None = None) -> Iterator[Record]:
    """Yield the records of lines with labels; lines without are left out, as the greeting of a library, and counted."""
    assembler = RecordAssembler()
    for line in lines:
        fields = fields_of(line)
        if not fields and beside is not None:
            beside.receive()
            beside.add("other_message" if line.strip() else "blank")
        if fields and (record := assembler.add(fields)) is not None:
            yield record
    if (record := assembler.finish()) is not None:
        yield record


_ENTRY = re.compile(r"^(\s*)(?:-\s+)?([\w./-]+):\s*(.*?)\s*$")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", re.IGNORECASE)


def yaml_records(lines: Iterable[str]) -> Iterator[Record]:
    """Yield the numbers of each document by their paths; lists have no names and are left out."""
    fields: dict[str, str] = {}
    path: list[tuple[int, str]] = []
    for line in lines:
        if line.strip() == "---":
            if fields:
                yield fields
            fields, path = {}, []
        elif (entry := _ENTRY.match(line)) is not None:
            depth = len(entry[1])
            while path and path[-1][0] >= depth:
                path.pop()
            if not entry[3]:
                path.append((depth, entry[2]))
            elif _NUMBER.fullmatch(entry[3]):
                fields[".".join([*(name for _, name in path), entry[2]])] = entry[3]
    if fields:
        yield fields


def json_records(chunks: Iterable[bytes], beside: Ledger | None = None) -> Iterator[Record]:
    """Yield the objects of JSON: one in a line, in a list, or one of lists that are columns; count lines beside."""
    decoder, text = json.JSONDecoder(), ""
    characters = codecs.getincrementaldecoder("utf-8")("replace")
    for chunk in chunks:
        text += characters.decode(chunk)
        place = 0
        while (begin := text.find("{", place)) >= 0:
            _count_beside(text[place:begin], beside)
            try:
                value, place = decoder.raw_decode(text, begin)
            except RecursionError:
                raise RecordingError(
                    "json_too_deep", "its JSON has too many levels", "write it as CSV"
                ) from None
            except ValueError:
                end = text.find("\n", begin)
                # an object ends with its line, unless it has several: those begin with a brace alone
                if 0 <= end < len(text) - 1 and text[end + 1] == "{" and end > begin + 1:
                    yield {}
                    place = end + 1
                    continue
                place = begin
                break
            yield from _records_of(value)
        text = text[place:] if place else text
        if len(text) > LONGEST_RECORD:
            raise RecordingError(
                "line_too_long",
                f"an object of its JSON is longer than {LONGEST_RECORD:,} bytes",
                "write it as CSV",
            )
    if beside is not None and "{" in text:  # of a program that was killed
        beside.receive()
        beside.add("pending")


def _count_beside(text: str, beside: Ledger | None) -> None:
    """Count the lines of words between two objects."""
    words = sum(any(map(str.isalpha, line)) for line in text.splitlines()) if beside is not None else 0
    if words and beside is not None:
        beside.receive(words)
        beside.add("other_message", words)


def _records_of(value: Any) -> Iterator[Record]:
    """Yield the records in an object: itself, those in a list of it, or the rows of its lists."""
    lists = {
        name: inner for name, inner in value.items() if isinstance(inner, list) and len(inner) > LONGEST_LIST
    }
    rows = next((inner for inner in lists.values() if all(isinstance(row, dict) for row in inner)), None)
    if rows is not None:
        yield from map(json_fields, rows)
    elif lists and len({len(inner) for inner in lists.values()}) == 1:
        yield from (
            json_fields(dict(zip(lists, row, strict=True))) for row in zip(*lists.values(), strict=True)
        )
    else:
        yield json_fields(value)


_READERS: Mapping[str, Callable[[Iterable[bytes], Ledger], Iterator[Record]]] = {
    "json": json_records,
    "yaml": lambda chunks, _: yaml_records(lines_of_chunks(chunks)),
    "labelled": lambda chunks, beside: labelled_records(lines_of_chunks(chunks), beside),
}
