"""Archives: NumPy's ``.npz`` with arrays named like columns, (n,) or (n, 3)."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from imumon.errors import SourceError
from imumon.recordings.column_names import understood
from imumon.recordings.columns import SENSORS, layout
from imumon.recordings.table import ROWS, ReadOptions, TableRows
from imumon.samples import AXES, Floats, SampleBlock


class NpzFile:
    """A NumPy archive (``.npz``) of arrays with names like those of columns: (n,) or (n, 3).

    Raises
    ------
    SourceError : it cannot be read, or holds no inertial sensor.
    """

    header: Mapping[str, Any] | None = None
    discarded = 0
    problem: str | None = None
    progress: float | None = None

    def __init__(self, path: str, wanted: ReadOptions) -> None:
        self.path = path
        self.fed = 0
        self.bad_checksums = 0
        try:
            with np.load(path, allow_pickle=False) as archive:
                whole = {name: archive[name] for name in archive.files}
        except (OSError, ValueError, EOFError, zipfile.BadZipFile):
            raise SourceError(f"{path} is no NumPy archive of plain arrays") from None
        try:
            names, arrays = _flattened(whole)
            found = layout(names, wanted.kind, wanted.given)
        except SourceError as error:
            raise SourceError(f"{path}: {error}") from None
        self._rows = TableRows(path, found, "npz", wanted.rate_hz, names)
        picked = [arrays[k] for k in self._rows.columns]
        if len({len(column) for column in picked}) != 1:
            raise SourceError(
                f"{path}: its arrays have {sorted({len(c) for c in picked})} samples, not one number"
            )
        self._columns = picked

    def __iter__(self) -> Iterator[list[SampleBlock]]:
        count = len(self._columns[0])
        for start in range(0, count, ROWS):
            piece = np.column_stack([column[start : start + ROWS] for column in self._columns])
            self.fed += piece.nbytes
            places = range(start + 1, start + 1 + len(piece))
            yield list(self._rows.blocks(self._rows.pick(piece), places))
            self.bad_checksums, self.progress = self._rows.lost, min(1.0, (start + ROWS) / count)
        yield list(self._rows.finish())

    @property
    def remarks(self) -> Sequence[str]:
        return self._rows.remarks

    def verdict(self) -> str:
        return f"{self.path} holds arrays without a sample"


def _flattened(arrays: Mapping[str, Any]) -> tuple[list[str], list[Floats]]:
    """Names and columns; of an array with three columns one for each axis.

    Raises
    ------
    SourceError : a sensor's array lies on its side.
    """
    names: list[str] = []
    columns: list[Floats] = []
    for name, array in arrays.items():
        if array.dtype.kind not in "iuf":
            continue
        words = name.rsplit("_", 1)
        unit = f" [{words[1]}]" if len(words) == 2 and words[1] in _ARRAY_UNITS else ""
        bare = words[0] if unit else name
        if array.ndim == 1:
            names.append(f"{bare}{unit}")
            columns.append(array.astype(np.float64))
        elif array.ndim == 2 and array.shape[1] == 3:
            for k, axis in enumerate(AXES):
                names.append(f"{bare}_{axis}{unit}")
                columns.append(array[:, k].astype(np.float64))
        elif array.ndim == 2 and array.shape[0] == 3 and understood(0, f"{bare}_x").quantity in SENSORS:
            raise SourceError(f"the array {name} is 3 x n: transpose it to n x 3, {name}={name}.T")
    return names, columns


_ARRAY_UNITS = {"gauss", "C", "kPa", "dps", "g", "mg", "rads", "uT", "nT", "ns", "us", "ms", "s"}
"""Units that the last word of an array's name may be."""
