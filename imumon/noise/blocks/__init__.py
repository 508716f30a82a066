"""Means over blocks of a stream: how its mean moves.

`block_means` states the model: what a mean over a block knows, how blocks join, and what a gap does to them.
"""

from imumon.noise.blocks.block_means import BlockAccumulator, BlockMeans

__all__ = ["BlockAccumulator", "BlockMeans"]
