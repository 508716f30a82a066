"""Commands that ask a running daemon: tui, status, wait."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from imumon.cli import options
from imumon.cli.daemon_state import current_reports, current_trouble, status_lines
from imumon.cli.exit_codes import NOT_FOUND, NOT_REACHED, SUCCESS, USAGE, CommandError
from imumon.cli.options import Parser
from imumon.cli.output import print_json, print_message, print_report, print_status
from imumon.cli.wait_condition import WaitCondition
from imumon.model.coefficients import GRADES, MARKOV, NOISE
from imumon.model.report_json import to_json
from imumon.model.units import duration
from imumon.tui import run, terminal

SPEAKS_S = 60.0
"""s between two lines about what is missing, where standard error is no terminal."""
MARKOV_PRECISION = 0.5
"""Half-width of the 95 % limits of M that is waited for without --precision: the settings have none, as M is rare."""


def add_tui(parser: Parser) -> None:
    options.add_id(parser, "device to show first")
    parser.add_argument("--baseline", metavar="FILE", help="compare with an earlier report (JSON)")


def add_status(parser: Parser) -> None:
    options.add_id(parser, "device; default: all, one line each if there are several")
    text = "print the report as JSON, or a list of them if several daemons answer"
    parser.add_argument("--json", action="store_true", help=text)
    parser.add_argument("--verbose", action="store_true", help="print the whole datasheet as text")


def add_wait(parser: Parser) -> None:
    add = parser.add_argument
    options.add_id(parser)
    text = "wait until gyroscope and accelerometer certainly have this grade or a better one; default: "
    text += "from the settings"
    add("--grade", choices=GRADES, help=text)
    text = "wait until the precision of this coefficient is reached on every axis; M shows on few sensors"
    add("--coefficient", choices=(*NOISE, MARKOV.sigma), help=text)
    text = "half-width of the 95 %% limits as a share of the value, 0.05 or 5%%; default: from the settings"
    add("--precision", type=options.share, metavar="P", help=text)
    text = "consider only this channel or sensor (gyro/x or gyro: B of an accelerometer takes long), repeatable; "
    text += "default: gyro and accel"
    add("--channel", action="append", metavar="NAME", help=text)
    text = "give up after T (90, 90s, 10m, 2h); without it, wait 2 s for a daemon and then without limit"
    add("--timeout", type=options.seconds, metavar="T", help=text)


def require_terminal(instead: str) -> None:
    """Raise `CommandError` if there is no terminal; `instead` is the command that needs none."""

    if not terminal.is_usable():
        cure = f"without one use: {instead}"
        raise CommandError("no_terminal", "the terminal UI needs a terminal", cure, USAGE)


def tui(
    arguments: argparse.Namespace, starting: str | None = None, ended: Callable[[], str | None] | None = None
) -> int:
    """Show the terminal UI.

    Parameters
    ----------
    starting : what to show until the daemon answers, if it is being started.
    ended : returns why the daemon has ended, None while it runs.
    """
    require_terminal("imumon status --json")

    baseline = options.baseline(arguments.baseline)
    with options.subscriber(arguments) as subscriber:
        if arguments.id is None and not arguments.connect:
            arguments.id = options.only_own_device(arguments, subscriber)
        endpoint = ", ".join(subscriber.endpoints) if len(subscriber.endpoints) < 3 else None
        return run(
            subscriber,
            id=arguments.id,
            program=options.settings(arguments).report.program,
            baseline=baseline,
            endpoint=endpoint,
            starting=starting,
            ended=ended,
        )


def _cure(arguments: argparse.Namespace) -> str:
    """Return what to do if no daemon answers, beside starting one."""
    if not arguments.connect:
        return "name its endpoint with --connect"
    return f"check that it listens on {', '.join(arguments.connect)}"


def status(arguments: argparse.Namespace) -> int:
    """Print one report of a running daemon, or a line about each if there are several."""

    with options.subscriber(arguments) as subscriber:
        names = options.answering(subscriber, arguments.id, options.ANSWER_S, _cure(arguments))
        if len(names) == 1 or arguments.id:
            report = options.report_of(subscriber, arguments.id, names, arguments)
            late = None if arguments.json else _why_late(subscriber, report)
            if arguments.verbose:
                report = replace(report, events=tuple(subscriber.events(report.device.id)))
            print_report(report, arguments.json, verbose=arguments.verbose, late=late)
            return SUCCESS
        reports = current_reports(subscriber, names)
        for name in names:
            options.warn_of_rivals(subscriber, name)
    if arguments.json:
        print_json(to_json([report for report, _ in reports.values()]))
    else:
        print("\n".join(status_lines(reports)))
    return SUCCESS


def _why_late(subscriber: Any, report: Any) -> str | None:
    """Return why the sensor delivers nothing, or how old the report is; None: its numbers are current."""

    ((report, age_s),) = current_reports(subscriber, [report.device.id]).values()
    if age_s > report.late_s:
        return f"the report is {duration(age_s)} old"
    return current_trouble(subscriber, report, time.monotonic() + options.ANSWER_S)


def _condition(arguments: argparse.Namespace) -> Any:
    """Return what to wait for, by the options and the settings."""

    if arguments.precision is not None and arguments.coefficient is None:
        message, cure = "--precision needs a coefficient", f"add --coefficient {' or '.join(NOISE)}"
        raise CommandError("coefficient_required", message, cure, USAGE)
    configured = options.settings(arguments).report
    return WaitCondition(
        grade=arguments.grade or (None if arguments.coefficient else configured.grade or None),
        coefficient=arguments.coefficient,
        precision=arguments.precision or configured.precision.get(arguments.coefficient, MARKOV_PRECISION),
        channels=tuple(arguments.channel or ()),
    )


def wait(arguments: argparse.Namespace) -> int:
    """Wait until a report meets the condition of the options or of the settings, else for the first sample."""

    condition = _condition(arguments)
    end_s = time.monotonic() + arguments.timeout if arguments.timeout else float("inf")
    with options.subscriber(arguments) as subscriber:
        report = options.first_report(
            subscriber, arguments.id, arguments.timeout or options.ANSWER_S, _cure(arguments), arguments
        )
        events_s = min(time.monotonic() + options.ANSWER_S, end_s)
        stopped = None  # why the sensor delivers nothing
        spoken_s = time.monotonic()
        try:
            while unmet := condition.unmet(report):
                before, stopped = stopped, current_trouble(subscriber, report, events_s)
                if stopped and stopped != before:
                    print_status("")
                    print_message(f"{report.device.id}: {stopped}")
                print_status(unmet)
                if not sys.stderr.isatty() and time.monotonic() >= spoken_s + SPEAKS_S:
                    spoken_s = time.monotonic()
                    print_message(f"{report.device.id}: waiting: {unmet}")
                if time.monotonic() >= end_s:
                    reason = f"{stopped}; {unmet}" if stopped else unmet
                    message = f"not reached in {duration(arguments.timeout)}: {reason}"
                    worse = condition.unreachable_grade(report)
                    cure = f"it is {worse} at best" if worse else "give a longer --timeout"
                    raise CommandError("not_reached", message, cure, NOT_REACHED)
                report = _next_report(subscriber, report, end_s)
        finally:
            print_status("")
    length = duration(report.session.elapsed_s)
    print(f"{report.device.id}: {condition.description(report)}; length of the record {length}")
    return SUCCESS


def _next_report(subscriber: Any, report: Any, end_s: float) -> Any:
    """Return the next report of the same device, or the same one at the end of the time (monotonic, s)."""
    while (left_s := end_s - time.monotonic()) > 0:
        newest, arrived_s = subscriber.report(report.device.id) or (report, 0.0)
        options.warn_of_rivals(subscriber, report.device.id)
        if newest is not report:
            return newest
        late = time.monotonic() - arrived_s > report.late_s
        if late and report.device.id not in subscriber.alive():
            message = f"the daemon of {report.device.id} has ended"
            raise CommandError("daemon_ended", message, "start it again", NOT_FOUND)
        time.sleep(min(left_s, options.POLL_S))
    return report
