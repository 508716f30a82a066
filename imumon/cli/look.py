"""Commands that look at a running daemon: tui, status."""

from __future__ import annotations

import argparse
import sys

from imumon.cli.words import (
    DONE,
    NOTHING_THERE,
    USAGE,
    Parser,
    Stop,
    add_endpoints,
    add_look,
    baseline,
    print_report,
    viewer,
)


def add_tui(parser: Parser) -> None:
    add_endpoints(parser)
    parser.add_argument("--config", metavar="FILE", help="settings of the bus; flags win over the file")
    parser.add_argument("--id", metavar="NAME", help="device to show first")
    parser.add_argument("--baseline", metavar="FILE", help="a saved report (JSON) behind the live curve")
    add_look(parser)


def add_status(parser: Parser) -> None:
    add_endpoints(parser)
    parser.add_argument("--config", metavar="FILE", help="settings of the bus; flags win over the file")
    parser.add_argument("--id", metavar="NAME", help="device; default: the first that answers")
    parser.add_argument("--json", action="store_true", help="the report as JSON")


def show(words: argparse.Namespace) -> int:
    """The live screen."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        raise Stop("the screen needs a terminal; without one use: imumon status --json", USAGE)
    from imumon.tui import run

    behind = baseline(words.baseline)
    with viewer(words) as feed:
        return run(feed, id=words.id, ascii=words.ascii, theme=words.theme, baseline=behind)


def status(words: argparse.Namespace) -> int:
    """One report of a running daemon."""
    with viewer(words) as feed:
        made = feed.wait_report(words.id, 2.0)
    if made is None:
        who = f"no daemon answers as {words.id}" if words.id else "no daemon answers"
        raise Stop(f"{who}: start one with imumon run, or name it with --connect", NOTHING_THERE)
    print_report(made, words.json)
    return DONE
