"""Time base: which tick of the sample clock each sample belongs to."""
