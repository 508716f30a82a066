"""Capture writer: bytes of a device, written to disk while they arrive.

Writing runs in its own thread, and a full disk ends the recording, not the reading. An existing file is
never overwritten: a new run uses the next free number. `RawCapture` reads the parts in order.
"""

from __future__ import annotations

import contextlib
import errno
import gzip
import json
import os
import stat
import threading
from collections import deque
from collections.abc import Mapping
from typing import Any, BinaryIO

from imumon.model.errors import why
from imumon.model.system_errors import cure_of_writing
from imumon.sources.files.base import RecordingError
from imumon.sources.files.raw_capture import MARK, part_path

BACKLOG = 8 << 20
"""Bytes that wait for a slow disk; with more, the recording ends."""

ELSEWHERE = "give another --record"
"""How a user names another place."""

FLUSH_S = 1.0
"""s of data that a kill may cost."""


def check_place(path: str) -> None:
    """Raise `RecordingError` if no recording can be written at a path; a full disk does not show here."""
    directory = os.path.dirname(path) or "."
    place = path if os.path.exists(path) else directory
    if not os.path.isdir(directory):
        code, why = "no_directory", f"there is no directory {directory}"
        cure = "create it, or give another --record"
    elif os.path.isdir(path):
        code, why = "is_directory", "that is a directory"
        cure = f"name a file in it, such as {os.path.join(path, 'run.bin')}"
    elif not os.access(place, os.W_OK):
        code, why, cure = "no_permission", f"{place} cannot be written", "give another --record"
    else:
        return
    raise RecordingError(code, f"cannot record to {path}: {why}", cure)


class CaptureWriter:
    """Writes raw bytes to disk while they arrive.

    Parameters
    ----------
    path : file; ``….gz`` compresses. If it exists, the next free number is used.
    header : what is noted in front (device, settings, time of the host); plain JSON values.
    rotate_bytes : begin a new part after this many bytes of input; 0: never.
    compress : compress whatever the name.

    Attributes
    ----------
    path : file that is written now.
    written_bytes : raw bytes written so far.
    stopped : why the recording ended by itself, in one line; None while it runs.

    Raises
    ------
    RecordingError : the file cannot be created.
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
        self._waiting = self._accepted = 0  # bytes in the backlog, and bytes accepted so far
        self._changed = threading.Condition()
        self._closing = False
        try:
            self._begin_part()
        except OSError as error:
            text = f"cannot record to {path}: {why(error)}"
            cure = cure_of_writing(error, ELSEWHERE)
            raise RecordingError("not_writable", text, cure) from None
        self._thread = threading.Thread(target=self._run, name=f"record {path}", daemon=True)
        self._thread.start()

    def write(self, data: bytes) -> None:
        """Accept bytes; return at once, and do nothing after the recording has ended."""
        if self.stopped is not None or not data:
            return
        with self._changed:
            if self._waiting + len(data) > BACKLOG:
                self._stop(f"the disk is too slow, {BACKLOG >> 20} MB are waiting: {ELSEWHERE}")
                return
            self._backlog.append(data)
            self._waiting += len(data)
            self._accepted += len(data)
            self._changed.notify()

    def lost(self, away_s: float | None) -> None:
        """Note that the stream was interrupted; see `Gap`."""
        self.write(MARK + json.dumps({"away_s": away_s}).encode() + b"\n")

    def end(self) -> None:
        """Let the thread write what waits and close the file; return at once."""
        with self._changed:
            self._closing = True
            self._changed.notify()

    @property
    def ended(self) -> bool:
        """Whether everything is written and the file is closed."""
        return not self._thread.is_alive()

    def close(self, wait_s: float = 10.0) -> None:
        """End the recording and wait until everything is written; `stopped` says what was not."""
        self.end()
        self._thread.join(timeout=wait_s)
        if not self.ended:
            missing = self._accepted - self.written_bytes
            self._stop(f"the disk is too slow, {missing} bytes did not reach it: {ELSEWHERE}")

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
        with self._file:
            if self._out is not self._file:
                self._out.close()

    def _flush(self) -> None:
        self._out.flush()
        self._file.flush()

    def _run(self) -> None:
        """Write until the end, in the thread."""
        try:
            while not (self._closing and not self._backlog) and self.stopped is None:
                with self._changed:
                    self._changed.wait_for(lambda: self._closing or self._waiting > BACKLOG // 8, FLUSH_S)
                    data = b"".join(self._backlog)
                    self._backlog.clear()
                    self._waiting = 0
                full = self._rotate and self._in_part and self._in_part + len(data) > self._rotate
                if data and full:
                    self._end_part()
                    self._begin_part()
                self._out.write(data)
                self._flush()
                self._in_part += len(data)
                self.written_bytes += len(data)
        except Exception as error:  # any error is reported in `stopped`
            self._stop(f"{why(error)}: {cure_of_writing(error, ELSEWHERE)}")
        with contextlib.suppress(OSError):
            self._end_part()

    def _stop(self, reason: str) -> None:
        if self.stopped is None:
            kept = ""
            with contextlib.suppress(
                OSError, ValueError
            ):  # what a full disk took of the last bytes counts, too
                kept = f"; the file has {os.fstat(self._file.fileno()).st_size:,} bytes"
            self.stopped = f"recording to {self.path} has ended: {reason}{kept}"


def _open_pipe(path: str) -> BinaryIO:
    """Open a pipe or a device for writing, without waiting for a reader of the pipe."""
    try:
        file = os.open(path, os.O_WRONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        if error.errno == errno.ENXIO and stat.S_ISFIFO(os.stat(path).st_mode):
            text = f"cannot record to {path}: no program reads that pipe"
            raise RecordingError("pipe_without_reader", text, "start its reader first") from None
        raise
    if stat.S_ISREG(os.fstat(file).st_mode):  # it was a pipe a moment ago
        os.close(file)
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), path)
    os.set_blocking(file, True)
    return os.fdopen(file, "wb")
