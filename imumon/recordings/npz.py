"""NumPy archive: an ``.npz`` file whose arrays, (n,) or (n, 3), have names like those of columns."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from imumon.recordings.base import ReadOptions, RecordingError
from imumon.recordings.column_names import parse_name
from imumon.recordings.columns import SENSORS, layout
from imumon.recordings.table import ROWS, Table, TableRows
from imumon.samples import AXES, Floats, SampleBlock


class NpzFile(Table):
    """A NumPy archive as blocks of samples.

    Raises
    ------
    RecordingError : it cannot be read, or has no inertial sensor.
    """

    def __init__(self, path: str, options: ReadOptions) -> None:
        self.path = path
        try:
            with np.load(path, allow_pickle=False) as archive:
                whole = {name: archive[name] for name in archive.files}
        except (OSError, ValueError, EOFError, zipfile.BadZipFile):
            raise RecordingError(
                "no_npz", f"{path} is no NumPy archive of plain arrays", "save it with numpy.savez"
            ) from None
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


def _flattened(arrays: Mapping[str, Any]) -> tuple[list[str], list[Floats]]:
    """Return names and columns; of an array with three columns one for each axis.

    Raises
    ------
    RecordingError : the array of a sensor is transposed.
    """
    names: list[str] = []
    columns: list[Floats] = []
    for name, array in arrays.items():
        if array.dtype.kind not in "iuf":
            continue
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
