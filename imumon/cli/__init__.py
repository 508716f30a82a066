"""Words on the command line.

    run         run, demo, sim                    cli/run.py
    look        tui, status, wait                 cli/look.py
    recording   replay                            cli/recording.py
    care        doctor, config, completion        cli/care.py
    documents   report                            cli/documents.py
    words       what all commands share           cli/words.py

Each command imports what it needs when it runs, so that `imumon --version` costs nothing. stdout carries
data, stderr talk. A user's mistake is one line: what, and how to mend it; a traceback is a defect. Exit
codes: 0 done, 1 failed, 2 usage or configuration, 3 nothing there, 4 not reached in time, 130 interrupted.
"""

from __future__ import annotations

import argparse
import difflib
import os
import sys
from collections.abc import Callable, Sequence

from imumon import __version__
from imumon.cli import care, documents, look, recording, run
from imumon.cli.words import DONE, INTERRUPTED, USAGE, Parser, Stop


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; the exit code."""
    # numpy's thread pool costs 64 MB of address space and helps nothing here
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    words = list(sys.argv[1:] if argv is None else argv)
    parser, commands = _parser(words[:1])
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


def _parser(asked: Sequence[str]) -> tuple[Parser, dict[str, Parser]]:
    """The whole command line; the options of `sim` only where `asked` for: they need the emulator."""
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

    run.add_run(command("run", run.run, "read a sensor and publish its noise figures"))
    run.add_demo(command("demo", run.demo, "emulated sensor, daemon and screen in one command"))
    look.add_tui(command("tui", look.show, "the live screen"))
    look.add_status(command("status", look.status, "one report from a running daemon"))
    look.add_wait(command("wait", look.wait, "until a grade or a precision is reached"))
    sim = command("sim", run.sim, "an emulated VN-100 on a pseudo-terminal")
    if "sim" in asked or "completion" in asked:
        run.add_sim(sim)
    recording.add_replay(command("replay", recording.run_replay, "a recording through the same pipeline"))
    documents.add_report(
        command("report", documents.report, "the datasheet of a sensor, and settings to paste")
    )
    care.add_doctor(command("doctor", care.doctor, "check port, sensor, bus, state and service"))
    care.add_config(command("config", care.config, "show the settings and their origins, or check them"))
    care.add_completion(command("completion", care.completion, "what a shell needs to complete imumon"))
    return parser, commands
