"""Means over blocks of a stream, and their cosine transform."""

from imumon.noise.blocks.block_means import BlockAccumulator, BlockMeans

__all__ = ["BlockAccumulator", "BlockMeans"]
