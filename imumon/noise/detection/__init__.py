"""Detection of samples that are not the noise of a sensor at rest."""

from imumon.noise.detection.guard import Guard, GuardedSamples

__all__ = ["Guard", "GuardedSamples"]
