"""Completion of the command line in a shell, by argcomplete.

The script that `imumon completion` prints makes the shell run ``imumon`` with ``_ARGCOMPLETE`` set. `complete`
answers then: options, choices, files, ports, and for ``--id`` the devices whose daemon is running.
"""

from __future__ import annotations

import argparse
import glob
import os
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any

from imumon.cli.exit_codes import SUCCESS
from imumon.cli.options import STOP_WITH_STDIN, Parser

QUERY_S = 0.5
"""How long to wait for running daemons, s."""


def add_completion(parser: Parser) -> None:
    text = "the shell to print the script for"
    parser.add_argument("shell", choices=("bash", "zsh", "fish"), metavar="{bash,zsh,fish}", help=text)


def completion(arguments: argparse.Namespace) -> int:
    """Print the script that makes a shell complete the command line."""
    from argcomplete.shell_integration import shellcode

    print(shellcode(["imumon"], use_defaults=False, shell=arguments.shell), end="")
    return SUCCESS


def complete(parsers: Callable[[str], tuple[Parser, dict[str, Parser]]]) -> None:
    """Answer the shell and end the process.

    Parameters
    ----------
    parsers : returns the parser of the program and those of its commands, with the options of one command.
    """
    import argcomplete
    from argcomplete.completers import DirectoriesCompleter, FilesCompleter, SuppressCompleter

    by_metavar: dict[str, Any] = dict.fromkeys(("FILE", "OUT", "PATH"), FilesCompleter())
    by_metavar |= {"DIR": DirectoriesCompleter(), "PORT": ports}
    name = [*os.environ.get("COMP_LINE", "").split(), "", ""][1]
    parser, commands = parsers(name)
    for action in commands[name]._actions if name in commands else ():
        completer = by_metavar.get(str(action.metavar))
        if action.dest == "id" and name != "run":  # there it is a new name
            completer = running_devices
        if completer is not None:
            action.completer = completer  # type: ignore[attr-defined]
    argcomplete.autocomplete(
        parser,
        always_complete_options=False,
        exclude=(STOP_WITH_STDIN,),
        print_suppressed=True,  # the help of a command does not repeat the options of all commands
        default_completer=SuppressCompleter(),
    )


def ports(prefix: str, **_: Any) -> Iterable[str]:
    """Return the serial ports of this machine and the emulator."""

    return ["sim", *glob.glob("/dev/ttyUSB*"), *glob.glob("/dev/ttyACM*"), *glob.glob("/dev/ttyS*")]


def running_devices(prefix: str, parsed_args: argparse.Namespace, **_: Any) -> Iterable[str]:
    """Return the names of the devices whose daemon answers in time; nothing after any error."""
    with suppress(Exception):
        from imumon.bus import Subscriber
        from imumon.config import load

        zenoh = load(getattr(parsed_args, "config", None)).zenoh
        with Subscriber(getattr(parsed_args, "connect", None), settings=zenoh) as subscriber:
            time.sleep(QUERY_S)
            return sorted({*subscriber.alive(), *subscriber.reports()})
    return ()
