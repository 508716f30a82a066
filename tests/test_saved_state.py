"""Laws of saved objects: what is restored continues exactly, and saved reports are those of the present pipeline."""

from __future__ import annotations

import gzip
import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import report_runs
import reports
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from placed import PlacedRecord

from imumon.checkpoint import FORMAT
from imumon.grid.sample_clock import BREAK
from imumon.model.report_json import to_json
from imumon.model.samples import SampleBlock, Stream
from imumon.model.saved_state import pack, restorable, unpack
from imumon.record import Record, RecordOptions

RATE = 20.0
STREAM = Stream("deltas", ("gyro/x", "gyro/y", "accel/x", "mag/x", "temperature"), "made", "startup")
LAYOUT = "9dd2ac09"
"""Digest of the names of all attributes that a state has. If it changes, so must `imumon.checkpoint.FORMAT`."""
LAYOUT_FORMAT = 16


def feed(made: PlacedRecord, lengths: list[int], seed: int) -> None:
    """Feed noise with losses, knocks, gaps of known and unknown length, and a temperature that settles."""
    rng = np.random.default_rng(seed)
    for turn, n in enumerate(lengths):
        place = made.record.span + np.arange(n)
        values = 1e-3 * rng.standard_normal((n, len(STREAM.channels)))
        values[:, 4] += 30.0 - 10.0 * np.exp(-place / 3000.0)
        if turn % 3 == 1:
            values[: n // 2, :3] *= 40.0
        steps = np.where(rng.random(n) < (0.02 if turn % 2 else 0.0), 3, 1).astype(np.int64)
        steps[0] = (1, 1, BREAK, 5000)[turn % 4]
        made.feed(values, steps)


LENGTHS = st.lists(st.integers(1, 4000), min_size=1, max_size=6)


def check_continuation(before: list[int], after: list[int], seed: int) -> None:
    one = PlacedRecord(STREAM.channels, RATE)
    feed(one, before, seed)
    two = one.restored()
    assert two.saved() == one.saved()
    for made in (one, two):
        feed(made, after, seed + 1)
        made.record.flush()
    assert two.saved() == one.saved()


@pytest.mark.parametrize("count", [3, pytest.param(40, marks=pytest.mark.slow)])
def test_what_is_restored_continues_exactly(count: int) -> None:
    """All accumulators of a record, with their marks, at any moment."""
    law = given(before=LENGTHS, after=LENGTHS, seed=st.integers(0, 2**32 - 1))(check_continuation)
    phases = (Phase.explicit, Phase.generate)  # a smaller case says no more
    settings(max_examples=count, deadline=None, phases=phases)(law)()


@pytest.fixture(scope="module")
def long_record() -> PlacedRecord:
    """A record whose warm-up is over, with hours and quarters."""
    made = PlacedRecord(STREAM.channels, RATE, options=RecordOptions(periods=True))
    feed(made, [9000] * 9, 1)
    return made


def attributes(content: Any) -> list[str]:
    return sorted({f"{name}.{key}" for name, members in content["objects"] for key in members})


def test_another_layout_has_another_format(long_record: PlacedRecord) -> None:
    """A state of another layout would be restored with attributes that are missing, and fail an hour later."""
    monitor = Record(RecordOptions(periods=True))
    values, stamps = np.zeros((1000, len(STREAM.channels))), np.arange(1000) * 10**8
    values[:, 0] = np.random.default_rng(1).standard_normal(1000)
    monitor.feed(SampleBlock(STREAM, values, stamps, np.zeros(1000, dtype=np.int64), None))
    data = pack((monitor.save(), long_record.record.save()))
    content = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
    digest = hashlib.sha256("\n".join(attributes(content)).encode()).hexdigest()[:8]
    assert (digest, FORMAT) == (LAYOUT, LAYOUT_FORMAT), "raise FORMAT, and write both here"


def test_a_restored_long_record_continues_exactly(long_record: PlacedRecord) -> None:
    one = long_record
    two = one.restored()
    for made in (one, two):
        feed(made, [9000] * 2, 2)
    assert two.saved() == one.saved()


def test_arrays_keep_their_type_shape_and_order() -> None:
    arrays = [
        np.array(3),
        np.zeros((0, 4)),
        np.array(["gyro", "accel"]),
        np.array([[True, False]]),
        np.arange(12.0).reshape(3, 4).T,
        np.array([np.nan, 1.0], dtype=np.float32),
    ]
    for array, back in zip(arrays, unpack(pack(arrays)), strict=True):
        assert back.dtype == array.dtype
        assert back.flags.f_contiguous == array.flags.f_contiguous
        np.testing.assert_array_equal(back, array)
        back.reshape(-1)[:1] = back.reshape(-1)[-1:]  # it may be changed


def test_only_what_is_marked_can_be_saved() -> None:
    with pytest.raises(TypeError):
        pack(Path("/"))
    with pytest.raises(TypeError):
        pack(np.array([None]))
    with pytest.raises(ValueError, match="two restorable classes"):
        restorable(type("Stream", (), {"__module__": "elsewhere"}))


def same(part: Any, other: Any) -> bool:
    """Return whether JSON is the same, but for what another processor rounds otherwise."""
    if isinstance(part, dict) and isinstance(other, dict):
        return part.keys() == other.keys() and all(same(part[key], other[key]) for key in part)
    if isinstance(part, list) and isinstance(other, list):
        return len(part) == len(other) and all(map(same, part, other))
    if isinstance(part, float) and isinstance(other, float):
        return part == pytest.approx(other, rel=1e-3, abs=1e-12)
    return part == other


@pytest.mark.slow
def test_the_saved_reports_are_those_of_the_present_pipeline() -> None:
    made = report_runs.saved()
    assert {path.name.partition(".")[0] for path in reports.FOLDER.iterdir()} == set(made)
    for name, part in made.items():
        text = gzip.decompress((reports.FOLDER / f"{name}.json.gz").read_bytes())
        assert same(json.loads(to_json(part)), json.loads(text)), f"{name}: run python tests/report_runs.py"
