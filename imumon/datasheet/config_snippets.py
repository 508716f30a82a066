"""Snippets: settings that people paste into other tools, with units and 95 % limits in comments.

The rules: the worst axis decides, as these tools take one number for three axes. A coefficient that the
record does not show is represented by its 95 % bound, which is safe, and its own line says so. Where not
even a bound is known, the line stays commented out: no number is invented. Every caveat stands in front.
Nothing is multiplied by a margin; what margin a vehicle needs is the user's to say.

N is the density of the rate as an Allan deviation gives it: white noise of N has the deviation
N / sqrt(dt) in samples of dt. K drives the bias: it walks by K sqrt(t). What each program makes of its
numbers is read in its own documents and source, which the comments name.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

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
CURES = {
    NEVER_CHANGES: "look why it is dead or stuck, and record anew",
    ROUNDED_AWAY: "record with more digits, or a finer range",
}
"""What to do about a coefficient that no longer record brings, by the reason."""
BOUND = "  # 95 % bound, not seen in this record"
WORDS = {"N": "white noise density", "K": "random walk of the bias"}


@dataclass(frozen=True, slots=True)
class Worst:
    """The largest of the axes, a bound standing in where nothing is measured.

    Attributes
    ----------
    value : SI, None where no axis has even a bound.
    lines : comments for people: what it is, and every axis.
    note : comment for the line of the value itself: that it is a bound; else empty.
    """

    value: float | None
    lines: tuple[str, ...]
    note: str = ""


def worst(made: Report, sensor: str, letter: str) -> Worst:
    """N or K of a sensor for a setting that takes one number."""
    found: dict[str, Coefficient] = {}
    for axis in AXES:
        channel = made.channels.get(f"{sensor}/{axis}")
        part: Coefficient | None = getattr(channel, letter) if channel is not None else None
        if part is not None:
            found[axis] = part
    sizes = {axis: size for axis, part in found.items() if (size := _size(part)) is not None}
    what = f"{NAMES[sensor]} {letter}, {WORDS[letter]}"
    if not sizes:
        return Worst(None, (f"{what}: {_unknown(sensor, found)}; do not guess",))
    axis = max(sizes, key=lambda name: sizes[name])
    unit = found[axis].unit
    seen = found[axis].status == "measured"
    how = f"worst axis {axis}" if seen else f"bound of axis {axis}: not seen in this record, truly smaller"
    lines = [f"{what}, {unit}; {how}", *(f"  {name}: {_told(part)}" for name, part in found.items())]
    if not seen:
        lines.append("  the bound is on the safe side; a longer record lowers it")
    return Worst(sizes[axis], tuple(lines), "" if seen else BOUND)


def _unknown(sensor: str, found: Mapping[str, Coefficient]) -> str:
    """Why no axis has even a bound, and what to do."""
    if not found:
        return f"the record holds no {NAMES[sensor]}; make one that does"
    for part in found.values():
        if (why := no_value_text(part)) is not None:
            return f"will not be known ({why}); {CURES[why]}"
    why = next((part.reason for part in found.values() if part.reason), "too few samples")
    return f"not known yet ({why}); record longer"


def _size(part: Coefficient) -> float | None:
    if part.status == "measured":
        return part.value
    return part.high if part.status == "upper_bound" else None


def _told(part: Coefficient) -> str:
    if part.status == "measured" and part.value is not None:
        limits = ""
        if part.low is not None and part.high is not None:
            limits = f" (95 %: {part.low:.3e} to {part.high:.3e})"
        return f"{part.value:.4e}{limits}"
    if part.status == "upper_bound" and part.high is not None:
        return f"< {part.high:.3e} (95 %), not seen"
    return no_value_text(part) or "not known yet"


def who(made: Report) -> str:
    """The sensor by model and number, else by the name of its device, else by its recording."""
    device = made.device
    if named := " ".join(part for part in (device.model, device.serial) if part):
        return named
    if device.id == "replay" and device.port:
        return device.port.rpartition("/")[2]
    return device.id


def head(made: Report) -> list[str]:
    """Comments in front of every snippet: whose noise, from how long a record, and what is wrong with it."""
    device, session = made.device, made.session
    rate = f" at {device.sample_rate_hz:g} Hz" if device.sample_rate_hz else ""
    left_out = session.excluded_s + session.warmup_s
    lines = [
        f"{who(made)}: noise at rest, measured by imumon, {made.time}",
        f"{duration(session.elapsed_s)} of {device.stream or 'samples'}{rate}, "
        f"{duration(left_out) if left_out else 'nothing'} of it left out",
    ]
    found = caveats(made)
    if "aliased" in found:
        by = f" by {device.alias_factor:.2f}" if device.alias_factor else ""
        lines.append(f"WARNING: aliased: N is too high{by}. Right for this very stream, wrong for the sensor")
    if (warning := filter_not_known(made)) is not None:
        lines.append(f"WARNING: {FILTER_NOT_KNOWN}: {warning.replace('√', 'sqrt')}")
    for word, channels in found.items():
        if word != "aliased":
            where = f" ({joined(channels)})" if channels else ""
            lines.append(f"WARNING: {word.replace('_', ' ')}{where}: {line(word)}")
    return [*lines, "No margin is added: vibration, temperature and mounting may need one"]


SAME_UNIT = "K in rad/s*sqrt(Hz) and m/s^2*sqrt(Hz): the same as rad/s^2/sqrt(Hz) and m/s^3/sqrt(Hz)"


def _yaml(made: Report, indent: str = "", order: tuple[str, ...] = ("accel", "gyro")) -> list[str]:
    lines = []
    for sensor in order:
        for letter, key in (("N", "noise_density"), ("K", "random_walk")):
            found = worst(made, sensor, letter)
            lines += [f"{indent}# {line}" for line in found.lines]
            name = f"{NAMES[sensor]}_{key}"
            value = None if found.value is None else f"{name}: {found.value:.6e}{found.note}"
            lines.append(f"{indent}{value or f'# {name}: ?'}")
    return lines


def _comments(lines: list[str]) -> list[str]:
    return [f"# {line}" for line in lines]


def _rate(made: Report) -> float:
    return made.device.sample_rate_hz or 0.0


def _update_rate(made: Report) -> str:
    rate = _rate(made)
    return f"update_rate: {rate:.6g}" if rate else "# update_rate: ? (Hz; this record does not tell it)"


def kalibr(made: Report) -> str:
    """Kalibr's imu.yaml: continuous-time densities and walks."""
    meaning = "Kalibr wiki, IMU Noise Model: strengths in continuous time, one for all axes"
    lines = [*_comments([*head(made), meaning, SAME_UNIT]), *_yaml(made)]
    return "\n".join([*lines, "rostopic: /imu/data", _update_rate(made)]) + "\n"


def openvins(made: Report) -> str:
    """OpenVINS' kalibr_imu_chain.yaml: pose that of the body, axes neither scaled nor turned."""
    meaning = "OpenVINS, NoiseManager: densities and walks in continuous time, as Kalibr's"
    lines = ["%YAML:1.0", *_comments([*head(made), meaning, SAME_UNIT]), "imu0:", *_matrix("T_i_b", 4)]
    lines += [
        *_yaml(made, "  "),
        "  rostopic: /imu/data",
        "  time_offset: 0.0",
        f"  {_update_rate(made)}",
        '  model: "kalibr"',
        "  # scale, skew and turn of the axes: OpenVINS asks for all of them; none is measured here",
    ]
    for name, diagonal in (("Tw", 1.0), ("R_IMUtoGYRO", 1.0), ("Ta", 1.0), ("R_IMUtoACC", 1.0), ("Tg", 0.0)):
        lines += _matrix(name, 3, diagonal)
    return "\n".join(lines) + "\n"


def _matrix(name: str, size: int, diagonal: float = 1.0) -> list[str]:
    rows = ([diagonal * (i == j) for j in range(size)] for i in range(size))
    return [f"  {name}:", *(f"    - {row}" for row in rows)]


def ros(made: Report) -> str:
    """Covariances of sensor_msgs/Imu: the variance of one sample of this stream, N^2 times the rate."""
    lines = _comments(head(made))
    lines.append("# sensor_msgs/Imu: covariance of one sample, row-major; axes as the sensor names them")
    for sensor, field, unit in (
        ("gyro", "angular_velocity_covariance", "(rad/s)^2"),
        ("accel", "linear_acceleration_covariance", "(m/s^2)^2"),
    ):
        diagonal = []
        for axis in AXES:
            channel = made.channels.get(f"{sensor}/{axis}")
            part = channel.N if channel is not None else None
            if part is not None and part.status == "measured" and part.value is not None and _rate(made):
                diagonal.append(part.value**2 * _rate(made))
                lines.append(
                    f"#   {sensor}/{axis}: N {_told(part)} {part.unit}, squared times {_rate(made):g} Hz"
                )
            elif channel is not None and channel.std:  # a channel that never changes has no noise to tell
                diagonal.append(channel.std**2)
                lines.append(f"#   {sensor}/{axis}: N is not known yet; square of the standard deviation")
        if len(diagonal) == 3:
            x, y, z = (f"{value:.4e}" for value in diagonal)
            lines.append(f"{field}: [{x}, 0, 0,  0, {y}, 0,  0, 0, {z}]  # {unit}")
        else:
            lines.append(f"# {field}: all zeros, which means unknown")
    lines += [
        "# this sensor's own orientation is not characterised; -1 means not given",
        "orientation_covariance: [-1, 0, 0,  0, 0, 0,  0, 0, 0]",
    ]
    return "\n".join(lines) + "\n"


@dataclass(frozen=True, slots=True)
class Step:
    """How often an autopilot's filter predicts, and where that is written.

    In such a step it adds (s dt)^2 to the variance of an angle or a velocity, and the same of its noise of
    bias to that of a bias: over a time both grow as N^2 and K^2 where s is N or K over sqrt(dt).
    """

    length_s: float
    source: str


PX4 = Step(0.010, "PX4 parameter reference: EKF2_PREDICT_US, 10 ms unless changed")
ARDUPILOT = Step(0.012, "ArduPilot, AP_NavEKF3: EKF_TARGET_DT, 12 ms")


def _autopilot(made: Report, names: Mapping[tuple[str, str], tuple[str, str]], step: Step, form: str) -> str:
    lines = _comments(head(made))
    lines += [
        f"# {step.source}",
        f"# deviation in one step of {1e3 * step.length_s:g} ms: N / sqrt({step.length_s:g} s) and "
        f"K / sqrt({step.length_s:g} s)",
        "# the least the sensor itself asks for. Defaults are far above it, for a vehicle vibrates: keep "
        "them,",
        "# or stay well above these; use them to compare sensors or on a rig at rest",
    ]
    for (sensor, letter), (name, unit) in names.items():
        found = worst(made, sensor, letter)
        lines += _comments(list(found.lines))
        if found.value is None:
            lines.append(f"# {name} ?")
        else:
            value = found.value / math.sqrt(step.length_s)
            lines += [f"# {name} in {unit}{found.note}", form.format(name=name, value=value, note=found.note)]
    return "\n".join(lines) + "\n"


def px4(made: Report) -> str:
    """PX4's EKF2: standard deviations of one prediction step, for the console."""
    names = {
        ("gyro", "N"): ("EKF2_GYR_NOISE", "rad/s"),
        ("gyro", "K"): ("EKF2_GYR_B_NOISE", "rad/s^2"),
        ("accel", "N"): ("EKF2_ACC_NOISE", "m/s^2"),
        ("accel", "K"): ("EKF2_ACC_B_NOISE", "m/s^3"),
    }
    return _autopilot(made, names, PX4, "param set {name} {value:.4e}{note}")


def ardupilot(made: Report) -> str:
    """ArduPilot's EKF3: the same, as a parameter file, whose readers know whole lines of comment alone."""
    names = {
        ("gyro", "N"): ("EK3_GYRO_P_NSE", "rad/s"),
        ("gyro", "K"): ("EK3_GBIAS_P_NSE", "rad/s^2"),
        ("accel", "N"): ("EK3_ACC_P_NSE", "m/s^2"),
        ("accel", "K"): ("EK3_ABIAS_P_NSE", "m/s^3"),
    }
    return _autopilot(made, names, ARDUPILOT, "{name},{value:.6g}")


def gtsam(made: Report) -> str:
    """GTSAM's combined preintegration: continuous-time covariances, squares of N and K."""
    lines = _comments([*head(made), "GTSAM, PreintegrationParams: covariances in continuous time"])
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
        found = worst(made, sensor, letter)
        lines += _comments(list(found.lines))
        value = "?" if found.value is None else f"{found.value:.6e}"
        lines.append(
            f"{'# ' if found.value is None else ''}params.{call}(np.eye(3) * {value}**2){found.note}"
        )
    lines += [
        "# of the integration, not of the sensor: small, for GTSAM begins with 1",
        "params.setIntegrationCovariance(np.eye(3) * 1e-8)",
    ]
    return "\n".join(lines) + "\n"


SNIPPETS: Mapping[str, Callable[[Report], str]] = {
    "kalibr": kalibr,
    "ros": ros,
    "px4": px4,
    "ardupilot": ardupilot,
    "gtsam": gtsam,
    "openvins": openvins,
}
