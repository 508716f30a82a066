"""Register text: what the settings of a VN-100 do to its data.

A report contains register values as sent, such as ``"85 IMU filtering": "0,4,4,4,0,0,3,3,3,0"``: this form is
compared and written back. This module describes the two registers that decide which samples the sensor sends, in a few
words. Other registers and invalid values have no description and are shown unchanged.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from imumon.sources.vn100.registers import FILTERED, LOOP_RATE, RegisterNumber

Values = list[float]


def describe_setting(name: str, value: str) -> str | None:
    """Return what a setting does, in a few words; None if it is unknown.

    Parameters
    ----------
    name, value : number and name of the register, and its value, as in a report.

    >>> describe_setting("85 IMU filtering", "0,4,4,4,0,0,3,3,3,0")
    'accel, gyro and temperature averaged over 4 samples (5 ms)'
    >>> describe_setting("82 delta theta and delta velocity", "0,0,0,0,0")
    'in the body frame, bias not removed'
    """
    number = name.partition(" ")[0]
    if not number.isdigit() or int(number) not in _DESCRIPTIONS:
        return None
    try:
        return _DESCRIPTIONS[int(number)]([float(field) for field in value.split(",")])
    except (ValueError, KeyError, IndexError):
        return None


def _join(items: Sequence[str]) -> str:
    """Return the items joined by commas and "and".

    >>> _join(["mag"]), _join(["mag", "accel", "gyro"])
    ('mag', 'mag, accel and gyro')
    """
    return " and ".join(filter(None, (", ".join(items[:-1]), *items[-1:])))


def _filter(values: Values) -> str:
    """Describe the boxcar averages: sensors, number of samples of the loop, and outputs."""
    by_window: dict[tuple[float, float], list[str]] = {}
    for sensor, window, mode in zip(FILTERED, values[:5], values[5:], strict=True):
        if window > 1 and mode:
            by_window.setdefault((window, mode), []).append(sensor)
    where = {1: ", uncompensated outputs only", 2: ", compensated outputs only", 3: ""}
    parts = [
        f"{_join(sensors)} averaged over {window:g} samples ({1e3 * window / LOOP_RATE:g} ms){where[int(mode)]}"
        for (window, mode), sensors in by_window.items()
    ]
    return "; ".join(parts) or "no averages"


def _delta(values: Values) -> str:
    frame = "north, east and down" if values[0] else "the body frame"
    removed = [sensor for sensor, mode in zip(("gyro", "accel"), values[1:3], strict=True) if mode]
    return f"in {frame}, bias {f'of {_join(removed)} removed' if removed else 'not removed'}"


_DESCRIPTIONS: dict[int, Callable[[Values], str]] = {
    RegisterNumber.DELTA_CONTROL: _delta,
    RegisterNumber.IMU_FILTER: _filter,
}
