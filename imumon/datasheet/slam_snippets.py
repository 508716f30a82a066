"""Settings of odometry and navigation filters: VINS, FAST-LIO, LIO-SAM, ORB-SLAM3, robot_localization, KF-GINS.

These programs define their numbers in four ways: in continuous time (LIO-SAM, ORB-SLAM3), as a standard deviation
of one sample (VINS), as a variance of one sample (FAST-LIO, robot_localization), or as a Gauss-Markov process in
navigation units (KF-GINS). Each format cites the file of the program's source that decides this.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from imumon.datasheet.config_snippets import SAME_UNIT, STEP_UNITS, comments, rate_of
from imumon.datasheet.filter_values import (
    axis_values,
    settings_header,
    worst_axis,
)
from imumon.filter_report import FilterReport
from imumon.report import Report
from imumon.samples import AXES
from imumon.units import DEG, HOUR

PARTS = (("accel", "N"), ("gyro", "N"), ("accel", "K"), ("gyro", "K"))

CORRELATION_TIME_H = 4.0
"""h, correlation time of the bias for KF-GINS: the one of its example."""

HORIZONS_PER_CORRELATION = 10.0
"""Horizons that this correlation time must be at least long: the process is then a walk."""

MILLIGAL = 1e-5  # m/s^2


def _named(
    report: Report,
    filters: FilterReport,
    names: Mapping[tuple[str, str], str],
    factors: Mapping[str, float | None],
    power: int = 1,
    indent: str = "",
    units: Mapping[tuple[str, str], str] | None = None,
) -> list[str]:
    """Return ``name: value`` of the worst axes, with their comments.

    Parameters
    ----------
    factors : factor of white noise ("N") and walk ("K"); None if it is unknown, as the rate is.
    power : 1 for a standard deviation, 2 for a variance, which takes the factor unsquared.
    units : of the numbers before `power`, where they are not those of N and walk.
    """
    lines = []
    for (sensor, letter), name in names.items():
        worst, factor = worst_axis(report, filters, sensor, letter), factors[letter]
        lines += comments(worst.lines, indent)
        if units is not None:
            unit = units[sensor, letter] if power == 1 else f"({units[sensor, letter]})^2"
            lines.append(f"{indent}# {name} in {unit}")
        if worst.value is None or factor is None:
            why = " (the sample rate is unknown)" if worst.value is not None else ""
            lines.append(f"{indent}# {name}: ?{why}")
        else:
            lines.append(f"{indent}{name}: {worst.value**power * factor:.6e}{worst.comment}")
    return lines


def _by_part(*names: str) -> dict[tuple[str, str], str]:
    return dict(zip(PARTS, names, strict=True))


def _at_rate(report: Report) -> str:
    rate = rate_of(report)
    return f"for samples at {rate:g} Hz, the rate of this record" if rate else "the sample rate is unknown"


def vins(report: Report, filters: FilterReport) -> str:
    """Return acc_n, gyr_n, acc_w and gyr_w of VINS-Mono and VINS-Fusion: standard deviations of a sample.

    A step of dt adds (dt/2)^2 of the variance of two samples that it takes for independent, half of what white
    noise adds; hence sqrt(2). It adds (w dt)^2 to the variance of the bias.
    """
    rate = rate_of(report)
    meaning = [
        "VINS-Fusion, vins_estimator/src/factor/integration_base.h: deviations of one sample, not divided by dt;",
        f"N sqrt(2 rate) and walk sqrt(rate), {_at_rate(report)}",
    ]
    factors = {"N": math.sqrt(2.0 * rate), "K": math.sqrt(rate)} if rate else dict.fromkeys("NK")
    names = _by_part("acc_n", "gyr_n", "acc_w", "gyr_w")
    lines = comments([*settings_header(report, filters), *meaning])
    return "\n".join([*lines, *_named(report, filters, names, factors, units=STEP_UNITS), ""])


def fastlio(report: Report, filters: FilterReport) -> str:
    """Return acc_cov, gyr_cov, b_acc_cov and b_gyr_cov of FAST-LIO: variances of a sample."""
    rate = rate_of(report)
    meaning = [
        "FAST-LIO, src/IMU_Processing.hpp and include/IKFoM_toolkit/esekfom/esekfom.hpp: P grows by dt^2 cov in a",
        f"sample: cov is N^2 rate and walk^2 rate, {_at_rate(report)}",
    ]
    names = _by_part("acc_cov", "gyr_cov", "b_acc_cov", "b_gyr_cov")
    values = _named(report, filters, names, dict.fromkeys("NK", rate or None), 2, "    ", STEP_UNITS)
    return "\n".join([*comments([*settings_header(report, filters), *meaning]), "mapping:", *values, ""])


def liosam(report: Report, filters: FilterReport) -> str:
    """Return the noise of LIO-SAM: continuous time, as GTSAM takes it."""
    meaning = [
        "LIO-SAM, src/imuPreintegration.cpp: GTSAM's continuous-time densities, and a bias that walks by sqrt(t)",
        SAME_UNIT,
    ]
    names = _by_part("imuAccNoise", "imuGyrNoise", "imuAccBiasN", "imuGyrBiasN")
    values = _named(report, filters, names, dict.fromkeys("NK", 1.0), 1, "  ")
    return "\n".join([*comments([*settings_header(report, filters), *meaning]), "lio_sam:", *values, ""])


def orbslam3(report: Report, filters: FilterReport) -> str:
    """Return the noise of ORB-SLAM3: continuous time; the program makes samples of it with IMU.Frequency."""
    rate = rate_of(report)
    meaning = [
        "ORB-SLAM3, src/Tracking.cc: continuous time; Noise is multiplied, Walk divided by sqrt(IMU.Frequency)",
        SAME_UNIT,
    ]
    names = _by_part("IMU.NoiseAcc", "IMU.NoiseGyro", "IMU.AccWalk", "IMU.GyroWalk")
    frequency = f"IMU.Frequency: {float(f'{rate:.6g}')!r}" if rate else "# IMU.Frequency: ? (Hz; unknown)"
    values = _named(report, filters, names, dict.fromkeys("NK", 1.0))
    return "\n".join([*comments([*settings_header(report, filters), *meaning]), *values, frequency, ""])


def robot_localization(report: Report, filters: FilterReport) -> str:
    """Return covariances of sensor_msgs/Imu for robot_localization, which estimates no bias.

    The error of the bias has to be in the covariance of a sample. With the walk w and the horizon h, the variance
    of the angle, N^2 h + w^2 h^3 / 3, is that of white noise with N^2 + w^2 h^2 / 3.
    """
    rate, h = rate_of(report), filters.horizon_s
    lines = comments(
        [
            *settings_header(report, filters),
            "robot_localization, src/ros_filter.cpp and src/ekf.cpp: the covariance of each sample comes from the",
            "message, and no bias is estimated: subtract it before. process_noise_covariance is not of the sensor:",
            "it is added times dt, and has to stay far above these values for angular velocity and acceleration",
            f"variance of a sample: (N^2 + walk^2 h^2 / 3) rate, h = {h:g} s, {_at_rate(report)}",
        ]
    )
    for sensor, field, unit in (
        ("gyro", "angular_velocity_covariance", "(rad/s)^2"),
        ("accel", "linear_acceleration_covariance", "(m/s^2)^2"),
    ):
        for letter in "NK":
            lines += comments(worst_axis(report, filters, sensor, letter).lines)
        white, walk = (axis_values(report, filters, sensor, letter) for letter in "NK")
        if rate and len(white) == len(walk) == len(AXES):
            x, y, z = (f"{(white[a] ** 2 + (walk[a] * h) ** 2 / 3.0) * rate:.4e}" for a in AXES)
            lines.append(f"{field}: [{x}, 0, 0,  0, {y}, 0,  0, 0, {z}]  # {unit}")
        else:
            lines.append(f"# {field}: ?")
    return "\n".join([*lines, ""])


def kfgins(report: Report, filters: FilterReport) -> str:
    """Return the section imunoise of KF-GINS: per axis, in navigation units.

    Its bias is a Gauss-Markov process of standard deviation s and correlation time T, driven by 2 s^2 / T: for
    times far below T a walk of s sqrt(2 / T), hence s = walk sqrt(T / 2).
    """
    time_h = max(CORRELATION_TIME_H, HORIZONS_PER_CORRELATION * filters.horizon_s / HOUR)
    bias = math.sqrt(time_h * HOUR / 2.0)
    lines = comments(
        [
            *settings_header(report, filters),
            "KF-GINS, src/kf_gins.cpp and src/kf-gins/gi_engine.cpp: standard deviations; arw and vrw are N;",
            "gbstd and abstd: a Gauss-Markov process driven by 2 std^2 / corrtime, std = walk sqrt(corrtime / 2);",
            "they are also the uncertainty of the bias at the start: set initbgstd and initbastd instead",
            "axes as the sensor names them; keep gsstd and asstd (scale factors) of your file: not measured",
        ]
    )
    lines.append("imunoise:")
    for name, sensor, letter, factor, unit in (
        ("arw", "gyro", "N", 60.0 * DEG, "deg/sqrt(hr)"),
        ("vrw", "accel", "N", 60.0, "m/s/sqrt(hr)"),
        ("gbstd", "gyro", "K", bias * DEG * HOUR, "deg/hr"),
        ("abstd", "accel", "K", bias / MILLIGAL, "mGal"),
    ):
        lines += comments(_axis_lines(report, filters, sensor, letter), "  ")
        values = axis_values(report, filters, sensor, letter)
        if len(values) == len(AXES):
            numbers = ", ".join(f"{values[axis] * factor:.6g}" for axis in AXES)
            lines.append(f"  {name}: [{numbers}]  # [{unit}]")
        else:
            lines.append(f"  # {name}: ?")
    return "\n".join([*lines, f"  corrtime: {time_h:.6g}  # [hr]", ""])


def _axis_lines(report: Report, filters: FilterReport, sensor: str, letter: str) -> Sequence[str]:
    """Return the comments of a setting with one number for each axis."""
    lines = worst_axis(report, filters, sensor, letter).lines
    return (lines[0].replace("; worst axis", ", of each axis; largest on"), *lines[1:])
