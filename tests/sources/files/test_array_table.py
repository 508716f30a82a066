"""Arrays of a program: their samples, and refusal of what is no number."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tables import truth

from imumon.sources.files import RecordingError
from imumon.sources.files.array_table import ArrayTable
from imumon.sources.files.base import OptionError, ReadOptions


def samples(arrays: dict[str, Any], **options: Any) -> tuple[np.ndarray, ArrayTable]:
    table = ArrayTable(arrays, ReadOptions(**({"accept": True} | options)))
    blocks = [block for blocks in table for block in blocks]
    return np.concatenate([block.values for block in blocks]), table


@pytest.mark.parametrize("form", ["masked", "nan", "list with None", "float32"])
def test_missing_values_are_lost_samples(form: str) -> None:
    _, gyro, _ = truth(300)
    holes = gyro.copy()
    holes[[10, 11, 200], [0, 1, 2]] = np.nan
    given: Any = holes
    if form == "masked":
        given = np.ma.masked_array(gyro, np.isnan(holes))
    elif form == "list with None":
        given = [[None if value != value else value for value in row] for row in holes.tolist()]
    elif form == "float32":
        given = holes.astype(np.float32)
    values, table = samples({"gyro": given}, rate_hz=100.0)
    assert len(values) == 297
    assert table.bad_checksums == 3


@pytest.mark.parametrize("name", ["gyro", "t"])
@pytest.mark.parametrize(
    "bad",
    [
        np.array([1.0, 2.0], dtype=object),
        np.array([{}, None]),
        np.array(["1", "2"]),
        np.array([1j, 2j]),
        np.array([True, False]),
        [[1.0], [1.0, 2.0]],
    ],
    ids=["objects", "dicts", "texts", "complex", "bools", "ragged"],
)
def test_what_is_no_number_is_refused(name: str, bad: Any) -> None:
    with pytest.raises(RecordingError) as error:
        samples({"accel": np.zeros((2, 3)), name: bad}, rate_hz=100.0)
    assert error.value.code == "array_type"


def test_a_column_without_a_meaning_may_hold_anything() -> None:
    values, _ = samples({"gyro": truth(50)[1], "label": np.array(["a"] * 50)}, rate_hz=100.0)
    assert values.shape == (50, 3)


def test_an_array_of_one_axis_is_x() -> None:
    _, table = samples({"gyro": truth(50)[1][:, 0]}, rate_hz=100.0)
    assert [column.use for column in table.columns] == ["gyro/x"]


def test_dates_are_a_time() -> None:
    _, gyro, _ = truth(500)
    dates = np.datetime64("2026-01-02T03:04:05", "us") + np.arange(500) * np.timedelta64(10_000, "us")
    values, table = samples({"stamp": dates, "gyro": gyro})
    assert len(values) == 500
    assert table.started == "2026-01-02T03:04:05.000Z"


@pytest.mark.parametrize(
    ("samples_are", "units", "factor"),
    [
        ("point", {"gyro": "deg/s"}, np.pi / 180),
        ("average", {}, 1.0),
        ("increment", {"gyro": "deg"}, np.pi / 1.8),
    ],
)
def test_the_user_states_units_and_what_a_sample_is(
    samples_are: Any, units: dict[str, str], factor: float
) -> None:
    _, gyro, _ = truth(500)
    table = ArrayTable(
        {"gyro": gyro}, ReadOptions(rate_hz=100.0, units=units, samples=samples_are, accept=True)
    )
    blocks = [block for blocks in table for block in blocks]
    np.testing.assert_allclose(blocks[0].values, gyro * factor, rtol=1e-12)
    assert blocks[0].stream.kind == ("unknown" if samples_are == "point" else "deltas")


def test_a_rate_is_no_unit_of_an_increment() -> None:
    options = ReadOptions(rate_hz=100.0, units={"gyro": "deg/s"}, samples="increment")
    with pytest.raises(OptionError) as error:
        ArrayTable({"gyro": truth(50)[1]}, options)
    assert error.value.code == "unknown_unit"
