"""Six sensors, each with a real daemon: one degraded, one lossy, one unplugged. Every alarm shows these three."""

from __future__ import annotations

import json
import time
from contextlib import ExitStack
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import pytest
from commands import run_inside
from daemons import Daemon
from faulty_sensor import spawn
from laws import WHITE
from metrics_viewer import metrics_of
from test_history_daemon import ask

from imumon.model.report_json import to_json
from imumon.sources.vn100.emulator import EmulatorSettings

NAMES = [f"imu{number}" for number in range(1, 7)]
DEGRADED, LOSSY, UNPLUGGED = NAMES[1:4]
KINDS = {DEGRADED: "change", LOSSY: "loss", UNPLUGGED: "disconnect"}
CODES = {DEGRADED: 1, LOSSY: 1, UNPLUGGED: 2}
QUIET_S = 10.0
"""s without samples after which the alarms are looked at: the guards hold back the last seconds."""
BAD_GYRO = replace(WHITE["gyro"], n=tuple(2.0 * n for n in WHITE["gyro"].n))


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_six_sensors_of_which_three_have_a_fault(tmp_path: Path) -> None:
    with ExitStack() as stack:
        sensors = {}
        for number, name in enumerate(NAMES):
            noise = {**WHITE, **({"gyro": BAD_GYRO} if name == DEGRADED else {})}
            settings = EmulatorSettings(
                seed=number, serial=f"010000000{number}", warm_up=0.0, link=str(tmp_path / name), **noise
            )
            sensors[name] = stack.enter_context(spawn(settings))
        daemons: dict[str, Daemon] = {}
        for name in NAMES:
            words = ["--id", name]
            config = tmp_path / f"{name}.toml"
            config.write_text(
                f"[alert]\ncommand = 'cat >> {tmp_path}/{name}.alerts'\n[log]\nformat = 'json'\n"
            )
            if name == DEGRADED:  # compared with what a good sensor has
                good = daemons[NAMES[0]].samples(2000)
                (tmp_path / "good.json").write_text(to_json(good))
                with config.open("a") as file:
                    file.write(f"[report]\nbaseline = '{tmp_path}/good.json'\n")
            daemon = Daemon(str(tmp_path / name), tmp_path / f"{name}.state", "--config", str(config), *words)
            daemons[name] = stack.enter_context(daemon)
        for daemon in daemons.values():
            daemon.samples(300)
        sensors[LOSSY].ask("fault drop=0.2")
        unplugged_at = time.time()
        sensors[UNPLUGGED].ask("unplug")
        daemons[DEGRADED].wait(lambda r: any("changed" in c.caveats for c in r.channels.values()))
        daemons[LOSSY].wait(lambda r: (r.session.recent_loss or 0.0) > 0.02)
        daemons[UNPLUGGED].wait(lambda r: r.state == "waiting")
        time.sleep(QUIET_S)
        places = [word for daemon in daemons.values() for word in ("--connect", daemon.endpoint)]

        checks = {name: run_inside(["check", *places, "--id", name])[:2] for name in NAMES}
        assert {name: code for name, (code, _) in checks.items() if code} == CODES, checks
        assert "gyro/x: N has grown by" in checks[DEGRADED][1]
        assert "of the last minute" in checks[LOSSY][1]
        assert "the sensor is disconnected: " in checks[UNPLUGGED][1]

        code, status, _ = run_inside(["status", *places])
        lines = {line.split()[0]: line for line in status.splitlines()}
        assert (code, list(lines)) == (0, NAMES)
        assert {name for name, line in lines.items() if "changed" in line} == {DEGRADED}
        assert {name for name, line in lines.items() if "  loss 0 %" not in line} == {LOSSY}
        assert {name for name, line in lines.items() if "  waiting  " in line} == {UNPLUGGED}

        kinds = set(KINDS.values())
        shown = {name: metrics_of(daemon.endpoint) for name, daemon in daemons.items()}
        assert {name for name in NAMES if shown[name]["imumon_up",] == 0.0} == {UNPLUGGED}
        changed = ("imumon_caveat", "changed", "gyro/x")
        assert {name for name in NAMES if changed in shown[name]} == {DEGRADED}
        counted = {name: {k for k in kinds if shown[name]["imumon_events_total", k]} for name in NAMES}
        assert {name: there for name, there in counted.items() if there} == {n: {k} for n, k in KINDS.items()}

        rows = {}
        for name, daemon in daemons.items():
            events, _ = ask(daemon.endpoint, f"imumon/{name}/history/event")
            there = {str(each["kind"]) for each in events} & kinds
            assert there == ({KINDS[name]} if name in KINDS else set()), events
            code, text, _ = run_inside(["history", *places, "--id", name, "--channel", "gyro/x", "--json"])
            (rows[name],) = json.loads(text)
        assert {name for name, row in rows.items() if row["missing"] > 0.02 * row["samples"]} == {LOSSY}
        assert {name for name, row in rows.items() if row["N"]["value"] > 1.5 * WHITE["gyro"].n[0]} == {
            DEGRADED
        }
        ends = {name: datetime.fromisoformat(row["end"]).timestamp() for name, row in rows.items()}
        assert {name for name in NAMES if ends[name] < unplugged_at + 0.5 * QUIET_S} == {UNPLUGGED}, ends

        alerts = {name: tmp_path / f"{name}.alerts" for name in NAMES}
        alerted = {
            name: {json.loads(line)["kind"] for line in path.read_text().splitlines()} & kinds
            for name, path in alerts.items()
            if path.exists()
        }
        assert {name: found for name, found in alerted.items() if found} == {n: {k} for n, k in KINDS.items()}
        for name, daemon in daemons.items():
            _, _, log = daemon.stop()
            logged = [json.loads(line) for line in log.splitlines() if line.startswith("{")]
            warned = {each["kind"] for each in logged if each["level"] == "warning"} & kinds
            assert warned == ({KINDS[name]} if name in KINDS else set()), log
