"""Register values of a VN-100: which stream to request, its alias factor, and which values to restore.

Register values are text, as on the wire. An output with divisor d sends every d/800 s. Samples pass the boxcar
average of register 85, whose length does not follow the output rate: they are aliased unless it is as long as
the output interval. Changes are volatile, and the values of the user are restored, also if an earlier process
was killed. This module sends nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TypeAlias

from imumon.model.samples import Kind
from imumon.sources.vn100.registers import BINARY_OUTPUTS, LOOP_RATE, REGISTERS, RegisterNumber

Texts: TypeAlias = Mapping[int, str]
"""Register values by register number, fields joined by commas."""

LOAD = 0.6
"""Share of the baud rate for the requested stream: replies and a second stream need the rest."""
FACTORY_WINDOW = 4
"""Samples that the filter of register 85 averages with factory settings."""
OFF = "0,0,00"
UNCOMPENSATED_DELTAS = "0,0,0,0,0"

_OUTPUTS: dict[Kind, tuple[int, int]] = {
    "deltas": (0x00F2, 64),  # UncompMag, Temp, Pres, DeltaTheta, DeltaVel
    "uncompensated": (0x003E, 60),  # UncompMag, UncompAccel, UncompGyro, Temp, Pres
    "compensated": (0x0730, 60),  # Temp, Pres, Mag, Accel, AngularRate
}
"""Word of the IMU group beside TimeStartup, and bytes of a packet."""

DIVISORS = tuple(d for d in range(1, LOOP_RATE + 1) if LOOP_RATE % d == 0)
"""Divisors whose rate is a whole number of hertz."""


CHANGEABLE = (
    *BINARY_OUTPUTS,
    RegisterNumber.DELTA_CONTROL,
    RegisterNumber.IMU_FILTER,
    RegisterNumber.OUTPUT_TYPE,
)
"""Registers that may be changed, in the order in which they are restored; the baud rate comes last."""


def output(kind: Kind, divisor: int, mode: int) -> str:
    """Return the value of a binary output register for `kind`; `mode` is the port of the sensor, 1 or 2.

    >>> output("deltas", 8, 1)
    '1,8,05,0001,00F2'
    """
    return f"{mode},{divisor},05,0001,{_OUTPUTS[kind][0]:04X}"


def divisors(kind: Kind, baud: int, rate_hz: float = 0.0) -> list[int]:
    """Return the divisors whose stream fits the baud rate, the fastest first; `rate_hz`, if any: of that rate only.

    >>> [LOOP_RATE // divisors("deltas", baud)[0] for baud in (9600, 115200, 921600)]
    [8, 100, 800]
    """
    fitting = [d for d in DIVISORS if _OUTPUTS[kind][1] * LOOP_RATE / d <= LOAD * baud / 10]
    return [d for d in fitting if not rate_hz or d * rate_hz == LOOP_RATE]


def configured_output(settings: Texts) -> str:
    """Return what the sensor sends by its settings, in words.

    >>> configured_output({6: "19", 7: "40"}), configured_output({6: "0", 75: "1,8,05,0001,00F2"})
    ('ASCII at 40 Hz', 'binary at 100 Hz')
    """
    kind, rate = settings.get(RegisterNumber.OUTPUT_TYPE, "0"), settings.get(RegisterNumber.OUTPUT_RATE, "")
    outputs = [f"ASCII at {rate or '?'} Hz"] if kind != "0" else []
    for register in BINARY_OUTPUTS:
        mode, divisor, *_ = parse_output(settings.get(register, OFF)) or (0, 0)
        if mode and divisor:
            outputs.append(f"binary at {LOOP_RATE / divisor:g} Hz")
    return " and ".join(outputs) or "nothing"


def parse_output(text: str) -> tuple[int, int, int, tuple[int, ...]] | None:
    """Return mode, divisor, groups and field words of a binary output register; None if `text` is invalid.

    >>> parse_output("1,8,5,0001,F2") == parse_output("1,8,05,0001,00F2")
    True
    """
    fields = text.split(",")
    try:
        mode, divisor = int(fields[0]), int(fields[1])
        groups, *words = (int(field, 16) for field in fields[2:])
    except (ValueError, IndexError):
        return None
    return mode, divisor, groups, tuple(words)


def is_ours(text: str) -> bool:
    """Return whether a binary output register has one of the streams that imumon requests.

    >>> is_ours("2,1,5,1,00F2"), is_ours("1,8,01,0001"), is_ours("0,0,00")
    (True, False, False)
    """
    parsed = parse_output(text)
    if parsed is None or parsed[0] not in (1, 2) or parsed[2] != 5:
        return False
    return parsed[3] in [(0x0001, word) for word, _ in _OUTPUTS.values()]


def source(text: str) -> str | None:
    """Return the source name of the stream of a binary output register, as the decoder forms it.

    >>> source("1,8,5,0001,F2")
    'binary 05:0001,00F2'
    """
    parsed = parse_output(text)
    return parsed and f"binary {parsed[2]:02X}:{','.join(f'{word:04X}' for word in parsed[3])}"


def same(one: str, other: str) -> bool:
    """Return whether two texts of a binary output register are equivalent."""
    return parse_output(one) == parse_output(other)


def off_port(text: str, mode: int) -> str:
    """Return a binary output register without the port `mode`; the other port keeps its stream.

    >>> off_port("3,8,01,0001", 1), off_port("1,8,01,0001", 1), off_port("2,8,01,0001", 1)
    ('2,8,01,0001', '0,8,01,0001', '2,8,01,0001')
    """
    first, _, rest = text.partition(",")
    return f"{int(first) & ~mode},{rest}"


def windowed(text: str, window: int, kind: Kind) -> str | None:
    """Return register 85 with windows as long as the output interval; None if `text` is invalid.

    >>> windowed("0,4,4,4,0,0,1,0,3,0", 20, "uncompensated")
    '0,20,20,4,0,0,1,1,3,0'
    """
    fields = text.split(",")
    if len(fields) != 10 or not all(field.isdigit() for field in fields):
        return None
    bit = 1 if kind == "uncompensated" else 2  # of the mode: which of the two outputs the window applies to
    fields[1] = fields[2] = str(window)  # windows of mag, accel, gyro, temperature, pressure; then the modes
    for mode in (6, 7):
        fields[mode] = str(int(fields[mode]) | bit)
    return ",".join(fields)


def alias_factors(
    kind_of: Callable[[str], Kind], rate_hz: float | None, filtering: str | None
) -> dict[str, float | None]:
    """Return the nominal factor by which aliasing inflates N of each sensor; 1: none, None: unknown.

    The sensor averages `window` samples of its 800 Hz loop and sends every (800/rate)-th average. White noise
    above half the output rate folds: the variance is 800/(window rate) times that of a true cluster average
    (IEEE Std 952-2020, C.1). ``deltas`` are true cluster averages.

    Parameters
    ----------
    kind_of : kind of the samples of a sensor.
    rate_hz : Hz, output rate; None: unknown.
    filtering : register 85; None: unknown.

    >>> alias_factors(lambda _: "compensated", 40.0, "0,4,4,4,0,0,3,3,3,0")["gyro"].__round__(3)
    2.236
    """
    factors: dict[str, float | None] = {}
    fields = (filtering or "").split(",")
    for sensor, column in (("gyro", 2), ("accel", 1)):
        kind = kind_of(sensor)
        if kind == "deltas":
            factors[sensor] = 1.0
        elif not rate_hz or len(fields) != 10 or not all(map(str.isdigit, fields)):
            factors[sensor] = None
        else:
            applies = int(fields[column + 5]) & (1 if kind == "uncompensated" else 2)
            factors[sensor] = alias_factor(int(fields[column]) if applies else 1, rate_hz)
    return factors


def alias_factor(window: int, rate_hz: float) -> float:
    """Return the nominal factor by which aliasing inflates N of averages of `window` samples; see `alias_factors`.

    >>> alias_factor(20, 40.0), alias_factor(0, 800.0)
    (1.0, 1.0)
    """
    return max(1.0, math.sqrt(LOOP_RATE / (max(1, window) * rate_hz)))


def filter_advice(rate_hz: float | None) -> Mapping[str, str]:
    """Return how to configure the filter, and the effect of the factory filter; see `DeviceDriver.filter_advice`."""
    factor = alias_factor(FACTORY_WINDOW, rate_hz) if rate_hz else 1.0
    here = f", here {factor:.2f}" if factor > 1.0 else ""
    folds_below = LOOP_RATE // FACTORY_WINDOW
    return {
        "aliased": f"The filter of a VN-100 is register {RegisterNumber.IMU_FILTER}: "
        f"set it to {LOOP_RATE} Hz divided by the rate.",
        "unknown": f"If it is a VN-100 with factory settings, N of point samples below {folds_below} Hz is too high by "
        f"√({folds_below} Hz / rate){here}.",
    }


def originals(current: Texts, saved: Texts | None, new_baud: str | None) -> dict[int, str]:
    """Return the values to restore at the end of the registers that imumon may change.

    A killed process leaves its stream on and the ASCII output off. Values of this form are replaced by the saved
    ones, or by the factory values without saved ones. All other values are those of the user.

    Parameters
    ----------
    current : registers as read now.
    saved : originals of an earlier process that did not restore them; None: there are none.
    new_baud : baud rate that this process may have set.
    """
    # only what could be read is written back
    values = {r: current[r] for r in (*CHANGEABLE, RegisterNumber.BAUD) if r in current}
    requested = [r for r in BINARY_OUTPUTS if is_ours(values.get(r, OFF))]
    if saved is None:
        if not requested:  # without one of the streams of imumon, all of it is the choice of the user
            return values
        saved = {
            r: REGISTERS[r].factory
            for r in (RegisterNumber.OUTPUT_TYPE, *BINARY_OUTPUTS, RegisterNumber.IMU_FILTER)
        }
    changed = {
        RegisterNumber.OUTPUT_TYPE: values.get(RegisterNumber.OUTPUT_TYPE) == "0",
        RegisterNumber.DELTA_CONTROL: values.get(RegisterNumber.DELTA_CONTROL) == UNCOMPENSATED_DELTAS,
        RegisterNumber.IMU_FILTER: _is_windowed(values.get(RegisterNumber.IMU_FILTER, "")),
        RegisterNumber.BAUD: values.get(RegisterNumber.BAUD) == new_baud,
    } | {r: r in requested or _is_off_port(values.get(r, OFF), saved.get(r, OFF)) for r in BINARY_OUTPUTS}
    return {r: saved[r] if changed[r] and r in saved else text for r, text in values.items()}


def _is_off_port(text: str, before: str) -> bool:
    """Return whether a binary output is `before` without one port, or without both."""
    return parse_output(before) is not None and any(same(text, off_port(before, mode)) for mode in (1, 2, 3))


def _is_windowed(text: str) -> bool:
    fields = text.split(",")
    return len(fields) == 10 and fields[1] == fields[2] and fields[1] in {str(d) for d in DIVISORS}
