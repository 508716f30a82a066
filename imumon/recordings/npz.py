"""NumPy archive: an ``.npz`` file whose arrays, (n,) or (n, 3), have names like those of columns."""

from __future__ import annotations

import math
import os
import zipfile
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.lib import format as npy

from imumon.column_names import parse_name
from imumon.errors import ImumonError
from imumon.files import open_regular
from imumon.recordings.base import ReadOptions, RecordingError
from imumon.recordings.columns import SENSORS, layout
from imumon.recordings.raw_capture import ACCESS
from imumon.recordings.table import ROWS, Table, TableRows
from imumon.report import plain
from imumon.samples import AXES, Floats, SampleBlock

MOST_RATIO = 100
"""Bytes per byte of the file to which an archive may decompress: numbers of a sensor reach 10."""

FREE_BYTES = 1 << 26
"""Bytes to which every archive may decompress."""


class NpzFile(Table):
    """A NumPy archive as blocks of samples.

    Raises
    ------
    RecordingError : it cannot be read, or has no inertial sensor.
    """

    def __init__(self, path: str, options: ReadOptions) -> None:
        self.path = path
        whole = _arrays(path)
        try:
            names, arrays = _flattened(whole)
            found = layout(names, options.kind, options.columns)
        except RecordingError as error:
            raise error.of(path) from None
        self._rows = TableRows(path, found, "npz", options.rate_hz, names)
        columns = [arrays[k] for k in self._rows.columns]
        if len({len(column) for column in columns}) != 1:
            lengths = ", ".join(f"{length:,}" for length in sorted({len(c) for c in columns}))
            raise RecordingError(
                "array_lengths",
                f"{path}: its arrays have different lengths, {lengths}",
                "save arrays of one length",
            )
        self._columns = columns

    def __iter__(self) -> Iterator[list[SampleBlock]]:
        count = len(self._columns[0])
        for start in range(0, count, ROWS):
            rows = np.column_stack([column[start : start + ROWS] for column in self._columns])
            self.fed += rows.nbytes
            self.progress = min(1.0, (start + ROWS) / count)
            yield self._blocks(rows, range(start + 1, start + 1 + len(rows)))
        yield self._finish()

    def no_samples(self) -> RecordingError:
        return RecordingError("no_rows", f"{self.path} has arrays without a sample", "save it again")


def _arrays(path: str) -> dict[str, Any]:
    """Return the arrays of numbers in an archive, by name.

    Raises
    ------
    RecordingError : it is no archive, or claims more than it holds, or decompresses to far more than its size.
    """
    try:
        with open(open_regular(path, follow=True), "rb") as file, zipfile.ZipFile(file) as archive:
            members = archive.infolist()
            total = sum(member.file_size for member in members)
            if total > FREE_BYTES + MOST_RATIO * os.path.getsize(path):
                text = f"{path} is corrupt: it claims to hold {total:,} bytes, far more than its size allows"
                raise RecordingError("npz_corrupt", text, "save it again with numpy.savez")
            found = {m.filename.removesuffix(".npy"): _array(archive, m, path) for m in members}
    except (ImumonError, MemoryError):
        raise
    except OSError as error:
        why = (error.strerror or str(error)).lower()
        raise RecordingError("not_readable", f"cannot read {path}: {why}", ACCESS) from None
    except Exception:  # zipfile and numpy raise many kinds on a corrupt file
        raise RecordingError(
            "no_npz", f"{path} is no NumPy archive of plain arrays", "save it with numpy.savez"
        ) from None
    return {plain(name): array for name, array in found.items() if array is not None}


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo, path: str) -> Any:
    """Return an array of an archive; None if it has no numbers. Raise an exception if it is corrupt."""
    with archive.open(member) as file:
        version = npy.read_magic(file)
        if version not in ((1, 0), (2, 0)):  # of fields with names
            return None
        read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, columns_first, dtype = read(file)
        if dtype.hasobject:
            raise ValueError("objects")
        size = math.prod(shape) * dtype.itemsize
        held = member.file_size - file.tell()
        if size != held:
            text = f"{path} is corrupt: {member.filename} claims {size:,} bytes and has {held:,}"
            raise RecordingError("npz_corrupt", text, "save it again with numpy.savez")
        if dtype.kind not in "iuf":
            return None
        content = np.frombuffer(file.read(size), dtype)
        return content.reshape(shape, order="F" if columns_first else "C")


def _flattened(arrays: Mapping[str, Any]) -> tuple[list[str], list[Floats]]:
    """Return names and columns; of an array with three columns one for each axis.

    Raises
    ------
    RecordingError : the array of a sensor is transposed.
    """
    names: list[str] = []
    columns: list[Floats] = []
    for name, array in arrays.items():
        stem, _, suffix = name.rpartition("_")
        unit = f" [{suffix}]" if stem and suffix in _ARRAY_UNITS else ""
        bare = stem if unit else name
        if array.ndim == 1:
            names.append(f"{bare}{unit}")
            columns.append(array.astype(np.float64))
        elif array.ndim == 2 and array.shape[1] == 3:
            for k, axis in enumerate(AXES):
                names.append(f"{bare}_{axis}{unit}")
                columns.append(array[:, k].astype(np.float64))
        elif array.ndim == 2 and array.shape[0] == 3 and parse_name(0, f"{bare}_x").quantity in SENSORS:
            raise RecordingError(
                "array_transposed", f"the array {name} is 3 x n", f"transpose it to n x 3, {name}={name}.T"
            )
    return names, columns


_ARRAY_UNITS = {"gauss", "C", "kPa", "dps", "g", "mg", "rads", "uT", "nT", "ns", "us", "ms", "s"}
"""Units that the name of an array may end with."""
