"""Words on the command line.

    run         run, demo, sim                    cli/run.py
    look        tui, status, wait                 cli/look.py
    recording   replay                            cli/recording.py
    care        doctor, config, completion        cli/care.py
    documents   report                            cli/documents.py
    words       what all commands share           cli/words.py
    letters     text on a stream that lacks some  cli/letters.py

Each command imports what it needs when it runs, so that `imumon --version` costs nothing. stdout carries
data, stderr talk. A user's mistake is one line: what, and how to mend it; a traceback is a defect. Exit
codes: 0 done, 1 failed, 2 usage or configuration, 3 nothing there, 4 not reached in time, 130 interrupted.
"""

from __future__ import annotations

import argparse
import difflib
import errno
import os
import sys
from collections.abc import Callable, Sequence
from typing import TypeAlias

from imumon import __version__
from imumon.cli import admin, query, replay_command, report_command, run_command
from imumon.cli.encoding import write_whatever_comes
from imumon.cli.options import DONE, FAILED, INTERRUPTED, USAGE, CommandError, Parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; the exit code."""
    try:
        code = _run(argv)
    except KeyboardInterrupt:
        code = INTERRUPTED
    if code == INTERRUPTED:
        import signal

        signal.signal(signal.SIGINT, signal.SIG_IGN)  # ^C once more, while the interpreter ends, is no news
    return code


def _run(argv: Sequence[str] | None) -> int:
    # numpy's thread pool costs 64 MB of address space and helps nothing here
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    _stand_in()
    write_whatever_comes(sys.stdout, sys.stderr)
    words = list(sys.argv[1:] if argv is None else argv)
    parser, commands = parsers(only=words[0] if words else "")
    if words and not words[0].startswith("-") and words[0] not in commands:
        close = difflib.get_close_matches(words[0], commands, 1, 0.5)
        hint = f"did you mean {close[0]}?" if close else "imumon --help lists them"
        print(f"imumon: no command {words[0]!r}; {hint}", file=sys.stderr)
        return USAGE
    try:
        arguments, unknown = parser.parse_known_args(words)
        if not hasattr(arguments, "act"):
            parser.print_help()
            return USAGE
        if unknown:
            sub = commands[arguments.command]
            sub.error(f"unknown argument {unknown[0]}{sub.nearest(unknown[0])}")
        act: Act = arguments.act
        code = act(arguments)
        sys.stdout.flush()
        return code
    except CommandError as stop:
        print(f"imumon: {stop}", file=sys.stderr)
        return stop.code
    except BrokenPipeError:
        # the reader of our output has left (`imumon status | head -1`): no complaint, no traceback
        _write_no_more()
        return DONE
    except (MemoryError, RuntimeError, ImportError, OSError) as error:
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EIO):
            _write_no_more()
            place = error.filename or "the output"
            print(f"imumon: cannot write {place}: {os.strerror(error.errno).lower()}", file=sys.stderr)
            return FAILED
        if not _out_of_memory(error):
            raise
        print("imumon: out of memory: grant more; what was saved last is kept", file=sys.stderr, flush=True)
        os._exit(FAILED)  # what is left to do would want memory, and wait for it


def _stand_in() -> None:
    """Have nobody hear what goes to a standard stream that was closed before we began.

    Else Python sends what is for stderr to stdout, and a file of ours would get the stream's number.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode))  # noqa: SIM115


def _write_no_more() -> None:
    """Let what is left for stdout go nowhere, or the end of the interpreter would complain again."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _out_of_memory(error: Exception) -> bool:
    """Whether that is the cause: each library says it in its own words."""
    said = ("start new thread", "failed to map segment", "Cannot allocate memory")
    return isinstance(error, MemoryError) or any(text in str(error) for text in said)


Act: TypeAlias = Callable[[argparse.Namespace], int]

COMMANDS: dict[str, tuple[Act, Callable[[Parser], None], str]] = {
    "run": (run_command.run, run_command.add_run, "read a sensor and publish its noise figures"),
    "demo": (run_command.demo, run_command.add_demo, "emulated sensor, daemon and screen in one command"),
    "tui": (query.show, query.add_tui, "the live screen"),
    "status": (query.status, query.add_status, "one report from a running daemon"),
    "wait": (query.wait, query.add_wait, "until a grade or a precision is reached"),
    "sim": (run_command.sim, run_command.add_sim, "an emulated VN-100 on a pseudo-terminal"),
    "replay": (replay_command.run_replay, replay_command.add_replay, "a recording through the same pipeline"),
    "report": (
        report_command.report,
        report_command.add_report,
        "the datasheet of a sensor, and settings to paste",
    ),
    "doctor": (admin.doctor, admin.add_doctor, "check port, sensor, bus, state and service"),
    "config": (admin.config, admin.add_config, "show the settings and their origins, or check them"),
    "completion": (admin.completion, admin.add_completion, "what a shell needs to complete imumon"),
}
"""What each does, its options, and a line of help."""


def parsers(only: str | None = None) -> tuple[Parser, dict[str, Parser]]:
    """The command line and its commands; with `only`, the options of that command alone are there.

    Some options tell defaults of what they start, which takes its time to import.
    """
    parser = Parser(
        prog="imumon",
        description="Live noise figures of an inertial sensor: N, B, K and grade, with 95 % limits.",
        epilog="Try it without a sensor: imumon demo",
    )
    parser.add_argument("--version", action="version", version=f"imumon {__version__}")
    sub = parser.add_subparsers(dest="command", metavar="COMMAND", parser_class=Parser)
    commands: dict[str, Parser] = {}
    for name, (act, add, text) in COMMANDS.items():
        new: Parser = sub.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        new.set_defaults(act=act)
        if only in (None, name):
            add(new)
        commands[name] = new
    return parser, commands
