"""Command `imumon replay`, and the options of commands that read a recording."""

from __future__ import annotations

import argparse
import sys
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

from imumon.api.document_report import document_report
from imumon.cli import options
from imumon.cli.exit_codes import SUCCESS, USAGE, CommandError
from imumon.cli.options import Parser
from imumon.cli.output import print_message, print_report
from imumon.documents.references import read_sheet
from imumon.model.cures import OPTIONS
from imumon.model.errors import ImumonError
from imumon.sources.clock import HostClock

FILES = (
    "bytes of the sensor (ASCII, binary, mixed), --record file, CSV, all also gzipped; NPZ, rosbag, MCAP, ulg (PX4), "
    "BIN (ArduPilot)"
)


def add_read_options(parser: argparse._ActionsContainer) -> None:
    """Add the options that say how to read a recording."""
    add = parser.add_argument
    add(
        OPTIONS["rate_hz"], type=options.rate, metavar="HZ", help="sample rate of samples without time stamps"
    )
    add("--no-guards", action="store_true", help="exclude no sample: every valid sample counts")
    add(
        OPTIONS["kind"],
        choices=options.STREAMS,
        help="stream to use if the file has several; default: the first of these that it has",
    )
    text = (
        "columns of a table, fields of a topic: gyro=COLUMN,COLUMN,COLUMN:UNIT,t=COLUMN:UNIT, or "
        "gyro/x=COLUMN:UNIT, "
    )
    text += "COLUMN/COUNTS:UNIT; a name, or a number from 1; also accel, mag, dt and rate=HZ; repeatable"
    add(OPTIONS["columns"], action=options.Joined, metavar="MAP", help=text)
    add(
        OPTIONS["topic"],
        metavar="NAME",
        help="topic of a bag, or of a log: vehicle_imu/1, IMU/0; also in settings of other software",
    )
    text = "the only sensor that is read from a table or log, where gyro and accel have different rates"
    add(OPTIONS["sensor"], choices=("gyro", "accel"), help=text)
    text = "rows of a table that are read, where a column says which sensor they are of; repeatable"
    add(OPTIONS["where"], action=options.Joined, metavar="COLUMN=VALUE", help=text)
    text = (
        "take what is proposed for columns that the recording does not state; the report says what is assumed"
    )
    add(OPTIONS["accept"], action="store_true", help=text)
    text = "definition of messages that a bag of ROS does not have: a .msg file, or a directory of them"
    add(OPTIONS["definitions"], metavar="PATH", help=text)
    text = (
        "filter of the sensor, where the recording does not say: the samples that it averages, and their rate"
    )
    add("--filter", type=sensor_filter, metavar="none|factory|WINDOW|WINDOW@HZ", help=text)


def add_datasheet(parser: argparse._ActionsContainer) -> None:
    """Add ``--datasheet``."""
    text = "values of the sensor's data sheet (TOML), or the name of one that imumon has, beside the measured ones"
    parser.add_argument("--datasheet", metavar="FILE.toml", help=text)


def sensor_filter(text: str) -> Any:
    """Return the filter that ``--filter`` names."""
    from imumon.api.replay_options import SensorFilter

    try:
        return SensorFilter.parse(text)
    except ImumonError as error:
        raise argparse.ArgumentTypeError(f"{error.message}; {error.cure}") from None


def reference_sheet(arguments: argparse.Namespace) -> Any:
    """Return the reference sheet of ``--datasheet``; None without it."""
    if arguments.datasheet is None:
        return None

    return read_sheet(arguments.datasheet)


def replay_options(arguments: argparse.Namespace, path: str, pace: Any = None, **more: Any) -> Any:
    """Return the options of a replay, with `more` of its record; raise `ImumonError` if one of them is malformed."""
    from imumon.api.replay_options import ReplayOptions
    from imumon.record import RecordOptions
    from imumon.sources.files.base import ReadOptions
    from imumon.sources.files.columns import parse_map, parse_where

    loaded = options.settings(arguments)
    return ReplayOptions(
        path=path,
        read=ReadOptions(
            rate_hz=arguments.rate or loaded.device.rate_hz or None,
            kind=arguments.stream,
            columns=parse_map(arguments.map) if arguments.map else {},
            topic=arguments.topic,
            sensor=arguments.sensor,
            where=parse_where(arguments.where) if arguments.where else {},
            definitions=arguments.msg,
            accept=arguments.accept,
        ),
        record=RecordOptions(
            guarded=loaded.guards.enabled and not arguments.no_guards,
            max_loss=loaded.alert.max_loss,
            precision=loaded.report.precision,
            **more,
        ),
        filter=arguments.filter,
        pace=pace,
    )


def replayed(wanted: Any, sheet: Any = None, bus: Any = None) -> Any:
    """Return the measurement of a recording, as `imumon.analyse` makes it; a terminal shows a progress bar.

    What is doubtful in the recording is printed behind the bar. Columns that are not certain are asked on a terminal.
    """
    from imumon.api.record_analysis import measured
    from imumon.cli.progress_bar import progress_bar
    from imumon.sources.files.columns import ColumnsUnclear

    try:
        with progress_bar() as update:
            measurement = measured(wanted, sheet, progress=update, bus=bus)
    except ColumnsUnclear as question:
        if (answered := _answered(question, wanted)) is None:
            raise
        return replayed(answered, sheet, bus)
    for text in measurement.report.device.remarks:
        print_message(f"{wanted.path}: {text}")
    for text in measurement.notes:
        print_message(text)
    return measurement


def _answered(question: Any, wanted: Any) -> Any:
    """Return the options with the answer to a question about columns; None: there is none, or it is no."""
    from imumon.sources.files.columns import parse_map

    if wanted.path == "-" or not (sys.stdin.isatty() and sys.stderr.isatty()):
        return None
    print(question.text, file=sys.stderr)
    choices = "[e/N]" if question.lacks else "[Y/n/e]"
    print(f"Use this? {choices} ", end="", file=sys.stderr, flush=True)
    answer = sys.stdin.readline().strip().lower() or ("n" if question.lacks else "y")
    if answer in ("y", "yes") and not question.lacks:
        return replace(wanted, read=replace(wanted.read, accept=True))
    if answer != "e":
        return None
    edited = _edited(question.proposal) or question.proposal
    read = replace(wanted.read, columns=parse_map(edited), where=question.where or wanted.read.where)
    return replace(wanted, read=read)


def _edited(text: str) -> str:
    """Return a text as a person edits it; where the line cannot be edited, it is above one that is typed again."""
    try:
        import readline
    except ImportError:  # a Python that was built without it
        readline = None  # type: ignore[assignment]
    if readline is None or not sys.stdout.isatty():
        print(f"{text}\n--map ", end="", file=sys.stderr, flush=True)
        return sys.stdin.readline().strip()
    readline.set_startup_hook(lambda: readline.insert_text(text))
    try:
        return input("--map ").strip()
    except EOFError:
        return ""
    finally:
        readline.set_startup_hook()


def add_replay(parser: Parser) -> None:
    add = parser.add_argument
    text = f"{FILES}; - is standard input; several of one sensor are combined"
    add("files", nargs="+", metavar="FILE", type=options.file_name, help=text)
    add_read_options(parser)
    add_datasheet(parser)
    add("--speed", default="max", metavar="X|max", help="times as fast as real time; default max")
    add("--json", action="store_true", help="the report as JSON")
    add("--verbose", action="store_true", help="print the whole datasheet, which takes a fifth more time")
    add("--publish", action="store_true", help="publish on Zenoh while replaying")
    add("--baseline", metavar="FILE", help="compare with an earlier report (JSON)")
    options.add_listen(parser)


def replay(arguments: argparse.Namespace) -> int:

    sheet = reference_sheet(arguments)
    pace = None if arguments.speed == "max" else HostClock(options.speed(arguments.speed))
    baseline = options.baseline(arguments.baseline)
    if len(arguments.files) > 1:
        report = _combined(arguments, sheet, baseline)
    else:
        with _publisher(arguments) as bus:
            wanted = replay_options(
                arguments,
                arguments.files[0],
                pace=pace,
                baseline=baseline,
                convergence=arguments.verbose,
            )
            report = replayed(wanted, sheet, bus).report
    print_report(report, arguments.json, baseline, verbose=arguments.verbose)
    noise = [channel.coefficients["N"] for channel in report.channels.values() if "N" in channel.coefficients]
    if all(estimate.status == "pending" for estimate in noise):  # scripts see nothing but empty cells
        reasons = "; ".join(dict.fromkeys(estimate.reason for estimate in noise if estimate.reason))
        name = arguments.files[0] if len(arguments.files) == 1 else f"{len(arguments.files)} recordings"
        print_message(f"{name}: no value of N{f': {reasons}' if reasons else ''}")
    return SUCCESS


def _combined(arguments: argparse.Namespace, sheet: Any, baseline: Any) -> Any:
    """Return the report of a sensor from several of its recordings."""
    from imumon.api.combination import combine

    given = {"--publish": arguments.publish, "--speed": arguments.speed != "max"}
    for option, value in given.items():
        if value:
            message = f"{option} is for one recording, and there are {len(arguments.files)}"
            raise CommandError(
                "one_recording_required", message, "leave it out, or name one recording", USAGE
            )
    wanted = [replay_options(arguments, path, baseline=baseline) for path in arguments.files]
    report = combine([replayed(options) for options in wanted]).report
    return document_report(report, sheet)


def _publisher(arguments: argparse.Namespace) -> Any:
    """Return a publisher as a context manager; without ``--publish`` it does nothing."""

    if not arguments.publish:
        return nullcontext()
    from imumon.bus import BusError, Publisher

    given = {"zenoh.listen": arguments.listen, "zenoh.connect": arguments.connect}
    loaded = options.settings(arguments, given)
    try:
        return Publisher("replay", loaded.zenoh)
    except BusError as error:
        raise options.with_origin(error, loaded) from None
