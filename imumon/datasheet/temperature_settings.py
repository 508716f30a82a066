"""Bias against the temperature for the parameters of flight controllers.

PX4 subtracts x0 + x1 d + x2 d^2 + x3 d^3 from a reading, where d is the temperature less TREF; ArduPilot the same
without x0, where d is the temperature less 35 degC. Both hold the correction outside of TMIN to TMAX. A sensor is
written where each of its axes has a curve. A slope that the record does not show is 0: no correction. The terms that a
curve does not have are 0, too, because a parameter of an earlier calibration would remain. Sources: PX4,
src/modules/temperature_compensation/TemperatureCompensation.h; ArduPilot,
libraries/AP_InertialSensor/AP_InertialSensor_tempcal.cpp.
"""

from __future__ import annotations

from dataclasses import dataclass

from imumon.datasheet.filter_values import NAMES, caveat_lines
from imumon.datasheet.tables import record_title, sensor_axes, sensor_title
from imumon.errors import ImumonError
from imumon.messages import no_bias_curve
from imumon.report import BiasCurve, Report
from imumon.samples import AXES

ARDUPILOT_REFERENCE_DEGC = 35.0
"""degC, TEMP_REFERENCE in ArduPilot."""
ARDUPILOT_SCALE = 1e6
"""SCALE_FACTOR in ArduPilot."""
LEAST_SPAN_DEGC = 10.0
"""degC, span that ArduPilot asks of a calibration, TEMP_RANGE_MIN."""
TERMS = 4
"""Terms of both polynomials, with the constant one."""


class NoBiasCurve(ImumonError):
    """No sensor has a curve of the bias against the temperature."""


@dataclass(frozen=True, slots=True)
class SensorCurve:
    """Curves of the axes of a sensor about one reference, or why there are none."""

    reason: str = ""  # empty: there is a curve
    reference_degC: float = 0.0
    low_degC: float = 0.0
    high_degC: float = 0.0
    terms: tuple[tuple[float, ...], ...] = ()  # by axis and power, channel unit / degC^power
    comments: tuple[str, ...] = ()

    @property
    def span_degC(self) -> float:
        return self.high_degC - self.low_degC


def is_shown(curve: BiasCurve) -> bool:
    """Return whether the record shows that the bias depends on the temperature."""
    slope = curve.terms[1]
    return len(curve.terms) > 2 or not slope.low <= 0.0 <= slope.high


def sensor_curve(report: Report, sensor: str, reference_degC: float | None = None) -> SensorCurve:
    """Return the curves of the axes of a sensor.

    Parameters
    ----------
    reference_degC : degC; None: the middle of the temperatures of the record.
    """
    curves = {axis: channel.bias_curve for axis, channel in sensor_axes(report, sensor)}
    whole = [curve for curve in curves.values() if curve is not None and curve.is_known]
    if len(whole) < len(AXES):
        reasons = [curve.reason for curve in curves.values() if curve is not None and curve.reason]
        return SensorCurve(reasons[0] if reasons else "no_axis")
    # where all axes have been: a sensor has one span for its three curves
    low, high = max(curve.degC[0] for curve in whole), min(curve.degC[-1] for curve in whole)
    reference = 0.5 * (low + high) if reference_degC is None else reference_degC
    comments = [f"{NAMES[sensor]}, {low:.1f} to {high:.1f} degC; 95 % limits of the curve at its ends:"]
    terms = []
    for axis, curve in zip(curves, whole, strict=True):
        comments.append(f"  {axis}: {_curve_text(curve)}")
        terms.append(_terms_about(curve, reference))
    return SensorCurve("", reference, low, high, tuple(terms), tuple(comments))


def _terms_about(curve: BiasCurve, reference_degC: float) -> tuple[float, ...]:
    """Return the `TERMS` coefficients of the powers of the temperature less a reference, the constant first."""
    from numpy.polynomial import Polynomial

    # without a slope that shows, the constant alone
    shown = [term.value for term in curve.terms[: None if is_shown(curve) else 1]]
    # p(t - t0) as a polynomial of d = t - reference: p is applied to the polynomial d + (reference - t0)
    shift = Polynomial([reference_degC - (curve.reference_degC or 0.0), 1.0])
    moved = Polynomial(shown)(shift).coef.tolist()
    # 0 and not nothing: a parameter of an earlier calibration would remain
    return (*moved, *[0.0] * (TERMS - len(moved)))


def _curve_text(curve: BiasCurve) -> str:
    """Return degree and limits of a curve, or that no slope is seen, and the hysteresis."""
    slope, loop = curve.terms[1], curve.hysteresis
    half = max(curve.high[0] - curve.bias[0], curve.high[-1] - curve.bias[-1])
    text = f"degree {len(curve.terms) - 1}, ±{half:.1e} {curve.terms[0].unit}"
    if not is_shown(curve):
        text = f"no slope seen, from {slope.low:.1e} to {slope.high:.1e} {slope.unit} (95 %): 0 is written"
    return (
        text
        if loop is None
        else f"{text}; hysteresis {loop.value:.1e}, from {loop.low:.1e} to {loop.high:.1e}"
    )


def curve_header(report: Report) -> list[str]:
    """Return the comments in front of the parameters.

    Raises
    ------
    NoBiasCurve : no sensor has a curve.
    """
    by_sensor = {sensor: sensor_curve(report, sensor) for sensor in NAMES}
    if all(curves.reason for curves in by_sensor.values()):
        text, cure = no_bias_curve(by_sensor["gyro"].reason)
        raise NoBiasCurve("no_bias_curve", f"the bias has no curve against the temperature: {text}", cure)
    lines = [
        f"{sensor_title(report)}: bias against the temperature, measured by imumon, {report.time}",
        record_title(report),
    ]
    for sensor, curves in by_sensor.items():
        if not curves.reason and curves.span_degC < LEAST_SPAN_DEGC:
            lines.append(
                f"WARNING: the {NAMES[sensor]} spans {curves.span_degC:.1f} degC: do not use it beyond"
            )
    return [*lines, *caveat_lines(report)]


def px4_lines(report: Report, sensor: str, letter: str) -> list[str]:
    """Return the parameters TC_* of the first instance of a sensor."""
    curves, name = sensor_curve(report, sensor), f"TC_{letter}0"
    if curves.reason:
        return [f"# {NAMES[sensor]}: {no_bias_curve(curves.reason)[0]}", f"# TC_{letter}_ENABLE ?"]
    values = {"TMIN": curves.low_degC, "TMAX": curves.high_degC, "TREF": curves.reference_degC}
    for power in range(TERMS):
        for number, terms in enumerate(curves.terms):
            # the mean of an accelerometer holds gravity: its curve is 0 at the reference
            values[f"X{power}_{number}"] = 0.0 if sensor == "accel" and power == 0 else terms[power]
    return [
        *(f"# {line}" for line in curves.comments),
        f"param set TC_{letter}_ENABLE 1",
        f"# {name}_ID ?  the device_id that `listener sensor_{sensor}` shows: nothing is corrected without it",
        *(f"param set {name}_{key} {_number(value)}" for key, value in values.items()),
    ]


def ardupilot_lines(report: Report) -> list[str]:
    """Return the parameters INS_TCAL1_*."""
    by_sensor = {
        sensor: sensor_curve(report, sensor, ARDUPILOT_REFERENCE_DEGC) for sensor in ("accel", "gyro")
    }
    known = [curves for curves in by_sensor.values() if not curves.reason]
    low, high = max(curves.low_degC for curves in known), min(curves.high_degC for curves in known)
    lines = ["INS_TCAL1_ENABLE,1", f"INS_TCAL1_TMIN,{_number(low)}", f"INS_TCAL1_TMAX,{_number(high)}"]
    for sensor, curves in by_sensor.items():
        group = {"accel": "ACC", "gyro": "GYR"}[sensor]
        lines += [f"# {line}" for line in curves.comments]
        if curves.reason:
            lines += [f"# {NAMES[sensor]}: {no_bias_curve(curves.reason)[0]}", f"# INS_TCAL1_{group}1_X ?"]
        for power in range(1, TERMS if not curves.reason else 0):  # it has no constant term
            for axis, terms in zip("XYZ", curves.terms, strict=True):
                value = terms[power] * ARDUPILOT_SCALE
                lines.append(f"INS_TCAL1_{group}{power}_{axis},{_number(value)}")
    return lines


def _number(value: float) -> str:
    """Return a number with the digits that a float of 32 bits has."""
    return f"{value:.9g}"
