"""Fit of N, B and K to the sums of a record."""

from imumon.noise.fit.estimator import Estimator, fit_curve
from imumon.noise.fit.results import ChannelFit, FittedCoefficient, read_slopes

__all__ = ["ChannelFit", "Estimator", "FittedCoefficient", "fit_curve", "read_slopes"]
