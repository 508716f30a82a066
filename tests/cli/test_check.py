"""`imumon check` and `imumon wait`: their lines and exit codes."""

from __future__ import annotations

import fcntl
import json
import re
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import reports
from blocks_at_rest import DELTAS, LEVEL, NOW, block
from cases import case
from commands import imumon, run_inside
from daemons import Daemon
from documents import words
from faulty_sensor import spawn
from free_ports import free_endpoint
from reports import FakeSource, with_bound, with_channel
from waiting import until

from imumon.api.measurement import Measurement
from imumon.bus import Publisher
from imumon.cli.exit_codes import CommandError
from imumon.cli.main import parsers
from imumon.cli.options import only_own_device, report_of
from imumon.cli.wait_condition import WaitCondition
from imumon.config import ZenohSettings
from imumon.documents.program_settings import number_lines, numbers_of
from imumon.model.coefficients import GRADES, NOISE
from imumon.model.messages import grade_text
from imumon.model.readiness import letters_for, ready_text, state_of
from imumon.model.report import DeviceDescription, Report, SensorGrade, SessionCounters, stamp
from imumon.model.report_json import to_json
from imumon.model.samples import INERTIAL, SampleBlock
from imumon.record import Record
from imumon.sources.vn100.emulator import EmulatorSettings
from imumon.tui.channel_table import SYMBOLS, rows_of
from imumon.tui.export import copied_lines
from imumon.tui.panels import headlines
from imumon.tui.view_state import ViewState

PERFORMANCE = re.compile(r"[A-Za-z_]+=-?\d+(\.\d+)?(s|%|c)?(;-?[\d.]*){0,4}")
"""One value by the Monitoring Plugins Development Guidelines."""


@contextmanager
def published(made: Report, skew_s: float = 0.0, once: bool = False) -> Iterator[str]:
    """Publish a report with the present time of a clock that is `skew_s` ahead; give the endpoint."""
    place, ended = free_endpoint(), threading.Event()

    def publish(bus: Publisher) -> None:
        while not ended.wait(0.0 if ended.is_set() else 0.2):
            now = datetime.now(UTC) + timedelta(seconds=skew_s)
            bus.publish(replace(made, time=stamp(now), period_s=0.2))
            if once:
                return

    with Publisher(made.device.id, ZenohSettings(listen=(place,))) as bus:
        thread = threading.Thread(target=publish, args=(bus,))
        thread.start()
        try:
            yield place
        finally:
            ended.set()
            thread.join()


def plugin(*words: str) -> tuple[int, str, list[str]]:
    """Run the plugin; return its exit code, its text, and its performance data."""
    code, output, errors = run_inside(["check", *words])
    assert errors == ""
    (line,) = output.splitlines()
    text, _, data = line.partition("|")
    values = data.split()
    assert all(PERFORMANCE.fullmatch(value) for value in values), values
    assert text.startswith(f"IMUMON {('OK', 'WARNING', 'CRITICAL', 'UNKNOWN')[code]} - ")
    return code, text.partition(" - ")[2], values


@cache
def measured(scale: float = 1.0) -> Report:
    """Return the report of a minute of white noise, of an industrial sensor by default."""
    stream = replace(DELTAS, channels=(*DELTAS.channels, "temperature"))
    part, monitor = block(6000), Record()
    assert part.time_ns is not None
    values = np.column_stack((LEVEL + scale * (part.values - LEVEL), np.full(6000, 25.0)))
    monitor.feed(SampleBlock(stream, values, part.time_ns, part.lost))
    monitor.flush()
    return monitor.report(NOW, DeviceDescription(id=reports.ID), "running", SessionCounters())


@pytest.fixture(scope="module")
def report() -> Report:
    return measured()


def lossy(report: Report, **changed: object) -> Report:
    return replace(report, session=replace(report.session, recent_loss=0.2), **changed)


LOSS = "20 % of the samples of the last minute are missing"


@pytest.mark.parametrize(
    ("state", "code", "text"),
    [
        (lambda report: report, 0, "gyro .*, accel .*, loss 0 %"),
        (lossy, 1, LOSS),
        (
            lambda report: replace(report, caveats=("stuck",)), 1,
            "the values do not change: an axis or the whole sensor hangs",
        ),
        (
            lambda report: with_channel(report, "gyro/y", caveats=("constant",)), 1,
            "gyro y: the values never changed: dead, stuck or not measured",
        ),
        (lambda report: lossy(report, state="waiting"), 2, f"the sensor is disconnected or silent; {LOSS}"),
    ],
)  # fmt: skip
def test_the_worst_state_decides(
    report: Report, state: Callable[[Report], Report], code: int, text: str
) -> None:
    with published(state(report)) as place:
        returned, said, data = plugin("--connect", place)
    assert (returned, bool(re.fullmatch(f"{report.device.id}: {text}", said))) == (code, True), said
    names = [value.partition("=")[0] for value in data]
    assert names[:5] == ["age", "loss", "samples", "missing", "temperature"]
    assert {"gyro_x_N", "accel_z_N"} <= set(names)


def test_the_limit_of_the_loss_a_grade_and_a_baseline(report: Report, tmp_path: Path) -> None:
    final = SensorGrade(meets="industrial", best="industrial", worst="industrial", provisional=False)
    with published(lossy(report, alarm_limits={"loss": 0.1})) as place:
        assert plugin("--connect", place)[0] == 1
    within = lossy(report, alarm_limits={"loss": 0.25}, grade={"gyro": final, "accel": final})
    with published(within) as place:
        assert plugin("--connect", place)[0] == 0
        code, text, _ = plugin("--connect", place, "--grade", "tactical")
        assert (code, text.count(" industrial")) == (2, 2)
        assert plugin("--connect", place, "--grade", "industrial")[0] == 0
        saved = tmp_path / "baseline.json"
        saved.write_text(to_json(measured(2.0)))
        code, text, _ = plugin("--connect", place, "--baseline", str(saved))
        assert code == 1
        assert "gyro/x: N has fallen by 50 % against the baseline" in text
        saved.write_text(to_json(report))
        assert plugin("--connect", place, "--baseline", str(saved))[0] == 0


def test_errors_are_unknown_and_a_missing_daemon_is_critical(tmp_path: Path) -> None:
    assert plugin("--connect", free_endpoint())[0] == 2
    for wrong in (["--max-age", "x"], ["--nonsense"], ["--baseline", "/nowhere"], ["--id", "///"]):
        code, text, data = plugin(*wrong)
        assert (code, data) == (3, [])
        assert text
    file = tmp_path / "bad.toml"
    file.write_text("[alert]\nmax_loss = 3\n[log]\nlevel = 'x'\n")
    assert plugin("--config", str(file))[0] == 3


@pytest.mark.slow
def test_a_real_sensor_is_ok_lossy_and_unplugged(tmp_path: Path) -> None:
    port = str(tmp_path / "port")  # a link: another program may get the terminal that is unplugged
    with spawn(EmulatorSettings(seed=1, link=port)) as sensor, Daemon(port, tmp_path / "state") as daemon:
        daemon.samples(200)
        assert plugin("--connect", daemon.endpoint)[0] == 0
        sensor.ask("fault drop=0.2")
        daemon.wait(lambda r: (r.session.recent_loss or 0.0) > 0.011)
        assert plugin("--connect", daemon.endpoint)[0] == 1
        sensor.ask("unplug")  # on a busy machine the sensor may be silent first
        daemon.wait(lambda r: any(e.kind == "disconnect" for e in daemon.viewer.events(r.device.id)))
        daemon.wait(lambda r: r.state == "waiting")
        code, text, _ = plugin("--connect", daemon.endpoint)
        assert code == 2
        assert "the sensor is disconnected: " in text


# ---------------------------------------------------------------- wait


def test_a_precision_needs_every_axis_measured() -> None:
    long = reports.long_report()
    assert WaitCondition(coefficient="N", precision=0.5).unmet(long) is None
    assert "required 1e-06" in str(WaitCondition(coefficient="N", precision=1e-6).unmet(long))
    unmet = WaitCondition(coefficient="K", precision=0.9).unmet(with_bound(long, "K", "accel/z", high=1.0))
    assert "K of accel/z is only bounded" in str(unmet)
    assert WaitCondition(coefficient="N", precision=0.5, channels=("mag/x",)).unmet(long) is None
    condition = WaitCondition(coefficient="N", precision=0.5, channels=("mag/q",))
    assert condition.unmet(replace(long, channels={}))  # its channels are not known yet
    with pytest.raises(CommandError, match="no mag/q"):
        condition.unmet(long)


def test_only_a_daemon_with_a_locked_state_is_the_own_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    monkeypatch.setattr(
        tempfile, "tempdir", str(tmp_path / "none")
    )  # no daemon of another test on an emulator
    arguments = parsers()[0].parse_args(["status"])
    for name in ("mine", "ended"):
        (tmp_path / f"{name}.lock").touch()
    with (tmp_path / "mine.lock").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert only_own_device(arguments, None) == "mine"
    assert only_own_device(arguments, None) is None


def test_of_several_own_daemons_the_one_at_the_configured_port_is_meant(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, report: Report, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    (tmp_path / "config.toml").write_text('[device]\nport = "/dev/ttyUSB1"\n')
    arguments = parsers()[0].parse_args(["status", "--config", str(tmp_path / "config.toml")])
    ports = {"first": "/dev/ttyUSB0", "second": "/dev/ttyUSB1", "foreign": "/dev/ttyUSB1"}
    published = [
        replace(report, device=replace(report.device, id=name, port=port)) for name, port in ports.items()
    ]
    source = FakeSource(*published)
    monkeypatch.setattr(FakeSource, "report", lambda self, id: self.reports().get(id), raising=False)
    with (tmp_path / "first.lock").open("w") as first, (tmp_path / "second.lock").open("w") as second:
        for lock in (first, second):
            fcntl.flock(lock, fcntl.LOCK_EX)
        assert only_own_device(arguments, source) == "second"
        assert report_of(source, None, list(ports), arguments).device.id == "second"
    said = capsys.readouterr().err
    assert "this is second, your own" in said
    assert "first, foreign" in said


@pytest.mark.parametrize("text", ["600", "600s", "10m", "10 min", "6e2"])
def test_every_duration_has_the_same_form(text: str) -> None:
    """Those of run, check, wait and report."""
    for command, option in (
        (["run"], "--duration"),
        (["check"], "--max-age"),
        (["wait"], "--timeout"),
        (["report"], "--horizon"),
    ):
        parsed, _ = parsers()[0].parse_known_args([*command, option, text])
        assert getattr(parsed, option[2:].replace("-", "_")) == 600.0
        code, _, errors = run_inside([*command, option, "10 parsecs"])
        assert (code, errors.count("is not a duration")) == ((3, 0) if command == ["check"] else (2, 1))


def wait(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Return how `imumon wait` ended, inside the test: to start Python takes longer."""
    return subprocess.CompletedProcess(arguments, *run_inside(["wait", *arguments]))


def test_exit_codes_with_a_daemon(tmp_path: Path) -> None:
    with Daemon("sim", tmp_path, "--speed", "30", "--seed", "1") as daemon:
        where = ("--connect", daemon.endpoint)
        daemon.samples(1)
        reached = wait(*where, "--coefficient", "N", "--precision", "10%", "--timeout", "60s")
        assert (reached.returncode, reached.stderr) == (0, "")
        assert reached.stdout.startswith("vn100-0100056785: N known to ")
        assert " or better, required 10 %; length of the record " in reached.stdout
        assert reached.stdout.count("\n") == 1
        settings = tmp_path / "config.toml"
        settings.write_text(f'[zenoh]\nlisten = ["{daemon.endpoint}"]\n[report]\ngrade = "consumer"\n')
        assert wait("--config", str(settings), "--timeout", "60s").returncode == 0
        late = wait(*where, "--grade", "navigation", "--timeout", "1s")
        assert (late.returncode, late.stdout) == (4, "")
        assert late.stderr.startswith("imumon: not reached in 1 s: ")
        assert late.stderr.count("\n") == 1
        wrong = wait(*where, "--channel", "gyro/q", "--timeout", "60s")
        assert (wrong.returncode, wrong.stderr.count("\n")) == (2, 1)
        assert "no gyro/q; it has gyro/x" in wrong.stderr
        daemon.stop()


def answered(output: tuple[int, str, str], expected: tuple[int, str, str]) -> bool:
    """Return whether a command ended with this code and has printed and said these texts."""
    (code, *said), (wanted, *texts) = output, expected
    return code == wanted and all(
        text in part and bool(text) == bool(part) for text, part in zip(texts, said, strict=True)
    )


def test_of_several_daemons_status_lists_all_and_others_need_a_name() -> None:
    """A command knows the daemons that have answered; on a busy machine, one answers late: each is tried again."""
    names = ("anna", "anne", "bert")
    with ExitStack() as all_three:
        made = [replace(measured(), device=replace(measured().device, id=name)) for name in names]
        places = [word for each in made for word in ("--connect", all_three.enter_context(published(each)))]

        def listed() -> bool:
            code, output, errors = run_inside(["status", *places])
            lines = output.splitlines()
            assert (code, errors) == (0, "")
            assert all(" old  " in line and "  loss 0 %  " in line for line in lines if len(lines) > 1)
            return [line.split()[:2] for line in lines] == [[name, "running"] for name in names]

        until(listed)
        every = "give one with --id: anna, anne, bert\n"
        for command, *words, answer in (
            ("wait", (2, "", f"imumon: several daemons answer: {every}")),
            ("report", (2, "", f"imumon: several daemons answer: {every}")),
            ("check", (3, f"IMUMON UNKNOWN - several daemons answer: {every}", "")),
            ("status", "--id", "ber", (0, "running: bert, ", "")),
            ("status", "--id", "ann", (2, "", "names that begin with ann: give one with --id: anna, anne\n")),
            ("status", "--id", "carl", (3, "", "give one of these with --id: anna, anne, bert")),
        ):
            given = [command, *places, *words]
            with case(given):
                until(lambda given=given, answer=answer: answered(run_inside(given), answer))

        def ids() -> list[str]:
            every = json.loads(run_inside(["status", *places, "--json"])[1])  # a report, or a list of some
            return [one["device"]["id"] for one in every] if isinstance(every, list) else []

        until(lambda: ids() == list(names))


def test_it_waits_for_a_daemon_that_starts_later(tmp_path: Path) -> None:
    place = free_endpoint()
    command = [sys.executable, "-m", "imumon", "wait", "--connect", place, "--timeout", "100s"]
    waiting = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    with spawn(EmulatorSettings(seed=1)) as sensor, Daemon(sensor.path, tmp_path, listen=place) as daemon:
        text, _ = waiting.communicate(timeout=120)
        daemon.stop()
    assert waiting.returncode == 0
    assert text.startswith("vn100-")


# ---------- every door gives the same answer to one question: the grade, whether a number is ready, the numbe


CODES = {"reached": 0, "open": 1, "missed": 2}


@pytest.fixture(scope="module")
def two_hours() -> Report:
    return replace(reports.report(), state="running")


def screen(two_hours: Report) -> str:
    """Return the headline and the table of the screen as text."""
    state = ViewState(reports={two_hours.device.id: two_hours}, id=two_hours.device.id)
    lines = [*headlines(state, 120, 5), *(line for line, _ in rows_of(state, 120))]
    return "\n".join("".join(text for text, _ in line) for line in lines)


def test_each_door_has_the_same_grade(two_hours: Report) -> None:
    with published(two_hours) as place:
        _, status, _ = run_inside(["status", "--connect", place])
        alone = plugin("--connect", place)[0]
        codes = [plugin("--connect", place, "--grade", grade)[0] for grade in GRADES]
    for sensor, grade in two_hours.grade.items():
        for door, text in {
            "status": status,
            "summary": repr(Measurement(two_hours)),
            "datasheet": words(two_hours, "md"),
            "screen": screen(two_hours),
        }.items():
            assert grade_text(grade) in text, (door, sensor)
    for code, required in zip(codes, GRADES, strict=True):
        verdicts = [grade.compared_with(required) for grade in two_hours.grade.values()]
        assert code == max(alone, *(CODES[verdict] for verdict in verdicts)), required
        waited = WaitCondition(grade=required).unmet(two_hours) is None
        assert waited == (set(verdicts) == {"reached"}), required


def test_each_door_has_the_same_ready_coefficients(two_hours: Report) -> None:
    axes = {name: channel for name, channel in two_hours.channels.items() if name.sensor in INERTIAL}
    ready = {letter: [] for letter in NOISE}
    for name, channel in axes.items():
        for letter in NOISE:
            goal = two_hours.precision[letter]
            state = state_of(channel, letter, two_hours.precision)
            wait = WaitCondition(coefficient=letter, precision=goal, channels=(name,))
            assert (wait.unmet(two_hours) is None) == (state == "ready"), (name, letter)
            ready[letter].append(state == "ready")
    marks = screen(two_hours).count(SYMBOLS["ready"][0])
    shown = [c for n, c in two_hours.channels.items() if c.estimates]
    assert marks == sum(
        state_of(c, letter, two_hours.precision) == "ready" for c in shown for letter in NOISE
    )
    text = ready_text(two_hours, "kalibr")
    assert text in screen(two_hours)
    assert [f"{letter} yes" in text for letter in letters_for("kalibr")] == [
        all(ready[letter]) for letter in letters_for("kalibr")
    ]


@pytest.mark.few(2)
@pytest.mark.parametrize("program", ["kalibr", "vins", "ros"])
@pytest.mark.parametrize("made", [reports.report, reports.long_report])
def test_each_door_gives_the_same_numbers(made, program: str, tmp_path: Path) -> None:
    two_hours = made()
    saved = tmp_path / "report.json"
    saved.write_text(to_json(two_hours))
    file = imumon("report", saved, "--format", program)
    assert Measurement(two_hours).settings(program) == numbers_of(file)
    assert copied_lines(two_hours, program)[1:] == number_lines(file)
