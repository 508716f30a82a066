"""Errors that a user may see: a stable code, a message and a cure.

Programs and tests look at `code`, people read `message` (what is wrong) and `cure` (what to do about it). No
code looks at the text: it may be reworded at any time. A subclass is one kind of situation that a
caller distinguishes by type, such as "no device there"; it lives in the package that raises it, and here if
several packages raise it.
"""

from __future__ import annotations

QUOTED = 40
"""Characters that a message quotes of foreign text at most."""


def why(error: Exception) -> str:
    """Return the reason of an error of the system or of a library, as a part of a message."""
    return (getattr(error, "strerror", None) or str(error) or type(error).__name__).lower()


class ImumonError(Exception):
    """Base class of all errors that a user may see.

    Parameters
    ----------
    code : stable word for programs and tests, such as ``port_busy``.
    message : what is wrong, one line without a final period.
    cure : what the user can do, one line; empty if there is nothing to do.
    """

    def __init__(self, code: str, message: str, cure: str = "") -> None:
        super().__init__(f"{message}: {cure}" if cure else message)
        self.code = code
        self.message = message
        self.cure = cure


class RateRequired(ImumonError):
    """The samples have no clock, and no sample rate is configured."""
