"""Words on the command line.

Each command is a function that imports what it needs when it runs, so that `imumon --version` costs nothing.
stdout carries data, stderr talk. A user's mistake is one line: what, and how to mend it; a traceback is a
defect. Exit codes: 0 done, 1 failed, 2 usage or configuration, 3 nothing there, 4 not reached in time,
130 interrupted.
"""

from __future__ import annotations

import argparse
import difflib
import os
import sys
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from imumon import __version__

DONE, FAILED, USAGE, NOTHING_THERE, NOT_IN_TIME, INTERRUPTED = 0, 1, 2, 3, 4, 130


class Stop(Exception):
    """End the command with one line on stderr and an exit code."""

    def __init__(self, text: str, code: int = FAILED) -> None:
        super().__init__(text)
        self.code = code


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line that names the nearest right word."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, allow_abbrev=False, **kwargs)

    def error(self, message: str) -> NoReturn:
        self.exit(USAGE, f"{self.prog}: {message.replace(chr(10), ' ')} (try {self.prog} --help)\n")

    def nearest(self, word: str) -> str:
        """``; did you mean --port?`` where one of this parser's options is near, else nothing."""
        known = [option for action in self._actions for option in action.option_strings]
        close = difflib.get_close_matches(word.partition("=")[0], known, 1, 0.6)
        return f"; did you mean {close[0]}?" if close else ""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; the exit code."""
    # numpy's thread pool costs 64 MB of address space and helps nothing here
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    parser, commands = _parser()
    words = list(sys.argv[1:] if argv is None else argv)
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
        act: Callable[[argparse.Namespace], int] = arguments.act
        code = act(arguments)
        sys.stdout.flush()
        return code
    except Stop as stop:
        print(f"imumon: {stop}", file=sys.stderr)
        return stop.code
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        # the reader of our output has left (`imumon status | head -1`): no complaint, no traceback
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE


def _parser() -> tuple[Parser, dict[str, Parser]]:
    parser = Parser(
        prog="imumon",
        description="Live noise figures of an inertial sensor: N, B, K and grade, with 95 % limits.",
        epilog="Try it without a sensor: imumon demo",
    )
    parser.add_argument("--version", action="version", version=f"imumon {__version__}")
    sub = parser.add_subparsers(dest="command", metavar="COMMAND", parser_class=Parser)
    commands: dict[str, Parser] = {}

    def command(name: str, act: Callable[[argparse.Namespace], int], text: str) -> Parser:
        new: Parser = sub.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        new.set_defaults(act=act)
        commands[name] = new
        return new

    _add_run(command("run", _run, "read a sensor and publish its noise figures"))
    _add_demo(command("demo", _demo, "emulated sensor, daemon and screen in one command"))
    _add_tui(command("tui", _tui, "the live screen"))
    _add_status(command("status", _status, "one report from a running daemon"))
    _add_sim(command("sim", _sim, "an emulated VN-100 on a pseudo-terminal"))
    _add_replay(command("replay", _replay, "a recording through the same pipeline"))
    return parser, commands


def _positive(text: str) -> float:
    value = float(text)
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number")
    return value


def _baud(text: str) -> str:
    if text != "auto" and not (text.isdigit() and int(text) > 0):
        raise argparse.ArgumentTypeError(f"{text!r} is neither auto nor a number")
    return text


def _add_run(parser: Parser) -> None:
    add = parser.add_argument
    add("--port", metavar="PORT", help="device path, pyserial URL, or sim; default: the one VN-100 found")
    add("--baud", type=_baud, metavar="auto|N", help="default auto: find it, never raise it")
    add("--set-baud", type=int, metavar="N", help="change the sensor's baud to N (volatile)")
    add("--rate", type=_positive, metavar="HZ", help="sample rate of a stream without a clock")
    add("--listen-only", action="store_true", default=None, help="write nothing to the sensor")
    add(
        "--stream",
        choices=("deltas", "uncompensated", "compensated"),
        help="what to ask the sensor for; default deltas",
    )
    add("--id", metavar="NAME", help="name in the keys; default vn100-<serial number>")
    add("--state", metavar="DIR", help="where the accumulated statistics live")
    add("--fresh", action="store_true", help="start anew; the old state is kept aside")
    add("--record", metavar="FILE", help="also keep the raw bytes, for replay")
    add("--config", metavar="FILE", help="settings; flags win over the file")
    add("--duration", type=_positive, metavar="S", help="stop after S seconds with a final report on stdout")
    add("--json", action="store_true", help="final report as JSON")
    add("--no-guards", action="store_true", default=None, help="cut nothing out")
    add("--speed", type=_positive, default=1.0, metavar="X", help="time-lapse, with --port sim only")
    add("--seed", type=int, metavar="N", help="noise of the emulator, with --port sim only")
    _add_endpoints(parser, listen=True)


def _add_endpoints(parser: Parser, *, listen: bool = False) -> None:
    add = parser.add_argument
    if listen:
        add("--listen", action="append", metavar="EP", help="Zenoh endpoint to listen on, repeatable")
    add("--connect", action="append", metavar="EP", help="Zenoh endpoint to connect to, repeatable")


def _add_demo(parser: Parser) -> None:
    parser.add_argument("--speed", type=_positive, default=60.0, metavar="X", help="time-lapse; default 60")
    parser.add_argument("--seed", type=int, metavar="N", help="noise of the emulator")
    _add_look(parser)


def _add_look(parser: Parser) -> None:
    parser.add_argument("--theme", metavar="NAME", help="colours; the palette (ctrl+p) lists them")
    parser.add_argument("--ascii", action="store_true", help="plain characters only")


def _add_tui(parser: Parser) -> None:
    _add_endpoints(parser)
    parser.add_argument("--id", metavar="NAME", help="device to show first")
    parser.add_argument("--baseline", metavar="FILE", help="a saved report (JSON) behind the live curve")
    _add_look(parser)


def _add_status(parser: Parser) -> None:
    _add_endpoints(parser)
    parser.add_argument("--id", metavar="NAME", help="device; default: the first that answers")
    parser.add_argument("--json", action="store_true", help="the report as JSON")


def _add_sim(parser: Parser) -> None:
    from imumon.emulator import add_arguments

    add_arguments(parser)


def _add_replay(parser: Parser) -> None:
    add = parser.add_argument
    add("file", metavar="FILE", help="raw capture (ASCII, binary, mixed, .gz), --record file, or CSV")
    add("--rate", type=_positive, metavar="HZ", help="sample rate of a stream without a clock")
    add("--speed", default="max", metavar="X|max", help="times real time; default max")
    add("--json", action="store_true", help="the report as JSON")
    add("--publish", action="store_true", help="publish on Zenoh while replaying")
    add("--no-guards", action="store_true", help="cut nothing out: every valid sample counts")
    _add_endpoints(parser, listen=True)
