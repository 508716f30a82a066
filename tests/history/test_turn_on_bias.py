"""Turn-on bias from end to end: a running daemon, and a sensor that is powered up six times."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import run_inside
from daemons import Daemon
from faulty_sensor import spawn
from paths import ROOT

from imumon.history import HistoryStore
from imumon.history.power_ups import LEAST_POWER_UPS
from imumon.history.store import SUFFIX
from imumon.model.report import Distribution, Report
from imumon.sources.vn100.emulator import EmulatorSettings, Noise

POWER_UPS = 6
SPEED = 5000.0
LAPSE = (sys.executable, str(ROOT / "tests" / "lapse.py"), f"{SPEED:g}")


def shape(report: Report) -> Distribution:
    channel = report.channels.get("gyro/x")
    return channel.distribution if channel and channel.distribution else Distribution()


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_report_gives_the_repeatability_over_six_power_ups(tmp_path: Path) -> None:
    """The daemon is restarted half-way, which is no power-up. The truth is in the rows of the history."""
    walks = Noise.equal(6.1e-5, 0.0, 5e-6)
    port, state = str(tmp_path / "port"), tmp_path / "state"
    settings = EmulatorSettings(seed=6, baud=57600, speed=SPEED, warm_up=0.0, link=port, gyro=walks)
    with spawn(settings) as sensor:
        for runs in (range(1, 4), range(4, POWER_UPS + 1)):
            with Daemon(port, state, before=LAPSE) as daemon:
                for number in runs:
                    report = daemon.wait(lambda r, n=number: shape(r).turn_on_count == n, timeout=200.0)
                    assert (shape(report).turn_on_std is None) == (number < LEAST_POWER_UPS)
                    if number < POWER_UPS:
                        restarts = report.session.restarts
                        sensor.ask("reboot")
                        daemon.wait(lambda r, n=restarts: r.session.restarts > n)
                report = daemon.wait(lambda r: True)
                code, sheet, _ = run_inside(["report", "--connect", daemon.endpoint])
                left, _, said = daemon.stop()
                assert (code, left) == (0, 0), said
    assert f"{POWER_UPS} power-ups" in sheet
    assert shape(report).turn_on_count == POWER_UPS
    low, std, high = (getattr(shape(report), f"turn_on_{name}") for name in ("low", "std", "high"))
    assert low < std < high
    _, text, _ = run_inside(
        ["history", "--state", str(state), "--channel", "gyro/x", "--step", "1h", "--json"]
    )
    means = np.array([row["mean"] for row in json.loads(text) if row["complete"]])
    with HistoryStore(next(state.glob(f"*{SUFFIX}"))) as store:
        biases = [power_up.means["gyro/x"] for power_up in store.power_ups()]
    assert len(set(biases)) == POWER_UPS
    assert all(np.min(np.abs(means - bias)) < 1e-4 * std for bias in biases), (biases, means)
    assert std == pytest.approx(np.std(biases, ddof=1))
