"""Rows in memory become the same samples as a file of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tables import G, truth

from imumon.model.samples import SampleBlock
from imumon.sources.files import ReadOptions, open_recording
from imumon.sources.files.base import RowSource
from imumon.sources.files.column_reader import read_columns
from imumon.sources.files.table import RowDecoder

NAMES = ["note", "t_s", "gyro_x_rps", "gyro_y_rps", "gyro_z_rps", "ax_g", "ay_g", "az_g", "temperature"]
UNITED = [name.replace("_g", " [g]") if name.endswith("_g") else name for name in NAMES]
"""As the names of arrays are read: a unit at their end is in brackets."""


def rows_with_faults(stamps: str) -> np.ndarray:
    """Return rows with names `NAMES`: late, doubled and lost ones, some without a number, a slow temperature.

    Parameters
    ----------
    stamps : ``clock`` of the sensor, or ``host``, which has jitter.
    """
    rng = np.random.default_rng(7)
    t, gyro, accel = truth(50_000)
    kept = rng.random(len(t)) > 0.01
    if stamps == "host":
        t = t + rng.uniform(0.0, 0.2 * (t[1] - t[0]), len(t)) + 1.7e9
    temperature = np.where(np.arange(len(t)) % 10, np.nan, 25.0)
    rows = np.column_stack([np.zeros(len(t)), t, gyro, accel / G, temperature])
    rows[rng.random(len(t)) < 0.002, 3] = np.nan
    rows = rows[kept]
    for late in range(100, len(rows), 1000):
        rows[late : late + 2] = rows[late : late + 2][::-1]
    return np.insert(rows, range(0, len(rows), 50), rows[::50], axis=0) if stamps == "clock" else rows


def joined(blocks: list[SampleBlock], field: str) -> np.ndarray:
    return np.concatenate([getattr(block, field) for block in blocks])


@pytest.mark.parametrize("stamps", ["clock", "host"])
@pytest.mark.parametrize("size", [1 << 15, 1000], ids=["blocks-of-the-file", "small-blocks"])
def test_rows_in_memory_give_the_samples_of_a_file(tmp_path: Path, stamps: str, size: int) -> None:
    rows = rows_with_faults(stamps)
    path = tmp_path / "a.npz"
    np.savez(path, **{name: rows[:, k] for k, name in enumerate(NAMES)})
    recording = open_recording(str(path), ReadOptions(accept=True))
    from_file = [item for items in recording for item in items if isinstance(item, SampleBlock)]

    decoder = RowDecoder(RowSource(str(path), "npz", UNITED), read_columns(UNITED, (), rows).layout(), None)
    from_memory = []
    for start in range(0, len(rows), size):
        block = rows[start : start + size, decoder.columns]
        from_memory += decoder.feed(block, range(start + 1, start + len(block) + 1))
    from_memory += decoder.finish()

    assert {block.stream for block in from_memory} == {block.stream for block in from_file} != set()
    assert np.array_equal(joined(from_memory, "values"), joined(from_file, "values"))
    assert np.array_equal(joined(from_memory, "lost"), joined(from_file, "lost"))
    if stamps == "clock":
        assert np.array_equal(joined(from_memory, "time_ns"), joined(from_file, "time_ns"))
    assert decoder.remarks == list(recording.remarks)
    assert decoder.started == recording.started
    assert decoder.incomplete == recording.bad_checksums > 0
