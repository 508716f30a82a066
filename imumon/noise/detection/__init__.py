"""Detection of samples that are not the noise of a sensor at rest."""

from imumon.noise.detection.guard import AFTER, BEFORE, START, Guard, GuardedSamples

__all__ = [
    "AFTER",
    "BEFORE",
    "START",
    "Guard",
    "GuardedSamples",
]
