"""`imumon check`: the line and the exit code of a monitoring plugin."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import reports
from blocks_at_rest import DELTAS, LEVEL, NOW, block
from commands import run_inside
from daemons import Daemon, free_endpoint
from faulty_sensor import spawn

from imumon.bus import Publisher
from imumon.model.report import DeviceDescription, Report, SensorGrade, SessionCounters, stamp
from imumon.model.report_json import to_json
from imumon.model.samples import SampleBlock
from imumon.record import Record
from imumon.sources.vn100.emulator import EmulatorSettings

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

    with Publisher(made.device.id, listen=[place]) as bus:
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


def healthy(report: Report) -> Report:
    return report


def with_loss(report: Report) -> Report:
    return replace(report, session=replace(report.session, recent_loss=0.2))


def stuck(report: Report) -> Report:
    return replace(report, caveats=("stuck",))


def constant(report: Report) -> Report:
    channel = replace(report.channels["gyro/y"], caveats=("constant",))
    return replace(report, channels={**report.channels, "gyro/y": channel})


def disconnected(report: Report) -> Report:
    return replace(with_loss(report), state="waiting")


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


@pytest.mark.parametrize(
    ("state", "code", "text"),
    [
        (healthy, 0, "gyro .*, accel .*, loss 0 %"),
        (with_loss, 1, "20 % of the samples of the last minute are missing"),
        (stuck, 1, "the values do not change: an axis or the whole sensor hangs"),
        (constant, 1, "gyro y: the values never changed: dead, stuck or not measured"),
        (
            disconnected,
            2,
            "the sensor is disconnected or silent; 20 % of the samples of the last minute are missing",
        ),
    ],
)
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
    lossy = replace(with_loss(report), alarm_limits={"loss": 0.1})
    with published(lossy) as place:
        assert plugin("--connect", place)[0] == 1
    lossy = replace(lossy, alarm_limits={"loss": 0.25}, grade={"gyro": final, "accel": final})
    with published(lossy) as place:
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
    for words in (["--max-age", "x"], ["--nonsense"], ["--baseline", "/nowhere"], ["--id", "///"]):
        code, text, data = plugin(*words)
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
