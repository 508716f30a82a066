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

    def __init__(self, **settings: Any) -> None:
        super().__init__(**({"allow_abbrev": False} | settings))

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
    """The whole command line; the options of `sim` only where it is `asked` for: they need the emulator."""
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
    sim = command("sim", _sim, "an emulated VN-100 on a pseudo-terminal")
    if "sim" in asked:
        _add_sim(sim)
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
    add("--baseline", metavar="FILE", help="an earlier report of this sensor (JSON): tell what has changed")
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
    add("--baseline", metavar="FILE", help="an earlier report of this sensor (JSON): tell what has changed")
    _add_endpoints(parser, listen=True)


def _run(words: argparse.Namespace) -> int:
    if words.port == "sim":
        return _run_emulated(words)
    if words.speed != 1.0 or words.seed is not None:
        raise Stop("--speed and --seed are for --port sim", USAGE)
    settings = _settings(words)
    return _daemon(words, settings, settings.device.port or None, _state_directory(words.state or settings))


def _run_emulated(words: argparse.Namespace) -> int:
    """`run --port sim`: an emulator of its own, and a state that is thrown away unless one is asked for."""
    import tempfile
    from pathlib import Path

    settings = _settings(words)
    with (
        _emulator(words.speed, words.seed) as sensor,
        tempfile.TemporaryDirectory(prefix="imumon-") as scratch,
    ):
        directory = Path(words.state) if words.state else Path(scratch)
        return _daemon(words, settings, sensor.path, directory)


def _settings(words: argparse.Namespace) -> Any:
    """Settings of the file with the flags on top."""
    from imumon.config import ConfigError, load

    baud = words.baud
    overrides = {
        "device.port": None if words.port == "sim" else words.port,
        "device.baud": int(baud) if baud and baud != "auto" else baud,
        "device.set_baud": words.set_baud,
        "device.rate_hz": words.rate,
        "device.listen_only": words.listen_only,
        "device.stream": words.stream,
        "device.id": words.id,
        "zenoh.listen": words.listen,
        "zenoh.connect": words.connect,
        "state.directory": words.state,
        "record.file": words.record,
        "guards.enabled": False if words.no_guards else None,
    }
    try:
        return load(words.config, overrides)
    except ConfigError as error:
        raise Stop(str(error), USAGE) from None


def _baseline(path: str | None) -> Any:
    """A saved report, None without a path."""
    if path is None:
        return None
    from imumon.report import Report, from_json

    try:
        with open(path, "rb") as file:
            return from_json(Report, file.read())
    except OSError as error:
        raise Stop(f"baseline {path}: {(error.strerror or str(error)).lower()}", USAGE) from None
    except ValueError:
        raise Stop(
            f"baseline {path} is no report: make one with imumon report --format json", USAGE
        ) from None


def _state_directory(where: Any) -> Any:
    """Where the statistics live: asked for, the service manager's, or the user's."""
    from pathlib import Path

    asked = where if isinstance(where, str) else where.state.directory
    if asked:
        return Path(asked)
    given = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    if given:
        return Path(given)
    home = os.environ.get("XDG_STATE_HOME") or os.path.expanduser("~/.local/state")
    return Path(home) / "imumon"


def _daemon(words: argparse.Namespace, settings: Any, path: str | None, directory: Any) -> int:
    import signal

    from imumon.bus import BusError
    from imumon.checkpoint import StateError
    from imumon.daemon import Daemon, Task
    from imumon.daemon.link import NoSensor
    from imumon.monitor import RateNeeded
    from imumon.sensors.vn100.session import SessionError
    from imumon.sources import PortError, SourceError

    task = Task(
        path=path,
        state_directory=directory,
        duration_s=words.duration,
        fresh=words.fresh,
        speed=words.speed,
        baseline=_baseline(words.baseline),
    )
    try:
        outcome = Daemon(settings, task).run()
    except RateNeeded as error:
        raise Stop(str(error), USAGE) from None
    except (NoSensor, SessionError) as error:
        raise Stop(str(error), NOTHING_THERE) from None
    except PortError as error:
        there = path is None or os.path.exists(path)
        raise Stop(str(error), FAILED if there else NOTHING_THERE) from None
    except SourceError as error:
        raise Stop(str(error)) from None
    except (BusError, StateError) as error:
        raise Stop(str(error)) from None
    if outcome.report is not None and (words.duration or words.json):
        _print(outcome.report, words.json)
    return INTERRUPTED if outcome.signal == signal.SIGINT else DONE


def _print(made: Any, as_json: bool) -> None:
    if as_json:
        from imumon.report import to_json

        print(to_json(made))
    else:
        from imumon.datasheet.text import table

        print(table(made))


def _emulator(speed: float, seed: int | None) -> Any:
    """Emulator in a process of its own, a context that gives it."""
    from dataclasses import replace

    from imumon.emulator import EmulatorSettings, spawn

    settings = EmulatorSettings(speed=speed)
    return spawn(settings if seed is None else replace(settings, seed=seed))


def _demo(words: argparse.Namespace) -> int:
    """Daemon on the emulator in a process of its own, and the screen here; quitting ends all three."""
    import subprocess
    import tempfile

    with tempfile.TemporaryDirectory(prefix="imumon-demo-") as scratch:
        endpoint = f"unixsock-stream/{scratch}/bus"
        command = [sys.executable, "-m", "imumon", "run", "--port", "sim", "--speed", f"{words.speed:g}"]
        command += ["--listen", endpoint, "--state", scratch, "--id", "demo"]
        command += [] if words.seed is None else ["--seed", str(words.seed)]
        with open(f"{scratch}/log", "w+") as log:
            daemon = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True
            )
            try:
                return _screen([endpoint], "demo", words)
            finally:
                daemon.terminate()
                try:
                    daemon.wait(5)
                except subprocess.TimeoutExpired:
                    daemon.kill()


def _tui(words: argparse.Namespace) -> int:
    return _screen(words.connect, words.id, words)


def _screen(
    connect: list[str] | None, device: str | None, words: argparse.Namespace, watched: Any = None
) -> int:
    from imumon.tui import run

    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        raise Stop("the screen needs a terminal; without one use: imumon status --json", USAGE)
    from imumon.bus import BusError, Viewer

    try:
        with Viewer(connect) as feed:
            return run(feed, id=device, ascii=words.ascii, theme=words.theme)
    except BusError as error:
        raise Stop(str(error)) from None


def _status(words: argparse.Namespace) -> int:
    from imumon.bus import BusError, Viewer

    try:
        with Viewer(words.connect) as feed:
            made = feed.wait_report(words.id, 2.0)
    except BusError as error:
        raise Stop(str(error)) from None
    if made is None:
        who = f"no daemon answers as {words.id}" if words.id else "no daemon answers"
        raise Stop(f"{who}: start one with imumon run, or name it with --connect", NOTHING_THERE)
    _print(made, words.json)
    return DONE


def _sim(words: argparse.Namespace) -> int:
    from imumon import emulator

    try:
        settings = emulator.from_arguments(words)
    except ValueError as error:
        raise Stop(str(error), USAGE) from None
    return emulator.run(settings)


def _replay(words: argparse.Namespace) -> int:
    from imumon.monitor import RateNeeded
    from imumon.replay import Replay, bar, replay
    from imumon.sources import SourceError

    if words.speed == "max":
        speed = None
    else:
        try:
            speed = _positive(words.speed)
        except (ValueError, argparse.ArgumentTypeError):
            raise Stop(f"--speed is max or a positive number, not {words.speed!r}", USAGE) from None
    task = Replay(
        path=words.file,
        rate_hz=words.rate,
        speed=speed,
        guarded=not words.no_guards,
        baseline=_baseline(words.baseline),
    )
    try:
        with _publisher(words) as bus:
            made = replay(task, progress=bar(), bus=bus)
    except RateNeeded as error:
        raise Stop(str(error), USAGE) from None
    except SourceError as error:
        raise Stop(str(error)) from None
    _print(made, words.json)
    return DONE


def _publisher(words: argparse.Namespace) -> Any:
    from contextlib import nullcontext

    if not words.publish:
        return nullcontext()
    from imumon.bus import BusError, Publisher

    try:
        return Publisher("replay", listen=words.listen, connect=words.connect)
    except BusError as error:
        raise Stop(str(error)) from None
