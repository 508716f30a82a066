"""Groups: channels that share their validity, because they are axes of one sensor's sample.

Rules: a sample counts for a whole group or not at all; the channels of a group lie side by side; what is no
number, or too large for its fourth power to be one, never counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from imumon.samples import Bools, Floats

LARGEST = 1e60


class ValidityGroups:
    """Which channels belong together.

    Parameters
    ----------
    channels : number of channels, c.
    groups : (c,) number of each channel's group: 0, ... 0, 1, ... 1, 2 and so on; None: all are one group.

    Attributes
    ----------
    of : (c,) group of each channel.
    members : the channels of each group.

    Raises
    ------
    ValueError : there is no channel, or `groups` are not as above.
    """

    def __init__(self, channels: int, groups: Sequence[int] | None = None) -> None:
        if channels < 1:
            raise ValueError(f"statistics need at least one channel, not {channels}")
        self.of: npt.NDArray[np.intp] = np.array([0] * channels if groups is None else groups, dtype=np.intp)
        if self.of.shape != (channels,) or self.of[0] != 0 or not set(np.diff(self.of).tolist()) <= {0, 1}:
            raise ValueError(f"groups must run from 0 upwards, one number for each of {channels} channels")
        edges = np.searchsorted(self.of, np.arange(self.of[-1] + 2)).tolist()
        self.members = [slice(a, b) for a, b in pairwise(edges)]

    def __len__(self) -> int:
        return len(self.members)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ValidityGroups) and self.of.tolist() == other.of.tolist()

    def __hash__(self) -> int:
        return hash(tuple(self.of.tolist()))

    @property
    def channels(self) -> int:
        """Number of channels."""
        return len(self.of)

    def check(self, values: Floats, valid: Bools | None) -> tuple[Floats, Bools | None]:
        """Samples as they are worked on, and which of them count.

        Parameters
        ----------
        values : (n, c) channel unit.
        valid : (n, g) which samples count; None: all.

        Returns
        -------
        values : (n, c) float64.
        present : (n, g) which count; None: all.

        Raises
        ------
        ValueError : `values` are not (n, c), or `valid` does not fill (n, g).
        """
        values = np.asarray(values, dtype=np.float64)
        if values.ndim != 2 or values.shape[1] != self.channels:
            raise ValueError(f"samples must come as (n, {self.channels}), not {values.shape}")
        with np.errstate(over="ignore", invalid="ignore"):
            ordinary = bool(
                abs(values.sum()) < LARGEST
            )  # one quick pass; only what is odd is looked at closely
        if valid is None and ordinary:
            return values, None
        shape = (len(values), len(self))
        present = np.ones(shape, dtype=bool) if valid is None else np.array(valid, dtype=bool).reshape(shape)
        if not ordinary:
            for group, members in enumerate(self.members):
                present[:, group] &= (np.abs(values[:, members]) < LARGEST).all(axis=1)
        return values, None if present.all() else present
