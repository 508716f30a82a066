"""Fit of N, B and K to an Allan curve."""

from imumon.noise.fit.estimator import Estimator, fit_curve
from imumon.noise.fit.results import ChannelFit, FittedCoefficient, read_slopes

__all__ = ["ChannelFit", "Estimator", "FittedCoefficient", "fit_curve", "read_slopes"]
