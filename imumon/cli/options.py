"""Arguments that several commands share: the parser, types of values, settings, and access to a daemon."""

from __future__ import annotations

import argparse
import difflib
import fcntl
import os
import re
import tempfile
import time
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn

from imumon.cli.exit_codes import NOT_FOUND, USAGE, CommandError
from imumon.cli.output import print_message_once
from imumon.model import units
from imumon.model.errors import why
from imumon.model.report_json import MAX_BYTES
from imumon.model.system_errors import cure_of_reading

STOP_WITH_STDIN = "--stop-with-stdin"
"""Option of `run` for the command `demo` alone."""
STREAMS = ("deltas", "uncompensated", "compensated")
ANSWER_S = 2.0
"""How long to wait for a daemon, or for what it has cached, s."""
TEMPORARY = "imumon-run-"
"""Beginning of the name of a temporary directory: of the state of a daemon on an emulator."""
POLL_S = 0.05
"""Time between two checks for a report, s."""


class Parser(argparse.ArgumentParser):
    """Parser whose errors are one line that names the nearest valid option."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**({"allow_abbrev": False} | settings))
        self.register("type", int, integer)
        self.register("type", float, number)

    def error(self, message: str) -> NoReturn:
        text = message.replace("\n", " ")
        raise CommandError("invalid_arguments", text, f"{self.prog} --help lists the options", USAGE)

    def suggestion(self, argument: str) -> str:
        """Return ``; did you mean --port?`` if an option of this parser is similar, else empty text."""

        known = {name.lstrip("-"): name for action in self._actions for name in action.option_strings}
        close = difflib.get_close_matches(argument.partition("=")[0].lstrip("-"), known, 1, 0.6)
        return f"; did you mean {known[close[0]]}?" if close else ""


class Joined(argparse.Action):
    """Option that may be repeated: its values become one list with commas."""

    def __call__(
        self, parser: Any, namespace: argparse.Namespace, values: Any, option_string: Any = None
    ) -> None:
        before = getattr(namespace, self.dest)
        setattr(namespace, self.dest, values if before is None else f"{before},{values}")


def integer(text: str) -> int:
    """Return a whole number."""
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None


def number(text: str) -> float:
    """Return a number."""
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None


def positive(text: str) -> float:
    """Return a finite number above 0."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number")
    return value


def speed(text: str) -> float:
    """Return a factor of real time; an invalid one has a code of its own."""
    try:
        return positive(text)
    except argparse.ArgumentTypeError as error:
        raise CommandError("speed_invalid", f"--speed: {error}", "give one, such as 60", USAGE) from None


def file_name(text: str) -> str:
    """Return the name of a file, which a shell variable that is not set leaves empty."""
    if not text.strip():
        raise argparse.ArgumentTypeError("the name of the file is empty")
    return text


def rate(text: str) -> float:
    """Return a sample rate, Hz, within the limits of the settings."""
    from imumon.model.samples import FASTEST_HZ, SLOWEST_HZ

    value = positive(text)
    if not SLOWEST_HZ <= value <= FASTEST_HZ:
        message = f"{text} Hz is not a sample rate; give one from {SLOWEST_HZ:g} to {FASTEST_HZ:g}"
        raise argparse.ArgumentTypeError(message)
    return value


def seconds(text: str) -> float:
    """Return a duration in seconds."""
    with suppress(ValueError):
        if value := units.seconds(text):
            return value
    raise argparse.ArgumentTypeError(f"{text!r} is not a duration; write 90, 90s, 10m, 2h or 1h30m")


def horizon(text: str) -> float:
    """Return the longest time without a fix, s, within the limits of the parameters for filters."""
    from imumon.model.filter_report import LONGEST_HORIZON_S, SHORTEST_HORIZON_S

    value = seconds(text)
    if not SHORTEST_HORIZON_S <= value <= LONGEST_HORIZON_S:
        message = f"{text} is no horizon; give one from {SHORTEST_HORIZON_S:g} s to {LONGEST_HORIZON_S:g} s"
        raise argparse.ArgumentTypeError(message)
    return value


def share(text: str) -> float:
    """Return a share of a value.

    >>> share("0.05"), share("5%")
    (0.05, 0.05)
    """
    try:
        value = float(text[:-1]) / 100.0 if text.endswith("%") else float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a precision; write 0.05 or 5%")
    return value


def address(text: str) -> str:
    """Return a host and port to listen on."""
    from imumon.config import ADDRESS

    if not re.fullmatch(ADDRESS, text) or not 0 < int(text.rpartition(":")[2]) < 65536:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not an address; write HOST:PORT, such as 127.0.0.1:8448"
        )
    return text


def add_listen(parser: Parser) -> None:
    """Add ``--listen`` of commands that publish."""
    text = "Zenoh endpoint to listen on, repeatable"
    parser.add_argument("--listen", action="append", metavar="EP", help=text)


def add_shared(parser: Parser, *, of_program: bool = False) -> None:
    """Add ``--config`` and ``--connect``, which the help of the program explains once for all commands.

    Parameters
    ----------
    of_program : the parser is that of the program; those of the commands have no defaults, which would replace what
        is before the name of the command.
    """

    words: dict[str, Any] = {} if of_program else {"default": argparse.SUPPRESS}
    text = "settings of a command; its options override the file. Default: the first that exists of ./config.toml, "
    text += "config.toml of imumon in the user's directory of settings, /etc/imumon/config.toml"
    parser.add_argument("--config", metavar="FILE", help=text if of_program else argparse.SUPPRESS, **words)
    text = "Zenoh endpoint that a command connects to, repeatable; default: the daemons of this machine"
    text = text if of_program else argparse.SUPPRESS
    parser.add_argument("--connect", action="append", metavar="EP", help=text, **words)


def settings(arguments: argparse.Namespace, overrides: dict[str, Any] | None = None) -> Any:
    """Return the settings of ``--config``, or of the first file found, with options on top."""
    from imumon.config import load

    loaded = load(getattr(arguments, "config", None), overrides or {})
    if loaded.ignored is not None:
        print_message_once(f"{loaded.ignored} has no table of imumon and is ignored")
    return loaded


def state_directory(settings: Any) -> Path:
    """Return the directory of the accumulated statistics: configured, of the service manager, or the user's."""
    given = settings.state.directory or os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    if given:
        return Path(given)
    home = os.environ.get("XDG_STATE_HOME") or os.path.expanduser("~/.local/state")
    return Path(home) / "imumon"


def subscriber(arguments: argparse.Namespace) -> Any:
    """Return a subscriber to the daemons of ``--connect`` or of the settings, as a context manager.

    ``--id`` becomes the name, or the beginning of it, that the daemon uses in its keys.
    """
    from imumon.bus import BusError, Subscriber, clean_id

    loaded = settings(arguments)
    if arguments.id:
        try:
            arguments.id = clean_id(arguments.id)
        except BusError as error:
            raise CommandError(error.code, error.message, error.cure, USAGE) from None
    try:
        return Subscriber(arguments.connect, settings=loaded.zenoh)
    except BusError as error:
        raise with_origin(error, loaded) from None


def add_id(parser: Parser, help: str = "device; needed if several daemons answer") -> None:
    """Add ``--id`` of commands that ask a daemon."""
    parser.add_argument("--id", metavar="NAME", help=f"{help}; the beginning of its name is enough")


def answering(subscriber: Any, id: str | None, timeout_s: float, cure: str) -> list[str]:
    """Return the names of the devices that `id` may mean and whose daemons have a report, at least one.

    Parameters
    ----------
    cure : what to do if no daemon answers, beside starting one.
    """
    from imumon.bus.subscriber import GATHER_S
    from imumon.model.messages import matching

    end_s = time.monotonic() + timeout_s
    while not matching(id, subscriber.reports()):
        if time.monotonic() >= end_s:
            raise _no_daemon(id, sorted({*subscriber.alive(), *subscriber.reports()}), cure)
        time.sleep(POLL_S)
    names: set[str] = set()
    while names != (names := {*subscriber.alive(), *subscriber.reports()}):
        time.sleep(GATHER_S)
    return matching(id, subscriber.reports())


def _no_daemon(id: str | None, known: list[str], cure: str) -> CommandError:
    if not known:
        return CommandError(
            "no_daemon", "no daemon answers", f"start one with imumon run, or {cure}", NOT_FOUND
        )
    if not id:
        message = f"the daemon of {', '.join(known)} has no report yet"
        return CommandError("no_report", message, "try again in a few seconds", NOT_FOUND)
    cure = f"give one of these with --id: {', '.join(known)}"
    return CommandError("no_daemon", f"no daemon has the name {id}", cure, NOT_FOUND)


def own_devices(arguments: argparse.Namespace) -> list[str]:
    """Return the devices whose daemons run now and keep their record in a directory of this user.

    That is the state directory; if none runs there, the temporary one of a daemon on an emulator.
    """
    running = []
    with suppress(OSError):
        for lock in sorted(state_directory(settings(arguments)).glob("*.lock")):
            running += [lock.stem] if _is_locked(lock) else []
    for directory in [] if running else sorted(Path(tempfile.gettempdir()).glob(f"{TEMPORARY}*")):
        with suppress(OSError):
            if directory.lstat().st_uid == os.getuid():  # anybody may make one of this name
                running += [lock.stem for lock in sorted(directory.glob("*.lock")) if _is_locked(lock)]
    return running


def _is_locked(lock: Path) -> bool:
    """Return whether a running daemon has locked a file."""
    with suppress(OSError), lock.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def only_own_device(arguments: argparse.Namespace, subscriber: Any) -> str | None:
    """Return the device of the only daemon of this user, or the only one at the configured port; None: not one."""
    running = own_devices(arguments)
    end_s = time.monotonic() + ANSWER_S
    if len(running) > 1 and settings(arguments).device.port:  # the reports have the ports
        while not {*running} <= {*subscriber.reports()} and time.monotonic() < end_s:
            time.sleep(POLL_S)
        running = own_among(arguments, subscriber, running)
    return running[0] if len(running) == 1 else None


def own_among(arguments: argparse.Namespace, subscriber: Any, names: Iterable[str]) -> list[str]:
    """Return which of these devices belong to daemons of this user, and of them those at the configured port."""
    running = [name for name in own_devices(arguments) if name in names]
    port = settings(arguments).device.port
    at_port = [name for name in running if port and _is_same_port(subscriber.report(name), port)]
    return at_port or running


def _is_same_port(newest: Any, port: str) -> bool:
    """Return whether a report is about the sensor at a port; a link in /dev/serial/by-id is the port it points to."""
    published = newest[0].device.port if newest is not None else None
    return published is not None and (
        published == port or os.path.realpath(published) == os.path.realpath(port)
    )


def first_report(
    subscriber: Any, id: str | None, timeout_s: float, cure: str, arguments: argparse.Namespace | None = None
) -> Any:
    """Return the newest report of a device; raise `CommandError` if several daemons may be meant.

    Parameters
    ----------
    cure : what to do if no daemon answers, beside starting one.
    arguments : of the command: of several daemons, it means the only one of this user, or of this user at the
        configured port; None: it must be named.
    """
    return report_of(subscriber, id, answering(subscriber, id, timeout_s, cure), arguments)


def report_of(
    subscriber: Any, id: str | None, names: list[str], arguments: argparse.Namespace | None = None
) -> Any:
    """Return the newest report of the only one of these devices, as `first_report` does."""
    if len(names) > 1 and not id and arguments is not None:
        running = own_among(arguments, subscriber, names)
        if len(running) == 1:
            others = ", ".join(name for name in names if name != running[0])
            print_message_once(f"this is {running[0]}, your own; --id chooses another one: {others}")
            names = running
    if len(names) > 1:
        message = f"{len(names)} daemons have names that begin with {id}" if id else "several daemons answer"
        raise CommandError("several_daemons", message, f"give one with --id: {', '.join(names)}", USAGE)
    warn_of_rivals(subscriber, names[0])
    return subscriber.report(names[0])[0]


def warn_of_rivals(subscriber: Any, id: str) -> None:
    """Print a message, once, if several programs publish a device."""
    if id in subscriber.rivals():
        print_message_once(f"two programs publish {id}; the first is shown; imumon doctor names both")


def with_origin(error: Any, settings: Any) -> Any:
    """Return an error of the bus with the place of the setting that causes it, if a setting does."""
    origin = settings.origins.get(error.setting, "default") if error.setting else "default"
    if origin == "default":
        return error
    return CommandError(error.code, f"{origin}: {error.message}", error.cure, USAGE)


def saved_report(path: Path) -> Any:
    """Return the report of a JSON file; raise ValueError if it is none."""
    from imumon.model.report import Report, from_json

    with path.open("rb") as file:
        return from_json(Report, file.read(MAX_BYTES + 1))


def baseline(path: str | None) -> Any:
    """Return a saved report; None without a path."""
    if path is None:
        return None
    try:
        return saved_report(Path(path))
    except OSError as error:
        message = f"baseline {path}: {why(error)}"
        raise CommandError("baseline_unreadable", message, cure_of_reading(error), USAGE) from None
    except ValueError:
        message, cure = f"baseline {path} is not a report", "make one with imumon report --format json"
        raise CommandError("baseline_not_a_report", message, cure, USAGE) from None
