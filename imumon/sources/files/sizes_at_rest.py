"""Sizes at rest: what the numbers of a sensor at rest say about their unit.

The length of the three axes of an accelerometer is one g in any attitude. The mean of a gyroscope is its bias, which
says nothing of the unit; what a sample adds to it does: N * sqrt(bandwidth) is at most about a degree per second.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imumon.model.samples import AXES, Floats
from imumon.model.units import STANDARD_GRAVITY
from imumon.sources.files.unit_grammar import known_unit

FEWEST = 8
"""Rows from which numbers show anything."""

ONE_G = (0.8, 1.25)
"""Sizes of an acceleration that may be one g, in g: the errors of scale and bias of an accelerometer are smaller."""

FASTEST_RATE = 70.0
"""rad/s, 4000 deg/s: the end of the widest range of a gyroscope."""

STRONGEST = 400.0
"""m/s2, length of an accelerometer at rest at most: a stated unit that makes it longer is another one."""

NEAR_ONE_G = 0.1
"""Share by which a size may differ from one g in a unit that is not stated."""

NOISIEST = 0.02
"""rad/s, noise of a sample of a gyroscope at rest at most, chosen: 1.1 deg/s."""

BETWEEN_UNITS = 7e-3
"""Noise of a sample of a gyroscope, in its own unit, chosen: of consumer sensors, 0.06 deg/s
and 1e-3 rad/s are usual."""

BETWEEN_UNITS_BESIDE = 0.6
"""Noise of a gyroscope, in its own unit, over that of the accelerometer beside it in m/s2, chosen: of sensors of one
grade, 0.02 to 0.3 is usual in rad/s, and 1 to 17 in deg/s."""

NOISIEST_DEG = 4.0
"""Noise of a sample that is no number of deg/s; mdeg/s or deg/h is proposed."""

MILLIRADIANS = (0.4, 8.0)
"""Noise of a sample that is one in mrad/s beside an acceleration in mg: of messages of MAVLink."""


DIRECTION = 0.02
"""Ratio of the noise of a length to that of its axes, below which it is one by definition."""

MOST_APART = 10.0
"""Ratio of the noise of two axes of one sensor at most, chosen."""

FAR = 6.0
"""Standard errors by which the means or the noise of two sensors differ, chosen."""


def sample_noise(rows: Floats) -> float:
    """Return the standard deviation of the noise of (n, k) samples, the median of their columns; 0.0 of too few.

    Third differences of white noise have 1 + 9 + 9 + 1 times its variance, and show no motion of a hand or a vehicle.
    """
    valid = rows[np.isfinite(rows).all(axis=1)]
    if len(valid) < FEWEST:
        return 0.0
    # 0.6745: the median of |normal|
    spread = np.median(np.abs(np.diff(valid, n=3, axis=0)), axis=0) / (0.6745 * 20.0**0.5)
    return float(np.median(spread))


def have_one_noise(axes: Sequence[Floats]) -> bool:
    """Return whether the noise of some (n,) numbers is of one size, as that of the axes of a sensor; 0.0 may be any."""
    noise = [sample_noise(axis[:, None]) for axis in axes]
    return max(noise) <= MOST_APART * min(noise) or min(noise) == 0.0


def is_direction(rows: Floats) -> bool:
    """Return whether (n, 3) numbers have one length, whatever their noise: a program has divided them by it."""
    length = np.linalg.norm(rows, axis=1, keepdims=True)
    return rows.shape[1] == 3 and sample_noise(length) < DIRECTION * min(
        sample_noise(rows[:, [k]]) for k in range(3)
    )


def same_sensor(rows: Floats, others: Floats) -> bool:
    """Return whether (n, k) samples and those beside them may be of one sensor: their means and noise are the same.

    The means of two sensors differ by their biases, and the noise of raw and of filtered numbers differs.
    """
    count = max(len(rows), 1)
    apart = rows - others
    with np.errstate(all="ignore"):
        far = np.abs(np.nanmean(apart, axis=0)) > FAR * np.nanstd(apart, axis=0) / math.sqrt(count)
        ratio = np.abs(np.log(np.nanstd(rows, axis=0) / np.nanstd(others, axis=0)))
    return not (far.any() or (ratio > FAR / math.sqrt(count)).any())


def is_one_g(size: float) -> bool:
    """Return whether an acceleration, m/s2, is one g."""
    return ONE_G[0] <= size / STANDARD_GRAVITY <= ONE_G[1]


def median_size(rows: Floats) -> float | None:
    """Return the median length of (n, k) vectors, those that are finite; None: there is none."""
    valid = rows[np.isfinite(rows).all(axis=1)]
    return float(np.median(np.linalg.norm(valid, axis=1))) if len(valid) else None


def doubt_at_rest(sensor: str, rows: Floats, noisiest: float) -> str:
    """Return what (n, k) values of a sensor, in SI, say against their unit; empty: nothing.

    Parameters
    ----------
    noisiest : rad/s, noise of a sample of a gyroscope at most.
    """
    size, noise = median_size(rows), sample_noise(rows)
    # two axes do not show gravity: at rest, the third one may hold all of it
    if sensor == "accel" and rows.shape[1] == len(AXES) and size is not None and not is_one_g(size):
        return (
            f"the length is {size:.3g} m/s^2, and not 1 g: its unit may be wrong, or gravity has been removed"
        )
    if sensor == "gyro" and noise > noisiest:
        return f"the noise is {math.degrees(noise):.2g} deg/s, more than at rest: its unit may be wrong"
    return ""


GRAVITY_UNITS = ("m/s^2", "g", "mg", "cm/s^2", "mm/s^2")
"""Units in which one g is looked for."""


def units_of_gravity(size: float) -> list[str]:
    """Return the units in which a size is one g, the nearest first.

    >>> units_of_gravity(9.79), units_of_gravity(0.98), units_of_gravity(996.0), units_of_gravity(3.0)
    (['m/s^2'], ['g'], ['mg', 'cm/s^2'], [])
    """
    apart = _apart_from_one_g(size)
    return sorted((unit for unit in apart if apart[unit] < NEAR_ONE_G), key=apart.__getitem__)


def _apart_from_one_g(size: float) -> dict[str, float]:
    """Return the share by which a size differs from one g in each unit."""
    known = {unit: known_unit(unit) for unit in GRAVITY_UNITS}
    return {
        unit: abs(size * of.factor / STANDARD_GRAVITY - 1.0) for unit, of in known.items() if of is not None
    }


def counts_of_gravity(size: float) -> float:
    """Return the counts per g that a size shows: a power of two, if it is nearer than one g in a unit; else 0.0.

    >>> counts_of_gravity(2040.0), counts_of_gravity(999.0), counts_of_gravity(3000.0)
    (2048.0, 0.0, 0.0)
    """
    power = 2.0 ** round(math.log2(size)) if size > 0.0 else 0.0
    nearest = min(NEAR_ONE_G, *_apart_from_one_g(size).values())
    return power if 64.0 <= power <= 65536.0 and abs(size / power - 1.0) < nearest else 0.0


def unit_of_rate(rows: Floats, beside: str, noise_beside: float) -> str:
    """Return the unit that the noise of a gyroscope at rest suggests.

    Parameters
    ----------
    beside : unit of the accelerometer beside it.
    noise_beside : m/s2, of a sample of that accelerometer; 0.0: unknown.
    """
    noise = sample_noise(rows)
    if beside == "mg" and MILLIRADIANS[0] < noise < MILLIRADIANS[1]:
        return "mrad/s"
    if noise > NOISIEST_DEG:
        return "mdeg/s" if noise > 20.0 or beside == "mg" else "deg/h"
    return "deg/s" if noise > (BETWEEN_UNITS_BESIDE * noise_beside or BETWEEN_UNITS) else "rad/s"
