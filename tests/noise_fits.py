"""Curves and fits of arrays, and how many of their limits hold a truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imumon.model.samples import Bools, Floats
from imumon.noise import ChannelFit, OctaveCascade, fit_curve
from imumon.noise.allan import AllanCurve
from imumon.noise.blocks import BlockAccumulator


def cascade_of(values: Floats, rate_hz: float, valid: Bools | None = None) -> OctaveCascade:
    """Return the cascade of (n, c) values with their validity (n, 1)."""
    cascade = OctaveCascade(values.shape[1], tau0=1.0 / rate_hz)
    cascade.update(values, valid)
    return cascade


def curve_of(values: Floats, rate_hz: float, valid: Bools | None = None) -> AllanCurve:
    return cascade_of(values, rate_hz, valid).result()


def with_temperature(curve: AllanCurve, degrees: Floats, rate_hz: float) -> AllanCurve:
    """Return the curve of a record beside whose samples a temperature (n,) was measured."""
    blocks = BlockAccumulator([0], 1.0 / rate_hz)
    blocks.update(degrees[None], None, np.zeros(1))
    means = blocks.result()
    return replace(curve, sums=replace(curve.sums, degrees=means.means[:, 0] + means.offset[0]))


def fits_of(
    values: Floats, rate_hz: float, valid: Bools | None = None, *, averaged: bool = False
) -> tuple[ChannelFit, ...]:
    return fit_curve(curve_of(values, rate_hz, valid), averaged=averaged, time_to=False)


def column(fits: Sequence[ChannelFit], name: str, limit: str) -> Floats:
    """Return a value or a limit of a coefficient of all channels; NaN where there is none."""
    return np.array([getattr(getattr(fit, name), limit) for fit in fits], dtype=np.float64)


def held(fits: Sequence[ChannelFit], name: str, truth: float) -> int:
    """Return the number of channels whose limits hold the truth."""
    return int(((column(fits, name, "low") <= truth) & (truth <= column(fits, name, "high"))).sum())


def width(fits: Sequence[ChannelFit], name: str) -> float:
    """Return the median width of the limits of a coefficient."""
    return float(np.median(column(fits, name, "high") - column(fits, name, "low")))


def measured(fits: Sequence[ChannelFit], name: str) -> int:
    """Return the number of channels with a value of a coefficient."""
    return sum(getattr(fit, name).status == "measured" for fit in fits)


MOST_MISSED = 2
"""Channels of eight whose limits may miss the truth: more do once in 170 times."""


def check_noise(fits: Sequence[ChannelFit], N: float, B: float) -> None:
    """Check that limits of eight channels hold N and B, and that no walk is invented."""
    assert held(fits, "N", N) >= len(fits) - MOST_MISSED
    assert held(fits, "B", B) >= len(fits) - MOST_MISSED
    assert measured(fits, "K") <= 1
