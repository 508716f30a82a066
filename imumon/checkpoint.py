"""State on disk: what was accumulated survives a stop, a crash, a power cut and an upgrade.

One file a device, written whole beside the old one and then put in its place, so that a reader finds either
the old state or the new one, never a half. The generation before is kept: if the newest file is damaged,
the one before serves. A file that cannot serve is set aside under another name with a reason, never
overwritten and never mixed in. Where nothing can be written, what is there is read, every save tries anew,
and `Checkpoint.failed` says why.

The file: one line ``imumon-state 2 CRC32 LENGTH`` and then LENGTH bytes of zlib: a line of JSON (``meta``,
and name, type and shape of every array), and the arrays, of each the first bytes of all its numbers, then all
second ones and so on, which is how numbers alike in size pack best: a state is written thousands of times a
day, often to a memory card. Packing and writing go on in a thread of their own: a slow disk must not hold up
the samples.
"""

from __future__ import annotations

import fcntl
import json
import math
import os
import re
import threading
import zlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

FORMAT = 2
LEVEL = 1  # of zlib: the next ones take twice the time for 3 % less
_MAGIC = "imumon-state"
_NO_MEMORY = "out of memory: grant more"

Arrays: TypeAlias = Mapping[str, npt.NDArray[Any]]


class StateError(Exception):
    """The state cannot be used; the text says why and what to do."""


class OtherFormat(StateError):
    """A state of an earlier or a later version, whole as far as one can tell."""


@dataclass(frozen=True, slots=True)
class SavedState:
    """What is kept: `meta` is JSON (identity, counters, small values), `arrays` the accumulators."""

    meta: dict[str, Any]
    arrays: dict[str, npt.NDArray[Any]]


def encode(state: SavedState) -> bytes:
    """File contents of a state."""
    arrays = {name: np.asarray(array) for name, array in state.arrays.items()}
    index = [(name, array.dtype.str, array.shape) for name, array in arrays.items()]
    head = json.dumps({"meta": state.meta, "arrays": index}, allow_nan=False).encode()
    whole = b"".join((head, b"\n", *map(_by_bytes, arrays.values())))
    data = zlib.compress(whole, LEVEL)
    return f"{_MAGIC} {FORMAT} {zlib.crc32(data):08x} {len(data)}\n".encode() + data


def _by_bytes(array: npt.NDArray[Any]) -> bytes:
    """First bytes of all numbers, then all second ones ..."""
    flat = np.ascontiguousarray(array).reshape(-1)
    return flat.view(np.uint8).reshape(flat.size, flat.itemsize).T.tobytes()


def decode(data: bytes) -> SavedState:
    """State in the contents of a file.

    Raises
    ------
    OtherFormat : of another version.
    StateError : not a state, or damaged.
    """
    line, _, body = data.partition(b"\n")
    words = re.fullmatch(
        rf"{_MAGIC} (\d{{1,9}}) ([0-9a-f]{{8}}) (\d{{1,18}})", line.decode("latin-1"), re.ASCII
    )
    if words is None:
        raise StateError("not a state file")
    if int(words[1]) != FORMAT:
        raise OtherFormat(f"of another version of imumon (format {words[1]}; this one reads {FORMAT})")
    if len(body) != int(words[3]) or f"{zlib.crc32(body):08x}" != words[2]:
        raise StateError("damaged (its checksum does not match)")
    try:
        return _unpacked(zlib.decompress(body))
    except (zlib.error, ValueError, KeyError, TypeError, AttributeError) as error:
        raise StateError(f"damaged ({error})") from None


def _unpacked(whole: bytes) -> SavedState:
    head, _, rest = whole.partition(b"\n")
    told = json.loads(head)
    arrays, begin = {}, 0
    for name, kind, shape in told["arrays"]:
        dtype, count = np.dtype(kind), math.prod(shape)
        end = begin + count * dtype.itemsize
        numbers = np.frombuffer(rest[begin:end], np.uint8).reshape(dtype.itemsize, count).T
        arrays[name] = np.ascontiguousarray(numbers).reshape(-1).view(dtype).reshape(shape)
        begin = end
    return SavedState(told["meta"], arrays)


class Checkpoint:
    """The state file of one device.

    Parameters
    ----------
    directory : made if it is not there.
    device : name of the device, already fit for a file name.

    Raises
    ------
    StateError : another daemon holds this device's state, or nothing can be locked there.
    """

    def __init__(self, directory: Path, device: str) -> None:
        self.path = directory / f"{device}.state"
        self.previous = directory / f"{device}.state.1"
        self.failed: str | None = None  # why the last save did not reach the disk
        self.saved = 0
        self._device, self._lock = device, -1
        self._owed: list[tuple[str, Path | None]] = []  # what is to be set aside, once that can be done
        try:
            self._take_hold()
        except OSError as error:
            self.failed = self._why(error)
        self._change = threading.Condition()
        self._next: SavedState | None = None
        self._writing = False

    def _take_hold(self) -> None:
        """Have the directory and the lock in it.

        Raises
        ------
        OSError : it cannot be made or written.
        StateError : another daemon has the lock, or nothing can be locked there.
        """
        directory = self.path.parent
        directory.mkdir(parents=True, exist_ok=True)
        lock = os.open(directory / f"{self._device}.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(lock)
            if isinstance(error, BlockingIOError):
                why, cure = f"another imumon keeps the state of {self._device} in {directory}", "stop it or "
            else:  # a network share, mostly
                why = f"no file can be locked in {directory} ({(error.strerror or str(error)).lower()})"
                cure = ""
            raise StateError(f"{why}; {cure}give another --state") from None
        self._lock = lock

    def _holds(self) -> bool:
        """Whether the lock is ours and still in its place: somebody may have removed the directory."""
        if self._lock < 0:
            return False
        try:
            place = os.stat(self.path.with_name(f"{self._device}.lock"))
        except FileNotFoundError:
            return False
        return os.path.samestat(place, os.fstat(self._lock))

    @property
    def there(self) -> bool:
        """Whether there is a state, of either generation."""
        return self.path.exists() or self.previous.exists()

    def load(self) -> tuple[SavedState | None, list[str]]:
        """Newest state that can be read, and what had to be set aside on the way, in words."""
        said: list[str] = []
        for path in (self.path, self.previous):
            try:
                return decode(path.read_bytes()), said
            except FileNotFoundError:
                continue
            except OSError as error:
                reason, why = "unreadable", f"not to be read ({(error.strerror or str(error)).lower()})"
            except OtherFormat as error:
                reason, why = "other-version", str(error)
            except StateError as error:
                reason, why = "damaged", str(error)
            said.append(f"state {path.name} is {why}; kept as {self.set_aside(reason, path).name}")
        return None, said

    def set_aside(self, reason: str, path: Path | None = None) -> Path:
        """Move the state to a name of its own, ``DEVICE.REASON-N.state``; later, where it cannot be now."""
        if self._lock >= 0:
            with suppress(OSError):
                return self._move(reason, path)
        self._owed.append((reason, path))
        return path or self._newest

    @property
    def _newest(self) -> Path:
        return self.path if self.path.exists() else self.previous

    def _move(self, reason: str, path: Path | None) -> Path:
        source, stem = path or self._newest, self.path.name.removesuffix(".state")
        for number in range(1, 10_000):
            aside = self.path.with_name(f"{stem}.{reason}-{number}.state")
            if not aside.exists():
                break
        if source.exists():
            source.rename(aside)
        if path is None:
            self.previous.unlink(missing_ok=True)
        return aside

    def save(self, state: SavedState) -> None:
        """Hand over a state to be written soon; a newer one replaces one that still waits."""
        with self._change:
            self._next = state
            if self._writing:
                return
            self._writing = True
        try:
            threading.Thread(target=self._write_all, name="checkpoint", daemon=True).start()
        except (RuntimeError, MemoryError):
            self.failed = "no thread can begin: grant more memory, or more threads"
            self._written()

    def settle(self, timeout_s: float = 5.0) -> bool:
        """Wait until what was handed over is written, or could not be; False when it takes too long."""
        with self._change:
            return self._change.wait_for(lambda: not self._writing, timeout_s)

    def close(self, state: SavedState | None = None, timeout_s: float = 5.0) -> None:
        """Write the last state, wait for the disk, let go of the lock."""
        if state is not None:
            self.save(state)
        if self.settle(timeout_s):
            self._write_all()  # where no thread could
        self._let_go()

    def _let_go(self) -> None:
        if self._lock >= 0:
            os.close(self._lock)
        self._lock = -1

    def _write_all(self) -> None:
        """Write what waits; then the thread ends, and with it the memory that the C library keeps for it."""
        try:
            while self._write_next():
                pass
        except Exception:  # there is not even memory to say what is wrong
            self.failed = _NO_MEMORY
            self._written()

    def _write_next(self) -> bool:
        """Write the state that waits and let go of it; False: there is none, the next has another thread."""
        with self._change:
            state, self._next = self._next, None
            if state is None:
                self._written()
                return False
        try:
            if not self._holds():
                self._let_go()
                self._take_hold()
            while self._owed:  # or it would be overwritten
                self._move(*self._owed[0])
                self._owed.pop(0)
            self._write(encode(state))
            self.failed, self.saved = None, self.saved + 1
        except Exception as error:  # whatever it is, the next save gets its chance
            self.failed = self._why(error)
        return True

    def _written(self) -> None:
        with self._change:
            self._writing = False
            self._change.notify_all()

    def _why(self, error: Exception) -> str:
        """What is wrong, and how to mend it."""
        if isinstance(error, StateError):
            return str(error)
        if isinstance(error, MemoryError):
            return _NO_MEMORY
        why = error.strerror if isinstance(error, OSError) else str(error)
        return f"{self.path.parent}: {why or type(error).__name__}; make room there or give another --state"

    def _write(self, data: bytes) -> None:
        new = self.path.with_suffix(".state.new")
        try:
            with open(new, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
        except OSError:
            new.unlink(missing_ok=True)  # half a file on a full disk helps nobody
            raise
        if self.path.exists():
            os.replace(self.path, self.previous)
        os.replace(new, self.path)
        directory = os.open(self.path.parent, os.O_RDONLY)
        try:
            os.fsync(directory)
        finally:
            os.close(directory)
