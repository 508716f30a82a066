"""Files of public programs: never a wrong number without a question, and the right one with the proposal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from public_formats import ACCEL_N, FORMATS, GYRO_N, RATE, PublicFormat

from imumon.model.errors import ImumonError
from imumon.model.samples import SampleBlock
from imumon.sources.files import ReadOptions, open_recording

WITHIN = 0.2
"""Share by which the white noise of 1200 samples may differ from the true one."""

ONE_SENSOR = (
    "GnssLogger",
    "GetSensorData",
    "RealSense recorder",
    "iSensor FX3 evaluation",
    "Inertial Sense PIMU",
)
"""Formats of which the proposal has one of both sensors."""

OWNER = (
    "MPU6050_raw of i2cdevlib",
    "Empatica ACC",
    "KITTI OXTS",
    "NovAtel RAWIMUSXA",
    "iSensor FX3 evaluation",
)
"""Formats of which only the owner knows the size of a count, or that have one row."""


def faults(form: PublicFormat, path: Path, **options: object) -> list[str]:
    """Return what is wrong with the samples of a file; raise `ImumonError` if it is not read."""
    recording = open_recording(str(path), ReadOptions(**options))  # type: ignore[arg-type]
    blocks = [block for some in recording for block in some if isinstance(block, SampleBlock)]
    values, channels = np.concatenate([block.values for block in blocks]), blocks[0].stream.channels
    wrong = []
    for sensor, noise in (("gyro", GYRO_N), ("accel", ACCEL_N)):
        for axis, true in zip("xyz", noise, strict=True):
            if f"{sensor}/{axis}" in channels:
                column = values[:, channels.index(f"{sensor}/{axis}")]
                ratio = np.diff(column).std() / 2.0**0.5 / RATE**0.5 / true
                wrong += [f"{sensor}/{axis} {ratio:.3g}"] * bool(abs(ratio - 1.0) > WITHIN)
            elif sensor in form.sensors and form.name not in ONE_SENSOR:
                wrong.append(f"no {sensor}/{axis}")
    return wrong


@pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)
def test_a_public_format_is_read_right_or_asked(tmp_path: Path, form: PublicFormat) -> None:
    path = tmp_path / form.file
    path.write_text(form.text())
    code = ""
    try:
        wrong = faults(form, path)
    except ImumonError as error:
        wrong, code = [], error.code
    assert not wrong
    assert code in ("", "columns_unclear", "no_sensor")
    if code and form.name not in OWNER:
        assert not faults(form, path, accept=True)
