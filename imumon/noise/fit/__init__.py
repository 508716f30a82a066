"""Fit of N, B and K to the sums of a record; `estimator` has the way of a channel through the package."""

from imumon.noise.fit.bias_curve import BiasFit
from imumon.noise.fit.curve_statement import read_slopes
from imumon.noise.fit.estimator import Estimator, fit_curve
from imumon.noise.fit.statement import ChannelFit, RegressorEstimate, StepEstimate

__all__ = [
    "BiasFit",
    "ChannelFit",
    "Estimator",
    "RegressorEstimate",
    "StepEstimate",
    "fit_curve",
    "read_slopes",
]
