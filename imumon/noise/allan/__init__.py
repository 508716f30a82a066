"""Allan variance of an endless stream."""

from imumon.noise.allan.cascade import (
    AllanCurve,
    OctaveCascade,
)

__all__ = [
    "AllanCurve",
    "OctaveCascade",
]
