"""Sums of a record, or of a part of it, that the likelihood of its noise is made of.

Two sets of statistics carry all that is known of N, B and K: Welch sums of the levels of the spectrum (`spectrum`) and
means over blocks (`blocks`). Sums of parts of a record have the levels by sub-band instead of by bin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from imumon.model.samples import Floats, Ints
from imumon.noise.blocks import BlockMeans
from imumon.noise.spectrum import PowerSpectrum
from imumon.noise.spectrum.level_sums import LevelSums


@dataclass(frozen=True, slots=True, eq=False)
class NoiseSums:
    """What is known of the noise of some channels.

    Attributes
    ----------
    tau0 : s, interval of the samples.
    levels : Welch sums by level, from the rate of the samples on.
    pooled : whether the levels are by sub-band, not by bin.
    blocks : means of the same samples.
    group : (c,) group of each channel, for the counts of the levels.
    spectrum : of the record, with the bins of its lines; None: they are not known.
    degrees : (n,) degC, means of the temperature over the same blocks, NaN where missing; None: there is none.
    """

    tau0: float
    levels: tuple[LevelSums, ...]
    pooled: bool
    blocks: BlockMeans
    group: Ints
    spectrum: PowerSpectrum | None
    degrees: Floats | None = None

    def select(self, channels: Sequence[int]) -> NoiseSums:
        """Return the sums of some of the channels."""
        columns = list(channels)
        levels = tuple(replace(level, power=level.power[columns]) for level in self.levels)
        spectrum = self.spectrum
        if spectrum is not None:
            masks = tuple(mask[columns] for mask in spectrum.masks)
            bands = tuple(spectrum.bands[c] for c in columns)
            spectrum = replace(spectrum, masks=masks, bands=bands)
        blocks = self.blocks.select(columns)
        return replace(self, levels=levels, blocks=blocks, group=self.group[columns], spectrum=spectrum)

    def with_temperature(self) -> NoiseSums:
        """Return the sums of all channels but the last one, which is the temperature, degC."""
        channels = len(self.group) - 1
        # the temperature has no noise that is fitted: its block means are a regressor of the other channels
        degrees = self.blocks.means[:, channels] + self.blocks.offset[channels]
        return replace(self.select(range(channels)), degrees=degrees)
