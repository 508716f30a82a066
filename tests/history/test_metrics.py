"""Metrics: every number of the report once, valid for Prometheus, scraped by a real one where it is installed."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from daemons import Daemon, MetricsViewer, scraped, values
from paths import ROOT
from reports import warming_up as report
from waiting import until

from imumon.config import ConfigError, load
from imumon.history.metrics import Metrics, MetricsError, Observed

DOCS = ROOT / "docs" / "monitoring"
EVENTS = {"connect": 2, "disconnect": 1}


def text_of(path: Path, *observed: Observed) -> str:
    Metrics(lambda: observed).write(str(path))
    return path.read_text()


@pytest.fixture
def text(tmp_path: Path) -> str:
    return text_of(tmp_path / "a.prom", Observed(report(), 0.5, EVENTS))


def test_every_number_of_the_report_is_there(text: str) -> None:
    made, shown = report(), values(text)
    assert shown["imumon_up",] == 1.0
    assert shown["imumon_rival",] == 0.0
    assert shown["imumon_samples_total",] == made.session.samples
    assert shown["imumon_missing_total",] == made.session.missing
    assert shown["imumon_events_total", "connect"] == 2.0
    assert shown["imumon_events_total", "gap"] == 0.0
    assert shown["imumon_temperature_celsius",] == made.channels["temperature"].last
    for name, channel in made.channels.items():
        for letter in "NBK":
            part = channel.coefficients.get(letter)
            for limit in ("value", "low", "high"):
                known = getattr(part, limit) if part is not None else None
                assert shown.get(("imumon_noise", name, letter, limit)) == known


def test_a_sensor_is_up_while_it_sends_and_its_daemon_reports(tmp_path: Path) -> None:
    for state, age_s, up in (("running", 0.5, 1.0), ("waiting", 0.5, 0.0), ("running", 60.0, 0.0)):
        shown = values(text_of(tmp_path / "a.prom", Observed(replace(report(), state=state), age_s, {})))
        assert (shown["imumon_up",], shown["imumon_report_age_seconds",]) == (up, age_s)


def test_an_address_of_another_machine_and_a_missing_directory_are_errors(tmp_path: Path) -> None:
    metrics = Metrics(lambda: ())
    for act, code in (
        (lambda: metrics.serve("203.0.113.7", 9847), "metrics_not_served"),
        (lambda: metrics.serve("127.0.0.1", 99999), "metrics_not_served"),
        (lambda: metrics.write(str(tmp_path / "none" / "a.prom")), "metrics_not_written"),
    ):
        with pytest.raises(MetricsError, match=r"^[^\n]*$") as refused:
            act()
        assert refused.value.code == code


@pytest.mark.parametrize("listen", ["", "9847", "localhost", "localhost:x", "a b:1"])
def test_an_address_that_is_none(tmp_path: Path, listen: str) -> None:
    file = tmp_path / "config.toml"
    file.write_text(f'[metrics]\nlisten = "{listen}"\n')
    with pytest.raises(ConfigError, match="HOST:PORT"):
        load(file)


def test_a_viewer_serves_and_another_writes_what_a_daemon_reports(tmp_path: Path) -> None:
    """Of the devices that it is for; the file is whole at each moment. It ends at a signal."""
    file = tmp_path / "imumon.prom"
    file.write_text("")
    with (
        Daemon("sim", tmp_path / "state", "--id", "lab") as daemon,
        MetricsViewer(daemon.endpoint, "--id", "la") as server,
        MetricsViewer(daemon.endpoint, "--id", "other") as empty,
        MetricsViewer(daemon.endpoint, file=file),
    ):
        made = daemon.samples(200)
        until(
            lambda: values(scraped(server.address)).get(("imumon_samples_total",), 0) >= made.session.samples
        )
        assert values(scraped(server.address))["imumon_events_total", "connect"] == 1.0
        assert values(scraped(empty.address)) == {}
        until(lambda: values(file.read_text()).get(("imumon_up",)) == 1.0)
        daemon.stop()
        until(lambda: values(scraped(server.address))["imumon_up",] == 0.0)
    assert [path.name for path in tmp_path.iterdir() if path.is_file()] == ["imumon.prom"]


@pytest.mark.skipif(shutil.which("promtool") is None, reason="promtool is not installed (Debian: prometheus)")
def test_promtool_finds_nothing_wrong(text: str) -> None:
    done = subprocess.run(
        ["promtool", "check", "metrics"], input=text, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    rules = subprocess.run(
        ["promtool", "check", "rules", str(DOCS / "alerts.yml")], capture_output=True, text=True, check=False
    )
    assert rules.returncode == 0, rules.stderr
