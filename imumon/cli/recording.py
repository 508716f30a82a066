"""Commands that work on a recording: replay."""

from __future__ import annotations

import argparse
from typing import Any

from imumon.cli.words import (
    DONE,
    USAGE,
    Parser,
    Stop,
    add_endpoints,
    baseline,
    positive,
    print_report,
    settings,
)


def add_replay(parser: Parser) -> None:
    add = parser.add_argument
    add("file", metavar="FILE", help="raw capture (ASCII, binary, mixed, .gz), --record file, or CSV")
    add("--rate", type=positive, metavar="HZ", help="sample rate of a stream without a clock")
    add("--speed", default="max", metavar="X|max", help="times real time; default max")
    add("--json", action="store_true", help="the report as JSON")
    add("--publish", action="store_true", help="publish on Zenoh while replaying")
    add("--config", metavar="FILE", help="settings of the bus; flags win over the file")
    add("--no-guards", action="store_true", help="cut nothing out: every valid sample counts")
    add("--baseline", metavar="FILE", help="an earlier report of this sensor (JSON): tell what has changed")
    add_endpoints(parser, listen=True)


def run_replay(words: argparse.Namespace) -> int:
    from imumon.monitor import RateNeeded
    from imumon.replay import Replay, bar, replay
    from imumon.sources import SourceError

    if words.speed == "max":
        speed = None
    else:
        try:
            speed = positive(words.speed)
        except (ValueError, argparse.ArgumentTypeError):
            raise Stop(f"--speed is max or a positive number, not {words.speed!r}", USAGE) from None
    task = Replay(
        path=words.file,
        rate_hz=words.rate,
        speed=speed,
        guarded=not words.no_guards,
        baseline=baseline(words.baseline),
    )
    try:
        with _publisher(words) as bus:
            made = replay(task, progress=bar(), bus=bus)
    except RateNeeded as error:
        raise Stop(str(error), USAGE) from None
    except SourceError as error:
        raise Stop(str(error)) from None
    print_report(made, words.json)
    return DONE


def _publisher(words: argparse.Namespace) -> Any:
    from contextlib import nullcontext

    if not words.publish:
        return nullcontext()
    from imumon.bus import BusError, Publisher

    try:
        return Publisher("replay", listen=words.listen, connect=words.connect, settings=settings(words).zenoh)
    except BusError as error:
        raise Stop(str(error)) from None
