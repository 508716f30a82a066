"""Raw capture: a file with the bytes of a device, read back.

A capture holds the output of the device, byte for byte. `CaptureWriter` puts one line in front that
describes it, and another one wherever the stream was interrupted::

    #imumon-recording {"driver": "vn100", "rate_hz": 200.0, "run": "2026-01-31 812 0", "part": 0, "base": "run.bin"}
    $VNYMR,...*4F
    #imumon-recording {"away_s": 3.2}
    $VNYMR,...*51

A stream whose clock is not absolute shows no gap by itself; ``away_s`` is its length, null: unknown. `RawCapture`
removes these lines. They begin anywhere, also behind a sentence that was interrupted: the bytes before and behind
such a line belong to different messages.

A capture may consist of several files: parts of one run (``run.bin``, ``run.0001.bin``, ...), and runs that continue
the same record. They have ``base`` in common, follow each other by ``part``, and have the same ``run`` or ``record``.
Files that were joined with ``cat`` read the same: then the later headers lie in the middle of the bytes.

The file is input like any other: any program may have written it, it may be truncated, a gzip member may be corrupt,
a line may never end. Reading then stops or continues with a reason in `RawCapture.problem`; the memory is bounded.
"""

from __future__ import annotations

import gzip
import json
import os
import stat
import sys
import zlib
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from typing import Any, BinaryIO, cast

from imumon.files import open_regular
from imumon.model.errors import why
from imumon.model.report import stamp
from imumon.model.report_json import JsonReader
from imumon.model.samples import FASTEST_HZ, SLOWEST_HZ, Gap
from imumon.model.system_errors import cure_of_reading
from imumon.sources.files.base import LONGEST_LINE, SQLITE, RecordingError

MARK = b"#imumon-recording "
"""Start of a line that is no data."""

CHUNK = 256 << 10
"""Bytes that are read at once."""

INFLATED_AT_ONCE = 1 << 12
"""Bytes of a gzip file that are decompressed at once: those before a corruption are not read."""

MOST_EXPANSION = 200
"""Bytes of the contents of a gzip file for each of its own at most: noise expands to about 5, text of zeros to 1000."""

EXPANSION_BYTES = 256 << 20
"""Bytes of the contents from which that counts: they are read in seconds, and a short file may hold few numbers."""

MOST_PARTS = 10_000
"""Parts of which a capture is not read twice; memory does not grow with their number."""

_OTHER_FILE = "name another file"
_FOREIGN = {
    b"PK\x03\x04": ("zip", "a ZIP archive", "unpack it first"),
    b"\xfd7zXZ": ("xz", "an xz archive", "unpack it first"),
    b"BZh": ("bzip2", "a bzip2 archive", "unpack it first"),
    b"\x28\xb5\x2f\xfd": ("zstd", "a zstd archive", "unpack it first"),
    b"\x89PNG": ("png", "an image", _OTHER_FILE),
    b"%PDF": ("pdf", "a PDF document", _OTHER_FILE),
    b"\x7fELF": ("elf", "a program", _OTHER_FILE),
    b"\x89HDF\r\n\x1a\n": ("hdf5", "an HDF5 file", "write its columns as CSV: pandas.read_hdf(FILE).to_csv"),
    b"MATLAB 7.3": ("mat_73", "a MATLAB 7.3 file", "save it again with save FILE.mat -v7"),
    b"\xd0\xcf\x11\xe0": ("xls", "a workbook of Excel", "save the sheet as CSV"),
    b"ARROW1": ("arrow", "an Arrow file", "write it as Parquet or CSV: pandas.read_feather(FILE).to_csv"),
    **dict.fromkeys(
        (b"\x80\x04\x95", b"\x80\x05\x95"),
        ("pickle", "a pickle of Python, which can run any program", "write it as CSV or with numpy.savez"),
    ),
    b"TDSm": ("tdms", "a TDMS file of LabVIEW", "export it as CSV"),
    b"FMT, 128, ": ("dataflash_text", "an ArduPilot log as text", "use the .BIN file it was made from"),
    SQLITE: (
        "sqlite",
        "an SQLite database",
        "name the .db3 file of a bag; imumon history --state DIR shows the histories of a directory",
    ),
}
"""First bytes of other formats: end of the code, what it is, what to do."""


def open_input(path: str, *, pipe: bool = True) -> BinaryIO:
    """Open a file that the user names, or a pipe; raise OSError if it is a device, which may have no end.

    Parameters
    ----------
    pipe : whether it may be a pipe, whose opening waits for its writer.
    """
    if pipe and stat.S_ISFIFO(os.stat(path).st_mode):
        return open(path, "rb")
    return open(open_regular(path, follow=True), "rb")


def part_path(path: str, part: int) -> str:
    """Return the path of a part of a recording.

    >>> part_path("run.bin.gz", 0), part_path("run.bin.gz", 12)
    ('run.bin.gz', 'run.0012.bin.gz')
    """
    if part == 0:
        return path
    directory, name = os.path.split(path)
    stem, dot, suffix = name.partition(".")
    return os.path.join(directory, f"{stem}.{part:04d}{dot}{suffix}")


class RawCapture:
    """A raw capture as chunks of bytes; memory does not grow with its length.

    Iterate to get the chunks of a raw capture, gzip or not, or of the output of `CaptureWriter`. Of the
    latter, further parts of the same run and of runs that continue its record follow, if they lie beside it
    under their own names and are not in it already. `items` yields a `Gap` where the stream was interrupted.

    Parameters
    ----------
    path : file; ``-`` is standard input.

    Attributes
    ----------
    header : what `CaptureWriter` noted (device, settings, time), or None.
    problem : after reading: why it ended early, or None.

    Raises
    ------
    RecordingError : no such file, not readable, empty, or of another format.
    """

    def __init__(self, path: str) -> None:
        self.path = path
        self.problem: str | None = None
        self._part = _Part(path)
        self.header = self._part.header
        self._later = [] if self.header is None else _later_parts(path, self.header)
        self._read: set[tuple[Any, Any]] = set()  # parts, by `_key`
        self._behind = 0  # bytes of the parts that have been read
        # sizes on disk: how long the contents of a gzip file are is unknown before its end
        self._total = 0 if path == "-" else sum(os.path.getsize(p) for p in [path, *self._later])

    @property
    def head(self) -> bytes:
        """First bytes, before iterating, to detect the format."""
        return self._part.head

    @property
    def progress(self) -> float | None:
        """Share of the bytes on disk that has been read, 0 to 1; None for a pipe."""
        return min(1.0, (self._behind + self._part.consumed) / self._total) if self._total else None

    def __iter__(self) -> Iterator[bytes]:
        return (item for item in self.items() if isinstance(item, bytes))

    def items(self) -> Iterator[bytes | Gap]:
        """Yield chunks of bytes, and the gaps between them."""
        yield from self._read_part()
        for path in self._later:
            self._behind += self._part.consumed
            before, self._part = self._part, _Part(path, later=True)
            if _key(self._part.header) in self._read:  # its bytes are in an earlier file as well
                self._part.close()
                continue
            # parts of one run follow each other without a lost byte; between two runs the daemon did not run
            if self._part.field("run") != before.field("run"):
                yield Gap(None)
            yield from self._read_part()

    def _read_part(self) -> Iterator[bytes | Gap]:
        run = self._part.field("run")
        self._read.add(_key(self._part.header))
        for item in self._part:
            if isinstance(item, bytes):
                yield item
                continue
            if len(self._read) < MOST_PARTS:  # each line between the bytes may have another key
                self._read.add(_key(item))
            if "run" not in item or item["run"] != run:  # else: parts of one run, joined in one file
                run = item.get("run", run)
                yield Gap(item.get("away_s"))
        if self._part.problem is not None and self.problem is None:
            self.problem = f"{self._part.path} {self._part.problem}"


def _key(header: Mapping[str, Any] | None) -> tuple[Any, Any]:
    """Return what identifies a part."""
    return (header or {}).get("run"), (header or {}).get("part")


class _Part:
    """One file of a capture: decompressed, without its header."""

    def __init__(self, path: str, *, later: bool = False) -> None:
        self.path = path
        self.consumed = 0  # bytes on disk read so far
        self.problem: str | None = None
        self.header: dict[str, Any] | None = None
        try:
            self._file = _standard_input() if path == "-" else open_input(path, pipe=not later)
            head = self._file.read(CHUNK)
        except (OSError, ValueError) as error:
            text = f"cannot read {path}: {why(error)}"
            raise RecordingError("not_readable", text, cure_of_reading(error)) from None
        if not head:
            raise RecordingError("empty", f"{path} is empty: nothing was recorded", "record again")
        for magic, (name, noun, cure) in _FOREIGN.items():
            if head.startswith(magic):
                raise RecordingError(f"format_{name}", f"{path} is not a recording but {noun}", cure)
        # the contents decide, not the name: `CaptureWriter` compresses under any name
        self._head, self._compressed = head, head[:2] == b"\x1f\x8b"
        chunks = self._decompressed() if self._compressed else iter(lambda: self.read(CHUNK), b"")
        self._items = split_lines(chunks)
        self._next: bytes | dict[str, Any] = next(self._items, b"")
        if isinstance(self._next, dict):
            self.header, self._next = self._next, next(self._items, b"")

    @property
    def head(self) -> bytes:
        return self._next if isinstance(self._next, bytes) else b""

    def field(self, name: str) -> Any:
        return (self.header or {}).get(name)

    def __iter__(self) -> Iterator[bytes | dict[str, Any]]:
        if self._next != b"":
            yield self._next
        self._next = b""
        yield from self._items
        self.close()

    def close(self) -> None:
        if self.path != "-":
            self._file.close()

    def read(self, size: int) -> bytes:
        """Return the next bytes on disk: what `gzip` needs of a file."""
        # in small pieces: of one with a corruption, gzip gives nothing, not even what lies before it
        size = min(size, INFLATED_AT_ONCE) if self._compressed else size
        try:
            data = self._head[:size] or self._file.read(size)
        except OSError as error:
            self.problem = f"cannot be read to its end ({error.strerror}): the part before is used"
            return b""
        self._head = self._head[size:]
        self.consumed += len(data)
        return data

    def _decompressed(self) -> Iterator[bytes]:
        """Yield the contents of all gzip members; of a corrupt file, the part before the corruption."""
        expanded = 0  # bytes of the contents
        archive = gzip.GzipFile(fileobj=cast("BinaryIO", self), mode="rb")
        while True:
            try:
                out = archive.read1(CHUNK)
            except EOFError:
                self.problem = self.problem or "is truncated: the part that is there is used"
                return
            except (OSError, zlib.error):
                self.problem = "is corrupt: only the part before the corruption is used"
                return
            expanded += len(out)
            if expanded > max(EXPANSION_BYTES, MOST_EXPANSION * self.consumed):
                text = (
                    f"{self.path} expands to more than {MOST_EXPANSION} times its size, which noise does not"
                )
                raise RecordingError(
                    "expands", text, "unpack it with gunzip first, if this is not by mistake"
                )
            if not out:
                return
            yield out


def _standard_input() -> BinaryIO:
    """Open standard input a second time: the end of a recording leaves `sys.stdin` open."""
    return os.fdopen(sys.stdin.fileno(), "rb", closefd=False)


def split_lines(chunks: Iterator[bytes]) -> Iterator[bytes | dict[str, Any]]:
    """Yield bytes, and the fields of the lines between them; an invalid line has none.

    >>> list(split_lines(iter([b"ab#imumon-rec", b'ording {"away_s": 2}', b"\\ncd#", b"e"])))
    [b'ab', {'away_s': 2}, b'cd', b'#e']
    """
    waiting = b""
    for chunk in chunks:
        waiting += chunk
        begin, search, end = 0, 0, -1  # first byte not yielded, where to look for a line, and its end
        while (mark := waiting.find(MARK, search)) >= 0:
            if end < mark:
                end = waiting.find(b"\n", mark)
                end = len(waiting) if end < 0 else end
            if end == len(waiting) and len(waiting) - mark < LONGEST_LINE:
                break  # the line continues in the next chunk
            search = mark + len(MARK)
            if end - mark >= LONGEST_LINE:
                continue  # no writer makes such a line: data that holds the mark by chance
            if mark > begin:
                yield waiting[begin:mark]
            yield read_header(waiting[search:end]) or {}
            begin = search = end + 1
        if mark < 0:  # the chunk may end within the mark: such a beginning waits for the next chunk
            mark = waiting.rfind(MARK[:1], max(search, len(waiting) - len(MARK)))
            mark = mark if mark >= 0 and MARK.startswith(waiting[mark:]) else len(waiting)
        if mark > begin:
            yield waiting[begin:mark]
        waiting = waiting[mark:]
    if waiting:
        yield waiting


def _later_parts(path: str, header: Mapping[str, Any]) -> list[str]:
    """Return the later parts of the record that begins at `path`, in order; none for standard input."""
    paths: list[str] = []
    number, base = header.get("part"), header.get("base")
    if not isinstance(number, int) or not isinstance(base, str) or path == "-":
        return paths
    following = part_path(base, number + 1)
    directory = os.path.dirname(path)
    if not os.path.exists(os.path.join(directory, following)):
        directory = os.path.dirname(os.path.realpath(path))  # of a link such as latest.bin: beside its target
    run, record = header.get("run"), header.get("record")
    while True:
        number += 1
        following = part_path(os.path.join(directory, base), number)
        try:
            part = _Part(following, later=True)
        except RecordingError:
            return paths
        part.close()
        # a file under the right name may be of an earlier record whose first parts were deleted
        if part.field("run") != run and (record is None or part.field("record") != record):
            return paths
        paths.append(following)


# ---------------------------------------------------------------- header
# Any program may have written it: a field that does not have the form that `CaptureWriter` gives it is ignored.


def read_header(line: bytes) -> dict[str, Any] | None:
    """Return the fields of a header from its JSON; None if it is no JSON object.

    >>> read_header(b'{"serial": "7", "rate_hz": Infinity, "caveats": [{}], "part": 0}')
    {'serial': '7', 'part': 0}
    """
    try:
        fields = json.loads(line)
    except (ValueError, RecursionError):  # thousands of brackets exhaust the stack of the parser
        return None
    if not isinstance(fields, dict):
        return None
    checked = {name: _value(name, fields[name]) for name in _TYPES if name in fields}
    return {name: value for name, value in checked.items() if value is not None}


_TYPES: Mapping[str, Any] = {
    **dict.fromkeys(("driver", "id", "model", "serial", "firmware", "stream", "record"), str),
    **dict.fromkeys(("time", "run", "base"), str),
    **dict.fromkeys(("rate_hz", "alias_factor", "away_s"), float),
    "caveats": tuple[str, ...],
    "settings": Mapping[str, str],
    "part": int,
}
"""Type of each field that is read."""

_LIMITS = {
    "rate_hz": (SLOWEST_HZ, FASTEST_HZ), "alias_factor": (1e-3, 1e3), "away_s": (0.0, 1e10), "part": (0, 1e9)
}  # fmt: skip
"""Smallest and greatest value of each number."""

_READER = JsonReader({})


def _value(name: str, data: Any) -> Any:
    """Return the value of a field; None if it does not have the right form."""
    try:
        value = _READER.part(_TYPES[name], data)
        if name == "time":  # one without a zone is UTC, whatever the zone of this host
            date = datetime.fromisoformat(value)
            return stamp(date if date.tzinfo else date.replace(tzinfo=UTC))
    except (TypeError, ValueError, OverflowError):
        return None
    if name in _LIMITS:
        low, high = _LIMITS[name]
        return value if low <= value <= high else None
    # the name of a file: a path would lead out of the directory of the recording
    return None if name == "base" and "/" in value else value
