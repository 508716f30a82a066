"""Words: what a report's caveats and grades mean, for people.

The screen, the datasheet and the text table speak of the same things; that they use the same words is
the purpose of this file. A caveat has a line, for where there is room for one, and a paragraph that adds
what to do about it. Unknown words, of a newer program, stand for themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from imumon.report import Coefficient, Drift, Report
from imumon.samples import sensor_of


@dataclass(frozen=True, slots=True)
class Meaning:
    """What a caveat means: in a line, and with its consequence and cure."""

    line: str
    advice: str


CAVEATS: Mapping[str, Meaning] = {
    "aliased": Meaning(
        "the sensor's own filter folds noise: N is too high",
        "The sensor's own filter lets noise from above half the output rate fold down: N of this stream is "
        "too high. It is right for whoever uses this very stream, and wrong as a figure of the sensor. Take "
        "delta angles and velocities, or widen the filter (register 85) to 800 Hz divided by the rate.",
    ),
    "unknown_compensation": Meaning(
        "the sensor may take its bias out of the deltas: it was only listened to",
        "Nobody knows whether the sensor takes its gyroscope bias out of its deltas (it was only listened "
        "to). If it does, mean, B and K describe its filter.",
    ),
    "compensated": Meaning(
        "the sensor takes its bias out live: B and K describe its filter, not the device",
        "The sensor's Kalman filter takes its gyroscope bias out of this stream live: mean, B and K of the "
        "gyroscope describe that filter, not the device. N is not touched. Take deltas or the uncompensated "
        "fields.",
    ),
    "warming_up": Meaning(
        "still warming up: drift may look like K",
        "The temperature still rises, or the mean still settles: drift that a warm-up makes looks like K. "
        "When it is over, what shows of it in the record is cut out; where none shows, nothing is.",
    ),
    "vibration": Meaning(
        "something vibrates: short times are distorted",
        "A vibration or a spectral line shows in the curve: the octaves that it bends were left out of the "
        "fit.",
    ),
    "misfit": Meaning(
        "the curve is not N + B + K: the limits are widened",
        "The curve is not the sum of N, B and K: the limits are widened by what is left over, and what the "
        "figures mean is not sure.",
    ),
    "not_at_rest": Meaning(
        "the sensor moves: motion is not noise",
        "The sensor moved. Motion is not noise, and no grade is given.",
    ),
    "gaps": Meaning(
        "more than a tenth of the samples is missing",
        "More than a tenth of the samples is missing: the limits at long times are somewhat too narrow.",
    ),
    "correlated": Meaning(
        "neighbouring samples are not independent: the shortest times are left out",
        "Neighbouring samples are not independent (a filter, or values that repeat): the shortest octaves "
        "were left out of the fit.",
    ),
    "ramp": Meaning(
        "the mean runs away steadily: a ramp is part of the model",
        "The mean runs away steadily: a ramp is part of the fitted model, beside K.",
    ),
    "changed": Meaning(
        "differs from the hours before or from the baseline: see the events",
        "N, B or the bias differs from the hours before or from the baseline.",
    ),
    "truncated": Meaning(
        "the recording is damaged or cut off",
        "The recording is damaged or cut off: only what comes before that is in it.",
    ),
    "constant": Meaning(
        "the values never changed: dead, stuck or not measured",
        "The values never changed: the axis is dead, stuck, or was not measured. Its sensor gets no grade.",
    ),
    "stuck": Meaning(
        "the values stand still: an axis or the whole sensor hangs",
        "The values stand still: an axis or the whole sensor hangs. What repeats is left out, and no grade "
        "is given.",
    ),
    "loop": Meaning(
        "the same samples over and over: replayed, not measured",
        "The same samples come over and over: replayed, not measured. They count once; no grade is given.",
    ),
    "disturbed": Meaning(
        "more than a tenth of the record was cut out: knocks or motion",
        "More than a tenth of the record was cut out as disturbed (knocks, motion): the numbers are of what "
        "is left. Put the sensor where nothing touches or moves it.",
    ),
    "saturated": Meaning("a range was exceeded", "A range was exceeded."),
    "quantised": Meaning(
        "the resolution of the values shows in the curve",
        "The resolution of the values shows in the curve.",
    ),
    "temperature": Meaning(
        "the temperature explains part of the drift", "Temperature explains part of the drift."
    ),
}


CLOCKS: Mapping[str, str] = {
    "startup": "the sensor's own clock",
    "counter": "a count of the sensor's loop",
    "dt": "the interval of each sample",
    "none": "a count of the samples, at the rate that was given or that stamps of a host tell",
}
"""Where the time of the samples comes from, by its name in a report."""


NEVER_CHANGES, ROUNDED_AWAY = "never changes", "rounded away"
_LACKING = {"constant": NEVER_CHANGES, "resolution": ROUNDED_AWAY}


def lacking(found: Coefficient) -> str | None:
    """Why a coefficient will not be known, in at most 14 letters; None where more time may tell."""
    return next((short for word, short in _LACKING.items() if word in (found.reason or "")), None)


def line(caveat: str) -> str:
    """What a caveat means, in a line.

    >>> line("saturated"), line("of_tomorrow")
    ('a range was exceeded', 'of tomorrow')
    """
    known = CAVEATS.get(caveat)
    return known.line if known is not None else caveat.replace("_", " ")


def uncertainty(about: str = "±", times: str = "×÷") -> str:
    """What the signs beside a coefficient mean, in a line.

    >>> uncertainty()
    '± half the 95 % interval; ×÷ its factor if wide; < bound'
    """
    return f"{about} half the 95 % interval; {times} its factor if wide; < bound"


FILTER_NOT_KNOWN = "filter not known"


def filter_not_known(report: Report) -> str | None:
    """Warning of point samples of a sensor that nobody could ask for its filter; None elsewhere."""
    device, rate = report.device, report.device.sample_rate_hz
    if device.alias_factor is not None or device.stream not in ("compensated", "uncompensated"):
        return None
    here = f", here {(200.0 / rate) ** 0.5:.2f}" if rate is not None and rate < 200.0 else ""
    return (
        "Nobody could ask the sensor for its filter. With that of a VN-100 as it leaves the factory, "
        f"N of point samples below 200 Hz is too high by √(200 Hz / rate){here}."
    )


def cut_by(report: Report) -> tuple[dict[str, float], float]:
    """Seconds cut out by reason, which add up to `excluded_s`, and those of the magnetometer alone.

    Where there are inertial sensors, what hits the magnetometer alone is no part of that sum.
    """
    by = dict(report.session.excluded_by)
    inertial = any(sensor_of(name) in ("gyro", "accel") for name in report.channels)
    alone = by.pop("magnetic", 0.0) if inertial else 0.0
    return by, alone


def cut_out(report: Report, text: Callable[[float], str]) -> tuple[str, ...]:
    """What was cut out as disturbed, with seconds told by `text`; nothing where nothing was."""
    by, alone = cut_by(report)
    whole = report.session.excluded_s
    reasons = ", ".join(f"{why} {text(seconds)}" for why, seconds in by.items())
    parts = (
        f"{text(whole)}{f' ({reasons})' if reasons else ''}" if whole else "",
        f"{text(alone)} of the magnetometer alone" if alone else "",
    )
    return tuple(part for part in parts if part)


def caveats(report: Report) -> dict[str, list[str]]:
    """Names of the channels by caveat; none for one that holds for the whole record."""
    found: dict[str, list[str]] = {caveat: [] for caveat in report.caveats}
    for name, channel in report.channels.items():
        for caveat in channel.caveats:
            if caveat not in report.caveats:
                found.setdefault(caveat, []).append(name)
    return found


def joined(channels: Iterable[str]) -> str:
    """Names of channels in few words.

    >>> joined(["gyro/x", "gyro/y", "accel/z", "temperature"])
    'gyro xy, accel z, temperature'
    """
    axes: dict[str, str] = {}
    for name in channels:
        sensor, _, axis = name.partition("/")
        axes[sensor] = axes.get(sensor, "") + axis
    return ", ".join(f"{sensor} {some}".strip() for sensor, some in axes.items())


def told(report: Report) -> list[str]:
    """Each caveat in a line, with the channels it holds for."""
    return [f"{joined(names)}: {line(c)}" if names else line(c) for c, names in caveats(report).items()]


def follows(drift: Drift | None) -> bool:
    """Whether a mean follows the temperature beyond what the noise makes: else its slope is no figure."""
    return drift is not None and drift.per_degC is not None and drift.steady_N is not None


def within(meets: str | None) -> str:
    """The grade whose limits every figure keeps, beside the headline, which is the nearest one.

    >>> within("consumer"), within(None)
    ('every figure within consumer limits', 'some figure beyond consumer limits')
    """
    return f"every figure within {meets} limits" if meets else "some figure beyond consumer limits"
