"""Array files: NumPy (.npz, .npy), MATLAB 5 (.mat) and Parquet, whose arrays have names like those of columns.

`array_table` says which columns they are. Blocks of rows are read as they are needed; only a MATLAB file is in memory
as a whole.
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

from imumon.files import open_regular
from imumon.model.errors import ImumonError, why
from imumon.model.samples import Floats
from imumon.model.system_errors import cure_of_reading, is_damage
from imumon.sources.files.array_table import ArrayColumn, ArrayTable, Opened, Reader, Shape, in_blocks
from imumon.sources.files.base import ROWS, ReadOptions, RecordingError
from imumon.sources.files.column_names import names_time

MOST_RATIO = 100
"""Bytes per byte of the file to which it may decompress: numbers of a sensor reach 10."""

FREE_BYTES = 1 << 26
"""Bytes to which every file may decompress."""


class Form(NamedTuple):
    """What a file of arrays is, the codes of errors in it, and the cure."""

    noun: str
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
    except Exception:  # zipfile raises many kinds; `ArrayFile` says what is wrong
        names = []
    if "xl/workbook.xml" in names:
        raise RecordingError("format_xlsx", f"{path} is a workbook of Excel", "save the sheet as CSV")
    return "npz" if path.endswith(".npz") or any(name.endswith(".npy") for name in names) else None


class ArrayFile(ArrayTable):
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
            opened = _READERS[kind](path)
        super().__init__(path, kind, opened, options)

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """Turn what libraries raise on a corrupt file into an error."""
        form = FORMS[self._kind]
        corrupt = (form.unreadable, f"{self.path} is corrupt, or is not {form.noun}", form.cure)
        try:
            yield
        except (ImumonError, MemoryError, GeneratorExit):
            raise
        except OSError as error:
            raise (RecordingError(*corrupt) if is_damage(error) else _unreadable(self.path, error)) from None
        except Exception:  # zipfile, numpy, scipy and pyarrow raise many kinds
            raise RecordingError(*corrupt) from None


def _opened(path: str) -> IO[bytes]:
    """Open a file; raise `RecordingError` if it cannot be opened, whatever the number: no decoder has seen it."""
    try:
        return os.fdopen(open_regular(path, follow=True), "rb")
    except OSError as error:
        raise _unreadable(path, error) from None


def _unreadable(path: str, error: OSError) -> RecordingError:
    return RecordingError("not_readable", f"cannot read {path}: {why(error)}", cure_of_reading(error))


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
    # before anything is read: a header may claim any shape
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
                block_key = (column.array, begin)
                # a member of an archive cannot go back, so each place that is read from has a stream of its own
                if block_key not in files:
                    files[block_key] = stack.enter_context(open_array(column.array))
                    files[block_key].seek(begin)
                # columns whose numbers alternate have one place: their block is read once
                if blocks.get(block_key, (-1, b""))[0] != start:
                    blocks[block_key] = start, files[block_key].read((end - start) * step)
                values = np.frombuffer(blocks[block_key][1], array.dtype)
                if isinstance(column.key, str):
                    return values[column.key]
                width = step // array.dtype.itemsize
                return values[column.key or 0 :: width] if width > 1 else values

            yield from in_blocks(columns, take)

    return read


def _fields(array: _Npy) -> tuple[Shape, Sequence[str]]:
    return array.shape, array.dtype.names or ()


def _npz(path: str) -> Opened:
    file = _opened(path)
    archive = zipfile.ZipFile(file)
    members = archive.infolist()
    _check_directory(file, archive)
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


def _check_directory(file: IO[bytes], archive: zipfile.ZipFile) -> None:
    """Raise `zipfile.BadZipFile` if the directory has fewer entries than the end of the archive says.

    A damaged length of an entry hides those behind it.
    """
    file.seek(-22 - len(archive.comment), os.SEEK_END)
    count = int.from_bytes(file.read(12)[10:], "little")
    if count not in (len(archive.infolist()), 0xFFFF):  # the last: the number is elsewhere, as it is larger
        raise zipfile.BadZipFile("entries are missing")


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

    return {name: (array.shape, ()) for name, array in arrays.items()}, lambda columns: in_blocks(
        columns, take
    )


def _parquet(path: str) -> Opened:
    if importlib.util.find_spec("pyarrow") is None:
        text = f"{path} is a Parquet file, and the package pyarrow that reads it is not installed"
        raise RecordingError("package_missing", text, "pip install '.[fast]'")
    import pyarrow.types as kinds
    from pyarrow import parquet

    file = parquet.ParquetFile(_opened(path), page_checksum_verification=True)
    names: dict[str, str] = {}  # of a column, by that of its array
    for field in file.schema_arrow:
        # a type of time has its unit, which a name need not have
        if kinds.is_timestamp(field.type) or kinds.is_duration(field.type):
            named = names_time(field.name)
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
                    # not safe: integers above 2^53 are rounded, as every reader of numbers does
                    column = column.cast("int64").cast("float64", safe=False)
                parts.append(np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64))
            yield np.column_stack(parts)

    return dict.fromkeys(names, ((file.metadata.num_rows,), ())), read


_READERS: Mapping[str, Callable[[str], Opened]] = {"npz": _npz, "npy": _npy, "mat": _mat, "parquet": _parquet}
