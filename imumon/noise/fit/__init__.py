"""Fit of N, B and K to an Allan curve."""

from imumon.noise.fit.estimator import (
    PRECISION,
    ChannelFit,
    Coefficient,
    Estimator,
    TimeTo,
    fit_curve,
)

__all__ = [
    "PRECISION",
    "ChannelFit",
    "Coefficient",
    "Estimator",
    "TimeTo",
    "fit_curve",
]
