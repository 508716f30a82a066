"""Recordings: raw bytes kept on disk, and read back.

A recording is what came from the port, byte for byte, behind one line that says what it is:
``#imumon-recording {JSON}``. Where the link was lost and found again, another such line says for how long,
``{"away_s": 3.2}``: a stream whose clock is not absolute shows no gap by itself. A decoder resynchronises
over these lines, and `RawCapture` takes them out. Writing goes on in a thread of its own, and a full disk ends
the recording, not the reading. What is there already is never overwritten: a new run takes the next free
number. Where it goes on with the record of the run before, reading goes on with it too.
"""

from __future__ import annotations

import contextlib
import errno
import gzip
import json
import os
import stat
import sys
import threading
import zlib
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, BinaryIO

from imumon.errors import SourceError
from imumon.recordings.recording_header import read_header

MARK = b"#imumon-recording "
LONGEST_LINE = 1 << 16
CHUNK = 256 << 10
BACKLOG = 8 << 20  # bytes that wait for a slow disk; with more the recording ends
FLUSH_S = 1.0  # what a kill may cost; ten times that when compressing

_FOREIGN = {
    b"PK\x03\x04": "a ZIP archive: unpack it first",
    b"\xfd7zXZ": "an xz archive: unpack it first",
    b"BZh": "a bzip2 archive: unpack it first",
    b"\x28\xb5\x2f\xfd": "a zstd archive: unpack it first",
    b"\x89PNG": "a picture",
    b"%PDF": "a PDF document",
    b"\x7fELF": "a program",
    b"\x93NUMPY": "a NumPy array",
    b"SQLite format 3": "an SQLite database",
}


def part_path(path: str, part: int) -> str:
    """Name of a part of a recording.

    >>> part_path("run.bin.gz", 0), part_path("run.bin.gz", 12)
    ('run.bin.gz', 'run.0012.bin.gz')
    """
    if part == 0:
        return path
    folder, name = os.path.split(path)
    stem, dot, suffix = name.partition(".")
    return os.path.join(folder, f"{stem}.{part:04d}{dot}{suffix}")


@dataclass(frozen=True, slots=True)
class LinkLoss:
    """Here the link was lost; `away_s`: s of the sensor's time until it was back, None where nobody knows."""

    away_s: float | None


class RawCapture:
    """A recording as chunks of bytes, in memory that does not grow with its length.

    Iterate to get the chunks: of a raw capture, of gzip of one, or of what `CaptureWriter` made; of the latter
    the further parts of the same run, and those of the runs that went on with its record, follow by
    themselves where they lie beside it under the names that they were given, and are not in it already.
    `pieces` has `LinkLoss` where the link was.

    Parameters
    ----------
    path : file; ``-`` is standard input.

    Attributes
    ----------
    header : what `CaptureWriter` noted (sensor, settings, time), or None.
    problem : after reading: why it ended early, or None.

    Raises
    ------
    SourceError : no such file, not readable, empty, or plainly something else.
    """

    def __init__(self, path: str) -> None:
        self.path = path
        self.problem: str | None = None
        self._part = _Part(path)
        self.header = self._part.header
        self._later = [] if self.header is None else _later_parts(path, self.header)
        self._read: set[tuple[Any, Any]] = set()  # parts, by `_key`
        self._behind = 0  # bytes of the parts that have been read
        self._total = 0 if path == "-" else sum(os.path.getsize(p) for p in [path, *self._later])

    @property
    def head(self) -> bytes:
        """The first bytes, before iterating: what tells what it is."""
        return self._part.head

    @property
    def progress(self) -> float | None:
        """Share of the bytes on disk that has been read, 0 to 1; None for a pipe."""
        return min(1.0, (self._behind + self._part.taken) / self._total) if self._total else None

    def __iter__(self) -> Iterator[bytes]:
        return (piece for piece in self.pieces() if isinstance(piece, bytes))

    def pieces(self) -> Iterator[bytes | LinkLoss]:
        """Chunks of bytes, and where the link was lost between them."""
        yield from self._read_part()
        for path in self._later:
            self._behind += self._part.taken
            before, self._part = self._part, _Part(path)
            if self._key(self._part.header) in self._read:  # put together with others by hand
                self._part.close()
                continue
            if _said(self._part, "run") != _said(before, "run"):
                yield LinkLoss(None)
            yield from self._read_part()

    def _read_part(self) -> Iterator[bytes | LinkLoss]:
        run = _said(self._part, "run")
        self._read.add(self._key(self._part.header))
        for item in self._part:
            if isinstance(item, bytes):
                yield item
                continue
            self._read.add(self._key(item))
            if "run" not in item or item["run"] != run:  # else: parts of one run, put together in one file
                run = item.get("run", run)
                yield LinkLoss(item.get("away_s"))
        if self._part.problem is not None and self.problem is None:
            self.problem = f"{self._part.path} {self._part.problem}"

    @staticmethod
    def _key(header: Mapping[str, Any] | None) -> tuple[Any, Any]:
        """What tells one part from every other."""
        told = header or {}
        return told.get("run"), told.get("part")


def read_file(path: str) -> RawCapture:
    """Open a recording; ``-`` is standard input."""
    return RawCapture(path)


class _Part:
    """One file of a recording: gzip undone, header taken off."""

    def __init__(self, path: str) -> None:
        self.path = path
        self.taken = 0  # bytes on disk read so far
        self.problem: str | None = None
        self.header: dict[str, Any] | None = None
        try:
            self._file: BinaryIO = sys.stdin.buffer if path == "-" else open(path, "rb")  # noqa: SIM115
            head = self._file.read(CHUNK)
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or str(error)
            raise SourceError(f"cannot read {path}: {why.lower()}") from None
        if not head:
            raise SourceError(f"{path} is empty: nothing was recorded")
        for magic, what in _FOREIGN.items():
            if head.startswith(magic):
                raise SourceError(f"{path} is not a recording but {what}")
        raw = self._read(head)
        self._items = _split(self._unzip(raw) if head[:2] == b"\x1f\x8b" else raw)
        self._next: bytes | dict[str, Any] = next(self._items, b"")
        if isinstance(self._next, dict):
            self.header, self._next = self._next, next(self._items, b"")

    @property
    def head(self) -> bytes:
        return self._next if isinstance(self._next, bytes) else b""

    def __iter__(self) -> Iterator[bytes | dict[str, Any]]:
        if self._next != b"":
            yield self._next
        self._next = b""
        yield from self._items
        self.close()

    def close(self) -> None:
        if self.path != "-":
            self._file.close()

    def _read(self, chunk: bytes) -> Iterator[bytes]:
        while chunk:
            self.taken += len(chunk)
            yield chunk
            try:
                chunk = self._file.read(CHUNK)
            except OSError as error:
                self.problem = f"could not be read to its end ({error.strerror}): what came before is used"
                return

    def _unzip(self, chunks: Iterator[bytes]) -> Iterator[bytes]:
        """Contents of all members; of a damaged file, what comes before the damage."""
        member = zlib.decompressobj(wbits=31)
        for rest in chunks:
            while rest:
                if member.eof:
                    if not rest.strip(b"\0"):  # padding
                        break
                    member = zlib.decompressobj(wbits=31)
                before = member.copy()
                try:
                    out = member.decompress(rest, CHUNK)
                except zlib.error:
                    self.problem = "is damaged: only what comes before the damage is used"
                    yield from _undamaged(before, rest)
                    return
                rest = member.unused_data if member.eof else member.unconsumed_tail
                if out:
                    yield out
        if not member.eof:
            self.problem = "is cut off: what is there is used"


def _split(chunks: Iterator[bytes]) -> Iterator[bytes | dict[str, Any]]:
    """Bytes, and what the lines between them say; one that cannot be read says nothing.

    >>> list(_split(iter([b"ab#imumon-rec", b'ording {"away_s": 2}', b"\\ncd#", b"e"])))
    [b'ab', {'away_s': 2.0}, b'cd', b'#e']
    """
    held = b""
    for chunk in chunks:
        held += chunk
        while (at := held.find(MARK)) >= 0:
            end = held.find(b"\n", at, at + LONGEST_LINE)
            if end < 0 and len(held) - at < LONGEST_LINE:
                break  # the line goes on in the next chunk
            if end < 0:
                at += len(MARK)  # no line of ours
                yield held[:at]
                held = held[at:]
                continue
            if at:
                yield held[:at]
            yield read_header(held[at + len(MARK) : end]) or {}
            held = held[end + 1 :]
        if at < 0:
            at = held.rfind(MARK[:1], -len(MARK))
            at = at if at >= 0 and MARK.startswith(held[at:]) else len(held)
        if at:
            yield held[:at]
            held = held[at:]
    if held:
        yield held


def _undamaged(member: Any, data: bytes) -> Iterator[bytes]:
    """What a member still gives of the chunk with the damage, to the last byte before it."""
    with contextlib.suppress(zlib.error):
        for k in range(len(data)):
            yield member.decompress(data[k : k + 1])


def _later_parts(path: str, header: Mapping[str, Any]) -> list[str]:
    """Parts of the same record behind the one at `path`, in order.

    None behind standard input, whose place nobody knows.
    """
    found: list[str] = []
    number, base = header.get("part"), header.get("base")
    if not isinstance(number, int) or not isinstance(base, str):
        return []
    if path == "-":
        return []
    folders = [os.path.dirname(place) for place in (path, os.path.realpath(path))]
    following = part_path(base, number + 1)
    folder = next((f for f in folders if os.path.exists(os.path.join(f, following))), folders[1])
    run, record = header.get("run"), header.get("record")
    while True:
        number += 1
        following = part_path(os.path.join(folder, base), number)
        try:
            part = _Part(following)
        except SourceError:
            return found
        part.close()
        if _said(part, "run") != run and (record is None or _said(part, "record") != record):
            return found
        found.append(following)


def _said(part: _Part, name: str) -> Any:
    """What the header of a part says; None where it says nothing."""
    return (part.header or {}).get(name)


def _open_pipe(path: str) -> BinaryIO:
    """A pipe or a device to write to, without waiting for a reader of the pipe.

    Raises
    ------
    OSError : it cannot be opened; nobody reads.
    """
    try:
        file = os.open(path, os.O_WRONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        if error.errno == errno.ENXIO and stat.S_ISFIFO(os.stat(path).st_mode):
            raise OSError(error.errno, "nobody reads that pipe; start its reader first") from None
        raise
    os.set_blocking(file, True)
    return os.fdopen(file, "wb")


def check_place(path: str) -> None:
    """Look whether a recording can be made there at all; that a disk is full is another matter.

    Raises
    ------
    SourceError : the path is plainly wrong.
    """
    folder = os.path.dirname(path) or "."
    place = path if os.path.exists(path) else folder
    if not os.path.isdir(folder):
        why = f"there is no folder {folder}; make it, or give another --record"
    elif os.path.isdir(path):
        why = f"that is a folder; name a file in it, such as {os.path.join(path, 'run.bin')}"
    elif not os.access(place, os.W_OK) and not os.statvfs(folder).f_flag & os.ST_RDONLY:
        why = f"no permission to write {place}; give another --record"
    else:
        return
    raise SourceError(f"cannot record to {path}: {why}")


class CaptureWriter:
    """Keeps raw bytes on disk while they come.

    Parameters
    ----------
    path : file; ``….gz`` compresses. If it is there already, the next free number is taken, as it is when
        the file is removed while it is written.
    header : what is noted in front (sensor, settings, time of the host); plain JSON values.
    rotate_bytes : begin a new part after so many bytes of input; 0: never.
    compress : compress whatever the name.

    Attributes
    ----------
    path : file that is written now.
    written_bytes : raw bytes written so far.
    stopped : why the recording ended by itself, in one line for people; None while it goes on.

    Raises
    ------
    SourceError : the file cannot be made.
    """

    def __init__(
        self, path: str, header: Mapping[str, Any], *, rotate_bytes: int = 0, compress: bool = False
    ) -> None:
        self._base = path
        self._compress = compress or path.endswith(".gz")
        self._rotate = rotate_bytes
        self._header = dict(header)
        self._number = -1
        self.path = path
        self.written_bytes = 0
        self.stopped: str | None = None
        self._backlog: deque[bytes] = deque()
        self._waiting = self._taken = 0
        self._changed = threading.Condition()
        self._closing = False
        try:
            self._begin_part()
        except OSError as error:
            raise SourceError(f"cannot record to {path}: {(error.strerror or str(error)).lower()}") from None
        self._thread = threading.Thread(target=self._work, name=f"record {path}", daemon=True)
        self._thread.start()

    def write(self, data: bytes) -> None:
        """Hand over bytes; returns at once, and does nothing after the recording has ended."""
        if self.stopped is not None or not data:
            return
        with self._changed:
            if self._waiting + len(data) > BACKLOG:
                self._stop(f"the disk is too slow, {BACKLOG >> 20} MB are waiting")
                return
            self._backlog.append(data)
            self._waiting += len(data)
            self._taken += len(data)
            self._changed.notify()

    def lost(self, away_s: float | None) -> None:
        """Note that the link was lost and found again; see `LinkLoss`."""
        self.write(MARK + json.dumps({"away_s": away_s}).encode() + b"\n")

    def end(self) -> None:
        """Nothing comes any more: what waits is written, and the file closed, while others go on."""
        with self._changed:
            self._closing = True
            self._changed.notify()

    @property
    def ended(self) -> bool:
        """Whether all is done."""
        return not self._thread.is_alive()

    def close(self, wait_s: float = 10.0) -> None:
        """End the recording, and wait so long until what waits is written; `stopped` says what was not."""
        self.end()
        self._thread.join(timeout=wait_s)
        if not self.ended:
            self._stop(f"the disk is too slow, {self._taken - self.written_bytes} bytes did not reach it")

    def _begin_part(self) -> None:
        """Open the next file whose name is free; a pipe or a device is used as it is."""
        while True:
            self._number += 1
            self.path = part_path(self._base, self._number)
            try:
                plain = not os.path.exists(self.path) or stat.S_ISREG(os.stat(self.path).st_mode)
                self._file: BinaryIO = open(self.path, "xb") if plain else _open_pipe(self.path)  # noqa: SIM115
                break
            except FileExistsError:
                continue
        self._out: Any = gzip.GzipFile("", "wb", 6, self._file) if self._compress else self._file
        self._in_part = 0
        first = self._header.setdefault("run", f"{self._header.get('time', '')} {os.getpid()} {self._number}")
        place = {"run": first, "part": self._number, "base": os.path.basename(self._base)}
        self._out.write(MARK + json.dumps(self._header | place, default=str).encode() + b"\n")
        self._flush()

    def _end_part(self) -> None:
        try:
            if self._out is not self._file:
                self._out.close()
        finally:
            self._file.close()

    def _removed(self) -> bool:
        """Whether somebody removed the file: what is written to it now, nobody will ever read."""
        now = os.fstat(self._file.fileno())
        return stat.S_ISREG(now.st_mode) and now.st_nlink == 0

    def _flush(self) -> None:
        self._out.flush()
        self._file.flush()

    def _work(self) -> None:
        """The writing thread."""
        try:
            while not (self._closing and not self._backlog) and self.stopped is None:
                with self._changed:
                    # bytes gather meanwhile, so that a write is worth its while
                    period = 10 * FLUSH_S if self._compress else FLUSH_S
                    self._changed.wait_for(lambda: self._closing or self._waiting > BACKLOG // 8, period)
                    data = b"".join(self._backlog)
                    self._backlog.clear()
                    self._waiting = 0
                full = self._rotate and self._in_part and self._in_part + len(data) > self._rotate
                if data and (full or self._removed()):
                    self._end_part()
                    self._begin_part()
                self._out.write(data)
                self._flush()
                self._in_part += len(data)
                self.written_bytes += len(data)
        except Exception as error:  # whatever it is, it is told
            why = error.strerror if isinstance(error, OSError) else str(error)
            self._stop((why or type(error).__name__).lower())
        with contextlib.suppress(OSError):
            self._end_part()

    def _stop(self, why: str) -> None:
        if self.stopped is None:
            self.stopped = f"recording to {self.path} has ended: {why}; {self.written_bytes} bytes are kept"
