"""Command `imumon history`: rows of the history, from a running daemon or from the file."""

from __future__ import annotations

import argparse
import json
import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

from imumon.cli import options
from imumon.cli.exit_codes import NOT_FOUND, USAGE, CommandError
from imumon.cli.options import Parser
from imumon.history.rows import csv_pieces, iso, json_pieces, rows
from imumon.history.selection import EVENTS, moment, of_parameters, selection
from imumon.history.store import SUFFIX, HistoryError, HistoryStore, devices
from imumon.model.coefficients import BIAS_SLOPE, COEFFICIENTS, NOISE, Estimate, mean_unit, unit_of
from imumon.model.errors import ImumonError
from imumon.model.history_report import STEPS, HistoryRow, history_rows, objects
from imumon.model.messages import matching
from imumon.model.samples import UNITS, ChannelName
from imumon.model.units import duration, in_columns, measured, number, plus_minus, pretty

WIDTH = 80
"""Cells of a line for people."""
_INDENT = " " * 17
MOST_EVENTS = 50
"""Events below the table: the newest, two screens; Zenoh has all."""


def add_history(parser: Parser) -> None:
    add = parser.add_argument
    options.add_id(parser, "device; default: the only one")
    add("--state", metavar="DIR", help="read the file in this directory, and ask no daemon")
    text = "rows from T on: 2h, 30d, 2026-11-03 or 2026-11-03T10:20:00Z (UTC); default: 1d before the end"
    add("--since", metavar="T", help=text)
    text = "only this channel or sensor (gyro/x or gyro), repeatable"
    add("--channel", action="append", metavar="NAME", help=text)
    text = "length of a row; default: 1h up to 2 months, else 1d"
    add("--step", choices=tuple(STEPS), help=text)
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="print an array of objects, SI units")
    form.add_argument("--csv", action="store_true", help="print one row per line, SI units")


def history(arguments: argparse.Namespace) -> int:
    """Print rows of the history."""

    now = time.time()
    chosen = selection(
        now,
        since=None if arguments.since is None else moment(arguments.since, now),
        channels=tuple(arguments.channel or ()),
        step=arguments.step,
    )
    rows, events = _objects(arguments, chosen)
    if arguments.json:
        pieces: Iterable[str] = (*json_pieces(rows), "\n")
    elif arguments.csv:
        pieces = csv_pieces(rows)
    else:
        pieces = chain(_table(rows, chosen.channels), _event_lines(events, chosen))
    for piece in pieces:
        sys.stdout.write(piece)
    return 0


def _objects(arguments: argparse.Namespace, chosen: Any) -> tuple[Iterator[Any], list[Any]]:
    """Return rows and events: of the daemon if one answers and no directory is given, else of the file."""
    if arguments.state is None:
        answer = _asked(arguments, chosen)
        if answer is not None:
            return answer
    loaded = options.settings(arguments)
    directory = Path(arguments.state) if arguments.state else options.state_directory(loaded)
    return _read(directory, arguments.id, chosen)


def _asked(arguments: argparse.Namespace, chosen: Any) -> tuple[Iterator[Any], list[Any]] | None:
    """Return rows and events of a running daemon; None if there is none and no endpoint was given."""

    with options.subscriber(arguments) as subscriber:
        cure = "read its file with --state"
        try:
            report = options.first_report(subscriber, arguments.id, options.ANSWER_S, cure, arguments)
        except CommandError as error:
            if arguments.connect or error.code != "no_daemon":
                raise
            return None
        channels = f"channel={','.join(chosen.channels)};" if chosen.channels else ""
        parameters = f"{channels}step={chosen.step};_time=[{iso(chosen.since)}..{iso(chosen.until)}]"
        answer = subscriber.history(report.device.id, parameters)
        if answer is None:
            message = f"the daemon of {report.device.id} keeps no history"
            raise CommandError("no_history", message, "set history.enabled = true", NOT_FOUND)
        events = subscriber.history(report.device.id, parameters, EVENTS)
        return iter(json.loads(answer)), json.loads(events or b"[]")


def _read(directory: Path, id: str | None, chosen: Any) -> tuple[Iterator[Any], list[Any]]:
    """Return rows and events of a file."""

    known = devices(directory)
    meant = matching(id, known)
    if len(meant) > 1:
        message = f"there are histories of {', '.join(meant)}"
        raise CommandError("several_histories", message, "choose one with --id", USAGE)
    if id is None and not known:
        message = f"no daemon answers, and there is no history in {directory}"
        cure = "start one with imumon run, or name the directory with --state"
        raise CommandError("no_history", message, cure, NOT_FOUND)
    if id is not None and known and not meant:
        message = f"there is no history of {id} in {directory}"
        raise CommandError(
            "no_history", message, f"give one of these with --id: {', '.join(known)}", NOT_FOUND
        )
    file = directory / f"{meant[0] if meant else id}{SUFFIX}"
    with HistoryStore(file) as store:
        events = store.events(chosen.since, chosen.until)
    return _file_rows(file, chosen), [{**event, "time": iso(event["time"])} for event in events]


def _file_rows(file: Path, chosen: Any) -> Iterator[dict[str, Any]]:
    """Yield the rows of a file."""

    with HistoryStore(file) as store:
        for timed in store.periods(chosen):
            yield from rows(timed, file.name.removesuffix(SUFFIX), chosen)


LIMIT_DAYS = "_time=[now(-366d)..now()];step=1d;channel=gyro,accel,mag"
"""Rows of the history that widen the limits of a document: days of a year."""


def published_days(subscriber: Any, id: str) -> list[HistoryRow]:
    """Return the days of a running daemon that widen the limits of a document; empty without a history."""
    return _days(lambda: objects(subscriber.history(id, LIMIT_DAYS) or b"[]"))


def stored_days(path: Path) -> list[HistoryRow]:
    """Return the days of the history in the directory of a saved state, which widen the limits of a document."""
    if (file := _beside(path)) is None:
        return []

    return _days(lambda: _file_rows(file, of_parameters(LIMIT_DAYS, time.time())))


def _days(answer: Callable[[], Iterable[Any]]) -> list[HistoryRow]:
    """Return the rows of an answer; empty after an error."""
    try:
        return [*history_rows(answer())]
    except ImumonError:
        return []


def with_turn_on(report: Any, path: Path) -> Any:
    """Return the report of a saved state with the turn-on bias that the history in its directory shows."""
    if (file := _beside(path)) is None:
        return report
    from imumon.history.power_ups import PowerUps

    try:
        with HistoryStore(file) as store:
            return PowerUps(store.power_ups()).annotated(report)
    except HistoryError:
        return report


def _beside(path: Path) -> Path | None:
    """Return the history beside a saved state; None if there is none, or it is no state."""
    name, state, _ = path.name.partition(".state")
    if not state:
        return None

    file = path.with_name(f"{name}{SUFFIX}")
    return file if file.exists() else None


def _table(objects: Iterable[dict[str, Any]], channels: Sequence[str]) -> Iterator[str]:
    """Yield lines for people: the periods of each channel in readable units, limits as half-widths."""

    parts: dict[ChannelName, list[HistoryRow]] = {}
    for row in history_rows(objects):
        parts.setdefault(row.channel, []).append(row)
    for channel, periods in parts.items():
        _, unit = mean_unit(channel.sensor, UNITS.get(channel.sensor, ""))
        units = [COEFFICIENTS[letter].units.get(channel.sensor) for letter in NOISE]
        heads = [
            f"{letter} {pretty(unit.unit)}" if unit else "" for letter, unit in zip(NOISE, units, strict=True)
        ]
        title = (f"{channel}, step {periods[0].step}", f"mean {pretty(unit)}", *heads, "°C")
        lines = in_columns([title, *map(_cells, periods)])
        for line, notes in zip(lines, ["", *map(_notes, periods)], strict=True):
            below = textwrap.wrap(notes, WIDTH, initial_indent=_INDENT, subsequent_indent=_INDENT)
            yield "\n".join([line, *below, ""])
    if not parts:
        of = f" of {', '.join(channels)}" if channels else ""
        yield f"no rows{of} in this time\n"


def _cells(row: HistoryRow) -> tuple[str, ...]:
    """Return the cells of a period of a channel."""
    sensor = row.channel.sensor
    factor, _ = mean_unit(sensor, "")
    noise = (_readable(sensor, letter, row.coefficients.get(letter), named=False) for letter in NOISE)
    mean = "–" if row.mean is None else number(factor * row.mean, 5)
    heat = "–" if row.temperature is None else f"{row.temperature:.1f}"
    return f"{row.begin:%Y-%m-%d %H:%M}", mean, *noise, heat


def _notes(row: HistoryRow) -> str:
    """Return what else is known of a period of a channel."""
    sensor, known = row.channel.sensor, row.coefficients
    notes = ["in progress"] * (not row.complete)
    others = [letter for letter in COEFFICIENTS if letter not in NOISE and letter in known]
    notes += [f"{letter} {_readable(sensor, letter, known[letter])}" for letter in others]
    notes += _slope(sensor, known.get(BIAS_SLOPE))
    notes += [f"{row.missing:,} missing"] * bool(row.missing)
    notes += [f"{duration(row.excluded_s)} excluded"] * (row.excluded_s >= 1.0)
    return ", ".join(notes)


def _event_lines(events: Sequence[dict[str, Any]], chosen: Any) -> Iterator[str]:
    """Yield the events of the span and of the channels, oldest first."""
    shown = [event for event in events if not event["channel"] or chosen.wants(ChannelName(event["channel"]))]
    if shown:
        yield f"\nthe newest of {len(shown)} events\n" if len(shown) > MOST_EVENTS else "\nevents\n"
    for event in shown[-MOST_EVENTS:]:
        times = f" ({event['count']} times)" if event["count"] > 1 else ""
        text = f"{event['time'][:16].replace('T', ' ')} {event['kind']}: {event['text']}{times}"
        yield f"{textwrap.fill(text, WIDTH, subsequent_indent=_INDENT)}\n"


def _slope(sensor: str, part: Estimate | None) -> list[str]:
    """Return the slope of the bias against the temperature in the readable unit, if it is known."""

    unit = unit_of(sensor, "B")
    slope = Estimate() if part is None else part.scaled(unit.factor)
    if slope.value is None:
        return []
    return [f"slope {plus_minus(slope.value, slope.low, slope.high, 3)} {pretty(unit.unit)}/°C"]


def _readable(sensor: str, letter: str, part: Estimate | None, *, named: bool = True) -> str:
    """Return a coefficient in the readable unit, with its half-width or the factor of its limits."""

    unit = COEFFICIENTS[letter].units.get(sensor)
    if part is None or unit is None:
        return "–"
    name = f" {pretty(unit.unit)}" if named else ""
    return part.scaled(unit.factor).text(
        lambda *limits: f"{measured(*limits)}{name}", lambda high: f"< {number(high, 3)}{name}", "pending"
    )
