"""Fit of N, B and K to the sums of a record."""

from imumon.noise.fit.estimator import Estimator, fit_curve
from imumon.noise.fit.results import ChannelFit, read_slopes

__all__ = ["ChannelFit", "Estimator", "fit_curve", "read_slopes"]
