"""Store: the SQLite file of the history of one device.

A period of an hour or a day is one row of ``period``; each of its channels is one row of ``noise``. Nine
channels take 80 MB in a year. The file is in WAL mode: readers never wait for the writer, and a killed writer leaves
a whole file. A file that is damaged, foreign or of another version is renamed to a name with the reason, like a state
(`imumon.checkpoint`), and a new one begins.

SQLite notices damage to its own structure only: a changed digit would be another number. Each row therefore has a
checksum of what it holds (`checksum`). A row with a wrong one is left out and counted, and the others are read: one bad
sector must not take a year. Rows of a file that is older than the checksums have none.

What is written to a file that was removed, or renamed, is lost when the writer ends: `HistoryStore.place` says whether
the open file still has its name, and `HistoryStore.copy_back` gives the name a file with all rows of the open one.

One process writes: the daemon that holds the lock of the state. A period is identified by its record and its number
in it, so one that is written again, as after a crash, replaces itself.
"""

from __future__ import annotations

import itertools
import os
import re
import sqlite3
import stat
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

from imumon.files import rename_aside
from imumon.history.schema import CHECKED, ESTIMATE_COLUMNS, SCHEMA, VERSION
from imumon.history.selection import Selection
from imumon.model.coefficients import GRADES, Estimate, GradeName, Status
from imumon.model.errors import ImumonError, why
from imumon.model.history_report import STEPS, HistoryPeriod, PeriodChannel
from imumon.model.report import Event

SUFFIX = ".history.sqlite"
EXTRAS = ("-wal", "-shm")
"""Endings of the files that SQLite keeps beside an open one."""
Place: TypeAlias = Literal["own", "removed", "taken"]
"""What has the name of an open file: the file itself, nothing (or one of its files is gone), or another file."""
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


def is_empty(path: Path) -> bool:
    """Return whether there is a file of 0 bytes, which no history has: somebody, or a full disk, has emptied it."""
    try:
        return os.lstat(path).st_size == 0
    except OSError:
        return False


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


def checksum(*values: object) -> int:
    """Return the checksum of a row; a number counts as it is read again, whatever its type.

    >>> checksum(1, "a", None) == checksum(1.0, "a", None), checksum(1) == checksum(2)
    (True, False)
    """
    # SQLite stores no negative zero
    plain = [float(value) + 0.0 if isinstance(value, int | float) else value for value in values]
    return zlib.crc32(repr(plain).encode("utf-8", "surrogateescape"))


class HistoryStore:
    """Open history file.

    Parameters
    ----------
    path : of the file.
    write : create it; else it must exist.

    Attributes
    ----------
    damaged_rows : that were left out so far: their checksum is wrong.

    Raises
    ------
    HistoryError : ``history_unreadable``, ``history_damaged``, ``history_version`` or ``no_history``.
    OSError, sqlite3.Error : of the disk, only with `write`.
    """

    def __init__(self, path: Path, *, write: bool = False) -> None:
        self.path, self._write, self.damaged_rows = path, write, 0
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
        if version == 0 and not write and is_empty(self.path):
            message = f"history {self.path} is empty (0 bytes)"
            raise HistoryError("history_damaged", message, "the daemon writes a new one in its place")
        if version != VERSION and (version or not write):
            message = f"history {self.path} is of another version of imumon (schema {version})"
            raise HistoryError(
                "history_version", message, f"use the version that made it; this reads {VERSION}"
            )
        if not write:
            return
        if version == 0 and connection.execute("SELECT 1 FROM sqlite_schema").fetchone():
            raise damaged(self.path)
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = NORMAL")
        connection.execute("PRAGMA journal_size_limit = 4194304")
        if version == 0:
            connection.executescript(f"BEGIN; {SCHEMA} PRAGMA user_version = {VERSION}; COMMIT;")
        for name in sorted(set(itertools.chain(*ESTIMATE_COLUMNS.values())) - set(self._columns("noise"))):
            connection.execute(f"ALTER TABLE noise ADD COLUMN {name}")
        for table in CHECKED:
            if "checksum" not in self._columns(table):
                connection.execute(f"ALTER TABLE {table} ADD COLUMN checksum INTEGER")
        if connection.execute("PRAGMA quick_check(1)").fetchone()[0] != "ok":
            raise damaged(self.path)
        self._files = self._identities()

    def _identities(self) -> dict[str, tuple[int, int]]:
        """Return device and inode of the files that have the names of the open ones, by ending."""
        found = {}
        for extra in ("", *EXTRAS):
            with suppress(OSError):
                status = os.lstat(f"{self.path}{extra}")
                found[extra] = status.st_dev, status.st_ino
        return found

    @property
    def place(self) -> Place:
        """Whether the open files still have their names."""
        now = self._identities()
        if any(now.get(extra) != known for extra, known in self._files.items()):
            return "taken" if now.get("", self._files[""]) != self._files[""] else "removed"
        return "own"

    def forsake(self) -> None:
        """Remove the log of the open file, whose name another file has taken: it would be read as a log of that one."""
        for extra, known in self._identities().items():
            if extra and known == self._files.get(extra):
                Path(f"{self.path}{extra}").unlink(missing_ok=True)

    def copy_back(self) -> None:
        """Give the name of the history to a copy of the open file, which has lost it.

        Raises
        ------
        OSError, sqlite3.Error : the copy cannot be written; the open file is as before, and so is what has its name.
        """
        new = self.path.with_name(f"{self.path.name}.new")
        new.unlink(missing_ok=True)
        try:
            with closing(sqlite3.connect(new)) as copy:
                self._connection.backup(copy)
        except BaseException:
            new.unlink(missing_ok=True)
            raise
        for extra in EXTRAS:  # a log of the open file would be read as one of the copy
            Path(f"{self.path}{extra}").unlink(missing_ok=True)
        os.replace(new, self.path)

    @property
    def damage(self) -> str | None:
        """What to say of the rows that were left out; None: there are none."""
        if not self.damaged_rows:
            return None
        rows = "1 row is" if self.damaged_rows == 1 else f"{self.damaged_rows:,} rows are"
        return f"history {self.path}: {rows} damaged and left out"

    def _columns(self, table: str) -> list[str]:
        return [name for _, name, *_ in self._connection.execute(f"PRAGMA table_info({table})")]

    def _checksum_column(self, table: str, prefix: str = "") -> str:
        return f"{prefix}checksum" if "checksum" in self._columns(table) else "NULL"

    def _whole(self, known: int | None, *values: object) -> bool:
        """Return whether a row has the checksum of these values, or none; count it if it is damaged."""
        whole = known is None or known == checksum(*values)
        self.damaged_rows += not whole
        return whole

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
        ends = period.step_s, timed.record, period.number, timed.begin, timed.end
        contents = period.samples, period.missing, period.excluded_s, period.temperature, period.warming_up
        (row,) = cursor.execute(
            """INSERT INTO period (step, record, number, begin, end, complete, samples, missing, excluded_s,
                                   temperature, warming_up, checksum)
               VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)
               ON CONFLICT (step, record, number) DO UPDATE SET
                   begin = excluded.begin, end = excluded.end, complete = excluded.complete,
                   samples = excluded.samples, missing = excluded.missing, excluded_s = excluded.excluded_s,
                   temperature = excluded.temperature, warming_up = excluded.warming_up,
                   checksum = excluded.checksum
               RETURNING id""",
            (*ends, period.complete, *contents, checksum(*ends, *contents)),
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
            values["checksum"] = checksum(*_noise_values(row, name, values))
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
                row = first, event.kind, event.channel, text, count + 1
                cursor.execute(
                    "INSERT OR REPLACE INTO event (id, time, kind, channel, text, count, checksum)"
                    " VALUES (?, ?, ?, ?, ?, ?, ?)",
                    (number, *row, checksum(*row)),
                )

    def set_power_up(self, power_up: PowerUp) -> None:
        """Write a power-up; the newest one is replaced if it is the same."""
        with self._connection as cursor:
            newest = cursor.execute("SELECT id, time FROM power_up ORDER BY id DESC LIMIT 1").fetchone()
            settled = bool(power_up.means)
            row = newest[0] if newest and newest[1] == power_up.time else None
            times = power_up.time, power_up.clock_s, power_up.seen
            row = cursor.execute(
                "INSERT OR REPLACE INTO power_up (id, time, clock_s, seen, settled, checksum)"
                " VALUES (?, ?, ?, ?, ?, ?)",
                (row, *times, settled, checksum(*times)),
            ).lastrowid
            for name, mean in power_up.means.items():
                channel = self._channel(cursor, name)
                cursor.execute(
                    "INSERT OR REPLACE INTO turn_on (power_up, channel, mean, checksum) VALUES (?, ?, ?, ?)",
                    (row, channel, mean, checksum(row, name, mean)),
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
            names = dict(self._connection.execute("SELECT id, name FROM channel"))
            wanted = [number for number, name in names.items() if selected.wants(name)]
            marks = ", ".join("?" * len(wanted))
            columns = self._columns("noise")
            estimates = {
                letter: names for letter, names in ESTIMATE_COLUMNS.items() if set(columns).issuperset(names)
            }
            checked = self._checksum_column("period", "p.")
            with closing(
                self._connection.execute(
                    f"""SELECT p.id, p.step, p.record, p.number, p.begin, p.end, p.complete, p.samples, p.missing,
                               p.excluded_s, p.temperature, p.warming_up, {checked},
                               {", ".join(f"n.{name}" for name in columns)}
                        FROM period p JOIN noise n ON n.period = p.id
                        WHERE p.step = ? AND p.begin <= ? AND p.begin > ? AND p.end >= ? AND n.channel IN ({marks})
                        ORDER BY p.begin, p.id, n.channel""",
                    (
                        *(STEPS[selected.step], selected.until),
                        *(
                            selected.since - 30 * 86400.0,
                            selected.since,
                        ),  # a period may last through a long gap
                        *wanted,
                    ),
                )
            ) as cursor:
                for (number, *period, known), group in itertools.groupby(cursor, key=lambda row: row[:13]):
                    channels = [dict(zip(columns, row[13:], strict=True)) for row in group]
                    whole = [
                        channel
                        for channel in channels
                        if self._whole(
                            channel.get("checksum"),
                            *_noise_values(number, names[channel["channel"]], channel),
                        )
                    ]
                    step, record, place, begin, end, _, *contents = period
                    if self._whole(known, step, record, place, begin, end, *contents) and whole:
                        yield _timed_period(period, whole, names, tuple(estimates))

    def events(self, since: float, until: float) -> list[dict[str, Any]]:
        """Return events, oldest first: time (s since 1970), kind, channel, text and count."""
        with self._reading():
            checked = self._checksum_column("event")
            rows = self._connection.execute(
                f"SELECT time, kind, channel, text, count, {checked} FROM event"
                " WHERE time BETWEEN ? AND ? ORDER BY time",
                (since, until),
            )
            return [
                dict(zip(("time", "kind", "channel", "text", "count"), row, strict=True))
                for *row, known in rows
                if self._whole(known, *row)
            ]

    def power_ups(self) -> list[PowerUp]:
        """Return the power-ups, oldest first."""
        with self._reading():
            means: dict[int, dict[str, float]] = {}
            checked = self._checksum_column("turn_on", "t.")
            rows = self._connection.execute(
                f"SELECT t.power_up, c.name, t.mean, {checked} FROM turn_on t JOIN channel c ON c.id = t.channel"
            )
            for number, name, mean, known in rows:
                if self._whole(known, number, name, mean):
                    means.setdefault(number, {})[name] = mean
            checked = self._checksum_column("power_up")
            return [
                PowerUp(time=time, clock_s=clock_s, seen=seen, means=means.get(number, {}))
                for number, time, clock_s, seen, known in self._connection.execute(
                    f"SELECT id, time, clock_s, seen, {checked} FROM power_up ORDER BY id"
                )
                if self._whole(known, time, clock_s, seen)
            ]


def _code(error: sqlite3.Error) -> int | None:
    """Return the code of an error of SQLite, without its details; None: it has none."""
    code: int | None = getattr(error, "sqlite_errorcode", None)
    return None if code is None else code & 0xFF


def _grade_number(period: HistoryPeriod, channel: str) -> int | None:
    grade = period.grades.get(channel.partition("/")[0])
    return None if grade is None else GRADES.index(grade)


def _noise_values(period: int, name: str, row: Mapping[str, Any]) -> Iterator[object]:
    """Yield what the checksum of a row of ``noise`` covers: also columns that this version does not know."""
    yield from (period, name)
    for column in sorted(row.keys() - {"period", "channel", "checksum"}):
        if row[column] is not None:
            yield from (column, row[column])


def _check_numbers(*values: object) -> None:
    """Raise ValueError unless all values are numbers or unknown: SQLite takes anything in each."""
    if not all(value is None or isinstance(value, int | float) for value in values):
        raise ValueError("a number is none")


def _timed_period(
    values: Sequence[Any], rows: Sequence[Mapping[str, Any]], names: Mapping[int, str], letters: Sequence[str]
) -> TimedPeriod:
    step, record, number, begin, end, complete, samples, missing, excluded_s, temperature, warming = values
    _check_numbers(step, *values[2:])
    channels: dict[str, PeriodChannel] = {}
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
            grades[name.partition("/")[0]] = GRADES[row["grade"]]
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
