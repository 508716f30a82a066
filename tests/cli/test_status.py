"""Command `imumon status`: one screen, everything, or plain values."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import reports
from commands import run_inside
from paths import ROOT
from test_check import published

from imumon.datasheet.tables import status_table
from imumon.report import Report


@pytest.fixture
def report() -> Report:
    running = reports.report(state="running")
    return replace(running, precision={"N": 0.001, "B": 0.15, "K": 0.5})


def test_it_is_one_screen_with_the_state_first(report: Report) -> None:
    lines = status_table(report, 80, None).splitlines()
    assert len(lines) < 24
    assert lines[0].startswith(f"running: {report.device.id}, VN-100T-CR ")
    assert max(map(len, lines)) <= 80
    for name, channel in report.channels.items():
        assert sum(line.startswith(f"{name} ") for line in lines) == bool(channel.coefficients)
    assert any(line.startswith("caveats: aliased") for line in lines) == ("aliased" in report.caveats)
    assert any(line.startswith("still to come: ") and "B within ±15 % in " in line for line in lines)


def test_why_the_numbers_are_not_current_is_in_the_second_line(report: Report) -> None:
    lines = status_table(
        replace(report, state="waiting"), 80, "the sensor is disconnected: gone"
    ).splitlines()
    assert lines[0].startswith("waiting: ")
    assert lines[1] == "the sensor is disconnected: gone"
    assert not any(line.startswith("still to come") for line in lines)


def test_the_command_prints_a_screen_everything_or_values(report: Report) -> None:
    with published(report) as endpoint:
        where = ["status", "--connect", endpoint]
        code, screen, errors = run_inside(where)
        assert (code, errors) == (0, "")
        assert screen.startswith("running: ")
        _, everything, _ = run_inside([*where, "--verbose"])
        assert len(everything.splitlines()) > len(screen.splitlines())
        assert "bias, 95 %" in everything
        _, values, _ = run_inside([*where, "--values"])
        assert run_inside([*where, "--values", "--json"])[0] == 2
    rows = [line.split("\t") for line in values.splitlines()]
    assert [row[0] for row in rows] == [
        name for name, channel in report.channels.items() if channel.coefficients
    ]
    for name, *texts in rows:
        for letter, text in zip("NBK", texts, strict=True):
            part = report.channels[name].coefficients[letter]
            known = part.high if part.is_bound else part.value
            assert text.startswith("<") == part.is_bound
            assert (float(text.lstrip("<")) == pytest.approx(known, rel=1e-5)) if text else known is None


def test_a_replay_prints_values_too(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    file = tmp_path / "imu.csv"
    rows = np.column_stack([np.arange(2000) * 0.01, rng.normal(0.0, 1e-3, 2000)])
    np.savetxt(file, rows, delimiter=",", header="t,gyro_x [rad/s]", comments="")
    code, values, _ = run_inside(["replay", str(file), "--values"])
    name, *texts = values.rstrip("\n").split("\t")
    assert (code, name, len(texts)) == (0, "gyro/x", 3)
    assert float(texts[0]) == pytest.approx(1e-4, rel=0.1)


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
    assert not loaded & {"numpy", "scipy", "pydantic", "textual", "matplotlib", "serial", "rosbags"}
