"""Register text: what the settings of a VN-100 do to its data.

A report contains register values as sent, such as ``"85 IMU filtering": "0,4,4,4,0,0,3,3,3,0"``: this form is
compared and written back. This module describes each value in a few words. Unknown registers and invalid
values have no description and are shown unchanged.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from imumon.devices.vn100 import registers
from imumon.devices.vn100.registers import REGISTERS, RegisterError, RegisterNumber, Value

Values = dict[str, Value]
_IDENTITY = [1, 0, 0, 0, 1, 0, 0, 0, 1]


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
    number = name.split()[0] if name else ""
    if not number.isdigit() or int(number) not in _DESCRIPTIONS:
        return None
    try:
        values = REGISTERS[int(number)].parse(value.split(","))
        return _DESCRIPTIONS[int(number)](values)
    except (RegisterError, KeyError, IndexError):
        return None


def _join(items: Sequence[str]) -> str:
    """Return the items joined by commas and "and".

    >>> _join(["mag"]), _join(["mag", "accel", "gyro"])
    ('mag', 'mag, accel and gyro')
    """
    return " and ".join(filter(None, (", ".join(items[:-1]), *items[-1:])))


def _calibration(values: Values) -> str:
    """Describe registers 23, 84 and 25: out = C (in - b)."""
    numbers = list(values.values())
    changed = ["scale or axes"] if numbers[:9] != _IDENTITY else []
    changed += ["bias"] if any(numbers[9:]) else []
    return f"{_join(changed)} changed by the user" if changed else "factory calibration only"


def _rotation(values: Values) -> str:
    return "axes are rotated" if list(values.values()) != _IDENTITY else "none: the axes of the housing"


def _filter(values: Values) -> str:
    """Describe the boxcar averages: sensors, number of samples of the loop, and outputs."""
    by_window: dict[tuple[int, int], list[str]] = {}
    for sensor in ("mag", "accel", "gyro", "temperature", "pressure"):
        window, mode = int(values[f"{sensor}_window"]), int(values[f"{sensor}_mode"])
        if window > 1 and mode:
            by_window.setdefault((window, mode), []).append(sensor)
    where = {1: ", uncompensated outputs only", 2: ", compensated outputs only", 3: ""}
    parts = [
        f"{_join(sensors)} averaged over {window} samples ({1e3 * window / registers.LOOP_RATE:g} ms){where[mode]}"
        for (window, mode), sensors in by_window.items()
    ]
    return "; ".join(parts) or "no averages"


def _delta(values: Values) -> str:
    frame = "north, east and down" if values["frame"] else "the body frame"
    removed = [s for s in ("gyro", "accel") if values[f"{s}_compensation"]]
    return f"in {frame}, bias {f'of {_join(removed)} removed' if removed else 'not removed'}"


def _vpe(values: Values) -> str:
    if not values["enable"]:
        return "off: no attitude filter"
    heading = {0: "absolute", 1: "relative", 2: "indoor"}[int(values["heading"])]
    return f"on, {heading} heading"


def _bias(values: Values) -> str:
    numbers = list(values.values())
    return f"{', '.join(f'{float(n):g}' for n in numbers)} rad/s" if any(numbers) else "none"


def _iron(values: Values) -> str:
    mode = {0: "off", 1: "on", 2: "reset"}[int(values["mode"])]
    return f"hard and soft iron: {mode}, {'not applied' if values['output'] == 1 else 'applied'}"


def _protocol(values: Values) -> str:
    check = "8-bit checksums" if values["serial_checksum"] == 1 else "CRC-16"
    count = {1: "SyncIn count", 2: "SyncIn time", 3: "SyncOut count", 4: "time of the PPS"}
    added = [count[int(values["serial_count"])]] if values["serial_count"] else []
    added += ["status"] if values["serial_status"] else []
    return f"{check}, {_join(added) or 'nothing'} appended"


def _sync(values: Values) -> str:
    pulse = {3: "are counted", 4: "start a sample", 5: "start a message", 6: "start every message"}
    out = {0: "none", 1: "at each sample", 2: "at each result", 3: "at each attitude", 6: "once a second"}
    return f"pulses in {pulse[int(values['in_mode'])]}, pulses out: {out[int(values['out_mode'])]}"


def _output(values: Values) -> str:
    mode, divisor = int(values["async_mode"]), int(values["divisor"])
    if not mode or not divisor:
        return "off"
    port = {1: "port 1", 2: "port 2", 3: "both ports"}[mode]
    return f"{registers.LOOP_RATE / divisor:g} Hz on {port}"


def _type(values: Values) -> str:
    kind = int(values["type"])
    return f"${registers.OUTPUT_TYPES[kind]}" if kind else "none"


_DESCRIPTIONS: dict[int, Callable[[Values], str]] = {
    RegisterNumber.BAUD: lambda values: f"{values['baud']:,}",
    RegisterNumber.OUTPUT_TYPE: _type,
    RegisterNumber.OUTPUT_RATE: lambda values: f"{values['rate']} Hz",
    **dict.fromkeys((23, 25, 84), _calibration),
    RegisterNumber.ROTATION: _rotation,
    RegisterNumber.PROTOCOL: _protocol,
    RegisterNumber.SYNC_CONTROL: _sync,
    35: _vpe,
    RegisterNumber.STARTUP_BIAS: _bias,
    RegisterNumber.IRON_CONTROL: _iron,
    RegisterNumber.DELTA_CONTROL: _delta,
    RegisterNumber.IMU_FILTER: _filter,
    **dict.fromkeys(registers.BINARY_OUTPUTS, _output),
}
