"""Errors of the operating system as messages: what is wrong, and what to do about it.

The number of an error says what has happened, and with it what helps: space, permission, a limit, another place. A
caller knows only how a user names another place, such as ``give another --record``. An error that is not in the tables
has the other place as its cure; the text of the system says what is wrong.

A file that is read can also be damaged: a decoder then seeks to a place that cannot be, and the system refuses it with
an error of its own. This is no error of the path or the disk, see `is_damage`.
"""

from __future__ import annotations

import errno

from imumon.model.errors import ImumonError, why

OTHER_STATE = "choose another --state"
"""How a user names another place of a state and a history."""

_OF_THE_MACHINE = {
    errno.EMFILE: "allow more open files: ulimit -n, or LimitNOFILE= of a service",
    errno.ENFILE: "close programs: the whole machine has no descriptor left (fs.file-max)",
    errno.ENOMEM: "grant more memory",
    errno.EIO: "check the disk: the log of the kernel has its errors",
    errno.ESTALE: "mount the network file system again",
    errno.ENAMETOOLONG: "use a shorter name",
    errno.ELOOP: "replace the symbolic link: it leads to itself, or is not followed here",
}
"""What to do about an error that does not depend on what the file is for."""

_OF_WRITING = {
    errno.ENOSPC: "free space, or {elsewhere}",
    errno.EDQUOT: "free space of your quota, or {elsewhere}",
    errno.EFBIG: "raise the limit of file sizes (ulimit -f, or LimitFSIZE= of a service), or {elsewhere}",
    **dict.fromkeys((errno.EROFS, errno.EACCES, errno.EPERM), "make it writable, or {elsewhere}"),
    **dict.fromkeys((errno.ENOENT, errno.ENOTDIR), "create its directory, or {elsewhere}"),
    **dict.fromkeys((errno.EBUSY, errno.ETXTBSY), "end the program that uses it, or {elsewhere}"),
    errno.EAGAIN: "let its reader read faster, or {elsewhere}",
}
"""What to do about an error of writing."""

_OF_READING = {
    **dict.fromkeys((errno.EACCES, errno.EPERM), "grant the permission to read it"),
    errno.EISDIR: "name a file in it",
    errno.EINVAL: "name a regular file",
    errno.EFBIG: "name a smaller file",
}
"""What to do about an error of reading, if it is not to check the path."""

_OF_SQLITE = {
    "FULL": errno.ENOSPC, "READONLY": errno.EROFS, "CANTOPEN": errno.EACCES, "PERM": errno.EACCES, "IOERR": errno.EIO,
    "NOMEM": errno.ENOMEM, "BUSY": errno.EBUSY, "LOCKED": errno.EBUSY, "TOOBIG": errno.EFBIG,
}  # fmt: skip
"""Number of the system by the second word of a name of SQLite, such as ``SQLITE_IOERR_WRITE``."""


def cure_of_writing(error: Exception, elsewhere: str) -> str:
    """Return what to do about an error of writing.

    Parameters
    ----------
    elsewhere : how a user names another place.

    >>> cure_of_writing(OSError(errno.EFBIG, "file too large"), "name another file")
    'raise the limit of file sizes (ulimit -f, or LimitFSIZE= of a service), or name another file'
    >>> cure_of_writing(OSError(errno.EPROTO, "protocol error"), "name another file")
    'name another file'
    """
    cure = (_OF_THE_MACHINE | _OF_WRITING).get(_number(error), "{elsewhere}")
    return cure.format(elsewhere=elsewhere)


def cure_of_reading(error: Exception) -> str:
    """Return what to do about an error of opening or reading a file that the user names."""
    return (_OF_THE_MACHINE | _OF_READING).get(_number(error), "check the path")


def not_written(name: str, error: OSError, elsewhere: str) -> ImumonError:
    """Return the error of a file, a stream or a connection that cannot be written."""
    text = f"cannot write {name}: {why(error)}"
    return ImumonError("output_not_writable", text, cure_of_writing(error, elsewhere))


def not_read(name: str, error: OSError) -> ImumonError:
    """Return the error of a file that cannot be read."""
    return ImumonError("file_unreadable", f"cannot read {name}: {why(error)}", cure_of_reading(error))


def not_done(error: OSError) -> ImumonError:
    """Return the error of an operation of which nothing else is known: it says the number and the file, if any."""
    name, cure = (str(error.filename), "check the path") if error.filename else ("the system", "try again")
    return ImumonError("system_error", f"{name}: {why(error)}", cure_of_writing(error, cure))


def is_damage(error: OSError) -> bool:
    """Return whether an error of decoding an open file says that its contents are wrong, not that it cannot be read.

    Libraries raise errors without a number. The system refuses an offset that no file can have.
    """
    return error.errno in (None, errno.EINVAL, errno.EOVERFLOW)


def _number(error: Exception) -> int:
    """Return the number of an error; 0: it has none."""
    if isinstance(error, MemoryError):
        return errno.ENOMEM
    words = (getattr(error, "sqlite_errorname", None) or "").split("_")
    return getattr(error, "errno", None) or _OF_SQLITE.get("".join(words[1:2]), 0)
