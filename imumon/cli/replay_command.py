"""Commands that work on a recording: replay."""

from __future__ import annotations

import argparse
from typing import Any

from imumon.cli.options import (
    DONE,
    USAGE,
    CommandError,
    Parser,
    add_endpoints,
    baseline,
    bus_stop,
    mention,
    positive,
    print_report,
    rate,
    settings,
)

FILES = "raw capture (ASCII, binary, mixed), --record file, CSV, all also .gz; .npz, rosbag 1 or 2, MCAP"


def add_reading(parser: argparse._ActionsContainer) -> None:
    """How a recording is to be read."""
    add = parser.add_argument
    add("--rate", type=rate, metavar="HZ", help="sample rate of a stream without a clock")
    add("--no-guards", action="store_true", help="cut nothing out: every valid sample counts")
    kinds = ("deltas", "uncompensated", "compensated")
    add("--stream", choices=kinds, help="of a table that has several; default: the best")
    text = "columns of a table: gyro/x=COLUMN:UNIT,...; COLUMN is a name or a number from 1; also t and dt"
    add("--map", metavar="MAP", help=text)
    add("--topic", metavar="NAME", help="of a bag that has several IMUs")


def task_of(words: argparse.Namespace, **more: Any) -> Any:
    """The recording that is to be read, and how."""
    from imumon.recordings.columns import parse_map
    from imumon.replay.replay import ReplayOptions

    try:
        columns = parse_map(words.map) if words.map else {}
    except ValueError as error:
        raise CommandError(str(error), USAGE) from None
    made = settings(words)
    asked = made.report
    return ReplayOptions(
        path=words.file,
        rate_hz=words.rate or made.device.rate_hz or None,
        guarded=made.guards.enabled and not words.no_guards,
        precision={"N": asked.precision_n, "B": asked.precision_b, "K": asked.precision_k},
        kind=words.stream,
        columns=columns,
        topic=words.topic,
        **more,
    )


def add_replay(parser: Parser) -> None:
    add = parser.add_argument
    add("file", metavar="FILE", help=f"{FILES}; - is standard input")
    add_reading(parser)
    add("--speed", default="max", metavar="X|max", help="times real time; default max")
    add("--json", action="store_true", help="the report as JSON")
    add("--publish", action="store_true", help="publish on Zenoh while replaying")
    add("--config", metavar="FILE", help="settings; flags win over the file")
    add("--baseline", metavar="FILE", help="an earlier report of this sensor (JSON): tell what has changed")
    add_endpoints(parser, listen=True)


def run_replay(words: argparse.Namespace) -> int:
    from imumon.errors import RateRequired
    from imumon.recordings import OptionNotApplicable, SourceError
    from imumon.replay.replay import bar, replay

    if words.speed == "max":
        speed = None
    else:
        try:
            speed = positive(words.speed)
        except (ValueError, argparse.ArgumentTypeError):
            raise CommandError(f"--speed is max or a positive number, not {words.speed!r}", USAGE) from None
    before = baseline(words.baseline)
    task = task_of(words, speed=speed, baseline=before)
    try:
        with _publisher(words) as bus:
            made = replay(task, progress=bar(), bus=bus, tell=mention)
    except (RateRequired, OptionNotApplicable) as error:
        raise CommandError(str(error), USAGE) from None
    except SourceError as error:
        raise CommandError(str(error)) from None
    print_report(made, words.json, before)
    return DONE


def _publisher(words: argparse.Namespace) -> Any:
    from contextlib import nullcontext

    if not words.publish:
        return nullcontext()
    from imumon.bus import BusError, Publisher

    made = settings(words)
    try:
        return Publisher("replay", listen=words.listen, connect=words.connect, settings=made.zenoh)
    except BusError as error:
        raise bus_stop(error, made) from None
