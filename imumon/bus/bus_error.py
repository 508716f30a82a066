"""Errors of the bus: Zenoh has one type and no code for all causes; here they get a code, a message and a cure."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence

import zenoh

from imumon.model.errors import ImumonError


class BusError(ImumonError):
    """The bus cannot be used: a problem with an endpoint, a credential or a name.

    `setting` is the dotted name of the setting whose value is invalid, such as ``zenoh.raw``. None: the error
    may vanish without a change of the settings, or its value is not from the settings.
    """

    def __init__(self, code: str, message: str, cure: str = "", *, setting: str | None = None) -> None:
        super().__init__(code, message, cure)
        self.setting = setting


class Unreachable(BusError):
    """No connection to an endpoint. Zenoh does not say whether it is absent or refuses the credentials."""


_PRIVILEGE = "choose a port above 1023, or a directory that you may write to"
_ANOTHER = "choose another with --listen"
_UNREACHABLE = "check that a daemon or router listens there, and the password or certificate"
_KNOWN_ERRORS = (
    (
        "unable to connect to any",
        "unreachable",
        "no answer, or a wrong password or certificate",
        _UNREACHABLE,
    ),
    ("address already in use", "address_in_use", "in use by another daemon or program", _ANOTHER),
    ("cannot assign requested address", "address_not_local", "not an address of this machine", _ANOTHER),
    ("permission denied", "permission_denied", "no permission", _PRIVILEGE),
    ("no such file or directory", "path_not_found", "no such directory", "create the directory {directory}"),
    ("failed to lookup address", "host_unknown", "no such host", "check the name of the host"),
)
"""Text in an error of Zenoh (lower case), code, message and cure. The first match counts."""


def classify(error: zenoh.ZError, endpoints: Sequence[str]) -> BusError:
    """Return an error of Zenoh as a `BusError`; code ``session_failed`` if it is unknown.

    This is the only place where the text of an error decides: `zenoh.ZError` has one type and no code for all
    causes. An unknown text, also one that a new release of Zenoh changes, is shown as it is.
    """
    text = str(error)
    where = next((e for e in endpoints if e in text), None) or (endpoints[0] if endpoints else "Zenoh")
    for pattern, code, message, cure in _KNOWN_ERRORS:
        if pattern in text.lower():
            kind = Unreachable if code == "unreachable" else BusError
            directory = os.path.dirname(where.partition("/")[2])
            return kind(code, f"{where}: {message}", cure.format(directory=directory))
    return BusError("session_failed", f"{where}: {readable(text)}", "check the settings of [zenoh]")


def readable(text: str) -> str:
    """Return the text of an error of Zenoh without the locations in its source code.

    >>> readable('Str("unknown key") at /home/x/.cargo/x/config.rs:86.')
    'unknown key'
    """
    text = re.sub(r"\s+at /\S+\.rs:\d+\.?", "", text)
    quoted = re.search(r'(?:Str\(|msg: )"((?:[^"\\]|\\.)*)"', text)
    return " ".join((quoted[1] if quoted else text).split()).rstrip(".]")
