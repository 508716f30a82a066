"""Arrays: of NumPy, MATLAB and Parquet files, and of a program."""

from __future__ import annotations

import json
import tracemalloc
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tables import DEG, G, read, replayed, truth

from imumon.api.replay_options import ReplayOptions
from imumon.model.samples import SampleBlock
from imumon.sources.files import RecordingError
from imumon.sources.files.array_table import ArrayTable
from imumon.sources.files.base import OptionError, ReadOptions

T, GYRO, ACCEL = truth(500)
ROWS = np.column_stack([T, GYRO, ACCEL])
BY_NUMBER = dict(
    zip(("t", "gyro/x", "gyro/y", "gyro/z", "accel/x", "accel/y", "accel/z"), "1234567", strict=True)
)


def fields() -> np.ndarray:
    names = ["t", "gx", "gy", "gz", "ax", "ay", "az"]
    return np.array([tuple(row) for row in ROWS], dtype=[(name, "f8") for name in names])


def fields_of_axes() -> np.ndarray:
    kinds = [("t", "f8"), ("gyro", "f8", 3), ("accel", "f8", (3,))]
    return np.array([(row[0], row[1:4], row[4:]) for row in ROWS], dtype=kinds)


def mat(path: Path, **arrays: Any) -> None:
    from scipy.io import savemat

    savemat(path, arrays, do_compression=True)


def parquet(path: Path, **arrays: Any) -> None:
    arrow = pytest.importorskip("pyarrow", reason="pyarrow is not installed (extra fast)")
    from pyarrow import parquet

    parquet.write_table(
        arrow.table({name: arrow.array(array) for name, array in arrays.items()}), path, row_group_size=77
    )


def columns() -> dict[str, np.ndarray]:
    return {name: ROWS[:, k] for k, name in enumerate(("t", "gx", "gy", "gz", "ax", "ay", "az"))}


UNITS = {"t": "s", **{f"g{a}": "rad/s" for a in "xyz"}, **{f"a{a}": "m/s^2" for a in "xyz"}}


def lists() -> dict[str, Any]:
    return {
        "gyro": GYRO.tolist(),
        "accel": {axis: column.tolist() for axis, column in zip("xyz", ACCEL.T, strict=True)},
    }


def parts() -> dict[str, Any]:
    arrays = {"gyro": GYRO, "accel": ACCEL}
    signals = [{"values": array.tolist(), "label": name} for name, array in arrays.items()]
    return {"log": {"time": T.tolist(), "signals": signals}}


OCTAVE = "# Created by Octave 6.4\n" + "".join(
    f"# name: {name}\n# type: matrix\n# rows: {len(array)}\n# columns: {array.shape[1]}\n"
    + "".join(f" {' '.join(map(repr, row))}\n" for row in array.tolist())
    + "\n\n"
    for name, array in (("t", T[:, None]), ("gyro", GYRO), ("accel", ACCEL))
)

WRITERS: dict[str, Callable[[Path], Any]] = {
    "three.npz": lambda path: np.savez_compressed(path, t=T, gyro=GYRO, accel=ACCEL),
    "by_column.npz": lambda path: np.savez(
        path, t=T, gyro=np.asfortranarray(GYRO), accel=np.asfortranarray(ACCEL)
    ),
    "n_by_1.npz": lambda path: np.savez(
        path, t=T[:, None], gyro=GYRO, **{f"a{x}": ACCEL[:, [k]] for k, x in enumerate("xyz")}
    ),
    "objects.npz": lambda path: np.savez(
        path, t=T, gyro=GYRO, accel=ACCEL, note=np.array([None, "a"], dtype=object)
    ),
    "fields.npy": lambda path: np.save(path, fields()),
    "arrays_in_fields.npy": lambda path: np.save(path, fields_of_axes()),
    "transposed.npz": lambda path: np.savez(path, t=T, gyro_dps=GYRO.T / DEG, accel_g=ACCEL.T / G),
    "flat.mat": lambda path: mat(path, t=T, gyro=GYRO, accel=ACCEL, name="a"),
    "nested.mat": lambda path: mat(
        path, imu={"t": T, "gyro_dps": GYRO / DEG, "accel_g": ACCEL / G, "name": "a"}
    ),
    "rate.mat": lambda path: mat(
        path,
        trial={
            "stamp": T / 86400.0,
            "gyro_dps": GYRO / DEG,
            "accel_g": ACCEL / G,
            "Fs": {"Acc": 1.0 / (T[1] - T[0])},
        },
    ),
    "parts.mat": lambda path: mat(path, **parts()),
    "octave.txt": lambda path: path.write_text(OCTAVE),
    "a.parquet": lambda path: parquet(path, name=["a"] * len(T), **columns()),
    "lists.parquet": lambda path: parquet(
        path,
        t=T,
        gyro=GYRO.tolist(),
        accel=ACCEL.tolist(),
        ragged=[[0.5] * (1 + k % 2) for k in range(len(T))],
    ),
    "stamps.parquet": lambda path: parquet(
        path, **{**columns(), "t": np.rint(1.7e9 * 1e9 + T * 1e9).astype("datetime64[ns]")}
    ),
}


DOCUMENTS: dict[str, Callable[[Path], Any]] = {
    "columns.json": lambda path: path.write_text(json.dumps({"dt_ms": 10, "t": T.tolist(), **lists()})),
    "rows.json": lambda path: path.write_text(
        json.dumps({"sensors": [{"name": n, "unit": u} for n, u in UNITS.items()], "values": ROWS.tolist()})
    ),
    "parts.json": lambda path: path.write_text(json.dumps(parts())),
    "frame.json": lambda path: path.write_text(
        json.dumps({n: dict(enumerate(c.tolist())) for n, c in zip(UNITS, ROWS.T, strict=True)}, indent=1)
    ),
}


@pytest.mark.parametrize("name", [*WRITERS, *DOCUMENTS])
def test_arrays_with_names_are_read(tmp_path: Path, name: str) -> None:
    (WRITERS | DOCUMENTS)[name](tmp_path / name)
    block = read(tmp_path / name)
    assert np.allclose(block.values, np.hstack([GYRO, ACCEL]), rtol=1e-9)
    assert block.time_ns is not None
    assert np.allclose(block.time_ns * 1e-9, T - T[0], atol=1e-6)


@pytest.mark.few
@pytest.mark.parametrize("save", [np.savez, np.savez_compressed], ids=["stored", "compressed"])
def test_the_memory_of_an_archive_does_not_grow_with_it(tmp_path: Path, save: Callable[..., None]) -> None:
    count = 300_000
    numbers = np.random.default_rng(1).standard_normal((count, 3))
    save(tmp_path / "a.npz", time_s=np.arange(count) / 100.0, gyro_rads=1e-3 * numbers)
    tracemalloc.start()
    recording = ReplayOptions(path=str(tmp_path / "a.npz")).open()
    blocks = (item for items in recording for item in items if isinstance(item, SampleBlock))
    assert sum(map(len, blocks)) == count
    assert tracemalloc.get_traced_memory()[1] < numbers.nbytes
    tracemalloc.stop()


def test_arrays_without_names_are_read_by_number(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.asfortranarray(ROWS))
    np.savez(tmp_path / "a.npz", t=T, imu=ROWS[:, 1:])
    mat(tmp_path / "a.mat", data=ROWS)
    for name in ("a.npy", "a.npz", "a.mat"):
        block = read(tmp_path / name, columns=BY_NUMBER)
        assert np.allclose(block.values, np.hstack([GYRO, ACCEL]), rtol=1e-9)
    named = {"gyro/x": "imu.1:rad/s", "gyro/y": "imu.2", "gyro/z": "imu.3"}
    assert np.allclose(read(tmp_path / "a.npz", columns=named).values, GYRO)


def test_arrays_of_two_lengths_are_read_one_by_one(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, t_gyro=T, gyro=GYRO, t_accel=T[::2], accel=ACCEL[::2])
    assert replayed(path, sensor="accel")[0].device.sample_rate_hz == 50.0
    report, remarks = replayed(path)
    assert report.session.samples == 500
    assert "t_accel, accel_x" in remarks


@pytest.mark.parametrize("name", DOCUMENTS)
def test_a_document_that_is_cut_is_refused(tmp_path: Path, name: str) -> None:
    DOCUMENTS[name](tmp_path / name)
    (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:-1000])
    with pytest.raises(RecordingError):
        read(tmp_path / name)


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_that_is_cut_is_corrupt(tmp_path: Path, name: str) -> None:
    WRITERS[name](tmp_path / name)
    data = (tmp_path / name).read_bytes()
    for share in (0.3, 0.95):
        (tmp_path / name).write_bytes(data[: int(share * len(data))])
        with pytest.raises(RecordingError, match="corrupt"):
            read(tmp_path / name)


def test_a_damaged_archive_is_named_as_damaged(tmp_path: Path) -> None:
    """Wherever the damage is: an offset that no file can have is damage, and no error of the path."""
    path, chance = tmp_path / "a.npz", np.random.default_rng(1)
    np.savez(path, t=T, gyro=GYRO, accel=ACCEL)
    whole, said = path.read_bytes(), Counter[str]()
    for number in range(100):
        data = bytearray(whole)
        begin = (4, len(whole) - 400)[number % 2]  # in all of it, or in its directory
        for place in chance.integers(begin, len(whole), 20):
            data[place] ^= 1 + chance.integers(255)
        path.write_bytes(data)
        try:
            read(path)
            said["harmless"] += 1  # the date of an entry, or a comment
        except RecordingError as error:
            said["corrupt" if "is corrupt" in error.message else error.code] += 1
    assert said["corrupt"] >= 95
    assert set(said) <= {"corrupt", "harmless"}


@pytest.mark.parametrize(
    ("head", "code"),
    [
        (b"\x89HDF\r\n\x1a\n", "format_hdf5"),
        (b"MATLAB 7.3 MAT-file", "format_mat_73"),
        (b"\xd0\xcf\x11\xe0", "format_xls"),
        (b"ARROW1\0\0", "format_arrow"),
        (b"\x80\x04\x95", "format_pickle"),
        (b"TDSm", "format_tdms"),
    ],
)
def test_files_of_other_programs_are_named_with_what_to_do(tmp_path: Path, head: bytes, code: str) -> None:
    (tmp_path / "a.dat").write_bytes(head + bytes(999))
    with pytest.raises(RecordingError) as error:
        replayed(tmp_path / "a.dat")
    assert error.value.code == code
    assert error.value.cure


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
