"""Files that another user may have prepared: opened without following a link, waiting, or reading without end.

A directory may be writable for others. A name in it may then be a symbolic link to another file, a pipe whose
opening never returns, a device without an end, or a file larger than the memory. `open_regular` opens regular files
only, and `read_bounded` reads at most a given number of bytes. `write_new` never writes through something that
exists, and `replace_file` never leaves a part of a file. The type is checked before opening, because opening has
effects, and after it, because a name may change between a check and its use.
"""

from __future__ import annotations

import errno
import os
import stat
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

_PIECE = 1 << 20
"""Bytes that are read at once from a file without a size, such as a pipe."""


MOST_ASIDE = 10
"""Files of one name that are kept of those that cannot be used."""

UNUSABLE = ("damaged", "unreadable", "not-a-lock")
"""Reasons for which a set-aside file is useless. One of another version or sensor can be used again, and is kept."""

ROOM_BYTES = 1 << 20
"""Bytes that must be free before a document is made: about those of the longest one."""

SMALL_BYTES = 1 << 16
"""Bytes of the largest file that a person writes, or that holds the settings of a sensor."""


def lack_of_files() -> OSError | None:
    """Return the error of opening one more file, if the process or the machine has no descriptor left.

    SQLite says only that it cannot open a file.
    """
    try:
        os.close(os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC))
    except OSError as error:
        return error if error.errno in (errno.EMFILE, errno.ENFILE) else None
    return None


def open_regular(
    path: Path | str, flags: int = os.O_RDONLY, *, follow: bool = False, mode: int = 0o666
) -> int:
    """Return the descriptor of a regular file.

    Parameters
    ----------
    flags, mode : of `os.open`.
    follow : whether the last part of the path may be a symbolic link.

    Raises
    ------
    OSError : it cannot be opened, or is something else.
    """
    try:  # before opening, which starts the writer of a pipe and can reset the device at a serial port
        regular = stat.S_ISREG(os.stat(path, follow_symlinks=follow).st_mode)
    except FileNotFoundError:
        regular = True  # it may be created
    if not regular:
        raise _not_regular(path)
    link = 0 if follow else os.O_NOFOLLOW
    file = os.open(path, flags | link | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC, mode)
    if not stat.S_ISREG(os.fstat(file).st_mode):
        os.close(file)
        raise _not_regular(path)
    return file


def _not_regular(path: Path | str) -> OSError:
    return OSError(errno.EINVAL, "it is not a regular file", str(path))


def read_bounded(path: Path | str, limit: int) -> bytes:
    """Return the content of a regular file that is not a symbolic link.

    Raises
    ------
    OSError : it cannot be read, is something else, or has more than `limit` bytes.
    """
    with open(open_regular(path), "rb") as file:
        return read_at_most(file, limit)


def read_at_most(file: BinaryIO, limit: int) -> bytes:
    """Return what a file holds; raise OSError if these are more than `limit` bytes."""
    pieces: list[bytes] = []
    size = 0
    while piece := file.read(min(_PIECE, limit + 1 - size)):
        pieces.append(piece)
        size += len(piece)
        if size > limit:
            raise OSError(errno.EFBIG, f"it is larger than {limit:,} bytes")
    return b"".join(pieces)


def replace_file(path: str | Path, data: bytes) -> None:
    """Write a file beside its place and give it its name when it is complete.

    What is no regular file is written as it is, and so is a file in a directory that takes no other.

    Raises
    ------
    OSError : it cannot be written; then the file is as before.
    """
    target = Path(os.path.realpath(path))
    if (target.exists() and not target.is_file()) or not os.access(target.parent, os.W_OK):
        target.write_bytes(data)
        return
    new = target.with_name(f".{target.name}.{os.getpid()}.new")
    write_new(new, data)
    if target.exists():
        new.chmod(stat.S_IMODE(target.stat().st_mode))
    os.replace(new, target)


def check_replaceable(path: str | Path) -> None:
    """Write a file of `ROOM_BYTES` where `replace_file` will write, and remove it: before long work, not after it.

    Raises
    ------
    OSError : the directory does not exist, is not writable, or has no room.
    """
    target = Path(os.path.realpath(path))
    if target.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(target))
    if target.exists() and not target.is_file():
        return  # opening a pipe would end its reader
    if target.exists() and not os.access(target.parent, os.W_OK):
        with target.open("ab"):
            return
    new = target.with_name(f".{target.name}.{os.getpid()}.new")
    try:
        write_new(new, bytes(ROOM_BYTES))
    finally:
        with suppress(OSError):
            new.unlink()


def rename_aside(path: Path, stem: str, reason: str, suffix: str) -> Path:
    """Rename a file to ``STEM.REASON-N.SUFFIX``, after all others; return it. A missing file is no error.

    Of files that are of no use, the newest `MOST_ASIDE` are kept: a disk that damages one each day, or a program that
    puts a pipe in its place, must not fill the directory.
    """
    begin, numbers = f"{stem}.{reason}-", []
    with os.scandir(path.parent) as entries:
        for entry in entries:
            number = entry.name.removeprefix(begin).removesuffix(suffix)
            if entry.name == f"{begin}{number}{suffix}" and number.isdecimal():
                numbers.append(int(number))
    aside = path.with_name(f"{begin}{max(numbers, default=0) + 1}{suffix}")
    if os.path.lexists(path):
        path.rename(aside)
    for old in sorted(numbers)[: -(MOST_ASIDE - 1)] if reason in UNUSABLE else ():
        with suppress(OSError):
            path.with_name(f"{begin}{old}{suffix}").unlink()
    return aside


def write_new(path: Path, data: bytes) -> None:
    """Write a new file and force it to disk; what had its name is removed, and a link is not followed.

    Raises
    ------
    OSError : it cannot be written; then there is no such file.
    """
    path.unlink(missing_ok=True)
    file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
    try:
        with open(file, "wb") as out:
            out.write(data)
            out.flush()
            os.fsync(out.fileno())
    except OSError:
        path.unlink(missing_ok=True)  # frees the space on a full disk
        raise
