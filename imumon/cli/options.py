"""What all commands share: exit codes, errors in one line, settings, endpoints, how a report is printed."""

from __future__ import annotations

import argparse
import difflib
import os
import re
import shutil
import sys
import time
from contextlib import suppress
from typing import Any, NoReturn

DONE, FAILED, USAGE, NOTHING_THERE, NOT_IN_TIME, INTERRUPTED = 0, 1, 2, 3, 4, 130


class CommandError(Exception):
    """End the command with one line on stderr and an exit code."""

    def __init__(self, text: str, code: int = FAILED) -> None:
        super().__init__(text)
        self.code = code


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line that names the nearest right word."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**({"allow_abbrev": False} | settings))

    def error(self, message: str) -> NoReturn:
        said = re.sub(r"invalid int value: (.*)", r"\1 is not a whole number", message.replace("\n", " "))
        said = re.sub(r"invalid float value: (.*)", r"\1 is not a number", said)
        self.exit(USAGE, f"{self.prog}: {said} (try {self.prog} --help)\n")

    def nearest(self, word: str) -> str:
        """``; did you mean --port?`` where one of this parser's options is near, else nothing."""
        known = {name.lstrip("-"): name for action in self._actions for name in action.option_strings}
        close = difflib.get_close_matches(word.partition("=")[0].lstrip("-"), known, 1, 0.6)
        return f"; did you mean {known[close[0]]}?" if close else ""


def positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number")
    return value


def rate(text: str) -> float:
    """Sample rate, Hz, as far as the settings allow one."""
    from imumon.config import FASTEST_HZ, SLOWEST_HZ

    value = positive(text)
    if not SLOWEST_HZ <= value <= FASTEST_HZ:
        raise argparse.ArgumentTypeError(
            f"{text} Hz is no sample rate; it is from {SLOWEST_HZ:g} to {FASTEST_HZ:g}"
        )
    return value


_SECONDS = {"s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0, "d": 86400.0}


def seconds(text: str) -> float:
    """Length of time in seconds.

    >>> seconds("90"), seconds("90s"), seconds("10m"), seconds("1h30m"), seconds("0.5 d")
    (90.0, 90.0, 600.0, 5400.0, 43200.0)
    """
    parts = re.findall(r"(\d+\.?\d*|\.\d+)\s*([a-z]*)\s*", text.lower())
    whole = "".join(f"{number}{unit}" for number, unit in parts) == re.sub(r"\s+", "", text.lower())
    try:
        total = sum(float(number) * _SECONDS[unit or "s"] for number, unit in parts)
    except KeyError:
        total = 0.0
    if not whole or not 0.0 < total < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is no length of time; write 90, 90s, 10m, 2h or 1h30m")
    return total


def share(text: str) -> float:
    """Share of a value.

    >>> share("0.05"), share("5%")
    (0.05, 0.05)
    """
    try:
        value = float(text[:-1]) / 100.0 if text.endswith("%") else float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1.0:
        raise argparse.ArgumentTypeError(f"{text!r} is no precision; write 0.05 or 5%")
    return value


def baud(text: str) -> str:
    if text != "auto" and not (text.isdigit() and int(text) > 0):
        raise argparse.ArgumentTypeError(f"{text!r} is neither auto nor a number")
    return text


def add_endpoints(parser: Parser, *, listen: bool = False) -> None:
    add = parser.add_argument
    if listen:
        add("--listen", action="append", metavar="EP", help="Zenoh endpoint to listen on, repeatable")
    add("--connect", action="append", metavar="EP", help="Zenoh endpoint to connect to, repeatable")


def theme(text: str) -> str:
    from imumon.tui import themes

    if text not in themes():
        raise argparse.ArgumentTypeError(f"no theme {text!r}; there are {', '.join(themes())}")
    return text


def add_look(parser: Parser) -> None:
    parser.add_argument(
        "--theme", type=theme, metavar="NAME", help="colours; the palette (ctrl+p) lists them"
    )
    parser.add_argument("--ascii", action="store_true", help="plain characters only")


def print_report(made: Any, as_json: bool, baseline: Any = None) -> None:
    """A report on stdout, in words with what has changed against a baseline."""
    if as_json:
        from imumon.cli.encoding import print_json
        from imumon.report import to_json

        print_json(to_json(made))
    else:
        from imumon.datasheet.signal_text import baseline_summary, signal_lines
        from imumon.datasheet.tables import report_table

        width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
        same = baseline_summary(made, baseline) if baseline is not None else None
        lines = [report_table(made, width), "", *signal_lines(made, width), *([same] if same else [])]
        print("\n".join(lines).rstrip())


def settings(words: argparse.Namespace, overrides: dict[str, Any] | None = None) -> Any:
    """Settings of the file named by ``--config``, or of the first found, with flags on top."""
    from imumon.config import ConfigError, load

    try:
        return load(getattr(words, "config", None), overrides or {})
    except ConfigError as error:
        raise CommandError(str(error), USAGE) from None


def settings_apart(words: argparse.Namespace, overrides: dict[str, Any]) -> Any:
    """`settings`, read in a process of its own; meanwhile this one begins to import the daemon."""
    from threading import Thread

    from imumon.config import ConfigError, load_apart

    answer = load_apart(words.config, overrides)
    Thread(target=_import_the_daemon).start()
    try:
        return answer()
    except ConfigError as error:
        raise CommandError(str(error), USAGE) from None


def _import_the_daemon() -> None:
    """Begin to; what goes wrong goes wrong again, and is told, where the daemon is needed."""
    with suppress(Exception):
        import imumon.daemon  # noqa: F401


def state_directory(made: Any) -> Any:
    """Where the statistics live: as the settings say, the service manager's place, or the user's."""
    from pathlib import Path

    if made.state.directory:
        return Path(made.state.directory)
    given = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    if given:
        return Path(given)
    home = os.environ.get("XDG_STATE_HOME") or os.path.expanduser("~/.local/state")
    return Path(home) / "imumon"


def viewer(words: argparse.Namespace) -> Any:
    """Subscriber to the daemons that ``--connect`` or the settings name; to be used as a context.

    The device that is asked for gets the name its daemon gave it.
    """
    from imumon.bus import BusError, Subscriber, clean_id

    made = settings(words)
    try:
        words.id = words.id and clean_id(words.id)
    except BusError as error:
        raise CommandError(str(error), USAGE) from None
    try:
        return Subscriber(words.connect, settings=made.zenoh)
    except BusError as error:
        raise bus_stop(error, made) from None


GATHER_S = 0.3
"""How much later than the first other daemons may answer."""


def first_report(feed: Any, id: str | None, timeout: float, cure: str) -> Any:
    """Newest report of the device that is asked for, else of the first that answers; which others there are.

    Parameters
    ----------
    cure : what else one might do where nobody answers.
    """
    made = feed.wait_report(id, timeout)
    if made is None:
        who = f"no daemon answers as {id}" if id else "no daemon answers"
        raise CommandError(f"{who}: start one with imumon run, or {cure}", NOTHING_THERE)
    if id is None:
        time.sleep(GATHER_S)
        others = sorted({*feed.alive(), *feed.reports()} - {made.device.id})
        if others:
            mention(f"this is {made.device.id}; --id shows the others: {', '.join(others)}")
    return made


def mention(text: str) -> None:
    """A line beside the data."""
    print(f"imumon: {text}", file=sys.stderr)


def bus_stop(error: Exception, made: Any) -> CommandError:
    """The bus cannot be had; where a setting is at fault, it is one of usage, with its place."""
    text = str(error)
    name = re.match(r"zenoh\.\w+", text)
    if name is None:
        return CommandError(text)
    origin = made.origins.get(name[0], "default")
    return CommandError(text if origin == "default" else f"{origin}: {text}", USAGE)


def baseline(path: str | None) -> Any:
    """A saved report, None without a path."""
    if path is None:
        return None
    from imumon.report import Report, from_json

    try:
        with open(path, "rb") as file:
            return from_json(Report, file.read())
    except OSError as error:
        raise CommandError(f"baseline {path}: {(error.strerror or str(error)).lower()}", USAGE) from None
    except ValueError:
        raise CommandError(
            f"baseline {path} is no report: make one with imumon report --format json", USAGE
        ) from None
