"""Measurements and what makes them cross the border of a process, as the page about fleets needs."""

from __future__ import annotations

import pickle
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from blocks_at_rest import NOW, block
from paths import ROOT

import imumon
from imumon.model.report import DeviceDescription, SessionCounters
from imumon.model.samples import ACCEL, GYRO, Floats
from imumon.record import Record

N = 1e-4
"""rad/s/√Hz"""
RATE = 100.0


def samples(seed: int, n: int = 6000) -> tuple[Floats, Floats]:
    gyro = imumon.simulate(n, RATE, N=[N] * 3, seed=seed)
    accel = imumon.simulate(n, RATE, N=[1e-3] * 3, bias=[0.0, 0.0, 9.81], seed=seed + 1000)
    return gyro, accel


def test_a_measurement_and_a_growing_record_continue_in_another_process() -> None:
    gyro, accel = samples(1)
    m = imumon.analyse(gyro=gyro, accel=accel, rate_hz=RATE, kind="average")
    assert pickle.loads(pickle.dumps(m)).report == m.report
    live = imumon.Live(RATE, channels=(*GYRO, *ACCEL))
    rows = np.hstack((gyro, accel))
    live.update(rows[:3000])
    copy = pickle.loads(pickle.dumps(live))
    for one in (live, copy):
        one.update(rows[3000:])
    assert copy.result().report.channels == live.result().report.channels
    record = Record()
    record.feed(block(3000))
    other = pickle.loads(pickle.dumps(record))
    for one in (record, other):
        one.feed(block(3000, 3000))
        one.flush()
    device, session = DeviceDescription(id="x"), SessionCounters()
    assert other.report(NOW, device, "running", session) == record.report(NOW, device, "running", session)


@pytest.mark.slow
def test_the_program_of_the_page_combines_recordings_on_a_local_cluster(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="the extra test has dask")
    (program,) = re.findall(
        r"```python example\n(.*?)```", (ROOT / "docs" / "FLEET.md").read_text(), re.DOTALL
    )
    (tmp_path / "fleet.py").write_text(program)
    names = "t_s," + ",".join(f"gyro_{axis} [rad/s]" for axis in "xyz")
    for k in range(4):
        table = np.column_stack((np.arange(6000) / RATE, samples(k)[0]))
        np.savetxt(tmp_path / f"{k}.csv", table, "%.9g", ",", header=names, comments="")
    (tmp_path / "damaged.csv").write_text(f"{names}\n")
    done = subprocess.run(
        [sys.executable, "fleet.py", "."],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
        timeout=250,
    )
    assert "damaged.csv: " in done.stdout
    together = imumon.load(tmp_path / "sensor.json")
    for axis in "xyz":
        assert together[f"gyro/{axis}"].N.value == pytest.approx(N, rel=0.03)
