"""Published noise values of the VN-100, to show beside measured ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from imumon.devices.base import ReferenceValue
from imumon.units import READABLE, figures

_MANUFACTURER: Mapping[tuple[str, str], tuple[float, str]] = {
    ("gyro", "N"): (0.21, "0.21 (0.0035 °/s/√Hz)"),
    ("gyro", "B"): (10.0, "5 to 7 typical, < 10"),
    ("accel", "N"): (0.0824, "0.082 (0.14 mg/√Hz)"),
    ("accel", "B"): (0.04, "< 0.04"),
    ("mag", "N"): (0.14, "0.14"),
}
"""Datasheet of the manufacturer, readable units. Its B is an in-run bias stability, the curve's floor."""

_LABORATORY: Mapping[tuple[str, str], tuple[float, float, float]] = {
    ("gyro", "N"): (8.858211836469779e-5, 1.118982270722039e-4, 9.042853866968627e-5),
    ("gyro", "B"): (2.187472354808633e-6, 3.558918644938269e-5, 1.683075710026665e-6),
    ("accel", "N"): (0.001876856697026, 0.001896141910733, 0.002811394406225),
    ("accel", "B"): (4.102051157211426e-4, 0.001026494646724, 5.055396828094319e-4),
}
"""SI, axes x, y, z: a published laboratory report on a VN-100 from five hours of `$VNYMR` at 40 Hz. The
stream is aliased and compensated: N is about √5 too high, and B describes the filter of the sensor."""

MAG_HZ = 250.0
"""Hz, rate at which a VN-100 reads its magnetometer, unfiltered."""

FILTERED_BELOW_HZ = 200.0
"""Hz, output rate below which the factory filter passes noise that folds: it averages 4 samples of 800 Hz."""


def _values() -> dict[tuple[str, str], Sequence[ReferenceValue]]:
    values: dict[tuple[str, str], Sequence[ReferenceValue]] = {}
    for key, (value, text) in _MANUFACTURER.items():
        laboratory = " / ".join(figures(v * READABLE[key].factor) for v in _LABORATORY.get(key, ()))
        values[key] = (
            ReferenceValue("manufacturer", value, text),
            *([ReferenceValue("laboratory report, x / y / z", None, laboratory)] if laboratory else []),
        )
    return values


REFERENCE_VALUES: Mapping[tuple[str, str], Sequence[ReferenceValue]] = MappingProxyType(_values())
"""Published values by (sensor, coefficient)."""

_NOTE = (
    "The laboratory report is from five hours of $VNYMR at 40 Hz and concludes industrial for both sensors. "
    "That stream is aliased and compensated: its N is about √5 = 2.24 times too high, and its gyroscope B "
    "describes the filter of the sensor. The manufacturer's bias stability is the curve's floor, 0.664 B."
)


def reference_notes(channels: Sequence[str], rate_hz: float | None) -> Sequence[str]:
    """Return notes for the comparison of a record with `REFERENCE_VALUES`.

    Parameters
    ----------
    channels : names of the channels of the record.
    rate_hz : Hz, their sample rate. The magnetometer has point samples: below `MAG_HZ` its noise is aliased.
    """
    if rate_hz is None or rate_hz >= MAG_HZ or "mag/x" not in channels:
        return (_NOTE,)
    return (
        _NOTE,
        f"A VN-100 reads its magnetometer {MAG_HZ:g} times a second, unfiltered: at {rate_hz:g} Hz its N is "
        f"{(MAG_HZ / rate_hz) ** 0.5:.2f} times too high.",
    )


def filter_advice(rate_hz: float | None) -> Mapping[str, str]:
    """Return how to configure the filter, and the effect of the factory filter; see `DeviceDriver.filter_advice`."""
    folds = rate_hz is not None and 0.0 < rate_hz < FILTERED_BELOW_HZ
    here = f", here {(FILTERED_BELOW_HZ / rate_hz) ** 0.5:.2f}" if rate_hz and folds else ""
    return {
        "aliased": "The filter of a VN-100 is register 85: set it to 800 Hz divided by the rate.",
        "unknown": "With the factory settings of a VN-100, N of point samples below 200 Hz is too high by "
        f"√(200 Hz / rate){here}.",
    }
