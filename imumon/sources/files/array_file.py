"""Array files: NumPy, MATLAB 5, Parquet and documents, whose arrays have names like those of columns.

A file is opened as named arrays; `array_table` says which columns they are. An array of NumPy is read block by block,
so that memory does not grow with the record; the other forms are in memory as a whole.
"""

from __future__ import annotations

import importlib.util
import math
import os
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.lib import format as npy

from imumon.files import open_regular
from imumon.model.errors import ImumonError, why
from imumon.model.system_errors import cure_of_reading, is_damage
from imumon.sources.files.array_table import StoredArray
from imumon.sources.files.base import RecordingError
from imumon.sources.files.document_file import OCTAVE, json_arrays, named_arrays, octave_arrays

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
    "json": Form("an object of JSON", "no_json", "no_json", "write it again"),
    "octave": Form("a text of Octave", "no_octave", "no_octave", "save it again with save -text"),
}

MAGIC = {
    b"\x93NUMPY": "npy", b"MATLAB 5.0": "mat", b"PAR1": "parquet", OCTAVE: "octave", b"{": "json", b"[": "json"
}  # fmt: skip
"""First bytes of the files of each form."""


def read_arrays(path: str, head: bytes) -> tuple[str, Mapping[str, Any]] | None:
    """Return which of `FORMS` a file has, and its arrays; None: it is no file of arrays.

    Parameters
    ----------
    head : its first bytes.

    Raises
    ------
    RecordingError : it cannot be read, or is a workbook.
    """
    form = _form(path, head)
    if form is None:
        return None
    with _damage(path, form):
        arrays = _READERS[form](path)
    # a text that begins as an object of JSON may be one of records
    return (form, arrays) if arrays or form != "json" else None


def _form(path: str, head: bytes) -> str | None:
    """Return which of `FORMS` a file may have by its first bytes; None: another one."""
    if not head.startswith(b"PK\x03\x04"):
        return next((form for magic, form in MAGIC.items() if head.startswith(magic)), None)
    try:
        with _opened(path) as file, zipfile.ZipFile(file) as archive:
            names = archive.namelist()
    except Exception:  # zipfile raises many kinds; its reader says what is wrong
        names = []
    if "xl/workbook.xml" in names:
        raise RecordingError("format_xlsx", f"{path} is a workbook of Excel", "save the sheet as CSV")
    return "npz" if path.endswith(".npz") or any(name.endswith(".npy") for name in names) else None


@contextmanager
def _damage(path: str, kind: str) -> Iterator[None]:
    """Turn what libraries raise of a corrupt file into an error."""
    form = FORMS[kind]
    corrupt = RecordingError(form.unreadable, f"{path} is corrupt, or is not {form.noun}", form.cure)
    try:
        yield
    except (ImumonError, MemoryError):
        raise
    except OSError as error:
        raise (corrupt if is_damage(error) else _unreadable(path, error)) from None
    except Exception:  # zipfile, numpy, scipy and pyarrow raise many kinds
        raise corrupt from None


def _opened(path: str) -> IO[bytes]:
    """Open a file; raise `RecordingError` if it cannot be opened, whatever the number: no decoder has seen it."""
    try:
        return os.fdopen(open_regular(path, follow=True), "rb")
    except OSError as error:
        raise _unreadable(path, error) from None


def _unreadable(path: str, error: OSError) -> RecordingError:
    return RecordingError("not_readable", f"cannot read {path}: {why(error)}", cure_of_reading(error))


def _check_size(path: str, total: int, kind: str) -> None:
    """Raise `RecordingError` if a file claims far more than its size allows."""
    if total > FREE_BYTES + MOST_RATIO * os.path.getsize(path):
        text = f"{path} is corrupt: it claims to hold {total:,} bytes, far more than its size allows"
        raise RecordingError(FORMS[kind].corrupt, text, FORMS[kind].cure)


# ---------------------------------------------------------------- NumPy


class _StoredNumbers(StoredArray):
    """Numbers of an array of NumPy, of which the last block is in memory.

    Parameters
    ----------
    path : of the file, for messages.
    opened : opens the array.
    begin : offset of its numbers.
    """

    def __init__(
        self, path: str, opened: Callable[[], IO[bytes]], begin: int, shape: tuple[int, ...], dtype: Any
    ) -> None:
        self._path, self._opened, self._begin, self._dtype = path, opened, begin, dtype
        self.shape = shape
        self._file: IO[bytes] | None = None
        self._rows = slice(0, 0)
        self._block: Any = None

    def __getitem__(self, rows: slice) -> Any:
        if rows == self._rows:
            return self._block
        width = math.prod(self.shape[1:])
        count = len(range(self.shape[0])[rows])
        with _damage(self._path, "npz"):
            if self._file is None or rows.start != self._rows.stop:  # only the first block is read again
                self._file = self._opened()
                self._file.seek(self._begin + (rows.start or 0) * width * self._dtype.itemsize)
            data = self._file.read(count * width * self._dtype.itemsize)
            self._block = np.frombuffer(data, self._dtype).reshape(count, *self.shape[1:])
        self._rows = rows
        return self._block


def _npz(path: str) -> dict[str, Any]:
    arrays: dict[str, Any] = {}
    file = _opened(path)
    archive = zipfile.ZipFile(file)
    members = archive.infolist()
    _check_directory(file, archive)
    _check_size(path, sum(member.file_size for member in members), "npz")
    for member in members:
        name = member.filename.removesuffix(".npy")
        arrays |= _npy_arrays(path, name, partial(archive.open, member), member.file_size)
    return arrays


def _npy(path: str) -> dict[str, Any]:
    if arrays := _npy_arrays(path, "", partial(_opened, path), os.path.getsize(path)):
        return arrays
    raise ValueError("no numbers")


def _npy_arrays(path: str, name: str, opened: Callable[[], IO[bytes]], size: int) -> dict[str, Any]:
    """Return an array, or the fields of one; none if it has no numbers. Raise an exception if it is corrupt."""
    with opened() as file:
        return _npy_arrays_in(path, name, opened, file, size)


def _npy_arrays_in(
    path: str, name: str, opened: Callable[[], IO[bytes]], file: IO[bytes], size: int
) -> dict[str, Any]:
    read_header = {
        (1, 0): npy.read_array_header_1_0,
        (2, 0): npy.read_array_header_2_0,
    }.get(npy.read_magic(file))
    if read_header is None:  # names of fields that are not ASCII
        return {}
    shape, by_column, dtype = read_header(file)
    if dtype.hasobject:
        return {}
    claimed, present = math.prod(shape) * dtype.itemsize, size - file.tell()
    # before anything is read: a header may claim any shape
    if claimed != present:
        text = f"{path} is corrupt: {name or 'it'} claims {claimed:,} bytes and has {present:,}"
        raise RecordingError(FORMS["npz"].corrupt, text, FORMS["npz"].cure)
    if dtype.kind in "iuf" and (len(shape) == 1 or (len(shape) == 2 and not by_column and shape[0] > 1)):
        return {name: _StoredNumbers(path, opened, file.tell(), shape, dtype)}
    # fields of records, and columns one behind the other
    array = np.frombuffer(file.read(), dtype).reshape(shape, order="F" if by_column else "C")
    if dtype.names and array.ndim == 1:
        # a field may be an array itself
        return {field: array[field] for field in dtype.names if dtype[field].base.kind in "iuf"}
    return {name: array} if dtype.kind in "iuf" else {}


def _check_directory(file: IO[bytes], archive: zipfile.ZipFile) -> None:
    """Raise `zipfile.BadZipFile` if the directory has fewer entries than the end of the archive says.

    A damaged length of an entry hides those behind it.
    """
    file.seek(-22 - len(archive.comment), os.SEEK_END)
    count = int.from_bytes(file.read(12)[10:], "little")
    if count not in (len(archive.infolist()), 0xFFFF):  # the last: the number is elsewhere, as it is larger
        raise zipfile.BadZipFile("entries are missing")


# ---------------------------------------------------------------- other programs


def _mat(path: str) -> dict[str, Any]:
    import scipy.io

    io: Any = scipy.io

    _check_size(path, sum(8 * math.prod(shape) for _, shape, _ in io.whosmat(path)), "mat")
    content = io.loadmat(path, simplify_cells=True)
    return named_arrays({name: value for name, value in content.items() if not name.startswith("__")})


def _parquet(path: str) -> dict[str, Any]:
    if importlib.util.find_spec("pyarrow") is None:
        text = f"{path} is a Parquet file, and the package pyarrow that reads it is not installed"
        raise RecordingError("package_missing", text, "pip install 'imumon[fast]'")
    import pyarrow.types as kinds
    from pyarrow import parquet

    file = parquet.ParquetFile(_opened(path), page_checksum_verification=True)
    are_read = (kinds.is_integer, kinds.is_floating, kinds.is_timestamp, kinds.is_duration)
    # of a list: what it has
    elements = {f.name: getattr(f.type, "value_field", f).type for f in file.schema_arrow}
    names = [name for name, kind in elements.items() if any(is_kind(kind) for is_kind in are_read)]
    groups = map(file.metadata.row_group, range(file.num_row_groups))
    values = (group.column(k).num_values for group in groups for k in range(group.num_columns))
    _check_size(path, 8 * sum(values), "parquet")
    table = file.read(columns=names, use_threads=False)
    return {name: _parquet_column(table.column(name)) for name in names}


def _parquet_column(column: Any) -> Any:
    """Return the numbers of a column, (n, k) of lists; (0,): these have several lengths."""
    if not hasattr(column.type, "value_field"):
        return column.to_numpy()
    from pyarrow import compute

    lengths = compute.list_value_length(column).unique()
    numbers = column.combine_chunks().flatten().to_numpy()
    return numbers.reshape(len(column), -1) if len(lengths) == 1 else numbers[:0]


_READERS: Mapping[str, Callable[[str], dict[str, Any]]] = {
    "npz": _npz,
    "npy": _npy,
    "mat": _mat,
    "parquet": _parquet,
    "json": json_arrays,
    "octave": octave_arrays,
}
