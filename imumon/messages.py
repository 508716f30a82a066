"""Texts for caveats, clocks, exclusions and grades of a report.

The terminal UI, the datasheet and the text table show the same things with the same texts, which are here. A
caveat has one line, and a paragraph that adds what to do about it. An unknown caveat, from a newer version, is
its own text.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from imumon.report import Coefficient, Drift, Report, SensorGrade
from imumon.samples import sensor_of

FILTERED_BELOW_HZ = 200.0
"""Hz, output rate below which the factory filter of a VN-100 passes noise that folds."""


@dataclass(frozen=True, slots=True)
class CaveatText:
    """Meaning of a caveat: in one line, and with its consequence and cure."""

    line: str
    advice: str


CAVEATS: Mapping[str, CaveatText] = {
    "aliased": CaveatText(
        "the sensor's own filter folds noise: N is too high",
        "The sensor's own filter lets noise from above half the output rate fold down: N of this stream is "
        "too high. It is right for a user of this stream, and wrong as a figure of the sensor. Use delta "
        "angles and velocities, or widen the filter (register 85) to 800 Hz divided by the rate.",
    ),
    "unknown_compensation": CaveatText(
        "unknown whether the sensor subtracts its bias from the deltas",
        "It is unknown whether the sensor subtracts its gyroscope bias from its deltas (listen-only). If it "
        "does, mean, B and K describe its filter.",
    ),
    "compensated": CaveatText(
        "the sensor subtracts its bias: B and K describe its filter, not the device",
        "The sensor's Kalman filter subtracts its gyroscope bias from this stream: mean, B and K of the "
        "gyroscope describe that filter, not the device. N is not affected. Use deltas or the uncompensated "
        "fields.",
    ),
    "warming_up": CaveatText(
        "still warming up: drift may look like K",
        "The temperature still rises, or the mean still settles: the drift of a warm-up looks like K. When it "
        "is over, the part that shows in the record is excluded; if none shows, nothing is.",
    ),
    "vibration": CaveatText(
        "something vibrates: short times are distorted",
        "A vibration or a spectral line shows in the curve: the fit does not use the octaves that it bends.",
    ),
    "misfit": CaveatText(
        "the curve is not N + B + K: the limits are widened",
        "The curve is not the sum of N, B and K: the limits are widened by the residuals, and the meaning of "
        "the figures is uncertain.",
    ),
    "not_at_rest": CaveatText(
        "the sensor moves: motion is not noise",
        "The sensor moved. Motion is not noise, and no grade is given.",
    ),
    "gaps": CaveatText(
        "more than a tenth of the samples is missing",
        "More than a tenth of the samples is missing: the limits at long times are somewhat too narrow.",
    ),
    "correlated": CaveatText(
        "neighbouring samples are not independent: the shortest times are not used",
        "Neighbouring samples are not independent (a filter, or values that repeat): the fit does not use the "
        "shortest octaves.",
    ),
    "ramp": CaveatText(
        "the mean drifts steadily: a ramp is part of the model",
        "The mean drifts steadily: a ramp is part of the fitted model, beside K.",
    ),
    "changed": CaveatText(
        "differs from the hours before or from the baseline: see the events",
        "N, B or the bias differs from the hours before or from the baseline.",
    ),
    "truncated": CaveatText(
        "the recording is damaged or truncated",
        "The recording is damaged or truncated: only what precedes the damage is used.",
    ),
    "constant": CaveatText(
        "the values never changed: dead, stuck or not measured",
        "The values never changed: the axis is dead, stuck, or was not measured. Its sensor gets no grade.",
    ),
    "stuck": CaveatText(
        "the values do not change: an axis or the whole sensor hangs",
        "The values do not change: an axis or the whole sensor hangs. Repeated samples are excluded, and no "
        "grade is given.",
    ),
    # not produced any more, for reports of earlier versions
    "loop": CaveatText(
        "the same samples over and over: replayed, not measured",
        "The same samples come over and over: replayed, not measured. They count once; no grade is given.",
    ),
    "disturbed": CaveatText(
        "more than a tenth of the record is excluded: knocks or motion",
        "More than a tenth of the record is excluded as disturbed (knocks, motion): the numbers describe the "
        "rest. Put the sensor where nothing touches or moves it.",
    ),
    "saturated": CaveatText("a range was exceeded", "A range was exceeded."),
    "quantised": CaveatText(
        "the resolution of the values shows in the curve",
        "The resolution of the values shows in the curve.",
    ),
    "temperature": CaveatText(
        "the temperature explains part of the drift", "Temperature explains part of the drift."
    ),
}
"""Texts by caveat."""

CLOCKS: Mapping[str, str] = {
    "startup": "the sensor's own clock",
    "counter": "a count of the sensor's loop",
    "dt": "the interval of each sample",
    "none": "a count of the samples, at a configured rate or the mean rate of host stamps",
}
"""Where the time of the samples comes from, by its name in a report."""

NEVER_CHANGES = "never changes"
ROUNDED_AWAY = "rounded away"
_NO_VALUE = {"constant": NEVER_CHANGES, "resolution": ROUNDED_AWAY}

FILTER_NOT_KNOWN = "filter not known"


def no_value_text(coefficient: Coefficient) -> str | None:
    """Return why a coefficient will never be known, in at most 14 cells; None if more data may show it."""
    return _NO_VALUE.get(coefficient.reason_code or "")


def line(caveat: str) -> str:
    """Return the meaning of a caveat in one line.

    >>> line("saturated"), line("of_tomorrow")
    ('a range was exceeded', 'of tomorrow')
    """
    known = CAVEATS.get(caveat)
    return known.line if known is not None else caveat.replace("_", " ")


def uncertainty(about: str = "±", times: str = "×÷") -> str:
    """Return the meaning of the signs beside a coefficient in one line.

    >>> uncertainty()
    '± half the 95 % interval; ×÷ its factor if wide; < bound'
    """
    return f"{about} half the 95 % interval; {times} its factor if wide; < bound"


def filter_not_known(report: Report) -> str | None:
    """Return a warning about point samples of a sensor whose filter is unknown; None for other streams."""
    device, rate = report.device, report.device.sample_rate_hz
    if device.alias_factor is not None or device.stream not in ("compensated", "uncompensated"):
        return None
    folds = rate is not None and rate < FILTERED_BELOW_HZ
    here = f", here {(FILTERED_BELOW_HZ / rate) ** 0.5:.2f}" if folds and rate is not None else ""
    return (
        "The filter of the sensor is unknown. With the factory settings of a VN-100, N of point samples below "
        f"200 Hz is too high by √(200 Hz / rate){here}."
    )


def excluded_by(report: Report) -> tuple[dict[str, float], float]:
    """Return the excluded seconds by reason, which add up to `excluded_s`, and those of the magnetometer alone.

    In a stream with inertial sensors, disturbances of the magnetometer alone are not part of that sum.
    """
    by = dict(report.session.excluded_by)
    inertial = any(sensor_of(name) in ("gyro", "accel") for name in report.channels)
    alone = by.pop("magnetic", 0.0) if inertial else 0.0
    return by, alone


def exclusions(report: Report, text: Callable[[float], str]) -> tuple[str, ...]:
    """Return what is excluded as disturbed; empty if nothing is.

    Parameters
    ----------
    text : function that formats seconds.
    """
    by, alone = excluded_by(report)
    total = report.session.excluded_s
    reasons = ", ".join(f"{why} {text(seconds)}" for why, seconds in by.items())
    parts = (
        f"{text(total)}{f' ({reasons})' if reasons else ''}" if total else "",
        f"{text(alone)} of the magnetometer alone" if alone else "",
    )
    return tuple(part for part in parts if part)


def caveats(report: Report) -> dict[str, list[str]]:
    """Return the channels by caveat; empty for a caveat of the whole record."""
    found: dict[str, list[str]] = {caveat: [] for caveat in report.caveats}
    for name, channel in report.channels.items():
        for caveat in channel.caveats:
            if caveat not in report.caveats:
                found.setdefault(caveat, []).append(name)
    return found


def joined(channels: Iterable[str]) -> str:
    """Return a short list of channels.

    >>> joined(["gyro/x", "gyro/y", "accel/z", "temperature"])
    'gyro xy, accel z, temperature'
    """
    axes: dict[str, str] = {}
    for name in channels:
        sensor, _, axis = name.partition("/")
        axes[sensor] = axes.get(sensor, "") + axis
    return ", ".join(f"{sensor} {some}".strip() for sensor, some in axes.items())


def caveat_lines(report: Report) -> list[str]:
    """Return each caveat in one line, with its channels."""
    return [f"{joined(names)}: {line(c)}" if names else line(c) for c, names in caveats(report).items()]


def follows_temperature(drift: Drift | None) -> bool:
    """Return whether a mean follows the temperature significantly: otherwise its slope is no figure."""
    return drift is not None and drift.per_degC is not None and drift.steady_N is not None


def within(meets: str | None) -> str:
    """Return the text of the grade that every figure meets, for use beside the nearest grade.

    >>> within("consumer"), within(None)
    ('every figure within consumer limits', 'some figure beyond consumer limits')
    """
    return f"every figure within {meets} limits" if meets else "some figure beyond consumer limits"


def grade_text(grade: SensorGrade) -> str:
    """Return both grades of a sensor in words, the same in every output.

    >>> grade_text(SensorGrade(nearest="industrial", meets="consumer"))
    'meets consumer, nearest industrial, provisional'
    >>> grade_text(SensorGrade(nearest="consumer", provisional=False)), grade_text(SensorGrade())
    ('meets nothing, nearest consumer', 'no grade')
    """
    if grade.nearest is None:
        return "no grade"
    provisional = ", provisional" if grade.provisional else ""
    return f"meets {grade.meets or 'nothing'}, nearest {grade.nearest}{provisional}"
