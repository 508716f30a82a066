"""Command `imumon replay`, and the options of commands that read a recording."""

from __future__ import annotations

import argparse
from contextlib import nullcontext
from typing import Any

from imumon.cli import options
from imumon.cli.exit_codes import SUCCESS, USAGE, CommandError
from imumon.cli.options import Parser
from imumon.cli.output import print_message, print_report, print_values

FILES = (
    "bytes of the sensor (ASCII, binary, mixed), --record file, CSV, all also gzipped; NPZ, rosbag, MCAP, ulg (PX4), "
    "BIN (ArduPilot)"
)


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
    text = "columns of a table, fields of a topic: gyro/x=COLUMN:UNIT,...; a name, or a number from 1; also t and dt"
    add("--map", metavar="MAP", help=text)
    add(
        "--topic",
        metavar="NAME",
        help="topic of a bag, or of a log: vehicle_imu/1, IMU/0; also in settings of other software",
    )
    text = "the only sensor that is read from a table or log, where gyro and accel have different rates"
    add("--sensor", choices=("gyro", "accel"), help=text)
    text = (
        "filter of the sensor, where the recording does not say: the samples that it averages, and their rate"
    )
    add("--filter", type=sensor_filter, metavar="none|factory|WINDOW|WINDOW@HZ", help=text)
    text = "also compute the fully overlapping Allan deviation; memory grows with the record"
    add("--exact", action="store_true", help=text)
    text = "averaging times of --exact: octaves (default), or ten per decade"
    add("--taus", choices=("octave", "decade"), help=text)


def add_datasheet(parser: argparse._ActionsContainer) -> None:
    """Add ``--datasheet``."""
    text = "limits of the sensor's data sheet (TOML), or the name of one that imumon has; each value passes, fails or "
    parser.add_argument("--datasheet", metavar="FILE.toml", help=f"{text}is undecided")


def sensor_filter(text: str) -> Any:
    """Return the filter that ``--filter`` names."""
    from imumon.replay import SensorFilter

    name, at, rate = text.partition("@")
    loop_hz = options.positive(rate) if at else None
    if name == "factory" and not at:
        return SensorFilter(None, None, text)
    if name != "none" and not (name.isdigit() and len(name) < 7):
        message = f"{text!r} is no filter; write none, factory, or how many samples it averages, such as 4 or 8@1000"
        raise argparse.ArgumentTypeError(message)
    return SensorFilter(1 if name == "none" else max(1, int(name)), loop_hz, text)


def given_options(arguments: argparse.Namespace) -> dict[str, str]:
    """Return the options of a recording that were given, as text by name."""
    named = {name: getattr(arguments, name) for name in ("rate", "stream", "map", "topic", "sensor", "taus")}
    texts = {
        f"--{name}": f"{value:g}" if isinstance(value, float) else str(value)
        for name, value in named.items()
        if value is not None
    }
    flags = {"--no-guards": arguments.no_guards, "--exact": arguments.exact}
    texts |= {name: "" for name, given in flags.items() if given}
    return texts | ({"--filter": arguments.filter.text} if arguments.filter else {})


def reference_sheet(arguments: argparse.Namespace) -> Any:
    """Return the reference sheet of ``--datasheet``; None without it."""
    if arguments.datasheet is None:
        return None
    from imumon.references import read_sheet

    return read_sheet(arguments.datasheet)


def replay_options(arguments: argparse.Namespace, **more: Any) -> Any:
    """Return the options of a replay; raise `ImumonError` if one of them is malformed."""
    from imumon.alarms import limits
    from imumon.recordings.columns import parse_map
    from imumon.replay import ReplayOptions

    loaded = options.settings(arguments)
    required = loaded.report
    if arguments.taus is not None and not arguments.exact:
        raise CommandError("exact_required", "--taus needs --exact", "add it", USAGE)
    return ReplayOptions(
        path=arguments.file,
        rate_hz=arguments.rate or loaded.device.rate_hz or None,
        guarded=loaded.guards.enabled and not arguments.no_guards,
        alarm_limits=limits(loaded.alert),
        precision=required.precision,
        kind=arguments.stream,
        columns=parse_map(arguments.map) if arguments.map else {},
        topic=arguments.topic,
        sensor=arguments.sensor,
        filter=arguments.filter,
        exact=(arguments.taus or "octave") if arguments.exact else None,
        **more,
    )


def replayed(arguments: argparse.Namespace, wanted: Any, bus: Any = None) -> Any:
    """Return the report of a recording and where its numbers come from; a terminal shows a progress bar.

    What is doubtful in the recording is printed behind the bar.
    """
    from imumon.cli.traceability import with_provenance
    from imumon.replay import ProgressBar, replay

    remarks: list[str] = []
    with ProgressBar() as bar:
        report = replay(wanted, progress=bar.update, bus=bus, remark=remarks.append)
    for text in remarks:
        print_message(text)
    return with_provenance(report, arguments.file, given_options(arguments), wanted.guarded)


def add_replay(parser: Parser) -> None:
    add = parser.add_argument
    add("file", metavar="FILE", type=options.file_name, help=f"{FILES}; - is standard input")
    add_read_options(parser)
    add_datasheet(parser)
    add("--speed", default="max", metavar="X|max", help="times as fast as real time; default max")
    options.add_output(parser, "the report as JSON")
    add("--publish", action="store_true", help="publish on Zenoh while replaying")
    options.add_config(parser)
    add("--baseline", metavar="FILE", help="compare with an earlier report (JSON)")
    options.add_endpoints(parser, listen=True)


def replay(arguments: argparse.Namespace) -> int:
    from imumon.cli.traceability import evaluated

    sheet = reference_sheet(arguments)
    speed = None if arguments.speed == "max" else options.speed(arguments.speed)
    baseline = options.baseline(arguments.baseline)
    with _publisher(arguments) as bus:
        wanted = replay_options(arguments, speed=speed, baseline=baseline)
        report = replayed(arguments, wanted, bus)
    report = evaluated(report, sheet)
    print_values(report) if arguments.values else print_report(report, arguments.json, baseline)
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
