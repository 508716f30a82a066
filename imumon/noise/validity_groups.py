"""Groups of channels that share their validity, because they are axes of one sample.

Rules: a sample counts for a whole group or not at all; the channels of a group are adjacent; values that are
not finite, or too large for their fourth power to be finite, never count.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from imumon.model.samples import Bools, Floats
from imumon.model.saved_state import restorable

LEAST_SHARE = 0.2
"""Share of valid samples from which the mean of a block counts, a segment of the spectrum, and a frame of the guard."""
ROUNDING = 1e-12
"""Relative size of what rounding alone makes."""
ROUNDING_VARIANCE = 1.0 / 12.0
"""Steps squared, variance that rounding adds to values that noise moves over its steps (Bennett 1948)."""
DITHERED = 0.5
"""Quantisation steps, least standard deviation at which rounding acts as white noise (Widrow and Kollar, Quantization
Noise, 2008, section 4: exact to 3 % there); below, it hides the noise."""
LARGEST = 1e60
"""Channel unit; larger values never count, so that sums of fourth powers stay finite. One over it is the least step."""


@restorable
class ValidityGroups:
    """Assignment of channels to groups.

    Parameters
    ----------
    channels : number of channels, c.
    groups : (c,) group of each channel: 0, ... 0, 1, ... 1, 2 and so on; None: all are in one group.

    Attributes
    ----------
    of : (c,) group of each channel.
    members : slice of the channels of each group.

    Raises
    ------
    ValueError : `channels` is less than 1, or `groups` is not as above.
    """

    def __init__(self, channels: int, groups: Sequence[int] | None = None) -> None:
        if channels < 1:
            raise ValueError(f"statistics need at least one channel, not {channels}")
        self.of: npt.NDArray[np.intp] = np.array([0] * channels if groups is None else groups, dtype=np.intp)
        if self.of.shape != (channels,) or self.of[0] != 0 or not set(np.diff(self.of).tolist()) <= {0, 1}:
            raise ValueError(f"groups must run from 0 upwards, one number for each of {channels} channels")
        # adjacent, so that a group is a slice of the columns, and not a copy
        edges = np.searchsorted(self.of, np.arange(self.of[-1] + 2)).tolist()
        self.members = [slice(a, b) for a, b in pairwise(edges)]

    def __len__(self) -> int:
        return len(self.members)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ValidityGroups) and self.of.tolist() == other.of.tolist()

    @property
    def channels(self) -> int:
        """Number of channels."""
        return len(self.of)

    def check(self, values: Floats, valid: Bools | None) -> tuple[Floats, Bools | None]:
        """Return samples as float64, and which of them count.

        Parameters
        ----------
        values : (n, c) channel unit, or (n,) of one channel. NaN and masked values never count.
        valid : (n, g) whether a sample counts; None: all.

        Returns
        -------
        values : (n, c) float64.
        present : (n, g) whether a sample counts; None: all.

        Raises
        ------
        ValueError : `values` is not (n, c), or `valid` cannot be reshaped to (n, g).
        """
        if isinstance(values, np.ma.MaskedArray):  # asarray would drop the mask and keep what is below it
            values = np.ma.filled(values.astype(np.float64), np.nan)
        values = np.asarray(values, dtype=np.float64)
        if values.ndim == 1 and self.of.size == 1:
            values = values[:, None]
        if values.ndim != 2 or values.shape[1] != self.of.size:
            turned = ": transpose them" if values.ndim == 2 and values.shape[0] == self.channels else ""
            raise ValueError(f"samples must have the shape (n, {self.channels}), not {values.shape}{turned}")
        with np.errstate(over="ignore", invalid="ignore"):
            # one fast pass, which NaN and inf fail, too; every value is looked at only then
            plausible = bool(abs(values.sum()) < LARGEST)
        if valid is None and plausible:
            return values, None
        shape = (len(values), len(self))
        present = np.ones(shape, dtype=bool) if valid is None else np.array(valid, dtype=bool)
        if present.size != shape[0] * shape[1]:
            raise ValueError(f"valid must have the shape {shape}, not {present.shape}")
        present = present.reshape(shape)
        if not plausible:
            for group, members in enumerate(self.members):
                present[:, group] &= (np.abs(values[:, members]) < LARGEST).all(axis=1)
        return values, None if present.all() else present
