"""What the tests of documents share: a recording of known noise, and its saved report."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from commands import imumon
from tables import csv

from imumon.noise.synthesis import synthesise

HZ = 40.0


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return two minutes at rest as CSV, N known, without a device or a filter."""
    path = tmp_path_factory.mktemp("recording") / "rest.csv"
    noise = synthesise(4_800, HZ, N=[6e-5] * 3 + [1.4e-3] * 3, seed=4)
    noise[:, 5] -= 9.8
    names = "t [s],wx [rad/s],wy [rad/s],wz [rad/s],ax [m/s^2],ay [m/s^2],az [m/s^2]"
    return csv(path, names.split(","), np.arange(4_800) / HZ, noise)


@pytest.fixture(scope="session")
def saved(recording: Path) -> Path:
    """Return the saved report of the recording."""
    path = recording.with_name("saved.json")
    assert imumon("report", recording, "-o", path) == ""
    return path
