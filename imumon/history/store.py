"""Store: the SQLite file of the history of one device.

A period of an hour or a day is one row of ``period``; each of its channels is one row of ``noise``. Nine
channels take 80 MB in a year. The file is in WAL mode: readers never wait for the writer, and a killed writer leaves
a whole file. A file that is damaged, foreign or of another version is renamed to a name with the reason, like a state
(`imumon.checkpoint`), and a new one begins.

One process writes: the daemon that holds the lock of the state. It opens the file for each write, so that a file that
was removed is made again. A period is identified by its record and its number in it, so one that is written again, as
after a crash, replaces itself.
"""

from __future__ import annotations

import itertools
import os
import re
import sqlite3
import stat
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from imumon.files import rename_aside
from imumon.history.schema import ESTIMATE_COLUMNS, SCHEMA, VERSION
from imumon.history.selection import Selection
from imumon.model.coefficients import SCALE, Estimate, GradeName, Status
from imumon.model.errors import ImumonError, why
from imumon.model.history_report import STEPS, HistoryPeriod, PeriodChannel
from imumon.model.report import Event
from imumon.model.samples import ChannelName

SUFFIX = ".history.sqlite"
EXTRAS = ("-wal", "-shm")
"""Endings of the files that SQLite keeps beside an open one."""
_STATUSES: tuple[Status, ...] = ("measured", "upper_bound", "pending", "indistinct")
"""Numbers of the statuses in a file, which hold for every file: a further one goes to the end."""


SAME_EVENT_S = 600.0
"""s within which events of one kind and channel are one row: a cable that flaps would fill the file."""


class HistoryError(ImumonError):
    """The history cannot be read or written."""


def damaged(path: Path) -> HistoryError:
    """Return the error of a file that is no history of imumon, or of which parts are lost."""
    message = f"history {path} is damaged, or not a history of imumon"
    return HistoryError("history_damaged", message, "the daemon sets it aside and begins a new one")


def set_aside(path: Path, reason: str) -> Path:
    """Rename a file and what belongs to it; return its new path, ``DEVICE.REASON-N.history.sqlite``."""
    aside = rename_aside(path, path.name.removesuffix(SUFFIX), reason, SUFFIX)
    for extra in EXTRAS:
        with suppress(OSError):
            os.rename(f"{path}{extra}", f"{aside}{extra}")
    return aside


def check_file(path: Path, write: bool) -> None:
    """Raise an error if there is no file to read, or something that is no regular file."""
    try:
        mode = os.lstat(path).st_mode
    except FileNotFoundError:
        if write:
            return
        message = f"there is no history {path}"
        raise HistoryError(
            "no_history", message, "start a daemon, or name its directory with --state"
        ) from None
    if not stat.S_ISREG(mode):
        raise damaged(path)


def devices(directory: Path) -> list[str]:
    """Return the names of the devices that have a history in a directory."""
    pattern = re.compile(r"([a-z0-9_-]{1,64})" + re.escape(SUFFIX))
    try:
        return sorted(match[1] for name in os.listdir(directory) if (match := pattern.fullmatch(name)))
    except OSError:
        return []


@dataclass(frozen=True, slots=True, kw_only=True)
class TimedPeriod:
    """A period with its time and record.

    Attributes
    ----------
    record : when the record began, as text.
    begin, end : s since 1970.
    """

    record: str
    begin: float
    end: float
    period: HistoryPeriod


@dataclass(frozen=True, slots=True, kw_only=True)
class PowerUp:
    """A power-up of the sensor.

    Attributes
    ----------
    time, seen : s since 1970, of the power-up, and when it was last seen.
    clock_s : s since the power-up at `seen`.
    means : channel unit, settled mean of each channel; empty: unknown.
    """

    time: float
    clock_s: float
    seen: float
    means: Mapping[str, float]


class HistoryStore:
    """Open history file.

    Parameters
    ----------
    path : of the file.
    write : create it; else it must exist.

    Raises
    ------
    HistoryError : ``history_unreadable``, ``history_damaged``, ``history_version`` or ``no_history``.
    OSError, sqlite3.Error : of the disk, only with `write`.
    """

    def __init__(self, path: Path, *, write: bool = False) -> None:
        self.path, self._write = path, write
        check_file(path, write)
        name = str(path.absolute()).replace("%", "%25").replace("?", "%3f").replace("#", "%23")
        reason = ""
        # the last mode is for a directory in which no file may be created beside it
        for mode in ("rwc",) if write else ("ro", "ro&immutable=1"):
            try:
                self._connection = sqlite3.connect(
                    f"file:{name}?mode={mode}", uri=True, timeout=5.0, check_same_thread=False
                )
                self._open(write)
                return
            except sqlite3.OperationalError as error:
                self.close()
                if write:
                    raise
                reason = str(error)
            except sqlite3.DatabaseError:
                self.close()
                raise damaged(path) from None
            except HistoryError:
                self.close()
                raise
        message = f"history {path} cannot be read ({reason})"
        raise HistoryError("history_unreadable", message, "ask the daemon instead, with --connect")

    def _open(self, write: bool) -> None:
        connection = self._connection
        version = connection.execute("PRAGMA user_version").fetchone()[0]
        empty = not version and connection.execute("SELECT 1 FROM sqlite_schema").fetchone() is None
        if empty and not write:  # of 0 bytes, or the daemon creates its tables at this moment
            message = f"history {self.path} holds nothing yet"
            raise HistoryError("no_history", message, "try again when a daemon has run for an hour")
        if version == 0 and not empty:
            raise damaged(self.path)
        if version not in (0, VERSION):
            message = f"history {self.path} is of another version of imumon (schema {version})"
            raise HistoryError(
                "history_version", message, f"use the version that made it; this reads {VERSION}"
            )
        if not write:
            return
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = NORMAL")
        connection.execute("PRAGMA journal_size_limit = 4194304")
        if empty:
            connection.executescript(f"BEGIN; {SCHEMA} PRAGMA user_version = {VERSION}; COMMIT;")
        for name in sorted(set(itertools.chain(*ESTIMATE_COLUMNS.values())) - set(self._columns("noise"))):
            connection.execute(f"ALTER TABLE noise ADD COLUMN {name}")

    def check(self) -> None:
        """Raise an error if the structure of the file is damaged; it is read as a whole, 0.1 s for each 10 MB."""
        if self._connection.execute("PRAGMA quick_check(1)").fetchone()[0] != "ok":
            raise damaged(self.path)

    def _columns(self, table: str) -> list[str]:
        return [name for _, name, *_ in self._connection.execute(f"PRAGMA table_info({table})")]

    def close(self) -> None:
        with suppress(sqlite3.Error, AttributeError):  # without a connection: it could not be opened
            self._connection.close()

    def __enter__(self) -> HistoryStore:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """Distinguish damage from errors that pass, such as a lock: only a damaged file is set aside."""
        try:
            yield
        except sqlite3.DatabaseError as error:
            # a table that is gone is an error of the statement; a text that is none has no code
            passes = _code(error) not in (None, sqlite3.SQLITE_ERROR)
            if isinstance(error, sqlite3.OperationalError) and passes:
                if self._write:
                    raise
                message = f"history {self.path} cannot be read ({why(error)})"
                raise HistoryError("history_unreadable", message, "try again, or ask the daemon") from None
            raise damaged(self.path) from None
        except (LookupError, TypeError, ValueError, OverflowError):  # a number that no row can have
            raise damaged(self.path) from None

    # ------------------------------------------------------------------ writing

    def add(self, periods: Sequence[TimedPeriod]) -> None:
        """Write periods in one transaction; one that was written before is replaced."""
        with self._connection as cursor:
            for timed in periods:
                self._add(cursor, timed)

    def _add(self, cursor: sqlite3.Connection, timed: TimedPeriod) -> None:
        period = timed.period
        cursor.execute(  # what was in progress in an earlier record has ended
            "UPDATE period SET complete = 1 WHERE complete = 0 AND step = ? AND NOT (record = ? AND number = ?)",
            (period.step_s, timed.record, period.number),
        )
        (row,) = cursor.execute(
            """INSERT INTO period (step, record, number, begin, end, complete, samples, missing, excluded_s,
                                   temperature, warming_up)
               VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)
               ON CONFLICT (step, record, number) DO UPDATE SET
                   begin = excluded.begin, end = excluded.end, complete = excluded.complete,
                   samples = excluded.samples, missing = excluded.missing, excluded_s = excluded.excluded_s,
                   temperature = excluded.temperature, warming_up = excluded.warming_up
               RETURNING id""",
            (
                *(period.step_s, timed.record, period.number, timed.begin, timed.end, period.complete),
                *(period.samples, period.missing, period.excluded_s, period.temperature, period.warming_up),
            ),
        ).fetchone()
        for name, channel in period.channels.items():
            values = {
                "period": row,
                "channel": self._channel(cursor, name),
                "mean": channel.mean,
                "std": channel.std,
                "grade": _grade_number(period, name),
            }
            for letter, estimate in channel.coefficients.items():
                status = _STATUSES.index(estimate.status)
                row_part = (estimate.value, estimate.low, estimate.high, status)
                values |= dict(zip(ESTIMATE_COLUMNS[letter], row_part, strict=True))
            marks = ", ".join("?" * len(values))
            cursor.execute(
                f"INSERT OR REPLACE INTO noise ({', '.join(values)}) VALUES ({marks})", tuple(values.values())
            )

    def _channel(self, cursor: sqlite3.Connection, name: str) -> int:
        cursor.execute("INSERT OR IGNORE INTO channel (name) VALUES (?)", (name,))
        return int(cursor.execute("SELECT id FROM channel WHERE name = ?", (name,)).fetchone()[0])

    def add_events(self, events: Sequence[tuple[float, Event]]) -> None:
        """Write events with their times, s since 1970; those of one kind and channel within 10 minutes are one row."""
        with self._connection as cursor:
            for time, event in events:
                known = cursor.execute(
                    "SELECT id, time, text, count FROM event WHERE kind = ? AND channel IS ? AND time > ? AND time <= ?"
                    " ORDER BY time DESC",
                    (event.kind, event.channel, time - SAME_EVENT_S, time),
                ).fetchone()
                number, first, text, count = known or (None, time, event.text, 0)
                cursor.execute(
                    "INSERT OR REPLACE INTO event (id, time, kind, channel, text, count) VALUES (?, ?, ?, ?, ?, ?)",
                    (number, first, event.kind, event.channel, text, count + 1),
                )

    def set_power_up(self, power_up: PowerUp) -> None:
        """Write a power-up; the newest one is replaced if it is the same."""
        with self._connection as cursor:
            newest = cursor.execute("SELECT id, time FROM power_up ORDER BY id DESC LIMIT 1").fetchone()
            settled = bool(power_up.means)
            row = newest[0] if newest and newest[1] == power_up.time else None
            row = cursor.execute(
                "INSERT OR REPLACE INTO power_up (id, time, clock_s, seen, settled) VALUES (?, ?, ?, ?, ?)",
                (row, power_up.time, power_up.clock_s, power_up.seen, settled),
            ).lastrowid
            for name, mean in power_up.means.items():
                cursor.execute(
                    "INSERT OR REPLACE INTO turn_on (power_up, channel, mean) VALUES (?, ?, ?)",
                    (row, self._channel(cursor, name), mean),
                )

    def delete_before(self, time: float) -> None:
        """Delete periods and events that ended before a time, s since 1970; their space is used again."""
        with self._connection as cursor:
            cursor.execute("DELETE FROM noise WHERE period IN (SELECT id FROM period WHERE end < ?)", (time,))
            cursor.execute("DELETE FROM period WHERE end < ?", (time,))
            cursor.execute("DELETE FROM event WHERE time < ?", (time,))

    # ------------------------------------------------------------------ reading

    def periods(self, selected: Selection) -> Iterator[TimedPeriod]:
        """Yield the periods of a selection, oldest first, with the selected channels."""
        with self._reading():
            known_channels = self._connection.execute("SELECT id, name FROM channel")
            names = {number: ChannelName(name) for number, name in known_channels}
            wanted = [number for number, name in names.items() if selected.wants(name)]
            marks = ", ".join("?" * len(wanted))
            known = set(self._columns("noise"))
            letters = [letter for letter, names in ESTIMATE_COLUMNS.items() if known.issuperset(names)]
            estimates = [name for letter in letters for name in ESTIMATE_COLUMNS[letter]]
            columns = ["channel", "mean", "std", "grade", *estimates]
            begin_from = selected.since - 30 * 86400.0  # a period may last through a long gap
            with closing(
                self._connection.execute(
                    f"""SELECT p.id, p.step, p.record, p.number, p.begin, p.end, p.complete, p.samples, p.missing,
                               p.excluded_s, p.temperature, p.warming_up,
                               {", ".join(f"n.{name}" for name in columns)}
                        FROM period p JOIN noise n ON n.period = p.id
                        WHERE p.step = ? AND p.begin <= ? AND p.begin > ? AND p.end >= ? AND n.channel IN ({marks})
                        ORDER BY p.begin, p.id, n.channel""",
                    (STEPS[selected.step], selected.until, begin_from, selected.since, *wanted),
                )
            ) as cursor:
                for (_, *period), group in itertools.groupby(cursor, key=lambda row: row[:12]):
                    channels = [dict(zip(columns, row[12:], strict=True)) for row in group]
                    yield _timed_period(period, channels, names, letters)

    def events(self, since: float, until: float) -> list[dict[str, Any]]:
        """Return events, oldest first: time (s since 1970), kind, channel, text and count."""
        with self._reading():
            names = ("time", "kind", "channel", "text", "count")
            rows = self._connection.execute(
                f"SELECT {', '.join(names)} FROM event WHERE time BETWEEN ? AND ? ORDER BY time",
                (since, until),
            )
            return [dict(zip(names, row, strict=True)) for row in rows]

    def power_ups(self) -> list[PowerUp]:
        """Return the power-ups, oldest first."""
        with self._reading():
            means: dict[int, dict[str, float]] = {}
            rows = self._connection.execute(
                "SELECT t.power_up, c.name, t.mean FROM turn_on t JOIN channel c ON c.id = t.channel"
            )
            for number, name, mean in rows:
                means.setdefault(number, {})[name] = mean
            return [
                PowerUp(time=time, clock_s=clock_s, seen=seen, means=means.get(number, {}))
                for number, time, clock_s, seen in self._connection.execute(
                    "SELECT id, time, clock_s, seen FROM power_up ORDER BY id"
                )
            ]


def _code(error: sqlite3.Error) -> int | None:
    """Return the code of an error of SQLite, without its details; None: it has none."""
    code: int | None = getattr(error, "sqlite_errorcode", None)
    return None if code is None else code & 0xFF


def _grade_number(period: HistoryPeriod, channel: ChannelName) -> int | None:
    grade = period.grades.get(channel.sensor)
    return None if grade is None else SCALE.index(grade)


def _check_numbers(*values: object) -> None:
    """Raise ValueError unless all values are numbers or unknown: SQLite takes anything in each."""
    if not all(value is None or isinstance(value, int | float) for value in values):
        raise ValueError("a number is none")


def _timed_period(
    values: Sequence[Any],
    rows: Sequence[Mapping[str, Any]],
    names: Mapping[int, ChannelName],
    letters: Sequence[str],
) -> TimedPeriod:
    step, record, number, begin, end, complete, samples, missing, excluded_s, temperature, warming = values
    _check_numbers(step, *values[2:])
    channels: dict[ChannelName, PeriodChannel] = {}
    grades: dict[str, GradeName] = {}
    for row in rows:
        _check_numbers(*row.values())
        name = names[row["channel"]]
        known = {}
        for letter in letters:
            value, low, high, status = (row[column] for column in ESTIMATE_COLUMNS[letter])
            if status is not None:
                known[letter] = Estimate(value=value, low=low, high=high, status=_STATUSES[status])
        channels[name] = PeriodChannel(coefficients=known, mean=row["mean"], std=row["std"])
        if row["grade"] is not None:
            grades[name.sensor] = SCALE[row["grade"]]
    period = HistoryPeriod(
        step_s=step,
        number=number,
        begin_age_s=0.0,
        end_age_s=0.0,
        complete=bool(complete),
        samples=samples,
        missing=missing,
        excluded_s=excluded_s,
        temperature=temperature,
        warming_up=bool(warming),
        grades=grades,
        channels=channels,
    )
    return TimedPeriod(record=record, begin=begin, end=end, period=period)
