"""Command `imumon check`: a plugin for monitoring systems (Nagios, Icinga, Sensu).

It prints one line, ``IMUMON OK - text|performance data``, and ends with the exit code of plugins, which is not
that of the other commands: 0 ok, 1 warning, 2 critical, 3 unknown. The format is that of the Monitoring Plugins
Development Guidelines: numbers without exponent, ``label=value[unit];warning;critical;minimum;maximum``.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from decimal import Decimal
from enum import IntEnum
from typing import Any

from imumon.cli import options
from imumon.cli.daemon_state import current_reports, current_trouble, grades_text
from imumon.cli.exit_codes import NOT_FOUND, CommandError
from imumon.cli.options import Parser
from imumon.model.coefficients import GRADES, GradeName
from imumon.model.errors import ImumonError
from imumon.model.messages import caveats, change_text, grade_text, joined, line, loss_label, loss_text
from imumon.model.report import SensorGrade
from imumon.model.report_json import plain
from imumon.model.samples import INERTIAL, TEMPERATURE


class Code(IntEnum):
    """Exit codes of plugins."""

    OK = 0
    WARNING = 1
    CRITICAL = 2
    UNKNOWN = 3


MAX_AGE_S = 5.0
"""s, age of a report from which it is critical, if the command line gives none."""
SHOWN_CHANGES = 3
"""Changes that the line names."""
WARNED = ("stuck", "constant", "clipped", "other_sender")
"""Caveats that are a warning, beside ``changed``."""


def add_check(parser: Parser) -> None:
    add = parser.add_argument
    options.add_id(parser)
    text = f"critical if the report is older than T (5, 90s, 10m); default {MAX_AGE_S:g}"
    add("--max-age", type=options.seconds, default=MAX_AGE_S, metavar="T", help=text)
    text = "critical if gyroscope or accelerometer is certainly worse than this grade, a warning if it may be"
    add("--grade", choices=GRADES, help=text)
    add("--baseline", metavar="FILE", help="warning if N or B differs from an earlier report (JSON)")


def check(arguments: argparse.Namespace) -> int:
    """Print the line of a plugin and return its exit code."""

    baseline = options.baseline(arguments.baseline)
    with options.subscriber(arguments) as subscriber:
        report = options.first_report(
            subscriber, arguments.id, options.ANSWER_S, "check its service", arguments
        )
        ((report, age_s),) = current_reports(subscriber, [report.device.id]).values()
        stopped = current_trouble(subscriber, report, time.monotonic() + options.ANSWER_S)
        rivals = report.device.id in subscriber.rivals()
    critical: list[str] = []
    warnings: list[str] = []
    if report.state == "stopped":
        critical.append("the daemon has ended")
    if stopped:
        critical.append(stopped)
    if age_s > arguments.max_age:
        critical.append(f"the last report is {age_s:.1f} s old")
    if arguments.grade:
        critical += _grades(report, "missed", f"is certainly worse than {arguments.grade}", arguments.grade)
        warnings += _grades(report, "open", f"may be worse than {arguments.grade}", arguments.grade)
    if rivals:  # the numbers are of the one that was seen first, which need not be the right one
        warnings.append(f"two programs publish {report.device.id}: give each daemon its own --id")
    if report.session.recent_loss is not None and report.is_lossy:
        warnings.append(loss_text(report.session.recent_loss))
    warnings += _caveats(report, baseline)
    facts = [f"{grades_text(report)}, {loss_label(report)}"]
    code = Code.CRITICAL if critical else Code.WARNING if warnings else Code.OK
    if code == Code.OK and not report.session.samples:
        code, facts = Code.UNKNOWN, ["no sample yet"]
    text = f"{report.device.id}: {'; '.join([*critical, *warnings] or facts)}"
    return _print(code, text, _performance(report, age_s, arguments.max_age))


def fail(error: ImumonError) -> int:
    """Print an error as a plugin does and return its exit code: a missing daemon is critical."""
    missing = isinstance(error, CommandError) and error.exit_code == NOT_FOUND
    return _print(Code.CRITICAL if missing else Code.UNKNOWN, str(error), ())


def _print(code: Code, text: str, performance: Sequence[str]) -> int:

    line = " ".join(plain(text.replace("\n", "; ").replace("|", "/")).split())
    print(f"IMUMON {code.name} - {line}" + (f"|{' '.join(performance)}" if performance else ""))
    return code


def _grades(report: Any, verdict: str, words: str, required: GradeName) -> Iterator[str]:
    """Yield the sensors of which the comparison with the required grade has this result."""
    for sensor, grade in report.grade.items():
        if grade.compared_with(required) == verdict:
            yield f"{sensor} {words}: {_grade_text(grade)}"


def _grade_text(grade: SensorGrade) -> str:
    """Return a grade with the coefficient that decides it, and why it is not certain."""
    by = f" by {grade.decided_by.coefficient} of {grade.decided_by.axis}" if grade.decided_by else ""
    return f"{grade_text(grade)}{by}{f' ({grade.reason})' if grade.reason else ''}"


def _caveats(report: Any, baseline: Any) -> Iterator[str]:
    """Yield what is a warning of the caveats, and what has changed."""

    channels_of = caveats(report)
    for caveat in WARNED:
        if caveat in channels_of:
            channels = joined(channels_of[caveat])
            yield f"{channels}: {line(caveat)}" if channels else line(caveat)
    changes = [(name, change) for name, channel in report.channels.items() for change in channel.changes]
    if baseline is not None:
        from imumon.record.changes import compare_with_report

        changes += [
            (name, change)
            for name, channel in report.channels.items()
            for change in compare_with_report(baseline, name, channel)
        ]
    texts = list(dict.fromkeys(change_text(name, change) for name, change in changes))
    yield from texts[:SHOWN_CHANGES]
    if len(texts) > SHOWN_CHANGES:
        yield f"{len(texts) - SHOWN_CHANGES} more changes"
    if "changed" in channels_of and not texts:
        yield line("changed")


def _performance(report: Any, age_s: float, max_age_s: float) -> list[str]:
    """Return the performance data: age, loss, counters, temperature, and N in the unit that people read."""
    session = report.session
    data = [f"age={_fixed(age_s)}s;;{max_age_s:g};0"]
    if session.recent_loss is not None:
        data.append(f"loss={_fixed(100.0 * session.recent_loss)}%;{_fixed(100.0 * report.max_loss)};;0;100")
    data += [f"samples={session.samples}c;;;0", f"missing={session.missing}c;;;0"]
    temperature = report.channels.get(TEMPERATURE)
    if temperature is not None and temperature.last is not None:
        data.append(f"temperature={_fixed(temperature.last)}")
    for name, channel in report.channels.items():
        n = channel.coefficients.get("N")
        if name.sensor in INERTIAL and n is not None and n.readable.value is not None:
            data.append(f"{name.sensor}_{name.axis}_N={_fixed(n.readable.value)};;;0")
    return data


def _fixed(value: float) -> str:
    """Return a number of four significant figures without exponent.

    >>> _fixed(0.0), _fixed(0.000123456), _fixed(20.123), _fixed(123456.7)
    ('0', '0.0001235', '20.12', '123500')
    """
    return f"{Decimal(f'{value:.4g}'):f}"
