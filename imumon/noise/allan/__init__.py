"""Allan variance of an endless stream.

`cascade` states the statistic and its rules, `octave` computes the differences of one averaging time after the other,
`curve` turns their sums into variances.
"""

from imumon.noise.allan.cascade import OctaveCascade
from imumon.noise.allan.curve import AllanCurve

__all__ = ["AllanCurve", "OctaveCascade"]
