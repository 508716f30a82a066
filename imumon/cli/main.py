"""Command line of imumon: the parser, and one place where errors become messages and exit codes.

Each command imports what it needs when it runs, so `imumon --version` is quick. Standard output carries data,
standard error carries messages. An error is one line that says what is wrong and how to fix it; a traceback is
a defect.
"""

from __future__ import annotations

import argparse
import difflib
import errno
import os
import resource
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module
from types import ModuleType
from typing import Any, TypeAlias

from imumon import __version__
from imumon.cli.exit_codes import INTERRUPTED, SUCCESS, USAGE, CommandError, exit_code
from imumon.cli.options import Parser, add_shared
from imumon.cli.output import discard_stdout, prepare_streams, print_error
from imumon.model.errors import ImumonError
from imumon.model.system_errors import not_done

Handler: TypeAlias = Callable[[argparse.Namespace], int]

COMMANDS = {
    "run": ("run_command", "read a device and publish its noise figures"),
    "demo": ("run_command", "emulator, daemon and terminal UI in one command"),
    "tui": ("query", "show the live terminal UI"),
    "web": ("web_command", "show the terminal UI in a browser"),
    "metrics": ("metrics_command", "serve the newest numbers to Prometheus, or write them to a file"),
    "status": ("query", "print one report from a running daemon"),
    "check": ("check_command", "monitoring plugin: one line and an exit code"),
    "wait": ("query", "wait until a grade or a precision is reached"),
    "history": ("history_command", "print what the sensor did over months"),
    "sim": ("run_command", "run an emulated sensor on a pseudo-terminal"),
    "replay": ("replay_command", "process a recording with the same pipeline"),
    "report": ("report_command", "write the datasheet of a sensor, or configuration for other software"),
    "explain": ("explain_command", "explain a word on the screen or in a document"),
    "doctor": ("admin", "check port, device, Zenoh, state and service"),
    "config": ("admin", "show the settings with their origin, or check them"),
    "completion": ("completion", "print a shell completion script"),
}
"""Module and help text of each command NAME; the module has its functions ``NAME`` and ``add_NAME``."""
ALONE = ("demo", "sim", "explain", "completion")
"""Commands that read no settings and ask no daemon."""
UNLISTED = ("sim", "completion")
"""Commands that the first help does not list: a developer or a shell needs them once."""
SHARED_OPTIONS = ("--config", "--connect")
"""Options with a value that may be before the command."""
COMPLETING = "_ARGCOMPLETE"
"""Environment variable that the script of argcomplete sets."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code."""
    try:
        code = _run(argv)
    except KeyboardInterrupt:
        code = INTERRUPTED
    if code == INTERRUPTED:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second ^C must not interrupt the interpreter's end
    return code


def _run(argv: Sequence[str] | None) -> int:
    # a thread pool of OpenBLAS costs 64 MB of address space and does not speed up this program
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    prepare_streams()
    if COMPLETING in os.environ:
        from imumon.cli import completion

        completion.complete(parsers)
    words = list(sys.argv[1:] if argv is None else argv)
    arguments = argparse.Namespace(json="--json" in words, plugin=_command(words) == "check")
    try:
        handler = _parse(words, arguments)
        _raise_file_limit()
        code = handler(arguments)
        sys.stdout.flush()
        return code
    except BrokenPipeError:
        discard_stdout()  # the reader of the output has ended (`imumon status | head -1`)
        return SUCCESS
    except MemoryError:
        return _out_of_memory(arguments)
    except OSError as error:
        if error.errno == errno.ENOMEM:
            return _out_of_memory(arguments)
        return _fail(not_done(error), arguments)
    except ImumonError as error:
        return _fail(error, arguments)


def _raise_file_limit() -> None:
    """Raise the limit of open files to what this process may have: each connection takes one."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    with suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))


def _parse(argv: Sequence[str], arguments: argparse.Namespace) -> Handler:
    """Parse the command line into `arguments` and return the function of the command."""
    name = _command(argv)
    parser, commands = parsers(only=name)
    if name and not name.startswith("-") and name not in commands:
        close = difflib.get_close_matches(name, commands, 1, 0.5)
        cure = f"did you mean {close[0]}?" if close else "imumon --help lists the commands"
        raise CommandError("unknown_command", f"no command {name!r}", cure, USAGE)
    _, unknown = parser.parse_known_args(argv, arguments)
    if arguments.command is None:
        parser.print_help()
        return lambda _: USAGE
    if unknown:
        command = commands[arguments.command]
        command.error(f"unknown argument {unknown[0]}{command.suggestion(unknown[0])}")
    handler: Handler = getattr(_module(arguments.command), arguments.command)
    return handler


def _command(argv: Sequence[str]) -> str:
    """Return the word that names the command: the first one behind the options of the program; empty: there is none."""
    words = iter(argv)
    for word in words:
        if word not in SHARED_OPTIONS:
            if not word.startswith(SHARED_OPTIONS):
                return word
        else:
            next(words, None)
    return ""


def _module(name: str) -> ModuleType:
    """Return the module of a command. It is imported when it is used, so that others start sooner."""
    return import_module(f"imumon.cli.{COMMANDS[name][0]}")


def _fail(error: ImumonError, arguments: argparse.Namespace) -> int:
    """Print an error and return its exit code."""
    if arguments.plugin:
        from imumon.cli import check_command

        return check_command.fail(error)
    as_json = getattr(arguments, "json", False)
    if (question := getattr(error, "text", None)) is not None and not as_json:
        print(f"{question}\n{error.cure}", file=sys.stderr)
    else:
        print_error(error, as_json=as_json)
    return exit_code(error)


def _out_of_memory(arguments: argparse.Namespace) -> int:
    cure = "give it more memory; the last saved state is kept"
    code = _fail(CommandError("out_of_memory", "out of memory", cure), arguments)
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # an orderly end would need more memory


def parsers(only: str | None = None) -> tuple[Parser, dict[str, Parser]]:
    """Return the parser of the program and those of its commands.

    Parameters
    ----------
    only : add the options of this command only, because those of others import packages; None: of all.
    """
    parser = Parser(
        prog="imumon",
        description="Live noise figures of an inertial sensor: coefficients and grade, with 95 % limits.",
        epilog="Try it without a sensor: imumon demo",
    )
    parser.add_argument("--version", action="version", version=f"imumon {__version__}")
    subparsers = parser.add_subparsers(
        title="commands", dest="command", metavar="COMMAND", parser_class=Parser
    )
    add_shared(parser, of_program=True)
    commands: dict[str, Parser] = {}
    for name, (_, text) in COMMANDS.items():
        listed: dict[str, Any] = {} if name in UNLISTED else {"help": text}
        command = subparsers.add_parser(name, description=f"{text[0].upper()}{text[1:]}.", **listed)
        if only in (None, name):
            getattr(_module(name), f"add_{name}")(command)
        if name not in ALONE:
            add_shared(command)
            command.epilog = "Also --config FILE and --connect EP: imumon --help explains them."
        commands[name] = command
    return parser, commands
