"""Commands that look at a running daemon: tui, status, wait."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from typing import Any

from imumon.cli.options import (
    DONE,
    NOT_IN_TIME,
    NOTHING_THERE,
    USAGE,
    CommandError,
    Parser,
    add_endpoints,
    add_look,
    baseline,
    first_report,
    print_report,
    seconds,
    settings,
    share,
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


def add_wait(parser: Parser) -> None:
    add = parser.add_argument
    add_endpoints(parser)
    add("--config", metavar="FILE", help="settings of the bus; flags win over the file")
    add("--id", metavar="NAME", help="device; default: the first that answers")
    add(
        "--grade",
        choices=("navigation", "tactical", "industrial", "consumer"),
        help="until gyroscope and accelerometer are this or better for certain; default: the settings'",
    )
    add("--coefficient", choices=("N", "B", "K"), help="until this is known to the precision on every axis")
    add(
        "--precision",
        type=share,
        metavar="P",
        help="half of the 95 %% interval as a share of the value, 0.05 or 5%%; default: the settings'",
    )
    add(
        "--channel",
        action="append",
        metavar="NAME",
        help="count this one alone, gyro or gyro/x, repeatable; default gyro and accel",
    )
    add(
        "--timeout",
        type=seconds,
        metavar="T",
        help="give up after so long (90, 90s, 10m, 2h); also how long to wait for a daemon, else 2 s",
    )


GONE_S = 5.0
"""After so long without a word a daemon that has left is not waited for any more."""


def show(
    words: argparse.Namespace, starting: str | None = None, ended: Callable[[], str | None] | None = None
) -> int:
    """The live screen; of a daemon that is just `starting`, and what its end was when it has `ended`."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        raise CommandError("the screen needs a terminal; without one use: imumon status --json", USAGE)
    from imumon.tui import run

    behind = baseline(words.baseline)
    with viewer(words) as feed:
        tried = ", ".join(feed.endpoints) if len(feed.endpoints) < 3 else None
        return run(
            feed,
            id=words.id,
            ascii=words.ascii,
            theme=words.theme,
            baseline=behind,
            endpoint=tried,
            starting=starting,
            ended=ended,
        )


def _cure(words: argparse.Namespace) -> str:
    """What to do where no daemon answers, beside starting one."""
    if not words.connect:
        return "name it with --connect"
    return f"see whether it listens there, on {', '.join(words.connect)}"


def status(words: argparse.Namespace) -> int:
    """One report of a running daemon."""
    with viewer(words) as feed:
        made = first_report(feed, words.id, 2.0, _cure(words))
    print_report(made, words.json)
    return DONE


def wait(words: argparse.Namespace) -> int:
    """Until a report holds what is asked, or the settings ask for; else until the first sample."""
    from imumon.cli.wait_condition import WaitCondition
    from imumon.units import duration

    if words.precision is not None and words.coefficient is None:
        raise CommandError("--precision needs --coefficient N, B or K", USAGE)
    told = settings(words).report
    by_default = {"N": told.precision_n, "B": told.precision_b, "K": told.precision_k}
    goal = WaitCondition(
        grade=words.grade or (None if words.coefficient else told.grade or None),
        coefficient=words.coefficient,
        precision=words.precision or by_default.get(words.coefficient),
        channels=tuple(words.channel or ()),
    )
    start = time.monotonic()
    end = start + words.timeout if words.timeout else float("inf")
    with viewer(words) as feed:
        made = first_report(feed, words.id, words.timeout or 2.0, _cure(words))
        said = ""
        while lacks := goal.lacks(made):
            if goal.unknown(made):
                _mention("")
                raise CommandError(f"--channel: {lacks}", USAGE)
            if lacks != said:
                said = lacks
                _mention(lacks)
            if time.monotonic() >= end:
                _mention("")
                raise CommandError(f"not reached in {duration(words.timeout)}: {lacks}", NOT_IN_TIME)
            made = _next(feed, made, end)
    _mention("")
    print(f"{made.device.id}: {goal.reached(made)} after {duration(made.session.elapsed_s)}")
    return DONE


def _next(feed: Any, made: Any, end: float) -> Any:
    """The next report of the same device; the same one again at the end of the time."""
    while (left := end - time.monotonic()) > 0:
        newest, moment = feed.reports()[made.device.id]
        if newest is not made:
            return newest
        gone = time.monotonic() - moment > max(GONE_S, 3.0 * made.period_s)
        if gone and made.device.id not in feed.alive():
            _mention("")
            raise CommandError(f"the daemon of {made.device.id} has ended; start it again", NOTHING_THERE)
        time.sleep(min(left, 0.1))
    return made


def _mention(text: str) -> None:
    """What is still missing, on a line of the terminal that is written over; nothing elsewhere."""
    if sys.stderr.isatty():
        print(f"\r\x1b[K{text[:120]}", end="", file=sys.stderr, flush=True)
