"""`imumon.Live`: blocks of any size give the report of all samples, also after results in between."""

from __future__ import annotations

import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from analyses import comparable

import imumon
from imumon.model.errors import ImumonError
from imumon.sources.files.base import ROWS

RATE = 200.0
CHANNELS = ("gyro/x", "gyro/y", "gyro/z", "temperature")


@pytest.fixture(scope="module")
def rows() -> np.ndarray:
    """Return (n, 4) samples with a knock and missing values, longer than two blocks that are read at once."""
    rng = np.random.default_rng(3)
    gyro = imumon.simulate(70_000, RATE, N=[6.1e-5] * 3, B=2.4e-5, seed=2)
    gyro[30_000:30_200] += rng.normal(0.0, 0.05, (200, 3))
    gyro[rng.random(len(gyro)) < 0.001, 1] = np.nan
    return np.column_stack([gyro, 25.0 + 1e-5 * np.arange(len(gyro))])


@pytest.fixture(scope="module")
def timed(rows: np.ndarray) -> tuple[np.ndarray, Any]:
    """Return the times of the rows, with a gap, and the report of all rows."""
    t = 3.0 + np.arange(len(rows)) / RATE
    t[50_000:] += 2.0
    return t, comparable(imumon.analyse(gyro=rows[:, :3], temperature=rows[:, 3], time_s=t).report)


@pytest.mark.few
@pytest.mark.parametrize("size", [97, 40_000])
def test_blocks_of_any_size_give_the_report_of_all_samples(
    rows: np.ndarray, timed: tuple[np.ndarray, Any], size: int
) -> None:
    t, expected = timed
    live = imumon.Live(channels=CHANNELS)
    for first in range(0, len(rows), size):
        live.update(rows[first : first + size], time_s=t[first : first + size])
        if first == 400 * 97:
            live.result()
    assert comparable(live.result().report) == expected
    assert comparable(live.result().report) == expected, "a result changes nothing"


def test_missing_samples_are_a_mask_or_a_number_before_the_block() -> None:
    gyro = imumon.simulate(3000, RATE, N=[6.1e-5] * 3, seed=2)
    holes = gyro.copy()
    holes[1000:1040] = np.nan
    expected = comparable(imumon.analyse(holes, rate_hz=RATE).report)
    masked, counted = imumon.Live(rate_hz=RATE), imumon.Live(rate_hz=RATE)
    masked.update(gyro, missing=np.isnan(holes[:, 0]))
    counted.update(gyro[:1000])
    counted.update(gyro[1040:], missing=40)
    assert comparable(masked.result().report) == comparable(counted.result().report) == expected


def test_a_number_of_missing_samples_is_arithmetic() -> None:
    """It equals as many rows, and costs no memory: a gap of more than a month has no known length."""
    gyro, count = imumon.simulate(2000, RATE, N=[6.1e-5] * 3, seed=2), 5 * ROWS + 7
    rows, counted, longest = (imumon.Live(rate_hz=RATE) for _ in range(3))
    for live in (rows, counted, longest):
        live.update(gyro[:1000])
    rows.update(np.full((count, 3), np.nan))
    rows.update(gyro[1000:])
    counted.update(gyro[1000:], missing=count)
    assert comparable(rows.result().report) == comparable(counted.result().report)
    tracemalloc.start()
    longest.update(gyro[1000:], missing=10**18)
    assert tracemalloc.get_traced_memory()[1] < 50e6
    tracemalloc.stop()
    session = longest.result().report.session
    assert (session.samples, session.missing, session.restarts) == (2000, 0, 1)


@pytest.mark.parametrize(
    ("options", "update", "code"),
    [
        ({"channels": ("gyro/x", "gyro/w")}, {}, "channels_invalid"),
        (
            {"channels": ("gyro/x", "gyro/y"), "rate_hz": 10.0},
            {"block": np.zeros((5, 2))},
            "map_incomplete",
        ),
        ({}, {"block": np.zeros((5, 3))}, "rate_required"),
        ({"rate_hz": 0.0}, {}, "rate_invalid"),
        ({"rate_hz": 10.0}, {"block": np.zeros((5, 2))}, "array_shape"),
        ({"rate_hz": 10.0}, {"block": np.full((5, 3), "a")}, "array_type"),
        ({"rate_hz": 10.0}, {"block": np.zeros((5, 3)), "missing": np.zeros(4, bool)}, "missing_invalid"),
        ({}, {"block": np.zeros((5, 3)), "time_s": np.zeros(4)}, "array_shape"),
        ({"rate_hz": 10.0}, {"block": np.zeros((0, 3))}, "no_rows"),
        ({"rate_hz": 10.0}, {"block": np.zeros((50, 3))}, "all_constant"),
    ],
)
def test_what_is_no_block_is_an_error_with_a_cure(
    options: dict[str, Any], update: dict[str, Any], code: str
) -> None:

    def tried() -> None:
        live = imumon.Live(**options)
        live.update(**update)
        live.result()

    with pytest.raises(ImumonError) as error:
        tried()
    assert (error.value.code, bool(error.value.cure)) == (code, True)
    assert "--" not in str(error.value)


def test_a_saved_record_continues_where_it_was(
    tmp_path: Path, rows: np.ndarray, timed: tuple[Any, Any]
) -> None:
    t, expected = timed
    live = imumon.Live(channels=CHANNELS)
    live.update(rows[:40_000], time_s=t[:40_000])
    live.save(tmp_path / "a.live")
    saved = imumon.Live.load(tmp_path / "a.live")
    n = live.result()["gyro/x"].N
    saved.update(rows[40_000:], time_s=t[40_000:])
    report = saved.result().report
    for field in ("samples", "missing", "disturbances", "elapsed_s", "restarts"):
        assert getattr(report.session, field) == getattr(expected.session, field), field
    n, whole = report.channels["gyro/x"].N, expected.channels["gyro/x"].N
    assert n.value == pytest.approx(
        whole.value, rel=2e-3
    )  # segments of the spectrum in progress are not saved
    (tmp_path / "b.live").write_bytes(b"nothing")
    for path, code in ((tmp_path / "b.live", "state_invalid"), (tmp_path / "c.live", "file_unreadable")):
        with pytest.raises(ImumonError) as error:
            imumon.Live.load(path)
        assert error.value.code == code
    with pytest.raises(ImumonError) as error:
        imumon.Live(rate_hz=10.0).save(tmp_path / "d.live")
    assert error.value.code == "no_rows"
