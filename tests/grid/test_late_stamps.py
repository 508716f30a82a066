"""Single late stamps of an even clock: no sample is lost, and none counts twice."""

from __future__ import annotations

import gzip
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from paths import RECORDINGS, needs_recordings
from tables import replayed
from test_live_stamps import measure

from imumon.grid.stamp_placement import LateStamps
from imumon.model.samples import Ints

STEP = 5_000_000


def placed(stamps: Ints, lost: Ints | None = None, chunk: int = 1 << 20) -> Ints:
    """Times of a record that arrives in chunks."""
    late = LateStamps(STEP)
    lost = np.zeros(len(stamps), np.int64) if lost is None else lost
    parts = [slice(begin, begin + chunk) for begin in range(0, len(stamps), chunk)]
    rows = [late.place(stamps[part], lost[part]) for part in parts]
    nothing = np.empty(0, np.int64)
    rows.append(late.place(nothing, nothing, final=True))
    steps = np.concatenate([some.steps for some in rows])
    times = np.concatenate([some.times for some in rows])
    np.testing.assert_array_equal(steps[1:], np.maximum(1, np.rint(np.diff(times) / STEP)))
    return times


def grid(count: int = 1000) -> Ints:
    return np.arange(count, dtype=np.int64) * STEP


def test_stamps_in_time_are_used_as_they_are() -> None:
    stamps = grid() + np.random.default_rng(1).integers(-STEP // 10, STEP // 10, 1000)
    np.testing.assert_array_equal(placed(stamps), stamps)
    gaps = np.delete(grid(), [100, 200, 201, *range(300, 700)])
    np.testing.assert_array_equal(placed(gaps), gaps)


@pytest.mark.few
@pytest.mark.parametrize("delay", [0.4, 0.9, 1.3, 30.0, 150.0])
def test_late_rows_are_placed_where_they_belong(delay: float) -> None:
    """A host that is busy stamps some rows when it is free again, one shortly after the other."""
    stamps = grid()
    free = stamps[500] + round(delay * STEP)
    stamps[500:] = np.maximum(stamps[500:], free + np.arange(500) * 20_000)
    np.testing.assert_allclose(placed(stamps), grid(), atol=STEP * 0.25)


def test_late_rows_behind_a_loss_leave_the_loss() -> None:
    stamps = np.delete(grid(), [500, 501])
    stamps[500] += STEP * 0.9
    np.testing.assert_array_equal(placed(stamps), np.delete(grid(), [500, 501]))


def test_a_known_loss_explains_a_long_step_at_once() -> None:
    stamps, late = np.delete(grid(100), [50]), LateStamps(STEP)
    lost = np.diff(stamps, prepend=-STEP) // STEP - 1
    assert len(late.place(stamps[:60], lost[:60])) == 60
    unknown = LateStamps(STEP)
    assert len(unknown.place(stamps[:60], 0 * lost[:60])) == 50


@pytest.mark.few
@pytest.mark.parametrize("wrong", [4_000_000_000 * 10**9, 800 * STEP, 0, -(10**18)])
def test_a_wrong_stamp_is_not_a_late_one(wrong: int) -> None:
    stamps = grid()
    stamps[500] = wrong
    np.testing.assert_array_equal(placed(stamps), stamps)


def test_another_rate_is_no_delay() -> None:
    for step in (2 * STEP, STEP // 2):
        stamps = np.concatenate([grid(), grid()[-1] + np.arange(1, 1001) * step])
        np.testing.assert_array_equal(placed(stamps), stamps)


@given(st.data())
def test_any_stamps_have_a_time_whatever_the_blocks(data: st.DataObject) -> None:
    steps = st.sampled_from(
        [STEP, STEP, STEP, STEP, 2 * STEP, 9 * STEP, STEP // 3, STEP // 99, 0, -STEP, 10**17]
    )
    stamps = np.cumsum(np.array(data.draw(st.lists(steps, max_size=300)), np.int64))
    lost = np.array(
        data.draw(st.lists(st.sampled_from([0, 0, 0, 1, 8]), min_size=300, max_size=300)), np.int64
    )
    lost = lost[: len(stamps)]
    whole = placed(stamps, lost)
    assert len(whole) == len(stamps)
    for chunk in (1, data.draw(st.integers(2, 99))):
        np.testing.assert_array_equal(placed(stamps, lost, chunk), whole)


REAL = [
    ("kiran_stat5min", 1),
    ("kiran_stat5min", 2),
    ("fc_cal_square", 2),
    ("fc_drive_circle", 1),
    ("fc_drive_circle", 2),
    ("sahq_parked", 1),
    ("sahq_drive_circles", 2),
]


@pytest.mark.few
@needs_recordings
@pytest.mark.parametrize(("name", "column"), REAL)
def test_real_stamps_of_hosts_lose_nothing(tmp_path: Any, name: str, column: int) -> None:
    """A sensor at 40 Hz, of which no sample is lost, stamped by drivers and by recorders."""
    lines = gzip.decompress((RECORDINGS / f"{name}.hosttime.csv.gz").read_bytes()).decode().splitlines()[1:]
    stamps = np.array([int(line.split(",")[column].replace(".", "")) for line in lines], np.int64)
    for chunk in (40, 1000):
        session, rate, _ = measure(stamps, chunk=chunk)
        assert (session.samples, session.missing, session.duplicates) == (len(stamps), 0, 0)
        assert (session.restarts, rate) == (0, pytest.approx(40.0, rel=2e-3))
    noise = np.random.default_rng(1).normal(size=len(lines))
    rows = [f"{line.split(',')[column]},{x:.6f}" for line, x in zip(lines, noise.tolist(), strict=True)]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["time [s],gyro_x [rad/s]", *rows]))
    session_of_table = replayed(path)[0].session
    assert (session_of_table.samples, session_of_table.missing) == (len(stamps), 0)
