"""Texts for caveats, clocks, exclusions and grades of a report, and what is derived from its fields.

The terminal UI, the datasheet and the text table show the same things with the same texts, which are here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

from imumon.model.coefficients import INDISTINCT_WORD, LIMIT_95, SIGNIFICANT, Estimate
from imumon.model.report import Change, Drift, Event, NoiseModel, Report, SensorGrade
from imumon.model.samples import INERTIAL, ChannelName, Level
from imumon.model.units import duration, sentence, share_text


class CaveatText(NamedTuple):
    """Meaning of a caveat in one line, and its consequence and cure in sentences."""

    line: str
    details: str = ""


CAVEATS: Mapping[str, CaveatText] = {
    "aliased": CaveatText(
        "the sensor's own filter folds noise: N is too high",
        "Noise from above half the output rate folds down. N is right for a user of this stream, but it is no "
        "figure of the sensor. Use delta angles and velocities, or configure the filter of the sensor to average "
        "over the output interval.",
    ),
    "unknown_compensation": CaveatText(
        "unknown whether the sensor subtracts its bias from this stream",
        "Neither the data nor the settings show it. If the sensor subtracts its gyroscope bias, mean, B and K "
        "describe its filter.",
    ),
    "compensated": CaveatText(
        "the sensor subtracts its bias: B and K describe its filter, not the device",
        "The sensor's Kalman filter subtracts the gyroscope bias from this stream, which also changes the mean. "
        "N is not affected. Use deltas or the uncompensated fields.",
    ),
    "assumed_unit": CaveatText(
        "a unit is assumed",
        "The recording does not state it, and its numbers only suggest it: in another unit, all coefficients of the "
        "sensor differ by a factor. The remarks name the columns. State the unit, with --map or in the header.",
    ),
    "assumed_rate": CaveatText(
        "the unit of the time is assumed",
        "The recording does not state it. At another rate, N differs by the root of the factor, and all times by the "
        "factor. State it, with --map t=COLUMN:UNIT or --rate.",
    ),
    "assumed_columns": CaveatText(
        "which columns are the sensor is assumed",
        "No name says which numbers are the gyroscope and the accelerometer: their size suggests it. Name them, with "
        "--map.",
    ),
    "doubtful_unit": CaveatText(
        "the size of the samples contradicts the unit of a sensor",
        "A gyroscope has more noise than any at rest, or an acceleration is not one g. In a wrong unit, all "
        "coefficients differ by a factor. The remarks name the columns.",
    ),
    "doubtful_rate": CaveatText(
        "the sample rate is doubtful",
        "Two times show different rates, a comment states another one, the host clock contradicts the rate, or no "
        "sensor has it. A wrong rate changes N by the root of its factor, and all times. The remarks name the cause. "
        "For a recording, choose the time with --map, or give --rate.",
    ),
    "mixed_rows": CaveatText(
        "every second row differs: the rows may be of two sensors",
        "The noise of rows of two sensors in turn is that of neither. Write a file for each sensor, or a column that "
        "says which one a row is of, for --where.",
    ),
    "warming_up": CaveatText(
        "still warming up: K is an upper bound",
        "The temperature still rises, or the mean still settles. At the end of the warm-up, the part that shows "
        "in the record is excluded.",
    ),
    "vibration": CaveatText(
        "something vibrates: short times are distorted",
        "A vibration, a hum or a spectral line is not counted as noise of the sensor. Mains, fans and pumps are "
        "common causes.",
    ),
    "misfit": CaveatText(
        "the curve is not that of the coefficients: B, K and M are bounds",
        "Chance makes such a curve in less than one record of a hundred. Where the spectrum shows the difference, "
        "the limits of N include it.",
    ),
    "not_at_rest": CaveatText(
        "the sensor moves: motion is not noise",
        "No grade is given. Leave the sensor at rest. If it is, its unit may be wrong: deg/s read as rad/s look "
        "like motion. For a table, --map names the units.",
    ),
    "gaps": CaveatText(
        "more than a tenth of the samples is missing", "The limits at long times are somewhat too narrow."
    ),
    "correlated": CaveatText(
        "neighbouring samples are not independent: the shortest times are not used",
        "The cause is a filter, or values that repeat.",
    ),
    "not_white": CaveatText(
        "the noise is not white: N lies between its levels at the highest frequencies",
        "Its density is not flat there, and no filter has this shape: look for a vibration. No grade is given.",
    ),
    "ramp": CaveatText("the mean drifts steadily: a ramp is part of the model", "K is fitted beside it."),
    "model_misses": CaveatText(
        "the drawn model leaves the limits of the measured curve",
        "B, K and M that decide it there are bounds: the noise is of a kind that the model does not have.",
    ),
    "halves": CaveatText(
        "K of the halves of the record contradict each other",
        "Something moved the mean in a part of the record only: a warm-up, a hand or a draught. K is a bound.",
    ),
    "popcorn": CaveatText(
        "the mean jumps between two levels (popcorn noise)",
        "M has its size and its time constant. B and K are without it.",
    ),
    "changed": CaveatText("differs from the time before or from the baseline: see the events"),
    "truncated": CaveatText(
        "the recording is damaged or truncated", "Only what precedes the damage is used."
    ),
    "rival": CaveatText(
        "two programs publish under this name: the first that was seen is shown",
        "It need not be the right one. End the other, or give each daemon its own --id; imumon doctor names both.",
    ),
    "other_sender": CaveatText(
        "another program sends to the same port or topic: only the first is used",
        "It need not be the right one. End the other, or name the sensor with from=ADDRESS.",
    ),
    "constant": CaveatText(
        "the values never changed: dead, stuck or not measured", "The sensor of this axis gets no grade."
    ),
    "clipped": CaveatText(
        "the values end at a limit: a range of the sensor is too small",
        "N is too small, and no grade is given. Choose a wider range.",
    ),
    "stuck": CaveatText(
        "the values do not change: an axis or the whole sensor hangs",
        "Repeated samples are excluded, and no grade is given.",
    ),
    "disturbed": CaveatText(
        "more than a tenth of the record is excluded: knocks or motion",
        "The numbers describe the rest. Put the sensor where nothing touches or moves it.",
    ),
    "saturated": CaveatText("a range was exceeded"),
    "outliers": CaveatText(
        "outliers raise N; they are kept as noise",
        "N counts them, but not those that came before they were known to be noise, and not single samples beyond 35 "
        "standard deviations: they are excluded, and only the upper limit of N counts them. Without outliers N would "
        "be lower by about the ratio that is shown as robust.",
    ),
    "quantised": CaveatText("the resolution of the values shows in the curve"),
    "temperature": CaveatText(
        "the temperature explains part of the drift", "The coefficients are without its effect."
    ),
    "oscillation": CaveatText(
        "the mean oscillates slowly: the coefficients are without it",
        "Air conditioning is a common cause.",
    ),
}
"""Texts by caveat."""

EVENT_LEVELS: Mapping[str, Level] = {
    "connect": "info",
    "disconnect": "warning",
    "waiting": "warning",
    "silent": "warning",
    "reconfigured": "notice",
    "sensor_error": "warning",
    "gap": "debug",
    "loss": "warning",
    "disturbance": "info",
    "warmup": "info",
    "rest": "info",
    "motion": "info",
    "constant": "warning",
    "stuck": "warning",
    "change": "warning",
    "history": "warning",
    "grade": "info",
    "restart": "notice",
    "state": "info",
    "recording": "error",
    "bus": "warning",
    "remark": "notice",
}
"""Level of an event by its kind. An event that ends a trouble is a notice whatever its kind; some others of the
kinds `connect`, `state` and `remark` differ too."""

CLOCKS: Mapping[str, str] = {
    "startup": "the sensor's own clock",
    "counter": "a count of the sensor's loop",
    "dt": "the interval of each sample",
    "none": "a count of the samples, at a configured rate or the mean rate of host stamps",
}
"""Where the time of the samples comes from, by its name in a report."""

EXCLUSION_CURES: Mapping[str, str] = {
    "glitch": "check the cable and the baud rate",
    "knock": "put it where nothing touches it",
    "motion": "keep it still, or check its unit (deg/s?)",
    "clipped": "choose a wider range of the sensor",
    "stuck": "restart the sensor",
    "magnetic": "keep magnets and currents away",
}
"""What to try against an exclusion, by its reason."""

NEVER_CHANGES = "never changes"
ROUNDED_AWAY = "rounded away"
_NO_VALUE = {
    "constant": NEVER_CHANGES,
    "resolution": ROUNDED_AWAY,
    "excluded": "excluded",
    "gaps": "cut by gaps",
}

FILTER_NOT_KNOWN = "filter not known"
NOT_APART = "it is B, K or M"
"""Meaning of the status ``indistinct``, in a line that has little room."""


def no_value_text(coefficient: Estimate) -> str | None:
    """Return why a coefficient is not known, in at most 14 cells; None if more data of the kind may show it."""
    return _NO_VALUE.get(coefficient.reason_code or "")


def line(caveat: str) -> str:
    """Return the meaning of a caveat in one line.

    >>> line("saturated"), line("of_tomorrow")
    ('a range was exceeded', 'of tomorrow')
    """
    return CAVEATS[caveat].line if caveat in CAVEATS else caveat.replace("_", " ")


def uncertainty(*, indistinct: bool = False) -> str:
    """Return the meaning of the signs beside a coefficient in one line.

    Parameters
    ----------
    indistinct : whether there are coefficients that the record does not separate.

    >>> uncertainty()
    '±: 95 % limits. ×÷: the same as a factor. <: bound.'
    """
    about_open = f" {INDISTINCT_WORD}: {NOT_APART}." if indistinct else ""
    return f"±: 95 % limits. ×÷: the same as a factor. <: bound.{about_open}"


def has_indistinct(report: Report) -> bool:
    """Return whether there are coefficients that the record does not separate."""
    return any(
        part.status == "indistinct"
        for channel in report.channels.values()
        for part in channel.estimates.values()
    )


def loss_text(share: float) -> str:
    """Return the loss of the last minute as a sentence.

    >>> loss_text(0.03)
    '3 % of the samples of the last minute are missing'
    """
    return f"{share_text(share)} of the samples of the last minute are missing"


def loss_label(report: Report) -> str:
    """Return the loss of the last minute in two words, such as ``loss 3 %``."""
    share = report.session.recent_loss
    return f"loss {'not known' if share is None else share_text(share)}"


def filter_not_known(report: Report) -> str | None:
    """Return a warning about point samples of a sensor whose filter is unknown; None where it cannot matter.

    A spectrum that falls towards half the sampling rate shows a filter that lets nothing fold.
    """
    if report.device.alias_factor is not None or report.device.stream in ("deltas", None):
        return None
    inertial = [channel for name, channel in report.channels.items() if name.sensor in INERTIAL]
    if report.channels and all("correlated" in channel.caveats for channel in inertial):
        return None
    return (
        "The filter of the sensor is unknown. If it does not average over the output interval, noise folds and "
        "N is too high."
    )


def excluded_by(report: Report) -> tuple[dict[str, float], float]:
    """Return the excluded seconds by reason, and those of the magnetometer alone if `excluded_s` omits them."""
    by = dict(report.session.excluded_by)
    inertial = any(name.sensor in INERTIAL for name in report.channels)
    alone = by.pop("magnetic", 0.0) if inertial else 0.0
    return by, alone


def excluded_text(share: float, by: Mapping[str, float]) -> str:
    """Return what share of a record is excluded, for which reason mostly, and what to try.

    Parameters
    ----------
    share : 0 to 1, of the samples.
    by : s, excluded time by reason. That of the magnetometer alone counts only if there is no other.

    >>> excluded_text(0.62, {"knock": 90.0, "glitch": 0.1, "magnetic": 99.0})
    '62 % excluded as knock: put it where nothing touches it'
    """
    counted = {reason: seconds for reason, seconds in by.items() if reason != "magnetic"} or dict(by)
    reason = max(counted, key=counted.__getitem__)
    return f"{share_text(share)} excluded as {reason}: {EXCLUSION_CURES[reason]}"


def change_text(channel: str, change: Change) -> str:
    """Return a change as text, such as ``gyro/x: N has grown by 40 % against the baseline``."""
    against = f"against the {change.against}"
    if change.since is not None and change.p_value is not None:
        against += f" since {change.since[:10]}, p = {change.p_value:.0e}"
    if change.ratio is None:
        name, unit = (
            ("bias", "") if change.quantity == "bias" else ("slope against the temperature", " per degC")
        )
        return f"{channel}: the {name} has moved from {change.before:.3g} to {change.now:.3g}{unit} {against}"
    verb = "grown" if change.ratio > 1.0 else "fallen"
    return f"{channel}: {change.quantity} has {verb} by {share_text(abs(change.ratio - 1.0))} {against}"


def exclusions(report: Report, text: Callable[[float], str]) -> tuple[str, ...]:
    """Return what is excluded as disturbed; empty if nothing is. `text` formats seconds."""
    by, alone = excluded_by(report)
    total = report.session.excluded_s
    reasons = ", ".join(f"{reason} {text(seconds)}" for reason, seconds in by.items())
    parts = [f"{text(total)} ({reasons})" if reasons else text(total)] if total else []
    return (*parts, *([f"{text(alone)} of the magnetometer alone"] if alone else []))


def one_warmup(events: Sequence[Event]) -> tuple[Event, ...]:
    """Return the events without the ends of a warm-up that a later one replaces: a record has one."""
    ends = [event for event in events if event.kind == "warmup"]
    return tuple(event for event in events if event not in ends[:-1])


def spreadsheet_cell(value: object) -> object:
    """Return a cell of a CSV file: a spreadsheet would execute text that begins like a formula.

    >>> spreadsheet_cell("=HYPERLINK(1)"), spreadsheet_cell("gyro/x"), spreadsheet_cell(-1.5)
    ("'=HYPERLINK(1)", 'gyro/x', -1.5)
    """
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULA) else value


_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def line_with_size(report: Report, caveat: str) -> str:
    """Return the meaning of a caveat in one line, with its size if the report has it."""
    ratios = [
        c.robust.ratio for c in report.channels.values() if caveat in c.caveats and c.robust is not None
    ]
    if caveat == "outliers" and ratios:
        return f"{line(caveat)}: up to {max(ratios):.2f} times the N without them"
    models = [c.model for c in report.channels.values() if caveat in c.caveats and c.model is not None]
    periods = sorted({duration(period) for model in models for period in model.oscillations_s})
    if caveat == "vibration":
        return f"{line(caveat)}{_frequencies(models)}"
    if caveat == "oscillation" and periods:
        return f"{line(caveat)}; period {', '.join(periods)}"
    return line(caveat)


def _frequencies(models: Sequence[NoiseModel]) -> str:
    """Return the frequencies of a hum, and which mains fold there; "" if there is none."""
    hums = [model for model in models if model.vibration_hz]
    if not hums:
        return ""
    low, high = min(hum.vibration_hz[0] for hum in hums), max(hum.vibration_hz[-1] for hum in hums)
    mains = sorted({f"{hz:g} Hz" for hum in hums for hz in hum.vibration_mains_hz})
    cause = f"; mains of {' or '.join(mains[:2])} fold there" if mains else ""
    return f"; {low:.2g} to {high:.2g} Hz are not counted as noise{cause}"


def advice(report: Report, caveat: str) -> str:
    """Return the meaning of a caveat with its size, consequence and cure, in sentences."""
    text, details = line_with_size(report, caveat), CAVEATS[caveat].details if caveat in CAVEATS else ""
    return f"{sentence(text)}. {details}".strip()


def caveats(report: Report) -> dict[str, list[ChannelName]]:
    """Return the channels by caveat; empty for a caveat of the whole record."""
    by_caveat: dict[str, list[ChannelName]] = {caveat: [] for caveat in report.caveats}
    for name, channel in report.channels.items():
        for caveat in channel.caveats:
            if caveat not in report.caveats:
                by_caveat.setdefault(caveat, []).append(name)
    return by_caveat


def joined(channels: Iterable[ChannelName]) -> str:
    """Return a short list of channels.

    >>> joined(map(ChannelName, ["gyro/x", "gyro/y", "accel/z", "temperature"]))
    'gyro xy, accel z, temperature'
    """
    axes: dict[str, str] = {}
    for name in channels:
        axes[name.sensor] = axes.get(name.sensor, "") + name.axis
    return ", ".join(f"{sensor} {some}".strip() for sensor, some in axes.items())


def caveat_lines(report: Report) -> list[str]:
    """Return each caveat in one line, with its channels."""
    lines = {caveat: line_with_size(report, caveat) for caveat in caveats(report)}
    return [f"{joined(names)}: {lines[c]}" if names else lines[c] for c, names in caveats(report).items()]


def follows_temperature(drift: Drift | None) -> bool:
    """Return whether a mean follows the temperature significantly: otherwise its slope is no figure."""
    if drift is None or drift.per_degC is None or drift.per_degC_high is None:
        return False
    return LIMIT_95 * abs(drift.per_degC) > SIGNIFICANT * (drift.per_degC_high - drift.per_degC)


def drifts_with_temperature(drift: Drift | None) -> bool:
    """Return whether time and temperature are not separable: the slope is then that of both together."""
    return drift is not None and drift.reason == "collinear"


NO_BIAS_CURVE: Mapping[str, tuple[str, str]] = {
    "no_temperature": (
        "the record holds no temperature",
        "record the temperature of the sensor beside its samples",
    ),
    "small_range": (
        "the temperature hardly moves, or is missing in most of the record",
        "cool the sensor down, and record while it warms up",
    ),
    "collinear": (
        "it moves like a drift in time, which hides its effect",
        "record until the temperature comes to rest, or let it return",
    ),
    "too_short": ("the record is too short", "record longer"),
    "implausible": (
        "its values are no temperature of a sensor in degC",
        "name the unit of the column, such as temperature (K)",
    ),
    "jumps": (
        "it jumps by half of its range, as that of a thermometer that fails",
        "record with one that works",
    ),
}
"""Why the bias has no curve against the temperature, and what to do, by the reason of the report."""
NO_THERMOMETER = ("implausible", "jumps")
"""Reasons for which the values are no temperature: they have no slope either."""


def no_bias_curve(reason: str) -> tuple[str, str]:
    """Return why there is no curve of the bias, and what to do.

    >>> no_bias_curve("of_tomorrow")
    ('of tomorrow', 'record longer')
    """
    return NO_BIAS_CURVE.get(reason, (reason.replace("_", " "), "record longer"))


def matching(name: str | None, names: Iterable[str]) -> list[str]:
    """Return the devices that a user means: the one of this name, else those that begin with it; None: all.

    >>> matching("a", ["b", "a2", "a"]), matching("a", ["b", "a2", "a1"]), matching(None, ["b", "a"])
    (['a'], ['a1', 'a2'], ['a', 'b'])
    """
    known = sorted(names)
    return [name] if name in known else [device for device in known if device.startswith(name or "")]


GRADE_WORDS = (
    "The grade is the best one whose limits no N and no B exceeds. It is provisional while the 95 % limits allow "
    "another one."
)
"""Meaning of the grades, printed beside them."""
GRADE_MEANING = "the best grade that all limits allow"
"""Meaning of the word for a grade, where there is little room."""


def grade_text(grade: SensorGrade) -> str:
    """Return the grade of a sensor, and whether it may change, the same in every output.

    >>> grade_text(SensorGrade(meets="consumer")), grade_text(SensorGrade())
    ('consumer, provisional', 'no grade')
    >>> grade_text(SensorGrade(meets="below consumer", provisional=False))
    'below consumer'
    """
    if grade.meets is None:
        return "no grade"
    return f"{grade.meets}, provisional" if grade.provisional else grade.meets
