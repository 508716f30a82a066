"""Figures of others, to set beside the measured ones; each with what it is and where it comes from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure in the readable unit of its coefficient (`units.READABLE`).

    Attributes
    ----------
    value : the figure, or the upper end of a range.
    text : as its source prints it.
    """

    value: float
    text: str


MANUFACTURER: Mapping[tuple[str, str], Figure] = {
    ("gyro", "N"): Figure(0.21, "0.21 (0.0035 °/s/√Hz)"),
    ("gyro", "B"): Figure(10.0, "5 to 7 typical, < 10"),
    ("accel", "N"): Figure(0.0824, "0.082 (0.14 mg/√Hz)"),
    ("accel", "B"): Figure(0.04, "< 0.04"),
    ("mag", "N"): Figure(0.14, "0.14"),
}
"""VN-100, datasheet of the manufacturer. Its B is an in-run bias stability, the floor of the curve."""

LABORATORY: Mapping[tuple[str, str], tuple[float, float, float]] = {
    ("gyro", "N"): (8.858211836469779e-5, 1.118982270722039e-4, 9.042853866968627e-5),
    ("gyro", "B"): (2.187472354808633e-6, 3.558918644938269e-5, 1.683075710026665e-6),
    ("accel", "N"): (0.001876856697026, 0.001896141910733, 0.002811394406225),
    ("accel", "B"): (4.102051157211426e-4, 0.001026494646724, 5.055396828094319e-4),
}
"""SI, axes x, y, z: a published laboratory report on a VN-100 from five hours of `$VNYMR` at 40 Hz, an
aliased and compensated stream: its N is about √5 too high, and its B describes the sensor's filter."""

LABORATORY_GRADE = "industrial"
