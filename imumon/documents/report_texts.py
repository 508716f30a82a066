"""Texts and numbers of a report that several forms of a document share."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from imumon.model.coefficients import COEFFICIENTS, NOISE, Estimate
from imumon.model.messages import (
    exclusions,
    filter_not_known,
    no_value_text,
)
from imumon.model.report import Allan, Channel, DeviceDescription, Report
from imumon.model.samples import ALIASED, AXES, INERTIAL, ChannelName
from imumon.model.units import counted, duration, figures, measured
from imumon.sources import registry

SENSOR_TITLES = {"gyro": "Gyroscope", "accel": "Accelerometer", "mag": "Magnetometer"}


def sensor_title(report: Report) -> str:
    """Return the sensor by model and serial number, else by the name of its device or of its recording."""
    device = report.device
    if title := " ".join(part for part in (device.model, device.serial) if part):
        return title
    if device.id == "replay":  # arrays and combinations of records have no name
        return device.port.rpartition("/")[2] if device.port else "record"
    return device.id


def record_title(report: Report) -> str:
    """Return the length, stream and rate of the record."""
    device = report.device
    rate = f" at {device.sample_rate_hz:g} Hz" if device.sample_rate_hz else ""
    return f"{duration(report.session.elapsed_s)} of {stream_noun(device)}{rate}"


def record_line(report: Report) -> str:
    """Return sensor, record and date in one line."""
    return f"{sensor_title(report)}: {record_title(report)}, {date_text(report)}"


def date_text(report: Report) -> str:
    """Return when the record began, or when the report was made."""
    started = report.session.started
    return f"from {started}" if started else f"date of the record unknown, report of {report.time}"


def stream_noun(device: DeviceDescription) -> str:
    """Return what the samples are, in words."""
    if device.stream in (None, "unknown"):
        return "samples"
    return "deltas" if device.stream == "deltas" else f"{device.stream} samples"


def sensor_axes(report: Report, sensor: str) -> Iterator[tuple[str, Channel]]:
    """Yield the axes of a sensor that the report has."""
    for axis in AXES:
        if (channel := report.channels.get(ChannelName(f"{sensor}/{axis}"))) is not None:
            yield axis, channel


def readable_curves(report: Report, sensor: str) -> dict[str, Allan]:
    """Return the Allan deviations of a sensor by axis, in readable units, those that have points."""
    factor = COEFFICIENTS["B"].units[sensor].factor

    def scaled(values: Sequence[float | None]) -> tuple[float | None, ...]:
        return tuple(None if v is None else v * factor for v in values)

    curves = {}
    for axis, channel in sensor_axes(report, sensor):
        if (allan := channel.allan) is not None and allan.tau_s:
            sigma = tuple(s * factor for s in allan.sigma)
            low, high, model, noise = map(scaled, (allan.low, allan.high, allan.model, allan.noise))
            curves[axis] = replace(allan, sigma=sigma, low=low, high=high, model=model, noise=noise)
    return curves


def shown_letters(channels: Iterable[Channel]) -> tuple[str, ...]:
    """Return the coefficients to show of channels: those that each has, and others where one has them."""
    known = {letter for channel in channels for letter in channel.estimates}
    return tuple(letter for letter in COEFFICIENTS if letter in NOISE or letter in known)


def coefficient_text(coefficient: Estimate | None, *, short: bool = False) -> str:
    """Return a coefficient with the limits that documents state, in readable units: ``0.358 (0.353 to 0.364)``.

    Parameters
    ----------
    short : with the half-width of its limits or their factor instead: ``0.358 ±1.5 %``, ``3.5 ×÷2.1``.
    """
    if coefficient is None:
        return ""
    pending = no_value_text(coefficient) or "too short"
    value = measured if short else with_limits
    return coefficient.stated.readable.text(value, lambda high: f"< {figures(high)}", pending)


def without_aliasing(report: Report, name: ChannelName, part: Estimate | None) -> Estimate | None:
    """Return N of a channel over the nominal alias factor of the sensor; None: none is known, or it is 1."""
    factor = report.device.alias_factor or 1.0
    if part is None or factor <= ALIASED or name.sensor not in INERTIAL:
        return None
    return part.scaled(1.0 / factor, part.unit)


def with_limits(value: float, low: float | None, high: float | None) -> str:
    """Return a value with its limits, with as many digits, three or four, as show their width.

    >>> with_limits(0.21, 0.20, 0.22), with_limits(0.21, 0.2098, 0.2102), with_limits(0.21, None, None)
    ('0.210 (0.200 to 0.220)', '0.2100 (0.2098 to 0.2102)', '0.210')
    """
    if low is None or high is None:
        return figures(value)
    digits = 4 if high - low < 0.01 * value else 3
    return f"{figures(value, digits)} ({figures(low, digits)} to {figures(high, digits)})"


def counters_text(report: Report) -> str:
    """Return how many samples arrived, and how many did not."""
    session = report.session
    return (
        f"{counted(session.samples, 'sample')}, {session.missing:,} missing in {counted(session.gaps, 'gap')}, "
        f"{counted(session.bad_checksums, invalid_noun(report.device))}"
    )


def excluded_sentence(report: Report) -> str:
    """Return what was excluded from the record, in one sentence."""
    excluded = [f"{text} as disturbed" for text in exclusions(report, _length)]
    if warmup_s := report.session.warmup_s:
        excluded.append(f"a warm-up of {_length(warmup_s)}")
    return f"Excluded: {'; '.join(excluded)}." if excluded else "Nothing is excluded."


def _length(seconds: float) -> str:
    return duration(seconds) if seconds >= 60.0 else f"{seconds:.1f} s"


def invalid_noun(device: DeviceDescription) -> str:
    """Return what `bad_checksums` counts: messages that failed their check, or rows of a table."""
    return "bad checksum" if device.driver else "invalid row"


FILTER_CURE = "For a recording, --filter names it."


def filter_warning(report: Report) -> str | None:
    """Return a warning about samples of a sensor whose filter is unknown; None if there is nothing to warn of."""
    warning = filter_not_known(report)
    return warning and " ".join(filter(None, (warning, driver_advice(report, "unknown"), FILTER_CURE)))


def driver_advice(report: Report, about: str) -> str:
    """Return what the driver of the sensor says about its filter; empty if the driver is unknown."""
    device = report.device
    driver = registry.installed(device.driver)
    return driver.filter_advice(device.sample_rate_hz).get(about, "") if driver is not None else ""
