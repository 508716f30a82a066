"""Command `imumon replay`, and the options of commands that read a recording."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
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


def add_read_options(parser: argparse._ActionsContainer) -> None:
    """Add the options that say how to read a recording."""
    add = parser.add_argument
    add("--rate", type=rate, metavar="HZ", help="sample rate of a stream without a clock")
    add("--no-guards", action="store_true", help="exclude nothing: every valid sample counts")
    kinds = ("deltas", "uncompensated", "compensated")
    add("--stream", choices=kinds, help="of a table that has several; default: the best")
    text = "columns of a table: gyro/x=COLUMN:UNIT,...; COLUMN is a name or a number from 1; also t and dt"
    add("--map", metavar="MAP", help=text)
    add("--topic", metavar="NAME", help="of a bag that has several IMUs")


def replay_options(arguments: argparse.Namespace, **more: Any) -> Any:
    """Return the options of a replay.

    Raises
    ------
    CommandError : one of them is malformed.
    """
    from imumon.recordings.columns import parse_map
    from imumon.replay import ReplayOptions

    with reading():
        columns = parse_map(arguments.map) if arguments.map else {}
    made = settings(arguments)
    precision = made.report
    return ReplayOptions(
        path=arguments.file,
        rate_hz=arguments.rate or made.device.rate_hz or None,
        guarded=made.guards.enabled and not arguments.no_guards,
        precision={"N": precision.precision_n, "B": precision.precision_b, "K": precision.precision_k},
        kind=arguments.stream,
        columns=columns,
        topic=arguments.topic,
        **more,
    )


@contextmanager
def reading() -> Iterator[None]:
    """Map the errors of reading a recording to exit codes."""
    from imumon.errors import RateRequired
    from imumon.recordings.base import OptionError, RecordingError

    try:
        yield
    except (RateRequired, OptionError) as error:
        raise CommandError(str(error), USAGE) from None
    except RecordingError as error:
        raise CommandError(str(error)) from None


def add_replay(parser: Parser) -> None:
    add = parser.add_argument
    add("file", metavar="FILE", help=f"{FILES}; - is standard input")
    add_read_options(parser)
    add("--speed", default="max", metavar="X|max", help="times real time; default max")
    add("--json", action="store_true", help="the report as JSON")
    add("--publish", action="store_true", help="publish on Zenoh while replaying")
    add("--config", metavar="FILE", help="settings; options override the file")
    add("--baseline", metavar="FILE", help="an earlier report of this sensor (JSON): report what has changed")
    add_endpoints(parser, listen=True)


def run_replay(arguments: argparse.Namespace) -> int:
    from imumon.replay import progress_bar, replay

    if arguments.speed == "max":
        speed = None
    else:
        try:
            speed = positive(arguments.speed)
        except (ValueError, argparse.ArgumentTypeError):
            raise CommandError(
                f"--speed is max or a positive number, not {arguments.speed!r}", USAGE
            ) from None
    before = baseline(arguments.baseline)
    options = replay_options(arguments, speed=speed, baseline=before)
    with reading(), _publisher(arguments) as bus:
        made = replay(options, progress=progress_bar(), bus=bus, remark=mention)
    print_report(made, arguments.json, before)
    return DONE


def _publisher(arguments: argparse.Namespace) -> Any:
    if not arguments.publish:
        return nullcontext()
    from imumon.bus import BusError, Publisher

    made = settings(arguments)
    try:
        return Publisher("replay", listen=arguments.listen, connect=arguments.connect, settings=made.zenoh)
    except BusError as error:
        raise bus_stop(error, made) from None
