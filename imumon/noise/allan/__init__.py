"""Allan variance of an endless stream."""

from imumon.noise.allan.cascade import OctaveCascade
from imumon.noise.allan.curve import AllanCurve

__all__ = ["AllanCurve", "OctaveCascade"]
