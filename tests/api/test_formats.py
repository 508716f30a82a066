"""Every format of a recording gives the numbers of its samples as arrays."""

from __future__ import annotations

from pathlib import Path

import pytest
from commands import imumon as command
from recordings import EXACT, WRITERS
from tables import truth

import imumon
from imumon.model.report import Report, from_json

SAMPLES = T, GYRO, ACCEL = truth(6_000)


@pytest.fixture(scope="module")
def of_arrays() -> Report:
    units = {"gyro": "rad/s", "accel": "m/s2"}  # as a file says them
    return imumon.analyse(gyro=GYRO, accel=ACCEL, time_s=T, units=units).report


@pytest.mark.few(3)
@pytest.mark.parametrize("name", EXACT)
def test_a_format_gives_the_numbers_of_its_samples(tmp_path: Path, of_arrays: Report, name: str) -> None:
    path = WRITERS[name](tmp_path / name, SAMPLES)
    of_file = imumon.analyse(path, accept=True).report
    assert of_file.channels == of_arrays.channels
    assert of_file.session.samples == of_arrays.session.samples == len(T)
    assert from_json(Report, command("replay", path, "--json")).channels == of_file.channels
