"""Command `imumon replay`, and the options of commands that read a recording."""

from __future__ import annotations

import argparse
from contextlib import nullcontext
from typing import Any

from imumon.cli import options
from imumon.cli.exit_codes import SUCCESS
from imumon.cli.options import Parser
from imumon.cli.output import print_message, print_report

FILES = "bytes of the sensor (ASCII, binary, mixed), --record file, CSV, all also gzipped; NPZ, rosbag, MCAP"


def add_read_options(parser: argparse._ActionsContainer) -> None:
    """Add the options that say how to read a recording."""
    add = parser.add_argument
    add("--rate", type=options.rate, metavar="HZ", help="sample rate of samples without time stamps")
    add("--no-guards", action="store_true", help="exclude no sample: every valid sample counts")
    add(
        "--stream",
        choices=options.STREAMS,
        help="stream to use if the file has several; default: the first of these that it has",
    )
    text = "columns of a table: gyro/x=COLUMN:UNIT,...; COLUMN is a name or a number from 1; also t and dt"
    add("--map", metavar="MAP", help=text)
    add("--topic", metavar="NAME", help="topic to read if a bag has several IMUs")


def replay_options(arguments: argparse.Namespace, **more: Any) -> Any:
    """Return the options of a replay; raise `ImumonError` if one of them is malformed."""
    from imumon.recordings.columns import parse_map
    from imumon.replay import ReplayOptions

    loaded = options.settings(arguments)
    required = loaded.report
    return ReplayOptions(
        path=arguments.file,
        rate_hz=arguments.rate or loaded.device.rate_hz or None,
        guarded=loaded.guards.enabled and not arguments.no_guards,
        precision={"N": required.precision_n, "B": required.precision_b, "K": required.precision_k},
        kind=arguments.stream,
        columns=parse_map(arguments.map) if arguments.map else {},
        topic=arguments.topic,
        **more,
    )


def add_replay(parser: Parser) -> None:
    add = parser.add_argument
    add("file", metavar="FILE", help=f"{FILES}; - is standard input")
    add_read_options(parser)
    add("--speed", default="max", metavar="X|max", help="times as fast as real time; default max")
    add("--json", action="store_true", help="the report as JSON")
    add("--publish", action="store_true", help="publish on Zenoh while replaying")
    options.add_config(parser)
    add("--baseline", metavar="FILE", help="compare with an earlier report (JSON)")
    options.add_endpoints(parser, listen=True)


def run_replay(arguments: argparse.Namespace) -> int:
    from imumon.replay import progress_bar, replay

    speed = None if arguments.speed == "max" else options.speed(arguments.speed)
    baseline = options.baseline(arguments.baseline)
    with _publisher(arguments) as bus:
        report = replay(
            replay_options(arguments, speed=speed, baseline=baseline),
            progress=progress_bar(),
            bus=bus,
            remark=print_message,
        )
    print_report(report, arguments.json, baseline)
    return SUCCESS


def _publisher(arguments: argparse.Namespace) -> Any:
    """Return a publisher as a context manager; without ``--publish`` it does nothing."""

    if not arguments.publish:
        return nullcontext()
    from imumon.bus import BusError, Publisher

    loaded = options.settings(arguments)
    try:
        return Publisher("replay", listen=arguments.listen, connect=arguments.connect, settings=loaded.zenoh)
    except BusError as error:
        raise options.with_origin(error, loaded) from None
