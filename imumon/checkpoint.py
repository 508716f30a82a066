"""Checkpoint: the state of a record on disk, which survives restarts, crashes, power failures and upgrades.

There is one file per device. A save writes a new file and renames it over the old one, so a reader finds
either the old state or the new one. The previous generation is kept and is used if the newest file is
damaged. A file that cannot be used is renamed to a name that contains the reason; it is never overwritten or
merged. Another user may have written it: it is a regular file of bounded size, or it is not read (`files`).
If nothing can be written, the existing state is still read, every save tries again, and `Checkpoint.failed`
gives the reason.

A state begins with a line: a word, the number of its format, and a checksum of what follows, the compressed objects of
the record (`saved_state`). A file of another format, or with another checksum, is set aside: what is restored is
exactly what was saved. A state is written thousands of times per day, often to a memory card, so it is compressed. A
thread compresses and writes, so a slow disk does not delay the samples.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import math
import os
import stat
import threading
import zlib
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from imumon.files import open_regular, read_bounded, rename_aside, write_new
from imumon.model.errors import ImumonError, why
from imumon.model.ledger import ColumnUse
from imumon.model.report import SessionCounters
from imumon.model.report_json import plain
from imumon.model.samples import DeviceInfo
from imumon.model.saved_state import restorable, unpack
from imumon.model.system_errors import OTHER_STATE, cure_of_writing

FORMAT = 16
"""Version of what a state holds: of the attributes of all objects in it, which a test compares with this number."""
LEVEL = 1
"""Compression level of zlib: level 6 takes one and a half times the time for 1 % less."""

FILE_BYTES = 1 << 26
"""Bytes of the largest file that is read as a state; a record of a year has less than 1 MB."""

PLAIN_BYTES = 1 << 28
"""Bytes of the largest state after decompression."""

FLUSH_S = 5.0
"""s for which a state waits for the disk."""

_MAGIC = b"imumon-state "
"""First bytes of a state of any format."""

NO_ROOM = (errno.ENOSPC, errno.EDQUOT)
"""Errors of a full disk. A small one may have room for two states, but not for three."""
_OUT_OF_MEMORY = "out of memory: grant more"


class StateError(ImumonError):
    """The state cannot be used."""


for _known in (DeviceInfo, ColumnUse, SessionCounters):
    restorable(_known)


@restorable
@dataclass(frozen=True, slots=True, kw_only=True)
class StateHeader:
    """Whose state it is and when it was saved."""

    version: str  # of imumon
    device: DeviceInfo
    settings: Mapping[str, str]  # those that change the data, by name, when the record began
    session: SessionCounters  # of the link, over all runs of the record; its ledger is without the samples
    saved: str  # ISO 8601
    boot: str | None  # id of the boot of the machine; null: it is hidden
    uptime_s: float  # s, of that boot when it was saved
    age_s: float  # s, of the newest sample at that time


@restorable
@dataclass(frozen=True, slots=True)
class SavedState:
    """Content of a state file: whose it is, and what `imumon.record` saves of the record."""

    header: StateHeader
    record: Any


def encode(packed: bytes) -> bytes:
    """Return the content of the file of a state from its packed objects."""
    content = zlib.compress(packed, LEVEL)
    return b"%s%d %s\n" % (_MAGIC, FORMAT, _checksum(content)) + content


def _checksum(content: bytes) -> bytes:
    return hashlib.sha256(content).hexdigest().encode()


def is_state(head: bytes) -> bool:
    """Return whether a file with these first bytes is a state of any format."""
    return head.startswith(_MAGIC)


def decode(data: bytes, name: str = "the state") -> Any:
    """Return the objects in the content of a file, which messages call `name`.

    Raises
    ------
    StateError : ``state_invalid``, not a state file; ``state_version``, another format; ``state_damaged``.
    """
    if not is_state(data):
        raise StateError("state_invalid", f"{name} is not a state file")
    line, _, content = data.partition(b"\n")
    begin = b"%s%d " % (_MAGIC, FORMAT)
    if not line.startswith(begin):
        raise StateError("state_version", f"{name} is of another version of imumon, which has another format")
    if line.removeprefix(begin) != _checksum(content):
        raise StateError("state_damaged", f"{name} is damaged (its checksum differs)")
    try:
        return unpack(zlib.decompressobj().decompress(content, PLAIN_BYTES))
    except (
        zlib.error,
        ValueError,
        LookupError,
        TypeError,
        AttributeError,
        RecursionError,
    ) as error:  # a checksum proves no origin
        raise StateError("state_damaged", f"{name} is damaged ({plain(str(error))})") from None


def check_directory(directory: Path) -> None:
    """Raise `StateError` if this cannot be a directory: it, or a part of its path, is something else."""
    existing = next((path for path in (directory, *directory.parents) if os.path.lexists(path)), None)
    if existing is not None and not existing.is_dir():
        text = f"the state cannot be saved in {directory}: {existing} is not a directory"
        raise StateError("state_no_directory", text, "give a directory with --state")
    if existing is not None and not os.access(existing, os.W_OK | os.X_OK):
        text = f"the state cannot be saved in {directory}: {existing} cannot be written"
        raise StateError(
            "state_no_directory", text, "give another directory with --state, or make it writable"
        )


class Checkpoint:
    """State file of one device.

    Parameters
    ----------
    directory : is created if it does not exist.
    device : name of the device, valid as a file name.

    Attributes
    ----------
    failed : why the last save did not reach the disk; None if it did.
    made_again : how often the state was written again after its lock, or its directory, was removed.

    Raises
    ------
    StateError : ``state_locked``, another daemon uses the state of this device; ``state_not_lockable``.
    """

    def __init__(self, directory: Path, device: str) -> None:
        self.path = directory / f"{device}.state"
        self.previous = directory / f"{device}.state.1"
        self.failed: str | None = None
        self.made_again = 0
        self._device, self._lock = device, -1
        self._deferred: list[tuple[str, Path | None]] = []  # arguments of `_move` that failed, to try again
        try:
            self._acquire_lock()
        except OSError as error:
            self.failed = self._reason(error)
        self._changed = threading.Condition()
        self._next: bytes | None = None
        self._before: Callable[[], None] | None = None  # of the next one
        self._writing = False

    def _acquire_lock(self) -> None:
        """Create the directory and lock the state of the device; raise OSError or StateError if impossible."""
        directory = self.path.parent
        directory.mkdir(parents=True, exist_ok=True)
        lock = self._open_lock(directory / f"{self._device}.lock")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(lock)
            if isinstance(error, BlockingIOError):
                text = f"another imumon uses the state of {self._device} in {directory}"
                raise StateError("state_locked", text, "stop it or choose another --state") from None
            # some network file systems have no locks
            text = f"files cannot be locked in {directory} ({why(error)})"
            raise StateError("state_not_lockable", text, "choose another --state") from None
        self._lock = lock

    def _open_lock(self, path: Path) -> int:
        """Return the descriptor of the lock file, which only its owner may open: any reader could lock it."""
        with suppress(FileNotFoundError):
            if not stat.S_ISREG(path.lstat().st_mode):  # a link or a pipe: no process has locked it
                self._move("not-a-lock", path)
        lock = open_regular(path, os.O_RDWR | os.O_CREAT, mode=0o600)
        with suppress(OSError):  # somebody else may have made it
            os.fchmod(lock, 0o600)
        return lock

    def _has_lock(self) -> bool:
        """Return whether this process has the lock and the locked file still exists under its name."""
        with suppress(FileNotFoundError):
            existing = os.stat(self.path.with_name(f"{self._device}.lock"))
            return self._lock >= 0 and os.path.samestat(existing, os.fstat(self._lock))
        return False

    @property
    def exists(self) -> bool:
        """Whether there is a state of either generation."""
        return os.path.lexists(self.path) or os.path.lexists(self.previous)

    def load(self) -> tuple[Any, list[str]]:
        """Return the newest state that can be read, or None, and a message for each file that was set aside."""
        messages: list[str] = []
        for path in (self.path, self.previous):
            try:
                return decode(read_bounded(path, FILE_BYTES), f"state {path.name}"), messages
            except FileNotFoundError:
                continue
            except MemoryError:
                reason, message = "damaged", f"state {path.name} needs more memory than there is"
            except OSError as error:
                message = f"state {path.name} cannot be read ({why(error)})"
                reason = "unreadable"
            except StateError as error:
                reason = "other-version" if error.code == "state_version" else "damaged"
                message = error.message
            if os.path.lexists(path):
                message += f"; kept as {self.set_aside(reason, path).name}"
            messages.append(message)  # of a directory that may not be searched, no file is known
        return None, messages

    def set_aside(self, reason: str, path: Path | None = None) -> Path:
        """Rename a file to ``DEVICE.REASON-N.state`` and return its path, unchanged if the next save must do it.

        Parameters
        ----------
        path : file to rename; None: the newest generation, and the older one is deleted.
        """
        if self._lock >= 0:
            with suppress(OSError):
                return self._move(reason, path)
        self._deferred.append((reason, path))
        return path or self._newest

    @property
    def _newest(self) -> Path:
        return self.path if os.path.lexists(self.path) else self.previous

    def _move(self, reason: str, path: Path | None) -> Path:
        aside = rename_aside(path or self._newest, self._device, reason, ".state")
        if path is None:
            self.previous.unlink(missing_ok=True)
        return aside

    def save(self, state: bytes, before: Callable[[], None] | None = None) -> None:
        """Write a state in the background; it replaces one that is not being written yet.

        Parameters
        ----------
        state : packed objects, as `decode` returns them.
        before : returns when what belongs to the state is in its own files; None: there is nothing.
        """
        with self._changed:
            self._next, self._before = state, before
            if self._writing:
                return
            self._writing = True
        try:
            threading.Thread(target=self._write_pending, name="checkpoint", daemon=True).start()
        except (RuntimeError, MemoryError):
            self.failed = "a thread cannot be started: grant more memory or more threads"
            self._finish_writing()

    def flush(self) -> bool:
        """Wait until every state is written or has failed; return False if that takes longer."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._writing, FLUSH_S)

    def close(self, state: bytes | None = None, before: Callable[[], None] | None = None) -> None:
        """Write the last state, wait for the disk, release the lock; `before` is as of `save`."""
        if state is not None:
            self.save(state, before)
        if self.flush():
            self._write_pending()  # if no thread could be started
        self._release_lock()

    def _release_lock(self) -> None:
        if self._lock >= 0:
            os.close(self._lock)
        self._lock = -1

    def _write_pending(self) -> None:
        """Write states until none is pending."""
        try:
            while True:
                with self._changed:
                    state, before, self._next, self._before = self._next, self._before, None, None
                    if state is None:
                        self._finish_writing()
                        return
                if before is not None:
                    before()
                self._write_state(state)
        except Exception:  # even the reason of a failure could not be formatted
            self.failed = _OUT_OF_MEMORY
            self._finish_writing()

    def _write_state(self, state: bytes) -> None:
        try:
            removed = self._lock >= 0 and not self._has_lock()
            if self._lock < 0 or removed:
                self._release_lock()
                self._acquire_lock()
                self.made_again += removed
            while self._deferred:  # before the files are overwritten
                self._move(*self._deferred[0])
                self._deferred.pop(0)
            self._write(encode(state))
            self.failed = None
        except Exception as error:  # no failure may prevent the next save
            self.failed = self._reason(error)

    def _finish_writing(self) -> None:
        with self._changed:
            self._writing = False
            self._changed.notify_all()

    def _reason(self, error: Exception) -> str:
        """Return what is wrong and what to do about it."""
        if isinstance(error, StateError):
            return str(error)
        if isinstance(error, MemoryError):
            return _OUT_OF_MEMORY
        message = error.strerror if isinstance(error, OSError) else str(error)
        return f"{self.path.parent}: {message or type(error).__name__}: {cure_of_writing(error, OTHER_STATE)}"

    def _keep_previous(self) -> None:
        """Give the present state the name of the previous one, too: at each moment a state has its own name."""
        link = self.previous.with_suffix(".link")
        try:
            link.unlink(missing_ok=True)
            os.link(self.path, link, follow_symlinks=False)
        except OSError:  # a file system without links, such as that of a memory card, or no regular file
            os.replace(self.path, self.previous)
            return
        os.replace(link, self.previous)
        # where both names are links to one file already, to rename one over the other does nothing
        link.unlink(missing_ok=True)

    def _write(self, data: bytes) -> None:
        new = self.path.with_suffix(".state.new")
        try:
            try:
                write_new(new, data)
            except OSError as error:
                if error.errno not in NO_ROOM or not (os.path.lexists(self.path) and self.previous.exists()):
                    raise
                self.previous.unlink()  # the newest state stays until the new one is whole
                write_new(new, data)
        except OSError as error:
            if error.errno not in NO_ROOM:
                raise
            text = f"{os.strerror(error.errno)}, {math.ceil(len(data) / 1000)} kB are needed"
            raise OSError(error.errno, text) from None
        if os.path.lexists(self.path):
            self._keep_previous()
        os.replace(new, self.path)
        directory = os.open(self.path.parent, os.O_RDONLY)
        try:
            os.fsync(directory)
        finally:
            os.close(directory)
