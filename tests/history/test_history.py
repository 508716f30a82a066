"""Laws of the history: nothing is lost, nothing twice; a bad file is set aside; answers are exact and quick."""

from __future__ import annotations

import json
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

import pytest
from commands import imumon
from histories import BEGIN, NAMES, RECORD, period, write
from paths import TESTS
from waiting import until

from imumon.cli.history_command import _readable
from imumon.history import HistoryStore
from imumon.history.history import History
from imumon.history.rows import csv_pieces, json_pieces, rows
from imumon.history.schema import VERSION
from imumon.history.selection import Selection, SelectionError, moment, of_parameters
from imumon.history.store import HistoryError
from imumon.model.coefficients import Estimate
from imumon.model.report import Event

EVER = Selection(since=0.0, until=1e12)


def read(path: Path, selected: Selection = EVER) -> list[dict[str, object]]:
    with HistoryStore(path) as store:
        return [row for timed in store.periods(selected) for row in rows(timed, "imu", selected)]


def written(path: Path) -> int:
    """Return how many rows are in a file, which may be made at this moment."""
    try:
        return len(read(path))
    except HistoryError as error:
        if error.code != "no_history":
            raise
        return 0


# ---------------------------------------------------------------------- the file


@pytest.mark.few
def test_an_empty_file_is_a_history_that_begins(tmp_path: Path) -> None:
    """A reader may come between the creation of the file and that of its tables."""
    path = tmp_path / "imu.history.sqlite"
    path.touch()
    assert written(path) == 0
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA journal_mode = WAL")
        assert written(path) == 0
    write(tmp_path, "imu", [period(0)])
    assert written(path) == len(NAMES) + 1


def test_what_is_written_is_read(tmp_path: Path) -> None:
    path = write(tmp_path, "imu", [period(k) for k in range(5)])
    found = read(path)
    assert len(found) == 5 * (len(NAMES) + 1)
    first = found[0]
    assert first["time"] == "2026-01-01T00:00:00.000Z"
    assert first["end"] == "2026-01-01T01:00:00.000Z"
    assert (first["channel"], first["step"], first["unit"]) == ("gyro/x", "1h", "rad/s")
    assert first["N"] == {"value": 1.234567e-4, "low": 1.222221e-4, "high": 1.246913e-4, "status": "measured"}
    assert first["K"] == {"value": None, "low": 0.0, "high": 3.4e-6, "status": "upper_bound"}
    assert (first["grade"], first["samples"], first["missing"]) == ("industrial", 360000, 3)
    assert found[-1]["channel"] == "temperature"
    assert found[-1]["N"] is None


def test_a_period_in_progress_ends_with_its_record(tmp_path: Path) -> None:
    path = write(tmp_path, "imu", [period(7, complete=False)])
    write(tmp_path, "imu", [period(0, record="2026-02-01T00:00:00.000Z", begin=BEGIN + 9e6, complete=False)])
    assert [row["complete"] for row in read(path) if row["channel"] == "gyro/x"] == [True, False]


@pytest.mark.parametrize(
    ("selected", "numbers"),
    [
        (Selection(since=BEGIN + 3600, until=BEGIN + 9000), [0, 1, 2]),
        (Selection(since=BEGIN + 3601, until=BEGIN + 7199), [1]),
        (Selection(since=BEGIN - 9, until=BEGIN - 1), []),
        (Selection(since=0, until=1e12, step="1d"), []),
    ],
)
def test_a_selection_takes_what_lies_or_lasts_in_it(
    tmp_path: Path, selected: Selection, numbers: list[int]
) -> None:
    path = write(tmp_path, "imu", [period(k) for k in range(5)])
    with HistoryStore(path) as store:
        assert [timed.period.number for timed in store.periods(selected)] == numbers


@pytest.mark.few
@pytest.mark.parametrize("damage", ["text", "cut", "middle", "earlier", "later", "link", "other"])
def test_a_file_that_cannot_be_used_is_set_aside(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "imu.history.sqlite"
    if damage == "text":
        path.write_bytes(b"this is no database, but long enough to look like one" * 99)
    elif damage == "link":
        (tmp_path / "elsewhere").write_bytes(b"mine")
        path.symlink_to(tmp_path / "elsewhere")
    elif damage == "other":
        with sqlite3.connect(path) as other:
            other.execute("CREATE TABLE theirs (x)")
        other.close()
    else:
        write(tmp_path, "imu", [period(k) for k in range(300)])
        data = path.read_bytes()
        if damage in ("earlier", "later"):
            with sqlite3.connect(path) as other:
                other.execute(f"PRAGMA user_version = {VERSION + (1 if damage == 'later' else -1)}")
            other.close()
        else:
            half = len(data) // 2
            cut = data[:half] if damage == "cut" else data[:half] + b"\xaa" * 8192 + data[half + 8192 :]
            path.write_bytes(cut)
    before = path.read_bytes()
    history = History(tmp_path, "imu", keep_days=400)
    history.add([period(0).period], RECORD, BEGIN)
    notes: list[str] = []
    until(lambda: notes.extend(text for text, _ in history.problems()) or notes)
    history.close()
    reason = "other-version" if damage in ("earlier", "later") else "damaged"
    assert (tmp_path / f"imu.{reason}-1.history.sqlite").read_bytes() == before
    assert "a new history begins" in notes[0]
    assert len(read(path)) == len(NAMES) + 1


@pytest.mark.few
@pytest.mark.parametrize("lost", ["file", "log", "directory", "renamed"])
def test_a_history_that_is_removed_is_made_again_with_what_follows(tmp_path: Path, lost: str) -> None:
    """Without this, what follows goes to a file without a name, and is lost with the daemon."""
    history = History(tmp_path / "state", "imu", keep_days=400)
    history.add([period(0).period], RECORD, BEGIN)
    history.barrier()()  # a write that goes on while its file is removed is lost with it
    assert written(history.path) == len(NAMES) + 1
    if lost == "directory":
        shutil.rmtree(history.path.parent)
    elif lost == "renamed":
        history.path.rename(tmp_path / "elsewhere")
    else:
        Path(f"{history.path}{'-wal' if lost == 'log' else ''}").unlink(missing_ok=lost == "log")
    for number in (1, 2):
        history.add([period(number).period], RECORD, BEGIN + 600.0 * number)
        history.barrier()()
    assert history.problems() == []
    history.close()
    assert len(read(history.path)) == (3 if lost == "log" else 2) * (len(NAMES) + 1)


def test_a_killed_writer_loses_nothing_that_it_has_said_to_be_written(tmp_path: Path) -> None:
    code = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "from histories import period\nfrom pathlib import Path\nfrom imumon.history import HistoryStore\n"
        "store = HistoryStore(Path(sys.argv[2]) / 'imu.history.sqlite', write=True)\n"
        "for k in range(10**6):\n    store.add([period(k)]); print(k, flush=True)\n"
    )
    here = str(TESTS)
    with subprocess.Popen(
        [sys.executable, "-c", code, here, str(tmp_path)], stdout=subprocess.PIPE, text=True
    ) as writer:
        assert writer.stdout is not None
        for _ in range(20):
            last = int(writer.stdout.readline())
        writer.send_signal(signal.SIGKILL)
    found = [row for row in read(tmp_path / "imu.history.sqlite") if row["channel"] == "gyro/x"]
    assert len(found) > last


def test_what_is_added_during_the_last_write_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writing, go_on = threading.Event(), threading.Event()

    def delete_before(store: HistoryStore, time: float) -> None:
        writing.set()
        go_on.wait(60)

    monkeypatch.setattr(HistoryStore, "delete_before", delete_before)
    history = History(tmp_path, "imu", keep_days=1)
    assert writing.wait(60)
    history.add([period(0).period], RECORD, BEGIN)
    threading.Timer(0.1, go_on.set).start()
    history.close()
    assert read(history.path)


def test_old_entries_are_deleted(tmp_path: Path) -> None:
    now = time.time()
    for number, begin in enumerate((now - 3 * 86400, now)):  # it deletes at its start, and then once a day
        history = History(tmp_path, "imu", keep_days=1)
        history.add([period(number).period], RECORD, begin)
        history.close()
    (day,) = {row["time"][:10] for row in read(history.path)}
    assert day == datetime.fromtimestamp(now - 3600, UTC).isoformat()[:10]


def test_what_cannot_be_written_waits_and_is_said_once(tmp_path: Path) -> None:
    if os.geteuid() == 0:
        place = Path("/proc/self")  # nobody can make a file there
    else:
        place = tmp_path / "closed"
        place.mkdir(mode=0o500)
    history = History(place, "imu", keep_days=400)
    for number in range(3):
        history.add([period(number).period], RECORD, BEGIN + 3600.0 * number)
    notes: list[str] = []
    until(lambda: notes.extend(text for text, _ in history.problems()) or notes)
    history.save()
    time.sleep(0.1)
    assert [text.partition(":")[0] for text in notes] == ["the history cannot be written"]
    assert history.problems() == []
    parameters = "_time=[2025-12-31T23:00:00Z..2026-01-01T04:00:00Z];step=1h;channel=gyro/x"
    assert len(json.loads(history.answer("", parameters))) == 3
    history.close()


# ---------------------------------------------------------------------- questions


def test_answers_contain_what_is_not_written_yet_and_what_is_in_progress(tmp_path: Path) -> None:
    history = History(tmp_path, "imu", keep_days=400)
    now = time.time()
    history.add([period(0).period], RECORD, now - 3600)
    history.add([period(1, complete=False, noise=2.0).period], RECORD, now)
    found = json.loads(history.answer("", "channel=gyro/x"))
    assert [row["complete"] for row in found] == [True, False]
    history.save()
    until(lambda: not history._pending)
    history.add([period(1, complete=False, noise=4.0).period], RECORD, now)
    found = json.loads(history.answer("", "channel=gyro/x"))
    assert [round(row["N"]["value"] / 1.234567e-4) for row in found] == [1, 4]
    history.close()


def test_events_of_one_kind_within_ten_minutes_are_one_with_a_count(tmp_path: Path) -> None:
    history = History(tmp_path, "imu", keep_days=400)
    now = time.time()
    for k, kind in enumerate(("change", "disturbance", "disturbance", "disturbance")):
        stamp = datetime.fromtimestamp(now - 60 + k, UTC).isoformat()
        history.event(Event(time=stamp, kind=kind, text=f"number {k}", device="imu"))
    history.save()
    until(lambda: not history._events)
    found = json.loads(history.answer("event", ""))
    assert [(each["kind"], each["text"], each["count"]) for each in found] == [
        ("change", "number 0", 1),
        ("disturbance", "number 1", 3),
    ]
    history.close()


@pytest.mark.parametrize(
    ("text", "since", "until"),
    [
        ("_time=[now(-2h)..now()]", 2800.0, 10000.0),
        ("_time=[now(-1h30m)..]", 4600.0, 10000.0),
        ("_time=[1970-01-01T00:00:00Z..1970-01-01T01:00:00Z]", 0.0, 3600.0),
        ("_time=[now(-2h);1h]", 2800.0, 6400.0),
        ("channel=gyro/x;_time=]now(-60)..now()[", 9940.0, 10000.0),
        ("", 10000.0 - 86400.0, 10000.0),
    ],
)
def test_time_is_selected_as_in_zenoh_storages(text: str, since: float, until: float) -> None:
    chosen = of_parameters(text, 10000.0)
    assert (chosen.since, chosen.until, chosen.step) == (since, until, "1h")


@pytest.mark.parametrize(
    ("parameters", "code"),
    [
        ("_time=[soon..later]", "time_invalid"),
        ("_time=[now()..now(-1h)]", "time_invalid"),
        ("_time=[2026-01-01]", "time_invalid"),
        ("step=5m", "step_invalid"),
    ],
)
def test_a_question_that_is_not_valid_is_refused(parameters: str, code: str) -> None:
    with pytest.raises(SelectionError) as refused:
        of_parameters(parameters, 10000.0)
    assert refused.value.code == code


@pytest.mark.parametrize(
    "text",
    [
        "2026-13-01",
        "",
        "x",
        "now(",
        "now(-1x)",
        "1e400d",
        "9" * 50 + "y",
        "9" * 15 + "d",
        "now(1e300)",
        "1h30",
    ],
)
def test_a_time_that_is_none(text: str) -> None:
    with pytest.raises(SelectionError):
        moment(text, 0.0)


def test_json_and_csv_have_the_same_numbers(tmp_path: Path) -> None:
    import csv

    found = read(write(tmp_path, "imu", [period(0)]))
    assert json.loads("".join(json_pieces(iter(found)))) == found
    lines = list(csv.DictReader("".join(csv_pieces(iter(found))).splitlines()))
    assert len(lines) == len(found)
    assert float(lines[0]["N"]) == 1.234567e-4
    assert lines[0]["K"] == ""
    assert lines[0]["K_high"] == "3.4e-06"
    assert lines[-1]["N_status"] == ""
    assert "".join(json_pieces(())) == "[]"


# ---------------------------------------------------------------------- the command


def test_the_command_reads_the_file(tmp_path: Path) -> None:
    now = time.time()
    write(tmp_path, "imu", [period(k, begin=now - 21600.0 + 3600.0 * k) for k in range(6)])
    assert len(json.loads(imumon("history", "--state", tmp_path, "--channel", "gyro", "--json"))) == 18
    table = imumon("history", "--state", tmp_path, "--channel", "gyro/x").splitlines()
    assert len(table) == 7
    assert "°/√h" in table[1]


@pytest.mark.parametrize(
    ("value", "low", "high", "text"),
    [
        (1.0, 0.99, 1.01, "±1.0 %"),
        (1.0, 0.6, 1.4, "±40 %"),
        (1.0, 0.3, 2.9, "×÷3.1"),
        (1.0, 0.0, 2.9, "×÷>9"),
    ],
)
def test_the_limits_of_a_row_are_a_percentage_or_a_factor(
    value: float, low: float, high: float, text: str
) -> None:
    part = Estimate(value=value, low=low, high=high, status="measured")
    assert " ".join(_readable("gyro", "N", part).split()[1:-1]) == text
