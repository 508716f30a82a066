"""Alert rules and dashboard for users of Prometheus: evaluated by a real one, on the metrics of a real daemon."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from paths import ROOT

DOCS = ROOT / "docs" / "monitoring"
RULES = re.findall(r"- alert: (\w+)", (DOCS / "alerts.yml").read_text())

DEVICE = 'device="a",instance="h",job="imumon"'
OF_N = 'channel="gyro/x",coefficient="N",' + DEVICE
FIRES: dict[str, dict[str, str]] = {
    "ImumonDown": {'up{instance="h",job="imumon"}': "0x20"},
    "ImumonSensorDisconnected": {f"imumon_up{{{DEVICE}}}": "0x20"},
    "ImumonNoSensor": {'up{instance="h",job="imumon"}': "1x20"},
    "ImumonReportOld": {f"imumon_report_age_seconds{{{DEVICE}}}": "0+60x20"},
    "ImumonAlarm": {f'imumon_alarm{{alarm="loss",{DEVICE}}}': "1x20"},
    "ImumonNoiseChanged": {f'imumon_caveat{{caveat="changed",channel="gyro/x",{DEVICE}}}': "1x20"},
    "ImumonStuck": {f'imumon_caveat{{caveat="constant",channel="gyro/x",{DEVICE}}}': "1x20"},
    "ImumonNoiseHigh": {
        f'imumon_noise{{{OF_N},limit="low"}}': "1x167 1.2x100",
        f'imumon_noise{{{OF_N},limit="high"}}': "1.05x167 1.3x100",
    },
}
"""Series by alert with which it fires, as `promtool test rules` writes them; one value a minute, for N an hour."""
QUIET = {
    'up{instance="h",job="imumon"}': "1x300",
    f"imumon_up{{{DEVICE}}}": "1x300",
    f"imumon_report_age_seconds{{{DEVICE}}}": "1x300",
    f'imumon_alarm{{alarm="loss",{DEVICE}}}': "0x300",
    f'imumon_caveat{{caveat="gaps",channel="gyro/x",{DEVICE}}}': "1x300",
    f'imumon_noise{{{OF_N},limit="low"}}': "1x300",
    f'imumon_noise{{{OF_N},limit="high"}}': "1.05x300",
}
"""Series with which none fires."""

installed = pytest.mark.skipif(
    shutil.which("prometheus") is None, reason="prometheus is not installed (Debian: prometheus)"
)


def name_of(series: str) -> str:
    return series.partition("{")[0]


@installed
@pytest.mark.parametrize("alert", RULES)
def test_each_rule_fires_for_its_fault_and_only_that(tmp_path: Path, alert: str) -> None:
    fires = FIRES[alert]
    step = "1h" if alert == "ImumonNoiseHigh" else "1m"
    at = "180h" if alert == "ImumonNoiseHigh" else "15m"
    others = {name_of(series) for series in fires}
    missing = {"imumon_up"} if alert == "ImumonNoSensor" else set()
    beside = {s: v for s, v in QUIET.items() if name_of(s) not in others | missing}
    tests = [
        {
            "interval": step,
            "input_series": [{"series": s, "values": v} for s, v in series.items()],
            "promql_expr_test": [
                {"expr": f'count by (alertname) (ALERTS{{alertstate="firing",alertname="{name}"}})', "eval_time": at,
                 "exp_samples": [{"labels": f'{{alertname="{name}"}}', "value": 1}] * (name == expected)}
                for name in RULES
            ],
        }
        for series, expected in ((fires | beside, alert), (QUIET, ""))
    ]  # fmt: skip
    whole = {"rule_files": [str(DOCS / "alerts.yml")], "evaluation_interval": step, "tests": tests}
    (tmp_path / "test.yml").write_text(json.dumps(whole))  # every JSON is YAML
    done = subprocess.run(
        ["promtool", "test", "rules", str(tmp_path / "test.yml")],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
