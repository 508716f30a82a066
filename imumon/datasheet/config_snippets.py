"""Settings of other software, with units and 95 % limits in comments.

Rules: the worst axis decides, because these programs take one number for three axes. A coefficient that the
record does not show is represented by its 95 % upper bound, which is safe, and its own line says so. Where
not even a bound is known, the line is commented out: no number is invented. Every caveat comes first. No
margin is added; the user knows what margin a vehicle needs.

N is the density of the rate as an Allan deviation gives it: white noise of N has the standard deviation
N / sqrt(dt) in samples of dt. K drives the bias: it walks by K sqrt(t). The comments name the document or the
source that says what each program makes of its numbers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from imumon.datasheet.tables import sensor_title
from imumon.messages import (
    FILTER_NOT_KNOWN,
    NEVER_CHANGES,
    ROUNDED_AWAY,
    caveats,
    filter_not_known,
    joined,
    line,
    no_value_text,
)
from imumon.report import Coefficient, Report
from imumon.samples import AXES
from imumon.units import duration

NAMES = {"gyro": "gyroscope", "accel": "accelerometer"}
MEANINGS = {"N": "white noise density", "K": "random walk of the bias"}
CURES = {
    NEVER_CHANGES: "find out why it is dead or stuck, and record again",
    ROUNDED_AWAY: "record with more digits, or a finer range",
}
"""What to do about a coefficient that no longer record shows, by the reason."""
BOUND_COMMENT = "  # 95 % upper bound, not seen in this record"


@dataclass(frozen=True, slots=True)
class WorstAxis:
    """Largest of the axes; a bound counts where nothing is measured.

    Attributes
    ----------
    value : SI, None if no axis has even a bound.
    lines : comments: what it is, and every axis.
    comment : comment behind the value if it is a bound; else empty.
    """

    value: float | None
    lines: tuple[str, ...]
    comment: str = ""


def worst_axis(report: Report, sensor: str, letter: str) -> WorstAxis:
    """Return N or K of a sensor for a setting that takes one number."""
    parts: dict[str, Coefficient] = {}
    for axis in AXES:
        channel = report.channels.get(f"{sensor}/{axis}")
        part: Coefficient | None = getattr(channel, letter) if channel is not None else None
        if part is not None:
            parts[axis] = part
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
        if (why := no_value_text(part)) is not None:
            return f"will not be known ({why}); {CURES[why]}"
    why = next((part.reason for part in parts.values() if part.reason), "too few samples")
    return f"not known yet ({why}); record longer"


def _size(part: Coefficient) -> float | None:
    if part.status == "measured":
        return part.value
    return part.high if part.status == "upper_bound" else None


def _value_text(part: Coefficient) -> str:
    if part.status == "measured" and part.value is not None:
        limits = ""
        if part.low is not None and part.high is not None:
            limits = f" (95 %: {part.low:.3e} to {part.high:.3e})"
        return f"{part.value:.4e}{limits}"
    if part.status == "upper_bound" and part.high is not None:
        return f"< {part.high:.3e} (95 %), not seen"
    return no_value_text(part) or "not known yet"


def _header(report: Report) -> list[str]:
    """Return the comments in front of every format: whose noise, of which record, and its caveats."""
    device, session = report.device, report.session
    rate = f" at {device.sample_rate_hz:g} Hz" if device.sample_rate_hz else ""
    excluded = session.excluded_s + session.warmup_s
    lines = [
        f"{sensor_title(report)}: noise at rest, measured by imumon, {report.time}",
        f"{duration(session.elapsed_s)} of {device.stream or 'samples'}{rate}, "
        f"{duration(excluded) if excluded else 'nothing'} excluded",
    ]
    words = caveats(report)
    if "aliased" in words:
        by = f" by {device.alias_factor:.2f}" if device.alias_factor else ""
        lines.append(f"WARNING: aliased: N is too high{by}. Right for this very stream, wrong for the sensor")
    if (warning := filter_not_known(report)) is not None:
        lines.append(f"WARNING: {FILTER_NOT_KNOWN}: {warning.replace('√', 'sqrt')}")
    for word, channels in words.items():
        if word != "aliased":
            where = f" ({joined(channels)})" if channels else ""
            lines.append(f"WARNING: {word.replace('_', ' ')}{where}: {line(word)}")
    return [*lines, "No margin is added: vibration, temperature and mounting may need one"]


SAME_UNIT = "K in rad/s*sqrt(Hz) and m/s^2*sqrt(Hz): the same as rad/s^2/sqrt(Hz) and m/s^3/sqrt(Hz)"


def _yaml(report: Report, indent: str = "", order: tuple[str, ...] = ("accel", "gyro")) -> list[str]:
    lines = []
    for sensor in order:
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
        for axis in AXES:
            channel = report.channels.get(f"{sensor}/{axis}")
            part = channel.N if channel is not None else None
            if part is not None and part.status == "measured" and part.value is not None and _rate(report):
                diagonal.append(part.value**2 * _rate(report))
                lines.append(
                    f"#   {sensor}/{axis}: N {_value_text(part)} {part.unit}, squared times "
                    f"{_rate(report):g} Hz"
                )
            elif channel is not None and channel.std:  # a channel that never changes has no known noise
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


PX4 = PredictionStep(0.010, "PX4 parameter reference: EKF2_PREDICT_US, 10 ms unless changed")
ARDUPILOT = PredictionStep(0.012, "ArduPilot, AP_NavEKF3: EKF_TARGET_DT, 12 ms")


def _autopilot(
    report: Report, names: Mapping[tuple[str, str], tuple[str, str]], step: PredictionStep, form: str
) -> str:
    lines = _comments(_header(report))
    lines += [
        f"# {step.source}",
        f"# deviation in one step of {1e3 * step.length_s:g} ms: N / sqrt({step.length_s:g} s) and "
        f"K / sqrt({step.length_s:g} s)",
        "# the minimum for the sensor itself. The defaults are far above it because a vehicle vibrates: keep",
        "# them, or stay well above these values; use these to compare sensors, or on a rig at rest",
    ]
    for (sensor, letter), (name, unit) in names.items():
        worst = worst_axis(report, sensor, letter)
        lines += _comments(list(worst.lines))
        if worst.value is None:
            lines.append(f"# {name} ?")
        else:
            value = worst.value / math.sqrt(step.length_s)
            lines += [
                f"# {name} in {unit}{worst.comment}",
                form.format(name=name, value=value, comment=worst.comment),
            ]
    return "\n".join(lines) + "\n"


def px4(report: Report) -> str:
    """Return parameters of the EKF2 of PX4 for its console: standard deviations of one prediction step."""
    names = {
        ("gyro", "N"): ("EKF2_GYR_NOISE", "rad/s"),
        ("gyro", "K"): ("EKF2_GYR_B_NOISE", "rad/s^2"),
        ("accel", "N"): ("EKF2_ACC_NOISE", "m/s^2"),
        ("accel", "K"): ("EKF2_ACC_B_NOISE", "m/s^3"),
    }
    return _autopilot(report, names, PX4, "param set {name} {value:.4e}{comment}")


def ardupilot(report: Report) -> str:
    """Return a parameter file of the EKF3 of ArduPilot; comments need lines of their own there."""
    names = {
        ("gyro", "N"): ("EK3_GYRO_P_NSE", "rad/s"),
        ("gyro", "K"): ("EK3_GBIAS_P_NSE", "rad/s^2"),
        ("accel", "N"): ("EK3_ACC_P_NSE", "m/s^2"),
        ("accel", "K"): ("EK3_ABIAS_P_NSE", "m/s^3"),
    }
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
        value = "?" if worst.value is None else f"{worst.value:.6e}"
        lines.append(
            f"{'# ' if worst.value is None else ''}params.{call}(np.eye(3) * {value}**2){worst.comment}"
        )
    lines += [
        "# of the integration, not of the sensor; the default of GTSAM is 1",
        "params.setIntegrationCovariance(np.eye(3) * 1e-8)",
    ]
    return "\n".join(lines) + "\n"
