"""Letters: text for a standard stream whose encoding lacks some of them.

The encoding of stdout is the user's to choose (a locale, PYTHONIOENCODING), and a unit such as °/√h is not
worth a failure: what cannot be written is spelt. JSON spells what is missing its own way, so nothing of it is
lost.
"""

from __future__ import annotations

import codecs
import io
import json
import sys
from typing import TextIO

_SPELT = str.maketrans(
    {
        "√": "sqrt ", "°": "deg", "²": "^2", "³": "^3", "½": "1/2", "±": "+-", "×": "x", "÷": "/", "·": "*",
        "−": "-", "–": "-", "—": "-", "…": "...", "χ": "chi", "σ": "sigma", "τ": "tau", "π": "pi", "≥": ">=",
        "≤": "<=", "→": "->",
    }
)  # fmt: skip


def _spell(error: UnicodeError) -> tuple[str, int]:
    """What stands for letters that an encoding lacks; a question mark for one without a spelling."""
    assert isinstance(error, UnicodeEncodeError)
    text = error.object[error.start : error.end].translate(_SPELT)
    return "".join(letter if letter.isascii() else "?" for letter in text), error.end


codecs.register_error("imumon", _spell)


def write_whatever_comes(*streams: TextIO) -> None:
    """Let no letter be an error on these streams, whatever their encoding."""
    for stream in streams:
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="imumon")


def print_json(text: str) -> None:
    """JSON on stdout; letters that the encoding lacks are escaped (RFC 8259, section 7)."""
    try:
        text.encode(sys.stdout.encoding or "utf-8")
    except UnicodeEncodeError:
        text = json.dumps(json.loads(text))
    print(text)
