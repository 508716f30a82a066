"""The history of a real daemon: on the bus, through the command, after it was killed."""

from __future__ import annotations

import json
import signal
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zenoh
from commands import imumon
from daemons import Daemon
from histories import with_slopes, write
from waiting import until

CONFIG = "[state]\nsave_period_s = 1.0\n[report]\nperiod_s = 0.25\n"


def ask(endpoint: str, selector: str) -> tuple[list[dict[str, object]], list[str]]:
    """Replies and refusals of a get by plain Zenoh."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    found: list[dict[str, object]] = []
    refused = []
    with zenoh.open(config) as session:
        for reply in session.get(selector):
            if reply.ok is not None:
                assert str(reply.ok.encoding) == "application/json"
                found += json.loads(reply.ok.payload.to_bytes())
            else:
                refused.append(json.loads(reply.err.payload.to_bytes())["error"]["code"])
    return found, refused


def two_rows(endpoint: str) -> list[dict[str, object]] | None:
    """The rows of a channel; None if there are not two yet."""
    rows, _ = ask(endpoint, "imumon/lab/history?channel=gyro/x")
    return rows if len(rows) > 1 else None


@pytest.mark.slow
def test_history_of_a_daemon_from_the_bus_to_the_file(tmp_path: Path) -> None:
    """In time-lapse, 200 s a second: killed in the middle of a row, which then goes on."""
    config = tmp_path / "config.toml"
    config.write_text(CONFIG)
    words = ("--speed", "200", "--seed", "3", "--id", "lab", "--config", str(config))
    with Daemon("sim", tmp_path, *words) as daemon:
        daemon.wait(lambda r: r.session.elapsed_s > 3700, 150.0)
        rows = until(lambda: two_rows(daemon.endpoint))
        assert [row["complete"] for row in rows[:-1]] == [True] * (len(rows) - 1)
        assert rows[-1]["complete"] is False
        assert {(row["device"], row["channel"], row["step"]) for row in rows} == {("lab", "gyro/x", "1h")}
        assert rows[0]["N"]["status"] == "measured"
        assert ask(daemon.endpoint, "imumon/lab/history?_time=[now(-2h)..now(-1h)]") == ([], [])
        assert ask(daemon.endpoint, "imumon/lab/history?step=7m") == ([], ["step_invalid"])
        whole, _ = ask(daemon.endpoint, "imumon/lab/history?step=1d")
        assert {row["channel"] for row in whole} >= {"gyro/x", "accel/z", "temperature"}
        kinds = {each["kind"] for each in ask(daemon.endpoint, "imumon/lab/history/event")[0]}
        assert {"connect", "grade"} <= kinds
        said = imumon("history", "--connect", daemon.endpoint, "--channel", "gyro/y", code=0)
        assert len(said.splitlines()) >= 3
        daemon.stop(signal.SIGKILL)
    before = json.loads(imumon("history", "--state", str(tmp_path), "--channel", "gyro/x", "--json"))
    assert len(before) >= 2
    assert sum(row["samples"] for row in before) > 3600 * 100


def test_a_restarted_daemon_reports_that_the_slope_of_the_bias_has_changed(tmp_path: Path) -> None:
    """The days are those of earlier runs, some of which ended in the middle of a day."""
    scatter = 1e-7 * np.random.default_rng(5).standard_normal(31)
    slopes = np.where(np.arange(31) < 24, -1e-6, 1e-6) + scatter
    days = with_slopes(slopes.tolist(), 1e-7, begin=time.time() - 32 * 86400)
    for number, day in enumerate(days[20:], 20):
        cut = replace(day.period, complete=False, number=0)
        days[number] = replace(
            day, record=f"2026-02-{number:02}T00:00:00.000Z", end=day.begin + 40_000, period=cut
        )
    write(tmp_path, "lab", days)
    with Daemon("sim", tmp_path, "--id", "lab", "--fresh") as daemon:
        daemon.samples(10)
        (event,) = until(lambda: [e for e in daemon.viewer.events("lab") if e.kind == "change"])
        assert (event.channel, event.level) == ("gyro/x", "warning")
        assert event.text.startswith("gyro/x: the slope against the temperature has moved from -")
