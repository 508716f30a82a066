"""Command `imumon status`: one screen, everything, or plain values."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import reports
from commands import run_inside
from paths import ROOT
from test_check import published

from imumon.documents.summary import summary_text
from imumon.model.report import Report


@pytest.fixture
def report() -> Report:
    running = reports.report(state="running")
    return replace(running, precision={"N": 0.001, "B": 0.15, "K": 0.5})


def test_it_is_one_screen_with_the_state_first(report: Report) -> None:
    lines = summary_text(report, 80).splitlines()
    assert len(lines) < 24
    assert lines[0].startswith(f"running: {report.device.id}, VN-100T-CR ")
    assert max(map(len, lines)) <= 80
    for name, channel in report.channels.items():
        assert sum(line.startswith(f"{name} ") for line in lines) == bool(channel.coefficients)
    assert any(line.startswith("caveats: aliased") for line in lines) == ("aliased" in report.caveats)


def test_why_the_numbers_are_not_current_is_in_the_second_line(report: Report) -> None:
    waiting = replace(report, state="waiting")
    lines = summary_text(waiting, 80, late="the sensor is disconnected: gone").splitlines()
    assert lines[0].startswith("waiting: ")
    assert lines[1] == "the sensor is disconnected: gone"
    assert not any(line.startswith("still to come") for line in lines)


def test_the_command_prints_a_screen_or_everything(report: Report) -> None:
    with published(report) as endpoint:
        where = ["status", "--connect", endpoint]
        code, screen, errors = run_inside(where)
        assert (code, errors) == (0, "")
        assert screen.startswith("running: ")
        _, everything, _ = run_inside([*where, "--verbose"])
        assert len(everything.splitlines()) > len(screen.splitlines())
        assert "## Appendix: distribution" in everything


@pytest.mark.parametrize("command", ["status", "check"])
def test_a_short_command_imports_nothing_heavy(report: Report, command: str, tmp_path: Path) -> None:
    """Also with the settings of a daemon: monitoring systems run them every minute, on small computers."""
    code = "import sys; from imumon.cli import main; main(sys.argv[1:]); print(*sys.modules)"
    settings = tmp_path / "config.toml"
    settings.write_text(
        (ROOT / "config.toml").read_text().replace("save_period_s = 30.0", "save_period_s = 60")
    )
    with published(report) as endpoint:
        words = [sys.executable, "-P", "-c", code, command, "--connect", endpoint]
        environment = {**os.environ, "XDG_CONFIG_HOME": str(tmp_path)}
        done = subprocess.run(
            words, capture_output=True, text=True, check=True, cwd=tmp_path, env=environment
        )
    loaded = {name.partition(".")[0] for name in done.stdout.split()}
    assert "zenoh" in loaded
    assert not loaded & {"numpy", "scipy", "textual", "matplotlib", "serial", "rosbags"}
