"""Laws of the history: nothing is lost, nothing twice; answers are exact; changes and repeatability between days."""

from __future__ import annotations

import json
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import imumon
from daemons import Daemon
from histories import BEGIN, NAMES, RECORD, period, with_slopes, write
from paths import TESTS
from reports import report as report_at
from reports import warming_up as report
from reports import with_channel
from waiting import until

from imumon.cli.history_command import _readable, stored_days
from imumon.documents.report_texts import coefficient_text
from imumon.documents.summary import summary_text
from imumon.history import HistoryStore
from imumon.history.day_changes import DayChanges
from imumon.history.history import History
from imumon.history.power_ups import LEAST_POWER_UPS, PowerUps
from imumon.history.repeatability import day_scatter
from imumon.history.rows import csv_pieces, iso, json_pieces, rows
from imumon.history.schema import VERSION
from imumon.history.selection import Selection, SelectionError, moment, of_parameters
from imumon.history.store import SUFFIX, HistoryError, PowerUp, TimedPeriod
from imumon.model.coefficients import Estimate
from imumon.model.history_report import HistoryRow
from imumon.model.history_report import history_rows as read_rows
from imumon.model.messages import change_text
from imumon.model.report import Distribution, Event, Report, from_json
from imumon.model.report_json import to_json
from imumon.model.samples import GYRO, MAG
from imumon.noise.statistics.moments import deviation_limits
from imumon.record.combined_limits import with_combined
from imumon.sources.vn100.emulator import EmulatorSettings, spawn

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


def of_version(path: Path, version: int) -> None:
    write(path.parent, "imu", [period(0)])
    with closing(sqlite3.connect(path)) as other:
        other.execute(f"PRAGMA user_version = {version}")


def of_another_program(path: Path) -> None:
    with closing(sqlite3.connect(path)) as other:
        other.execute("CREATE TABLE theirs (x)")


def linked(path: Path) -> None:
    (path.parent / "elsewhere").write_bytes(b"mine")
    path.symlink_to(path.parent / "elsewhere")


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("damaged", "reason"),
    [
        (
            lambda path: path.write_bytes(b"this is no database, but long enough to look like one" * 99),
            "damaged",
        ),
        (lambda path: of_version(path, VERSION + 1), "other-version"),
        (lambda path: of_version(path, VERSION - 1), "other-version"),
        (of_another_program, "damaged"),
        (linked, "damaged"),
    ],
)
def test_a_file_that_cannot_be_used_is_set_aside(
    tmp_path: Path, damaged: Callable[[Path], object], reason: str
) -> None:
    path = tmp_path / "imu.history.sqlite"
    damaged(path)
    before = path.read_bytes()
    history = History(tmp_path, "imu", keep_days=400)
    history.add([period(0).period], RECORD, BEGIN)
    notes: list[str] = []
    until(lambda: notes.extend(text for text, _ in history.problems()) or notes)
    history.close()
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
        for _ in range(20):
            last = int(writer.stdout.readline())
        writer.send_signal(signal.SIGKILL)
    found = [row for row in read(tmp_path / "imu.history.sqlite") if row["channel"] == "gyro/x"]
    assert len(found) > last


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
    history.barrier()
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
    history.barrier()
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
    history.barrier()
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
    history = History(tmp_path, "imu", keep_days=400)
    stamp, text = datetime.fromtimestamp(now - 60.0, UTC).isoformat(), "gap: 3 samples missing (0.03 s)"
    history.event(Event(time=stamp, kind="gap", text=text, device="imu"))
    history.close()
    assert len(json.loads(imumon("history", "--state", tmp_path, "--channel", "gyro", "--json"))) == 18
    table = imumon("history", "--state", tmp_path, "--channel", "gyro/x").splitlines()
    assert len(table) == 16  # a row and a line of notes for each hour, and the event
    assert "°/√h" in table[0]
    everything = imumon("history", "--state", tmp_path)
    assert max(map(len, everything.splitlines())) <= 80
    assert "gap: 3 samples" in everything[everything.index("\nevents\n") :]


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


# ---------------------------------------- what the history adds to a document


def make_report() -> Report:
    """Return the report of a quarter of an hour."""
    return report_at(900.0)


def history_rows(folder: Path, noises: Sequence[float]) -> list[HistoryRow]:
    """Return the rows beside a saved state whose N has these factors, one per day."""
    begin = time.time() - (len(noises) + 1) * 86400.0
    days = [period(k, step_s=86400, begin=begin + 86400.0 * k, noise=noise) for k, noise in enumerate(noises)]
    hours = [period(k, step_s=3600, begin=begin + 3600.0 * k) for k in range(24 * len(noises))]
    write(folder, "imu", days + hours)
    return stored_days(folder / "imu.state")


@pytest.mark.few
@pytest.mark.parametrize(
    "wrong",
    [
        {"step": "1h"}, {"complete": False}, {"warming_up": True}, {"samples": 0}, {"samples": "many"},
        {"time": "soon"}, {"channel": 3}, {"N": {"status": "measured", "value": 1e300, "low": 0, "high": 1e301}},
        {"N": {"status": "measured", "value": "x", "low": 0, "high": 1}}, {"N": 4}, {"N": None},
    ],
)  # fmt: skip
def test_a_row_that_is_no_day_does_not_count(tmp_path: Path, wrong: dict[str, Any]) -> None:
    known = [row for row in history_rows(tmp_path, [1.0, 2.0, 3.0, 4.0]) if row.channel == "gyro/x"]
    rows = json.loads(to_json(known))
    assert day_scatter(read_rows(rows))["gyro/x"]["N"].days == 4
    assert day_scatter(read_rows([rows[0] | wrong, *rows[1:]]))["gyro/x"]["N"].days == 3


def test_a_saved_state_shows_the_history_of_its_directory(tmp_path: Path) -> None:
    """Of a real daemon's directory: days, power-ups; the saved report keeps the limits."""
    with spawn(EmulatorSettings(seed=3)) as sensor, Daemon(sensor.path, tmp_path, "--id", "imu") as daemon:
        daemon.samples(400)
        daemon.stop()
    begin = time.time() - 30 * 86400.0
    days = [period(k, step_s=86400, begin=begin + 86400.0 * k, noise=1 + 0.1 * (k % 2)) for k in range(8)]
    with HistoryStore(tmp_path / f"imu{SUFFIX}", write=True) as store:
        store.add(days)
        for k in range(6):
            at = begin + 86400.0 * k
            store.set_power_up(PowerUp(time=at, clock_s=9.0, seen=at + 9.0, means={"gyro/x": 1e-3 * k}))
    state = tmp_path / "imu.state"
    saved = tmp_path / "saved.json"
    imumon("report", state, "-o", saved)
    report = from_json(Report, saved.read_text())
    alone, known = (
        channels["gyro/x"].coefficients["N"].interval for channels in (with_combined(report), report.channels)
    )
    assert known[0] < alone[0] < alone[1] < known[1]
    text = coefficient_text(report.channels["gyro/x"].coefficients["N"])
    assert text in imumon("report", saved, "--format", "md")
    shape = report.channels["gyro/x"].distribution
    assert (shape.turn_on_count, shape.turn_on_std) == (6, pytest.approx(1e-3 * np.sqrt(3.5)))


# ---------------------------------------- laws of what the history finds


DAY = 86400.0


def days(count: int, *, begin: float = BEGIN, step_at: int = 999) -> list[TimedPeriod]:
    """Days of a sensor with 1 % of scatter, with a step of N by 12 % in all channels."""
    factors = 1.0 + 0.01 * np.random.default_rng(1).standard_normal(count)
    factors[step_at:] *= 1.12
    return [
        period(number, step_s=86400, begin=begin + number * DAY, noise=float(factor))
        for number, factor in enumerate(factors)
    ]


def test_a_step_is_found_with_its_day_and_the_scatter_is_not() -> None:
    judged = DayChanges()
    judged.add(days(30))
    assert judged.changes == {}
    judged = DayChanges()
    judged.add(days(30, step_at=27))
    (change,) = judged.changes["gyro/y"]
    assert (change.quantity, change.against, change.since) == ("N", "history", "2026-01-28T00:00:00.000Z")
    assert change.ratio == pytest.approx(1.12, abs=0.02)
    assert change.p_value < 1e-5
    assert "temperature" not in judged.changes
    assert change_text(GYRO[1], change).startswith(
        "gyro/y: N has grown by 12 % against the history since 2026-01-28, p = "
    )


def test_days_that_are_short_in_progress_or_warm_up_do_not_count() -> None:
    judged = DayChanges()
    judged.add([period(k, step_s=86400, complete=False) for k in range(20)])
    judged.add([period(k, step_s=86400, warming_up=True) for k in range(20)])
    judged.add([period(k) for k in range(20)])
    assert judged._days == {}


def test_a_step_of_the_slope_is_judged_by_the_errors_of_the_days() -> None:
    """Of any sign; a day with a wide error, however far off, is no change."""
    scatter = 1e-7 * np.random.default_rng(5).standard_normal(30)
    slopes = np.where(np.arange(30) < 20, -1e-6, 1e-6) + scatter
    for values, expected in ((scatter, 0), (np.append(scatter, 1e-5), 0), (slopes, 1)):
        judged = DayChanges()
        judged.add(with_slopes(values.tolist(), 1e-7))
        assert len(judged.changes.get(GYRO[0], ())) == expected
    (change,) = judged.changes["gyro/x"]
    assert (change.quantity, change.ratio, change.since) == ("slope", None, "2026-01-21T00:00:00.000Z")
    assert (change.before, change.now) == (pytest.approx(-1e-6, abs=2e-7), pytest.approx(1e-6, abs=2e-7))
    text = change_text(GYRO[0], change)
    assert text.startswith("gyro/x: the slope against the temperature has moved from -")
    assert " per degC against the history since 2026-01-21, p = " in text
    assert text in summary_text(with_channel(report(), GYRO[0], changes=(change,)), 200)


def test_the_history_prints_the_slope_of_a_day(tmp_path: Path) -> None:
    write(tmp_path, "imu", with_slopes([-1e-6] * 3, 1e-7))
    ask = ["history", "--state", tmp_path, "--since", "2026-01-01", "--step", "1d"]
    text = imumon(*ask, "--channel", "gyro")
    assert text.count("slope -0.206 ±0.041 °/h/°C") == 2
    assert text.count("slope") == 3
    assert '"slope":{"value":-1e-06,"low":-1.2e-06,' in imumon(*ask, "--json")


@pytest.mark.few
@pytest.mark.parametrize("correlation", [0.0, 0.8, 1.0])
def test_scatter_of_any_kind_makes_few_changes(correlation: float) -> None:
    """500 series of 30 days: white, strongly correlated, and a random walk."""
    rng, changed = np.random.default_rng(3), 0
    for _ in range(500):
        series = [0.0]
        for shock in 0.03 * rng.standard_normal(29):
            series.append(correlation * series[-1] + float(shock))
        judged = DayChanges()
        judged.add(
            [
                period(day, step_s=86400, noise=float(np.exp(level)), names=(GYRO[0],))
                for day, level in enumerate(series)
            ]
        )
        changed += bool(judged.changes)
    assert changed <= 15  # one of a hundred by chance: 15 have a probability of 1e-4


def opened(directory: Path) -> History:
    """Return a history that has read what its file has."""
    history = History(directory, "imu", keep_days=400)
    until(lambda: history._power_ups is not None)
    return history


def test_a_change_is_reported_once_also_after_a_restart(tmp_path: Path) -> None:
    now = time.time()
    begin = now - 31 * DAY
    write(tmp_path, "imu", days(30, begin=begin, step_at=27))
    for expected in (len(NAMES), 0):
        history = opened(tmp_path)
        found = history.new_changes()
        assert len(found) == expected
        assert history.new_changes() == []
        for name, text in found:
            history.event(Event(time=iso(now), kind="change", text=text, device="imu", channel=name))
        annotated = history.annotated(report())
        assert [c.against for c in annotated.channels["gyro/y"].changes][-1] == "history"
        assert "changed" in annotated.channels["gyro/y"].caveats
        history.close()


# ---------------------------------------------------------------------- power-ups


def settled(bias: float, now: float) -> TimedPeriod:
    return period(0, begin=now - 3600.0, mean=bias)


def test_a_restart_of_the_daemon_is_no_power_up_and_one_of_the_sensor_is() -> None:
    ups = PowerUps([])
    ups.update(100.0, BEGIN)
    ups.update(4000.0, BEGIN + 3900.0)
    again = PowerUps(ups._all)
    again.update(90_000.0, BEGIN + 89_900.5)  # the daemon was away
    assert len(again._all) == 1
    again.update(5.0, BEGIN + 90_000.0)  # the clock restarted
    again.update(
        90_000.0, BEGIN + 400_000.0
    )  # it is ahead, but not by as much as the host: off for days in between
    assert [round(each.time - BEGIN) for each in again._all] == [-100, 89_995, 310_000]


def test_the_bias_is_taken_once_the_sensor_has_settled() -> None:
    ups = PowerUps([])
    ups.update(700.0, BEGIN)
    assert not ups.settle(settled(0.1, BEGIN), 100.0)  # half an hour is not over
    ups.update(3000.0, BEGIN + 2300.0)
    assert not ups.settle(period(1, complete=False), 2400.0)
    assert not ups.settle(period(1, warming_up=True), 2400.0)
    assert ups.settle(settled(0.2, BEGIN + 2300.0), 2400.0)
    assert not ups.settle(settled(0.3, BEGIN + 2900.0), 3000.0)
    assert ups.biases(GYRO[0]) == [0.2]
    assert ups.biases(MAG[0]) == []


def test_the_repeatability_has_limits_after_five_power_ups() -> None:
    ups, biases = PowerUps([]), [0.1, 0.14, 0.09, 0.11, 0.12]
    for number, bias in enumerate(biases):
        shape = ups.described(Distribution(), GYRO[2])
        assert shape.turn_on_count == (number or None)
        assert shape.turn_on_std is None
        begin = BEGIN + number * DAY
        ups.update(1.0, begin)
        ups.update(4000.0, begin + 4000.0)
        assert ups.settle(settled(bias, begin + 4000.0), 3300.0)
    shape = ups.described(Distribution(), GYRO[2])
    assert shape.turn_on_count == LEAST_POWER_UPS
    assert shape.turn_on_std == pytest.approx(np.std(biases, ddof=1))
    assert (shape.turn_on_low, shape.turn_on_high) == deviation_limits(shape.turn_on_std or 0.0, 4)


def test_power_ups_are_in_the_file(tmp_path: Path) -> None:
    now = time.time()
    for number, bias in enumerate((0.1, 0.2)):
        history = opened(tmp_path)
        history.clock(9000.0 - number, now)
        history.add([period(number, mean=bias, complete=True).period], "r", now)
        history.close()
        assert history._power_ups.biases(GYRO[0]) == [0.1, 0.2][: number + 1]
