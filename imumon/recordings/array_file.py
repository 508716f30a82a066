"""Array files: NumPy (.npz, .npy), MATLAB 5 (.mat) and Parquet, whose arrays have names like those of columns.

An array of one column, (n,), (n, 1) or (1, n), is a column of the table. One of three columns has an axis each. Other
columns have the name of the array and a number from 1; only ``--map`` uses them. Blocks of rows are read as they are
needed; only a MATLAB file is in memory as a whole.
"""

from __future__ import annotations

import importlib.util
import math
import os
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.lib import format as npy

from imumon.column_names import parse_name
from imumon.errors import ImumonError, why
from imumon.files import open_regular
from imumon.recordings.base import ReadOptions, RecordingError
from imumon.recordings.columns import LISTED, SENSORS, layout
from imumon.recordings.raw_capture import ACCESS
from imumon.recordings.table import ROWS, Table
from imumon.report import plain
from imumon.samples import AXES, Floats, SampleBlock

MOST_RATIO = 100
"""Bytes per byte of the file to which it may decompress: numbers of a sensor reach 10."""

FREE_BYTES = 1 << 26
"""Bytes to which every file may decompress."""


class Form(NamedTuple):
    """What a file of arrays is, the codes of errors in it, and the cure."""

    what: str
    unreadable: str
    corrupt: str
    cure: str


FORMS = {
    "npz": Form("a NumPy archive of plain arrays", "no_npz", "npz_corrupt", "save it again with numpy.savez"),
    "npy": Form("a NumPy array of numbers", "no_npy", "no_npy", "save it again with numpy.save"),
    "mat": Form("a MATLAB 5 file", "no_mat", "mat_corrupt", "save it again with save FILE.mat -v7"),
    "parquet": Form("a Parquet file", "no_parquet", "no_parquet", "write it again"),
}

MAGIC = {b"\x93NUMPY": "npy", b"MATLAB 5.0": "mat", b"PAR1": "parquet"}
"""First bytes of the files of each form."""

ARRAY_UNITS = {"gauss", "C", "kPa", "dps", "g", "mg", "rads", "uT", "nT", "ns", "us", "ms", "s"}
"""Units that the name of an array may end with."""


@dataclass(frozen=True, slots=True)
class ArrayColumn:
    """Column of an array.

    Attributes
    ----------
    name : as of a column of a table.
    array : of the array that it is a part of.
    length : rows.
    key : its number in the array, or the name of a field; None: it is the array.
    """

    name: str
    array: str
    length: int
    key: int | str | None = None


def array_kind(path: str, head: bytes) -> str | None:
    """Return which of `FORMS` a file has by its first bytes; None: another one.

    Raises
    ------
    RecordingError : it is a workbook.
    """
    if not head.startswith(b"PK\x03\x04"):
        return next((kind for magic, kind in MAGIC.items() if head.startswith(magic)), None)
    try:
        with _opened(path) as file, zipfile.ZipFile(file) as archive:
            names = archive.namelist()
    except (OSError, zipfile.BadZipFile):
        names = []
    if "xl/workbook.xml" in names:
        raise RecordingError("format_xlsx", f"{path} is a workbook of Excel", "save the sheet as CSV")
    return "npz" if path.endswith(".npz") or any(name.endswith(".npy") for name in names) else None


class ArrayFile(Table):
    """A file of arrays as blocks of samples.

    Parameters
    ----------
    kind : key of `FORMS`.

    Raises
    ------
    RecordingError : it cannot be read, or has no inertial sensor.
    """

    def __init__(self, path: str, kind: str, options: ReadOptions) -> None:
        self.path, self._kind = path, kind
        with self._errors():
            shapes, self._read = _READERS[kind](path)
        listed = ", ".join(
            f"{plain(name) or 'one array'} {shape}" for name, (shape, _) in list(shapes.items())[:LISTED]
        )
        columns = [
            column for name, (shape, fields) in shapes.items() for column in _columns(name, shape, fields)
        ]
        names = [column.name for column in columns]
        try:
            found = layout(names, options.kind, options.columns, options.sensor)
        except RecordingError as error:
            if error.code != "no_sensor":
                raise error.of(path) from None
            text = (
                f"{path}: no array has the name of a gyroscope or accelerometer; there are {listed or 'none'}"
            )
            example = next(
                (column.name for column in columns if column.key is not None or not column.array), "NAME"
            )
            raise RecordingError(
                "no_sensor", text, f"name the columns, --map gyro/x={example}:rad/s,..."
            ) from None
        self._columns = [columns[k] for k in self._begin(found, kind, options.rate_hz, names)]
        lengths = {column.length: column.array for column in self._columns}
        if len(lengths) != 1:
            text = ", ".join(f"{array} {length:,}" for length, array in sorted(lengths.items()))
            cure = "save arrays of one length, or read each sensor with its own time, --sensor gyro and --sensor accel"
            raise RecordingError("array_lengths", f"{path}: its arrays have different lengths: {text}", cure)

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """Turn what libraries raise on a corrupt file into an error."""
        form = FORMS[self._kind]
        corrupt = (form.unreadable, f"{self.path} is corrupt, or is not {form.what}", form.cure)
        try:
            yield
        except (ImumonError, MemoryError, GeneratorExit):
            raise
        except OSError as error:
            if error.errno is None:  # of a library: the contents are wrong
                raise RecordingError(*corrupt) from None
            raise RecordingError("not_readable", f"cannot read {self.path}: {why(error)}", ACCESS) from None
        except Exception:  # zipfile, numpy, scipy and pyarrow raise many kinds
            raise RecordingError(*corrupt) from None

    def __iter__(self) -> Iterator[list[SampleBlock]]:
        count, done = self._columns[0].length, 0
        with self._errors():
            for rows in self._read(self._columns):
                self.fed += rows.nbytes
                done += len(rows)
                self.progress = min(1.0, done / count)
                yield self._blocks(rows, range(done - len(rows) + 1, done + 1))
        yield self._finish()

    def no_samples(self) -> RecordingError:
        return RecordingError("no_rows", f"{self.path} has arrays without a sample", "save it again")


def _opened(path: str) -> IO[bytes]:
    return os.fdopen(open_regular(path, follow=True), "rb")


Shape = tuple[int, ...]
Reader = Callable[[Sequence[ArrayColumn]], Iterator[Floats]]
"""Yields blocks of the rows of some columns, (n, k)."""
Opened = tuple[Mapping[str, tuple[Shape, Sequence[str]]], Reader]
"""Shape of each array, with the names of its fields, and its reader."""


def _columns(array: str, shape: Shape, fields: Sequence[str]) -> list[ArrayColumn]:
    """Return the columns of an array; raise `RecordingError` if it is that of a sensor, but transposed."""
    bare, unit = _name_and_unit(plain(array))
    shape = (max(shape),) if len(shape) == 2 and 1 in shape else shape
    if fields:
        return [ArrayColumn(plain(name), array, shape[0], name) for name in fields]
    if len(shape) == 1:
        return [ArrayColumn(f"{bare}{unit}" or "1", array, shape[0])]
    if len(shape) != 2:
        return []
    rows, width = shape
    if rows == len(AXES) != width and parse_name(0, f"{bare}_x").quantity in SENSORS:
        cure = f"transpose it to n x 3, {array}={array}.T"
        raise RecordingError("array_transposed", f"the array {array} is 3 x n", cure)
    names = [f"{bare}.{k + 1}" if bare else f"{k + 1}" for k in range(min(width, ROWS))]
    if bare and width == len(AXES):
        names = [f"{bare}_{axis}{unit}" for axis in AXES]
    return [ArrayColumn(name, array, rows, k) for k, name in enumerate(names)]


def _name_and_unit(array: str) -> tuple[str, str]:
    """Return the name of an array without a unit at its end, and that unit in brackets."""
    stem, _, suffix = array.rpartition("_")
    return (stem, f" [{suffix}]") if stem and suffix in ARRAY_UNITS else (array, "")


def _in_blocks(
    columns: Sequence[ArrayColumn], take: Callable[[ArrayColumn, int, int], Any]
) -> Iterator[Floats]:
    """Yield blocks from what returns the rows of a column from a start to an end."""
    for start in range(0, columns[0].length, ROWS):
        end = min(start + ROWS, columns[0].length)
        yield np.column_stack([np.asarray(take(column, start, end), dtype=np.float64) for column in columns])


# ---------------------------------------------------------------- NumPy


@dataclass(frozen=True, slots=True)
class _Npy:
    """Array in the form of NumPy; `begin` is the offset of its numbers."""

    shape: Shape
    by_column: bool
    dtype: np.dtype[Any]
    begin: int

    def place(self, column: ArrayColumn) -> tuple[int, int]:
        """Return the offset of the first number of a column, and the bytes from one row to the next."""
        size = self.dtype.itemsize
        if not isinstance(column.key, int):
            return self.begin, size
        if self.by_column:
            return self.begin + column.key * self.shape[0] * size, size
        return self.begin, self.shape[1] * size


def _npy_header(file: IO[bytes], path: str, name: str, held: int) -> _Npy | None:
    """Return the header of an array; None if it has no numbers. Raise an exception if it is corrupt."""
    version = npy.read_magic(file)
    if version not in ((1, 0), (2, 0)):  # names of fields that are not ASCII
        return None
    shape, by_column, dtype = (npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0)(
        file
    )
    if dtype.hasobject:
        return None
    begin = file.tell()
    size = math.prod(shape) * dtype.itemsize
    if size != held - begin:
        text = f"{path} is corrupt: {name} claims {size:,} bytes and has {held - begin:,}"
        raise RecordingError(FORMS["npz"].corrupt, text, FORMS["npz"].cure)
    plain_fields = dtype.names and len(shape) == 1 and all(dtype[name].kind in "iuf" for name in dtype.names)
    return _Npy(shape, by_column, dtype, begin) if dtype.kind in "iuf" or plain_fields else None


def _npy_reader(open_array: Callable[[str], IO[bytes]], arrays: Mapping[str, _Npy]) -> Reader:
    """Return the reader of arrays, each of which is opened once for each of its columns that lie apart."""

    def read(columns: Sequence[ArrayColumn]) -> Iterator[Floats]:
        with ExitStack() as stack:
            files: dict[tuple[str, int], IO[bytes]] = {}
            blocks: dict[tuple[str, int], tuple[int, bytes]] = {}

            def take(column: ArrayColumn, start: int, end: int) -> Any:
                array = arrays[column.array]
                begin, step = array.place(column)
                at = (column.array, begin)
                if at not in files:
                    files[at] = stack.enter_context(open_array(column.array))
                    files[at].seek(begin)
                if blocks.get(at, (-1, b""))[0] != start:
                    blocks[at] = start, files[at].read((end - start) * step)
                values = np.frombuffer(blocks[at][1], array.dtype)
                if isinstance(column.key, str):
                    return values[column.key]
                width = step // array.dtype.itemsize
                return values[column.key or 0 :: width] if width > 1 else values

            yield from _in_blocks(columns, take)

    return read


def _fields(array: _Npy) -> tuple[Shape, Sequence[str]]:
    return array.shape, array.dtype.names or ()


def _npz(path: str) -> Opened:
    file = _opened(path)
    archive = zipfile.ZipFile(file)
    members = archive.infolist()
    _check_size(path, sum(member.file_size for member in members), "npz")
    arrays = {}
    for member in members:
        with archive.open(member) as content:
            header = _npy_header(content, path, member.filename, member.file_size)
        if header is not None:
            arrays[member.filename.removesuffix(".npy")] = header
    names = {member.filename.removesuffix(".npy"): member for member in members}
    read = _npy_reader(lambda name: archive.open(names[name]), arrays)
    return {name: _fields(array) for name, array in arrays.items()}, read


def _npy(path: str) -> Opened:
    with _opened(path) as file:
        array = _npy_header(file, path, "it", os.path.getsize(path))
    if array is None:
        raise ValueError("no numbers")
    read = _npy_reader(lambda _: _opened(path), {"": array})
    return {"": _fields(array)}, read


def _check_size(path: str, total: int, kind: str) -> None:
    """Raise `RecordingError` if a file claims far more than its size allows."""
    if total > FREE_BYTES + MOST_RATIO * os.path.getsize(path):
        text = f"{path} is corrupt: it claims to hold {total:,} bytes, far more than its size allows"
        raise RecordingError(FORMS[kind].corrupt, text, FORMS[kind].cure)


# ---------------------------------------------------------------- other programs


def _mat(path: str) -> Opened:
    import scipy.io

    io: Any = scipy.io

    _check_size(path, sum(8 * math.prod(shape) for _, shape, _ in io.whosmat(path)), "mat")
    arrays: dict[str, Any] = {}

    def add(name: str, value: Any) -> None:
        if value.dtype.names and value.size == 1:
            for field in value.dtype.names:
                add(f"{name}.{field}", np.asarray(value.reshape(-1)[0][field]))
        elif value.dtype.kind in "iuf" and value.ndim == 2:
            arrays[name] = value

    for name, value in io.loadmat(path).items():
        if isinstance(value, np.ndarray) and not name.startswith("__"):
            add(name, value)

    def take(column: ArrayColumn, start: int, end: int) -> Any:
        array = arrays[column.array]
        return array.reshape(-1)[start:end] if column.key is None else array[start:end, column.key]

    return {name: (array.shape, ()) for name, array in arrays.items()}, lambda columns: _in_blocks(
        columns, take
    )


def _parquet(path: str) -> Opened:
    if importlib.util.find_spec("pyarrow") is None:
        text = f"{path} is a Parquet file, and the package pyarrow that reads it is not installed"
        raise RecordingError("package_missing", text, "pip install 'imumon[fast]'")
    import pyarrow.types as kinds
    from pyarrow import parquet

    file = parquet.ParquetFile(_opened(path))
    names: dict[str, str] = {}  # of a column, by that of its array
    for field in file.schema_arrow:
        if kinds.is_timestamp(field.type) or kinds.is_duration(field.type):
            named = parse_name(0, field.name).quantity == "t"
            names[f"{field.name if named else 'time'} [{field.type.unit}]"] = field.name
        elif kinds.is_integer(field.type) or kinds.is_floating(field.type):
            names[field.name] = field.name

    def read(columns: Sequence[ArrayColumn]) -> Iterator[Floats]:
        used = [names[column.array] for column in columns]
        for batch in file.iter_batches(ROWS, columns=[*dict.fromkeys(used)], use_threads=False):
            parts = []
            for name in used:
                column = batch.column(name)
                if not kinds.is_floating(column.type):
                    column = column.cast("int64").cast("float64", safe=False)
                parts.append(np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64))
            yield np.column_stack(parts)

    return dict.fromkeys(names, ((file.metadata.num_rows,), ())), read


_READERS: Mapping[str, Callable[[str], Opened]] = {"npz": _npz, "npy": _npy, "mat": _mat, "parquet": _parquet}
