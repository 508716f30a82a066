"""Command `imumon web`: the terminal UI in a browser."""

from __future__ import annotations

import argparse
import os

from imumon.cli import options
from imumon.cli.exit_codes import INTERRUPTED, SUCCESS, USAGE, CommandError
from imumon.cli.options import Parser
from imumon.cli.output import print_message
from imumon.tui.web import is_loopback, serve

LISTEN = "127.0.0.1:8448"


def add_web(parser: Parser) -> None:
    add = parser.add_argument
    text = f"address of the page; default {LISTEN}. Other machines can reach it only on another address than 127.0.0.1"
    add("--listen", type=options.address, default=LISTEN, metavar="HOST:PORT", help=text)


def web(arguments: argparse.Namespace) -> int:
    """Serve the terminal UI to browsers until interrupted."""
    from imumon.daemon.log import configure_logging

    settings = options.settings(arguments)
    host, _, port = arguments.listen.rpartition(":")
    host = host.strip("[]")
    if not is_loopback(host) and not settings.zenoh.insecure:
        message = f"--listen {arguments.listen}: every host on the network could see the sensor"
        cure = f"use {LISTEN} and a tunnel (ssh -L), or set zenoh.insecure = true"
        raise CommandError("listen_insecure", message, cure, USAGE)
    words: list[str] = []
    for endpoint in arguments.connect or ():
        words += ["--connect", endpoint]
    if arguments.config is not None:
        words += ["--config", os.path.abspath(arguments.config)]

    def ready(address: str) -> None:
        print_message(f"the screen is at {address}; end with ctrl+c")

    close_log = configure_logging(settings.log.level, settings.log.format)  # of aiohttp and asyncio, too
    try:
        return INTERRUPTED if serve(words, host, int(port), ready) else SUCCESS
    finally:
        close_log()
