"""Settings of calibration tools, middleware and autopilots: Kalibr, OpenVINS, ROS, PX4, ArduPilot, GTSAM.

N is the density of the rate as an Allan deviation gives it: white noise of N has the standard deviation
N / sqrt(dt) in samples of dt. The walk drives the bias: it walks by walk sqrt(t). The comments cite how each
program defines its numbers, by the file of its source that reads them; `filter_values` makes numbers and comments.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from imumon.datasheet.filter_values import NAMES, settings_header, value_text, worst_axis
from imumon.datasheet.tables import sensor_axes
from imumon.filter_report import FilterReport
from imumon.report import Report

SAME_UNIT = "walk in rad/s*sqrt(Hz) and m/s^2*sqrt(Hz): the same as rad/s^2/sqrt(Hz) and m/s^3/sqrt(Hz)"


def comments(lines: Sequence[str], indent: str = "") -> list[str]:
    """Return lines as comments."""
    return [f"{indent}# {line}" for line in lines]


def rate_of(report: Report) -> float:
    """Return the sample rate of the record, Hz; 0 if it is unknown."""
    return report.device.sample_rate_hz or 0.0


def _yaml(report: Report, filters: FilterReport, indent: str = "") -> list[str]:
    lines = []
    for sensor in ("accel", "gyro"):
        for letter, key in (("N", "noise_density"), ("K", "random_walk")):
            worst = worst_axis(report, filters, sensor, letter)
            lines += comments(worst.lines, indent)
            name = f"{NAMES[sensor]}_{key}"
            value = None if worst.value is None else f"{name}: {worst.value:.6e}{worst.comment}"
            lines.append(f"{indent}{value or f'# {name}: ?'}")
    return lines


def _update_rate(report: Report) -> str:
    rate = rate_of(report)
    return f"update_rate: {rate:.6g}" if rate else "# update_rate: ? (Hz; unknown in this record)"


def kalibr(report: Report, filters: FilterReport) -> str:
    """Return imu.yaml of Kalibr: continuous-time densities and walks."""
    meaning = "Kalibr wiki, IMU Noise Model: strengths in continuous time, one for all axes"
    header = comments([*settings_header(report, filters), meaning, SAME_UNIT])
    return "\n".join([*header, *_yaml(report, filters), "rostopic: /imu/data", _update_rate(report)]) + "\n"


def openvins(report: Report, filters: FilterReport) -> str:
    """Return kalibr_imu_chain.yaml of OpenVINS: pose of the body, axes neither scaled nor rotated."""
    meaning = (
        "OpenVINS, ov_msckf/src/state/Propagator.cpp: densities and walks in continuous time, as Kalibr's"
    )
    header = comments([*settings_header(report, filters), meaning, SAME_UNIT])
    lines = ["%YAML:1.0", *header, "imu0:", *_matrix("T_i_b", 4)]
    lines += [
        *_yaml(report, filters, "  "),
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


def ros(report: Report, filters: FilterReport) -> str:
    """Return the covariances of sensor_msgs/Imu: variance of one sample, N^2 times the rate."""
    lines = comments(settings_header(report, filters))
    lines.append("# sensor_msgs/Imu: covariance of one sample, row-major; axes as the sensor names them")
    for sensor, field, unit in (
        ("gyro", "angular_velocity_covariance", "(rad/s)^2"),
        ("accel", "linear_acceleration_covariance", "(m/s^2)^2"),
    ):
        diagonal = []
        for axis, channel in sensor_axes(report, sensor):
            part, rate = channel.N, rate_of(report)
            if part is not None and part.status == "measured" and part.value is not None and rate:
                diagonal.append(part.value**2 * rate)
                text = f"N {value_text(part)} {part.unit}, squared times {rate:g} Hz"
                lines.append(f"#   {sensor}/{axis}: {text}")
            elif channel.std:  # a channel that never changes has no known noise
                diagonal.append(channel.std**2)
                lines.append(f"#   {sensor}/{axis}: N is not known yet; square of the standard deviation")
        if len(diagonal) == 3:
            x, y, z = (f"{value:.4e}" for value in diagonal)
            lines.append(f"{field}: [{x}, 0, 0,  0, {y}, 0,  0, 0, {z}]  # {unit}")
        else:
            lines.append(f"# {field}: all zeros, which means unknown")
        lines.append("# the message has no field for the walk; a filter that estimates the bias takes:")
        lines += comments(worst_axis(report, filters, sensor, "K").lines)
    lines += [
        "# orientation is not characterised; -1 means not given",
        "orientation_covariance: [-1, 0, 0,  0, 0, 0,  0, 0, 0]",
    ]
    return "\n".join(lines) + "\n"


@dataclass(frozen=True, slots=True)
class PredictionStep:
    """Length of a prediction step of an autopilot's filter, and its source.

    In each step of length dt the filter adds (s dt)^2 to the variance of an angle, a velocity or a bias, with
    the configured noise s. For s = N / sqrt(dt) or walk / sqrt(dt) that is N^2 or walk^2 per second.
    """

    length_s: float
    sources: tuple[str, ...]


STEP_UNITS = {
    ("gyro", "N"): "rad/s", ("gyro", "K"): "rad/s^2", ("accel", "N"): "m/s^2", ("accel", "K"): "m/s^3",
}  # fmt: skip
"""Units of the noise of a step, in the order of the names of the parameters."""
PX4 = PredictionStep(
    0.010,
    (
        "PX4 parameter reference: EKF2_PREDICT_US, 10 ms unless changed",
        "PX4, src/modules/ekf2/EKF/covariance.cpp: the variance of a bias grows by (dt noise)^2 in a step",
    ),
)
ARDUPILOT = PredictionStep(
    0.012,
    (
        "ArduPilot, AP_NavEKF3: EKF_TARGET_DT, 12 ms",
        "ArduPilot, AP_NavEKF3_core.cpp: the variance of a delta angle's bias grows by (dt^2 noise)^2 in a step",
    ),
)


def _autopilot(
    report: Report, filters: FilterReport, names: Sequence[str], step: PredictionStep, form: str
) -> str:
    lines = comments(
        [
            *settings_header(report, filters),
            *step.sources,
            f"deviation in one step of {step.length_s:g} s: N / sqrt(step) and walk / sqrt(step)",
            "the minimum for the sensor itself. The defaults are far above it because a vehicle vibrates: keep",
            "them, or stay well above these values; use these to compare sensors, or on a rig at rest",
        ]
    )
    for ((sensor, letter), unit), name in zip(STEP_UNITS.items(), names, strict=True):
        worst = worst_axis(report, filters, sensor, letter)
        lines += comments(worst.lines)
        if worst.value is None:
            lines.append(f"# {name} ?")
        else:
            value = worst.value / math.sqrt(step.length_s)
            above = "" if "{comment}" in form else worst.comment
            lines.append(f"# {name} in {unit}{above}")
            lines.append(form.format(name=name, value=value, comment=worst.comment))
    return "\n".join(lines) + "\n"


def px4(report: Report, filters: FilterReport) -> str:
    """Return parameters of the EKF2 of PX4 for its console: standard deviations of one prediction step."""
    names = ("EKF2_GYR_NOISE", "EKF2_GYR_B_NOISE", "EKF2_ACC_NOISE", "EKF2_ACC_B_NOISE")
    return _autopilot(report, filters, names, PX4, "param set {name} {value:.4e}{comment}")


def ardupilot(report: Report, filters: FilterReport) -> str:
    """Return a parameter file of the EKF3 of ArduPilot; comments need lines of their own there."""
    names = ("EK3_GYRO_P_NSE", "EK3_GBIAS_P_NSE", "EK3_ACC_P_NSE", "EK3_ABIAS_P_NSE")
    return _autopilot(report, filters, names, ARDUPILOT, "{name},{value:.6g}")


def gtsam(report: Report, filters: FilterReport) -> str:
    """Return code for the combined preintegration of GTSAM: continuous-time covariances, N^2 and walk^2."""
    meaning = "GTSAM, gtsam/navigation/PreintegrationCombinedParams.h: covariances in continuous time"
    lines = [
        *comments([*settings_header(report, filters), meaning]),
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
        worst = worst_axis(report, filters, sensor, letter)
        lines += comments(worst.lines)
        mark, value = ("# ", "?") if worst.value is None else ("", f"{worst.value:.6e}")
        lines.append(f"{mark}params.{call}(np.eye(3) * {value}**2){worst.comment}")
    lines += [
        "# of the integration, not of the sensor; the default of GTSAM is 1",
        "params.setIntegrationCovariance(np.eye(3) * 1e-8)",
        "# GTSAM before 4.3, gtsam/navigation/CombinedImuFactor.cpp: an uncertainty of the bias in every sample, 1 by",
        "# default (rad/s, m/s^2); the bias of the graph has it already",
        'if hasattr(params, "setBiasAccOmegaInit"):',
        "    params.setBiasAccOmegaInit(np.zeros((6, 6)))",
    ]
    return "\n".join(lines) + "\n"
