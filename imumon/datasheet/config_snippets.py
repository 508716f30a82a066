"""Settings of other software, with units and 95 % limits in comments.

Rules: the worst axis decides, because these programs take one number for three axes. A coefficient that the
record does not show is replaced by its 95 % upper bound, which is safe, with a comment on its line. Where not
even a bound is known, the line is a comment without a number. Every caveat comes first. No margin is added:
the user knows the margin of the vehicle.

N is the density of the rate as an Allan deviation gives it: white noise of N has the standard deviation
N / sqrt(dt) in samples of dt. K drives the bias: it walks by K sqrt(t). The comments cite how each program
defines its numbers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from imumon.datasheet.tables import filter_warning, record_title, sensor_axes, sensor_title
from imumon.messages import (
    FILTER_NOT_KNOWN,
    caveats,
    joined,
    line,
    no_value_text,
)
from imumon.report import Coefficient, Report
from imumon.units import duration

NAMES = {"gyro": "gyroscope", "accel": "accelerometer"}
MEANINGS = {"N": "white noise density", "K": "random walk of the bias"}
CURES = {
    "constant": "find out why it is dead or stuck, and record again",
    "resolution": "record with more digits, or a finer range",
}
"""What to do about a coefficient that more data will not give, by its `reason_code`."""
BOUND_COMMENT = "  # 95 % upper bound, not seen in this record"


@dataclass(frozen=True, slots=True)
class WorstAxis:
    """Largest of the axes; a bound counts where nothing is measured."""

    value: float | None  # SI, None if no axis has even a bound
    lines: tuple[str, ...]  # comments: meaning of the value, and every axis
    comment: str = ""  # comment after the value if it is a bound; else empty


def worst_axis(report: Report, sensor: str, letter: str) -> WorstAxis:
    """Return N or K of a sensor for a setting that takes one number."""
    axes = sensor_axes(report, sensor)
    parts: dict[str, Coefficient] = {a: part for a, c in axes if (part := getattr(c, letter)) is not None}
    sizes = {axis: size for axis, part in parts.items() if (size := _size(part)) is not None}
    title = f"{NAMES[sensor]} {letter}, {MEANINGS[letter]}"
    if not sizes:
        return WorstAxis(None, (f"{title}: {_unknown(sensor, parts)}; do not guess",))
    axis = max(sizes, key=lambda name: sizes[name])
    measured = parts[axis].status == "measured"
    how = f"worst axis {axis}" if measured else f"upper bound of axis {axis}, not seen in this record"
    lines = [f"{title}, {parts[axis].unit}; {how}"]
    lines += [f"  {name}: {_value_text(part)}" for name, part in parts.items()]
    if not measured:
        lines.append("  the bound is on the safe side; a longer record lowers it")
    return WorstAxis(sizes[axis], tuple(lines), "" if measured else BOUND_COMMENT)


def _unknown(sensor: str, parts: Mapping[str, Coefficient]) -> str:
    """Return why no axis has even a bound, and what to do."""
    if not parts:
        return f"the record holds no {NAMES[sensor]}; make one that does"
    for part in parts.values():
        if part.reason_code in CURES:
            return f"will not be known ({no_value_text(part)}); {CURES[part.reason_code]}"
    reason = next((part.reason for part in parts.values() if part.reason), "too few samples")
    return f"not known yet ({reason}); record longer"


def _size(part: Coefficient) -> float | None:
    if part.status == "measured":
        return part.value
    return part.high if part.status == "upper_bound" else None


def _value_text(part: Coefficient) -> str:
    if part.status == "measured" and part.value is not None:
        known = part.low is not None and part.high is not None
        return f"{part.value:.4e}" + (f" (95 %: {part.low:.3e} to {part.high:.3e})" if known else "")
    if part.status == "upper_bound" and part.high is not None:
        return f"< {part.high:.3e} (95 %), not seen"
    return no_value_text(part) or "not known yet"


def _header(report: Report) -> list[str]:
    """Return the comments in front of every format: sensor, record and caveats."""
    device, excluded = report.device, report.session.excluded_s + report.session.warmup_s
    lines = [
        f"{sensor_title(report)}: noise at rest, measured by imumon, {report.time}",
        f"{record_title(report)}, {duration(excluded) if excluded else 'nothing'} excluded",
    ]
    by_caveat = caveats(report)
    if "aliased" in by_caveat:
        by = f" by {device.alias_factor:.2f}" if device.alias_factor else ""
        lines.append(f"WARNING: aliased: N is too high{by}: right for this stream, wrong for the sensor")
    if (warning := filter_warning(report)) is not None:
        lines.append(f"WARNING: {FILTER_NOT_KNOWN}: {warning.replace('√', 'sqrt')}")
    for caveat, channels in by_caveat.items():
        if caveat != "aliased":
            where = f" ({joined(channels)})" if channels else ""
            lines.append(f"WARNING: {caveat.replace('_', ' ')}{where}: {line(caveat)}")
    return [*lines, "No margin is added: vibration, temperature and mounting may need one"]


SAME_UNIT = "K in rad/s*sqrt(Hz) and m/s^2*sqrt(Hz): the same as rad/s^2/sqrt(Hz) and m/s^3/sqrt(Hz)"


def _yaml(report: Report, indent: str = "") -> list[str]:
    lines = []
    for sensor in ("accel", "gyro"):
        for letter, key in (("N", "noise_density"), ("K", "random_walk")):
            worst = worst_axis(report, sensor, letter)
            lines += [f"{indent}# {text}" for text in worst.lines]
            name = f"{NAMES[sensor]}_{key}"
            value = None if worst.value is None else f"{name}: {worst.value:.6e}{worst.comment}"
            lines.append(f"{indent}{value or f'# {name}: ?'}")
    return lines


def _comments(lines: list[str]) -> list[str]:
    return [f"# {line}" for line in lines]


def _rate(report: Report) -> float:
    return report.device.sample_rate_hz or 0.0


def _update_rate(report: Report) -> str:
    rate = _rate(report)
    return f"update_rate: {rate:.6g}" if rate else "# update_rate: ? (Hz; unknown in this record)"


def kalibr(report: Report) -> str:
    """Return imu.yaml of Kalibr: continuous-time densities and walks."""
    meaning = "Kalibr wiki, IMU Noise Model: strengths in continuous time, one for all axes"
    lines = [*_comments([*_header(report), meaning, SAME_UNIT]), *_yaml(report)]
    return "\n".join([*lines, "rostopic: /imu/data", _update_rate(report)]) + "\n"


def openvins(report: Report) -> str:
    """Return kalibr_imu_chain.yaml of OpenVINS: pose of the body, axes neither scaled nor rotated."""
    meaning = "OpenVINS, NoiseManager: densities and walks in continuous time, as Kalibr's"
    lines = ["%YAML:1.0", *_comments([*_header(report), meaning, SAME_UNIT]), "imu0:", *_matrix("T_i_b", 4)]
    lines += [
        *_yaml(report, "  "),
        "  rostopic: /imu/data",
        "  time_offset: 0.0",
        f"  {_update_rate(report)}",
        '  model: "kalibr"',
        "  # scale, skew and rotation of the axes: OpenVINS requires all of them; none is measured here",
    ]
    for name, diagonal in (("Tw", 1.0), ("R_IMUtoGYRO", 1.0), ("Ta", 1.0), ("R_IMUtoACC", 1.0), ("Tg", 0.0)):
        lines += _matrix(name, 3, diagonal)
    return "\n".join(lines) + "\n"


def _matrix(name: str, size: int, diagonal: float = 1.0) -> list[str]:
    rows = ([diagonal * (i == j) for j in range(size)] for i in range(size))
    return [f"  {name}:", *(f"    - {row}" for row in rows)]


def ros(report: Report) -> str:
    """Return the covariances of sensor_msgs/Imu: variance of one sample, N^2 times the rate."""
    lines = _comments(_header(report))
    lines.append("# sensor_msgs/Imu: covariance of one sample, row-major; axes as the sensor names them")
    for sensor, field, unit in (
        ("gyro", "angular_velocity_covariance", "(rad/s)^2"),
        ("accel", "linear_acceleration_covariance", "(m/s^2)^2"),
    ):
        diagonal = []
        for axis, channel in sensor_axes(report, sensor):
            part, rate = channel.N, _rate(report)
            if part is not None and part.status == "measured" and part.value is not None and rate:
                diagonal.append(part.value**2 * rate)
                text = f"N {_value_text(part)} {part.unit}, squared times {rate:g} Hz"
                lines.append(f"#   {sensor}/{axis}: {text}")
            elif channel.std:  # a channel that never changes has no known noise
                diagonal.append(channel.std**2)
                lines.append(f"#   {sensor}/{axis}: N is not known yet; square of the standard deviation")
        if len(diagonal) == 3:
            x, y, z = (f"{value:.4e}" for value in diagonal)
            lines.append(f"{field}: [{x}, 0, 0,  0, {y}, 0,  0, 0, {z}]  # {unit}")
        else:
            lines.append(f"# {field}: all zeros, which means unknown")
    lines += [
        "# orientation is not characterised; -1 means not given",
        "orientation_covariance: [-1, 0, 0,  0, 0, 0,  0, 0, 0]",
    ]
    return "\n".join(lines) + "\n"


@dataclass(frozen=True, slots=True)
class PredictionStep:
    """Length of a prediction step of an autopilot's filter, and its source.

    In each step of length dt the filter adds (s dt)^2 to the variance of an angle, a velocity or a bias, with
    the configured noise s. For s = N / sqrt(dt) or K / sqrt(dt) that is N^2 or K^2 per second.
    """

    length_s: float
    source: str


STEP_UNITS = {
    ("gyro", "N"): "rad/s", ("gyro", "K"): "rad/s^2", ("accel", "N"): "m/s^2", ("accel", "K"): "m/s^3",
}  # fmt: skip
"""Units of the noise of a step, in the order of the names of the parameters."""
PX4 = PredictionStep(0.010, "PX4 parameter reference: EKF2_PREDICT_US, 10 ms unless changed")
ARDUPILOT = PredictionStep(0.012, "ArduPilot, AP_NavEKF3: EKF_TARGET_DT, 12 ms")


def _autopilot(report: Report, names: Sequence[str], step: PredictionStep, form: str) -> str:
    lines = _comments(_header(report))
    lines += [
        f"# {step.source}",
        f"# deviation in one step of {step.length_s:g} s: N / sqrt(step) and K / sqrt(step)",
        "# the minimum for the sensor itself. The defaults are far above it because a vehicle vibrates: keep",
        "# them, or stay well above these values; use these to compare sensors, or on a rig at rest",
    ]
    for ((sensor, letter), unit), name in zip(STEP_UNITS.items(), names, strict=True):
        worst = worst_axis(report, sensor, letter)
        lines += _comments(list(worst.lines))
        if worst.value is None:
            lines.append(f"# {name} ?")
        else:
            value = worst.value / math.sqrt(step.length_s)
            lines.append(f"# {name} in {unit}{worst.comment}")
            lines.append(form.format(name=name, value=value, comment=worst.comment))
    return "\n".join(lines) + "\n"


def px4(report: Report) -> str:
    """Return parameters of the EKF2 of PX4 for its console: standard deviations of one prediction step."""
    names = ("EKF2_GYR_NOISE", "EKF2_GYR_B_NOISE", "EKF2_ACC_NOISE", "EKF2_ACC_B_NOISE")
    return _autopilot(report, names, PX4, "param set {name} {value:.4e}{comment}")


def ardupilot(report: Report) -> str:
    """Return a parameter file of the EKF3 of ArduPilot; comments need lines of their own there."""
    names = ("EK3_GYRO_P_NSE", "EK3_GBIAS_P_NSE", "EK3_ACC_P_NSE", "EK3_ABIAS_P_NSE")
    return _autopilot(report, names, ARDUPILOT, "{name},{value:.6g}")


def gtsam(report: Report) -> str:
    """Return code for the combined preintegration of GTSAM: continuous-time covariances, N^2 and K^2."""
    lines = _comments([*_header(report), "GTSAM, PreintegrationParams: covariances in continuous time"])
    lines += [
        "import gtsam",
        "import numpy as np",
        "",
        "params = gtsam.PreintegrationCombinedParams.MakeSharedU(9.80665)  # z up; MakeSharedD for z down",
    ]
    for sensor, letter, call in (
        ("accel", "N", "setAccelerometerCovariance"),
        ("gyro", "N", "setGyroscopeCovariance"),
        ("accel", "K", "setBiasAccCovariance"),
        ("gyro", "K", "setBiasOmegaCovariance"),
    ):
        worst = worst_axis(report, sensor, letter)
        lines += _comments(list(worst.lines))
        mark, value = ("# ", "?") if worst.value is None else ("", f"{worst.value:.6e}")
        lines.append(f"{mark}params.{call}(np.eye(3) * {value}**2){worst.comment}")
    lines += [
        "# of the integration, not of the sensor; the default of GTSAM is 1",
        "params.setIntegrationCovariance(np.eye(3) * 1e-8)",
    ]
    return "\n".join(lines) + "\n"
