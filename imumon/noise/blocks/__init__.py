"""Means over blocks of a stream."""

from imumon.noise.blocks.block_means import BlockAccumulator, BlockMeans

__all__ = ["BlockAccumulator", "BlockMeans"]
