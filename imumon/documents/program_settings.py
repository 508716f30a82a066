"""Settings of other programs: a template for each, and one table of the factors from N and walk to their numbers.

N is the density of the rate as an Allan deviation gives it: white noise of N has the standard deviation N / sqrt(dt) in
samples of dt. The walk drives the bias: it walks by walk sqrt(t). The comments of a template cite how its program
defines its numbers, by the file of its source that reads them; `filter_values` makes numbers and comments.

A line of a template that begins with @ is replaced: ``@number gyro N NAME`` by a number of the worst axis with its
comments. The other words are the functions of `LINES`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from imumon.documents.filter_values import axis_values, bound_text, settings_header, value_text, worst_axis
from imumon.documents.report_texts import sensor_axes
from imumon.model.filter_report import FilterReport
from imumon.model.report import Report
from imumon.model.samples import AXES
from imumon.model.units import DEG, HOUR

TEMPLATES = Path(__file__).with_name("templates")
"""One file ``NAME.template`` for each of the `PROGRAMS`."""
_VALUE = r"[-+]?\d[\d.]*(?:e[-+]?\d+)?"
_ROW = re.compile(rf"([\w.]+): \[({_VALUE}(?:,\s*{_VALUE})*)\]")
_NUMBER = re.compile(
    rf"(?:param set |params\.)?([A-Za-z][\w.]*)(?:(?:: ?|,| )({_VALUE})|\(np\.eye\(3\) \* ({_VALUE})(?:\*\*2)?\))"
)
"""Lines with numbers, as `Program.known` and `LINES` write them."""

UNITS = {
    ("gyro", "N"): "rad/s", ("gyro", "K"): "rad/s^2", ("accel", "N"): "m/s^2", ("accel", "K"): "m/s^3",
}  # fmt: skip
"""Units of the standard deviation of a sample or a step."""


@dataclass(frozen=True, slots=True)
class Program:
    """How a program defines the numbers that it reads.

    For N or walk in SI, s, the number is s^power factor rate^rate_power.

    Attributes
    ----------
    text : what the document is.
    white : factor of N; that of the walk is 1.
    rate_hz : Hz, of the steps of the program; None: the sample rate of the record.
    power : 1 for a standard deviation, 2 for a variance.
    known, unknown : lines of a number, and those of one that is not known.
    """

    text: str
    white: float = 1.0
    rate_power: float = 0.0
    rate_hz: float | None = None
    power: int = 1
    known: str = "{name}: {value:.6e}{bound}"
    unknown: str = "# {name}: ?{why}"


PROGRAMS: Mapping[str, Program] = {
    # continuous time
    "kalibr": Program("Kalibr imu.yaml"),
    # variance of a sample
    "ros": Program("covariances of a ROS sensor_msgs/Imu"),
    # deviation in a step of length dt, which adds (s dt)^2 to a variance
    "px4": Program(
        "PX4 EKF2 parameters",
        rate_power=0.5,
        rate_hz=1.0 / 0.010,
        known="# {name} in {unit}\nparam set {name} {value:.4e}{bound}",
        unknown="# {name} ?",
    ),
    "ardupilot": Program(  # comments need lines of their own there
        "ArduPilot EKF3 parameters",
        rate_power=0.5,
        rate_hz=1.0 / 0.012,
        known="# {name} in {unit}{bound}\n{name},{value:.6g}",
        unknown="# {name} ?",
    ),
    # continuous time
    "gtsam": Program(
        "GTSAM preintegration parameters, Python",
        known="params.{name}(np.eye(3) * {value:.6e}**2){bound}",
        unknown="# params.{name}(np.eye(3) * ?**2)",
    ),
    "openvins": Program("OpenVINS kalibr_imu_chain.yaml"),
    # deviation of a sample. A step adds (dt/2)^2 of the variance of two samples that it takes for independent, half of
    # what white noise adds; hence sqrt(2). It adds (w dt)^2 to the variance of the bias.
    "vins": Program(
        "VINS-Mono and VINS-Fusion noise",
        white=math.sqrt(2.0),
        rate_power=0.5,
        known="# {name} in {unit}\n{name}: {value:.6e}{bound}",
        unknown="# {name} in {unit}\n# {name}: ?{why}",
    ),
    # variance of a sample
    "fastlio": Program(
        "FAST-LIO covariances",
        rate_power=1.0,
        power=2,
        known="# {name} in ({unit})^2\n{name}: {value:.6e}{bound}",
        unknown="# {name} in ({unit})^2\n# {name}: ?{why}",
    ),
    # continuous time
    "liosam": Program("LIO-SAM noise"),
    "orbslam3": Program("ORB-SLAM3 IMU noise"),
    # variance of a sample
    "robot_localization": Program("covariances of a ROS sensor_msgs/Imu for robot_localization"),
    # navigation units: see `AXIS_FACTORS`
    "kfgins": Program("KF-GINS imunoise"),
}

AXIS_FACTORS = {"deg/sqrt(hr)": 60.0 * DEG, "m/s/sqrt(hr)": 60.0, "deg/hr": DEG * HOUR, "mGal": 1e5}
"""Factors from SI to the units of KF-GINS."""
CORRELATION_HORIZONS = 24.0
"""Correlation time of the bias for KF-GINS, in horizons: a walk within one; the 4 h of its example for 600 s."""


@dataclass(frozen=True, slots=True)
class TemplateContext:
    """A program, and what its settings are made from; `bounds`: numbers that rest on a bound are no comments."""

    program: Program
    report: Report
    filters: FilterReport
    bounds: bool

    @property
    def rate(self) -> float | None:
        """Sample rate of the record, Hz; None if it is unknown."""
        return self.report.device.sample_rate_hz or None

    @property
    def correlation_time_h(self) -> float:
        return CORRELATION_HORIZONS * self.filters.horizon_s / HOUR

    def values(self, sensor: str, letter: str) -> dict[str, float]:
        """Return N or walk of the axes where it is known."""
        return axis_values(self.report, self.filters, sensor, letter)

    def line(self, text: str, bound: str) -> str:
        """Return the line of a number; one that rests on a `bound` is a comment unless it is asked for."""
        return f"# {text}" if bound and not self.bounds else text


def settings_document(program: str, report: Report, filters: FilterReport, *, bounds: bool = False) -> str:
    """Return the settings of one of the `PROGRAMS`.

    Parameters
    ----------
    bounds : whether a number that rests on a bound is a line that the program reads; else it is a comment.
    """
    context = TemplateContext(PROGRAMS[program], report, filters, bounds)
    lines = []
    for line in (TEMPLATES / f"{program}.template").read_text("utf-8").splitlines():
        match = re.fullmatch(r"( *)@(\w+) ?(.*)", line)
        if match is None:
            lines.append(line)
            continue
        replacement = "\n".join(LINES[match[2]](context, match[3])).split("\n")
        lines += [match[1] + text for text in replacement]
    return "\n".join([*lines, ""])


def numbers_of(settings: str) -> dict[str, float]:
    r"""Return the numbers in settings of one of the `PROGRAMS`, by name; those in a row as ``name[0]`` and so on.

    >>> numbers_of("# a comment\ngyr_n: 2e-3  # unit\nparams.setX(np.eye(3) * 2.0**2)\narw: [1, 2]\nINS_A,3\n")
    {'gyr_n': 0.002, 'setX': 4.0, 'arw[0]': 1.0, 'arw[1]': 2.0, 'INS_A': 3.0}
    """
    numbers: dict[str, float] = {}
    for line in settings.splitlines():
        bare = line.split("#")[0].strip()
        if (match := _ROW.fullmatch(bare)) is not None:
            for k, text in enumerate(match[2].split(",")):
                numbers[f"{match[1]}[{k}]"] = float(text)
        elif (match := _NUMBER.fullmatch(bare)) is not None:
            value = float(match[2] or match[3])
            numbers[match[1]] = value**2 if bare.endswith("**2)") else value
    return numbers


def number_lines(settings: str) -> list[str]:
    r"""Return the lines of settings that are a number, known, only bounded or unknown, without what explains them.

    >>> number_lines("# worst axis z\n  gyr_n: 2e-3\n# gyr_w: 1e-6  # not seen\n# acc_w: ?\nmodel: kalibr\n")
    ['gyr_n: 2e-3', '# gyr_w: 1e-6  # not seen', '# acc_w: ?']
    """
    lines = map(str.strip, settings.splitlines())
    return [line for line in lines if " ?" in line or numbers_of(line.removeprefix("# "))]


def comments(lines: Sequence[str]) -> list[str]:
    """Return lines as comments."""
    return [f"# {line}" for line in lines]


def _header(context: TemplateContext, _: str) -> list[str]:
    return comments(settings_header(context.report, context.filters))


def _number(context: TemplateContext, words: str) -> list[str]:
    """Return a number of the worst axis, from its sensor, letter and name."""
    sensor, letter, name = words.split()
    program, worst = context.program, worst_axis(context.report, context.filters, sensor, letter)
    rate, unit = program.rate_hz or context.rate, UNITS[sensor, letter]
    lines = comments(worst.lines)
    if worst.value is None or (rate is None and program.rate_power):
        why = "" if worst.value is None else " (the sample rate is unknown)"
        return [*lines, program.unknown.format(name=name, unit=unit, why=why)]
    factor = program.white if letter == "N" else 1.0
    value = worst.value**program.power * factor * (rate or 1.0) ** program.rate_power
    bound = f"  # {worst.bound}" if worst.bound else ""
    *above, text = program.known.format(name=name, unit=unit, value=value, bound=bound).split("\n")
    return [*lines, *above, context.line(text, worst.bound)]


def _about(context: TemplateContext, words: str) -> list[str]:
    """Return the comments of a number, from its sensor and letter."""
    return comments(worst_axis(context.report, context.filters, *words.split()).lines)


def _rate(context: TemplateContext, words: str) -> list[str]:
    """Return the line with the sample rate, or the comment that it is not known."""
    known, _, unknown = words.partition(" || ")
    rate = context.filters.device.sample_rate_hz
    return [known.format(rate=float(f"{rate:.6g}"))] if rate else comments([unknown])


def _topic(context: TemplateContext, name: str) -> list[str]:
    """Return the line with the topic of the record, else with the usual one."""
    return [f"{name}: {context.filters.device.topic or '/imu/data'}"]


def _bound(context: TemplateContext, sensor: str, *letters: str) -> str:
    """Return what the numbers of the three axes rest on where one is not measured; empty if all are."""
    axes = [*sensor_axes(context.report, sensor)]
    bounds = (
        bound_text(letter, {axis: channel.coefficients[letter] for axis, channel in axes})
        for letter in letters
    )
    return next(filter(None, bounds), "")


def _at_rate(context: TemplateContext, text: str) -> list[str]:
    """Return a comment that ends with the sample rate."""
    rate = (
        f"for samples at {context.rate:g} Hz, the rate of this record"
        if context.rate
        else "the sample rate is unknown"
    )
    return comments([f"{text.format(horizon=context.filters.horizon_s)}, {rate}"])


def _matrix(field: str, diagonal: Sequence[float], unit: str) -> str:
    x, y, z = (f"{value:.4e}" for value in diagonal)
    return f"{field}: [{x}, 0, 0,  0, {y}, 0,  0, 0, {z}]  # {unit}"


def _sample_covariance(context: TemplateContext, words: str) -> list[str]:
    """Return the variance of one sample of each axis, N^2 times the rate; that of the record while N is not known."""
    sensor, field, unit = words.split()
    lines, diagonal = [], []
    for axis, channel in sensor_axes(context.report, sensor):
        part = channel.coefficients.get("N")
        if part is not None and part.status == "measured" and part.value is not None and context.rate:
            diagonal.append(part.value**2 * context.rate)
            text = f"N {value_text(part)} {part.unit}, squared times {context.rate:g} Hz"
        elif channel.std:  # a channel that never changes has no known noise
            diagonal.append(channel.std**2)
            text = "N is not known yet; square of the standard deviation"
        else:
            continue
        lines.append(f"#   {sensor}/{axis}: {text}")
    if len(diagonal) < len(AXES):
        return [*lines, f"# {field}: all zeros, which means unknown"]
    return [*lines, context.line(_matrix(field, diagonal, unit), _bound(context, sensor, "N"))]


def _covariance_with_walk(context: TemplateContext, words: str) -> list[str]:
    """Return the variance of one sample for a filter that estimates no bias.

    The error of the bias has to be in the covariance of a sample. With the walk w and the horizon h, the variance
    of the angle, N^2 h + w^2 h^3 / 3, is that of white noise with N^2 + w^2 h^2 / 3.
    """
    sensor, field, unit = words.split()
    white, walk = (context.values(sensor, letter) for letter in "NK")
    if not context.rate or not len(white) == len(walk) == len(AXES):
        return [f"# {field}: ?"]
    h = context.filters.horizon_s
    diagonal = [(white[axis] ** 2 + (walk[axis] * h) ** 2 / 3.0) * context.rate for axis in AXES]
    return [context.line(_matrix(field, diagonal, unit), _bound(context, sensor, *"NK"))]


def _axes(context: TemplateContext, words: str) -> list[str]:
    """Return the numbers of the three axes in the units of KF-GINS.

    Its bias is a Gauss-Markov process of standard deviation s and correlation time T, driven by 2 s^2 / T: for
    times far below T a walk of s sqrt(2 / T), hence s = walk sqrt(T / 2).
    """
    sensor, letter, name, unit = words.split()
    first, *others = worst_axis(context.report, context.filters, sensor, letter).lines
    lines = comments([first.replace("; worst axis", ", of each axis; largest on"), *others])
    values = context.values(sensor, letter)
    if len(values) < len(AXES):
        return [*lines, f"# {name}: ?"]
    deviation = math.sqrt(context.correlation_time_h * HOUR / 2.0) if letter == "K" else 1.0
    numbers = ", ".join(f"{values[axis] * deviation * AXIS_FACTORS[unit]:.6g}" for axis in AXES)
    bound = _bound(context, sensor, letter)
    return [*lines, context.line("; ".join(filter(None, (f"{name}: [{numbers}]  # [{unit}]", bound))), bound)]


LINES: Mapping[str, Callable[[TemplateContext, str], list[str]]] = {
    "header": _header,
    "number": _number,
    "about": _about,
    "rate": _rate,
    "topic": _topic,
    "at_rate": _at_rate,
    "sample_covariance": _sample_covariance,
    "covariance_with_walk": _covariance_with_walk,
    "axes": _axes,
    "correlation_time": lambda context, name: [f"{name}: {context.correlation_time_h:.6g}  # [hr]"],
}
"""Functions that make the lines for a word of a template, from the context and the rest of the line."""
