"""A recording of noise that is known, and its saved report."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from commands import imumon
from evaluations import HZ

from imumon.noise.synthesis import synthesise


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return 50 s at rest as CSV, N known, without a device or a filter."""
    path = tmp_path_factory.mktemp("recording") / "rest.csv"
    noise = synthesise(2000, HZ, N=[6e-5] * 3 + [1.4e-3] * 3, seed=4)
    noise[:, 5] -= 9.8
    names = "t [s],wx [rad/s],wy [rad/s],wz [rad/s],ax [m/s^2],ay [m/s^2],az [m/s^2]"
    rows = np.column_stack([np.arange(2000) / HZ, noise])
    np.savetxt(path, rows, delimiter=",", header=names, comments="", fmt="%.12g")
    return path


@pytest.fixture(scope="session")
def gyroscope(recording: Path) -> Path:
    """Return the gyroscope of the recording alone: an analysis takes half the time."""
    path = recording.with_name("gyro.csv")
    rows = (line.split(",")[:4] for line in recording.read_text().splitlines())
    path.write_text("\n".join(",".join(row) for row in rows) + "\n")
    return path


@pytest.fixture(scope="session")
def saved(recording: Path) -> Path:
    """Return the saved report of the recording."""
    path = recording.with_name("saved.json")
    imumon("report", recording, "-o", path)
    return path
