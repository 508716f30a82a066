"""Output of the commands: data on standard output, messages on standard error.

A standard stream may be closed, full, or have an encoding that lacks characters such as ° and √. None of this
is an error of the command: a character that cannot be encoded is replaced by an ASCII spelling, and JSON escapes
it, so no data is lost.
"""

from __future__ import annotations

import codecs
import errno
import io
import json
import os
import shutil
import sys
from contextlib import suppress
from dataclasses import asdict
from functools import cache
from typing import Any

from imumon.model.errors import ImumonError
from imumon.model.report_json import plain, to_json
from imumon.model.system_errors import not_written

_ASCII = str.maketrans(
    {
        "√": "sqrt ", "°": "deg", "²": "^2", "³": "^3", "½": "1/2", "±": "+-", "×": "x", "÷": "/", "·": "*",
        "−": "-", "–": "-", "—": "-", "…": "...", "χ": "chi", "σ": "sigma", "τ": "tau", "π": "pi", "≥": ">=",
        "≤": "<=", "→": "->",
    }
)  # fmt: skip

WHOLE = "--verbose prints the whole datasheet; imumon report -o X.html writes it."
WHOLE_STOPPED = WHOLE.replace("report", "report FILE")
"""Last line of a summary: without a daemon, the datasheet is that of a file, a recording or the saved state."""


def _replace_unencodable(error: UnicodeError) -> tuple[str, int]:
    """Return the ASCII spelling of the characters that an encoding lacks, and where encoding continues.

    This is an error handler of `codecs`. A character without a spelling becomes a question mark.
    """
    assert isinstance(error, UnicodeEncodeError)
    text = error.object[error.start : error.end].translate(_ASCII)
    return "".join(character if character.isascii() else "?" for character in text), error.end


codecs.register_error("imumon", _replace_unencodable)


class _StandardOutput(io.FileIO):
    """Standard output, whose errors are errors of the command with a cure.

    A reader that has ended is no error: it had enough.
    """

    def write(self, data: Any, /) -> int:
        try:
            written: int | None = super().write(data)
            if written is None:  # the output does not block, and its reader is slow
                raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        except BrokenPipeError:
            raise
        except OSError as error:
            discard_stdout()
            raise not_written("the output", error, "write elsewhere") from None
        return written


def prepare_streams() -> None:
    """Open closed standard streams on the null device; prepare others for errors of encoding and of writing.

    If a standard stream is closed, Python would send messages for it elsewhere, and the next file that is
    opened would get its descriptor.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="imumon")
    # one of a test, or the null device, has no such errors
    if sys.stdout is sys.__stdout__ and isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout = io.TextIOWrapper(
            io.BufferedWriter(_StandardOutput(sys.stdout.fileno(), "w", closefd=False)),
            encoding=sys.stdout.encoding,
            errors="imumon",
            line_buffering=sys.stdout.line_buffering or sys.stdout.write_through,
        )


def discard_stdout() -> None:
    """Send the rest of standard output to the null device, so that the final flush cannot fail."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def print_message(text: str) -> None:
    """Print one line on standard error; the text may hold names from files, keys and other programs."""

    lines = "\n".join(map(plain, text.split("\n")))  # faults of settings are one line each
    with suppress(OSError):  # it has no reader
        print(f"imumon: {lines}", file=sys.stderr)


print_message_once = cache(print_message)


def print_error(error: ImumonError, as_json: bool) -> None:
    """Print an error on standard error: one line, or as JSON."""
    if not as_json:
        print_message(str(error))
        return

    described: dict[str, Any] = {"code": error.code, "message": error.message, "cure": error.cure}
    if faults := getattr(error, "faults", ()):
        described["faults"] = [asdict(fault) for fault in faults]
    with suppress(OSError):
        print(json.dumps({"error": described}), file=sys.stderr)


def print_status(text: str) -> None:
    """Overwrite the status line of a terminal; print nothing where standard error is not one."""

    if sys.stderr.isatty():
        columns = os.get_terminal_size(sys.stderr.fileno()).columns or 80
        print(f"\r\x1b[K{plain(text)[: columns - 1]}", end="", file=sys.stderr, flush=True)


def print_json(text: str) -> None:
    """Print JSON on standard output; characters that the encoding lacks are escaped (RFC 8259, section 7)."""
    try:
        text.encode(sys.stdout.encoding or "utf-8")
    except UnicodeEncodeError:
        text = json.dumps(json.loads(text))
    print(text)


def print_report(
    report: Any, as_json: bool, baseline: Any = None, *, verbose: bool = False, late: str | None = None
) -> None:
    """Print a report as JSON, as the whole datasheet if `verbose`, else as a summary of one screen.

    Parameters
    ----------
    baseline : earlier report that it was compared with.
    late : why the numbers are not current; None: they are.
    """
    if as_json:
        print_json(to_json(report))
    elif verbose:
        from imumon.documents import document
        from imumon.model.filter_report import DEFAULT_HORIZON_S
        from imumon.record.filter_report_builder import filter_report

        print(document(report, "md", filter_report(report, DEFAULT_HORIZON_S)).decode(), end="")
    else:
        from imumon.documents.summary import comparison_text, summary_text

        comparison = comparison_text(report, baseline) if baseline is not None else None
        last = [comparison] if comparison else []
        last.append(WHOLE_STOPPED if report.state == "stopped" else WHOLE)
        print(summary_text(report, shutil.get_terminal_size().columns, late=late, last=last))
