"""Bias against the temperature in the datasheet: the slope, and its line with the 95 % band as a figure of the page.

The figure has the difference from the bias at the reference.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING

from imumon.documents.elements import DataTable, Element, Figure, Paragraph
from imumon.documents.plotting import COLOURS, MARKERS, axes_for, draw_legend, page_svg
from imumon.documents.report_texts import SENSOR_TITLES, sensor_axes
from imumon.model.coefficients import unit_of
from imumon.model.errors import ImumonError
from imumon.model.messages import no_bias_curve
from imumon.model.report import BiasCurve, Report
from imumon.model.units import figures, pretty

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def temperature_elements(report: Report) -> Iterator[Element]:
    """Yield the curves of all sensors, or why there are none; nothing without a temperature."""
    known = {sensor: dict(_curves(report, sensor)) for sensor in SENSOR_TITLES}
    for sensor, curves in known.items():
        yield from _sensor_elements(sensor, curves)
    if any(curve.is_known for curves in known.values() for curve in curves.values()):
        yield Paragraph(
            "A straight line, with 95 % limits: those of the bias are for another record as long. It "
            "holds within the span of the record only. The residual noise is that of means over blocks. The bias of "
            "an accelerometer holds gravity."
        )


def _sensor_elements(sensor: str, curves: Mapping[str, BiasCurve]) -> Iterator[Element]:
    """Yield the curves of a sensor as a table and a figure, or why there are none."""
    title = SENSOR_TITLES[sensor]
    shown = {axis: curve for axis, curve in curves.items() if curve.is_known}
    reasons = dict.fromkeys(curve.reason for curve in curves.values() if curve.reason)
    for reason in reasons.keys() - {"no_temperature", None}:
        text, cure = no_bias_curve(reason)
        yield Paragraph(f"{title}: no curve, because {text}. What helps: {cure}.")
    if not shown:
        return
    unit, some = unit_of(sensor, "B"), next(iter(shown.values()))
    name, reference = pretty(unit.unit), f"{some.reference_degC or 0.0:.1f} °C"
    head = (
        title,
        f"bias at {reference}, {name}",
        f"slope, {name}/°C",
        "residual noise, without → with",
    )
    yield DataTable(head, tuple((axis, *_cells(curve, unit.factor)) for axis, curve in shown.items()))
    text = f"{title}, bias less that at {reference}, in {name}; {some.degC[0]:.1f} to {some.degC[-1]:.1f} °C."
    legend = "Band: 95 %, for another record as long."
    yield Figure(text, None, partial(temperature_svg, sensor, shown), legend)


def temperature_svg(sensor: str, shown: Mapping[str, BiasCurve]) -> str:
    """Return the curves of a sensor as an SVG element of the HTML page."""
    label = f"Bias of the {SENSOR_TITLES[sensor].lower()} against the temperature"
    return page_svg(lambda panel: _draw(panel, sensor, shown), f"temperature-{sensor}", label, height=0.7)


def draw_bias(report: Report, sensor: str, ax: Axes | None = None) -> Axes:
    """Draw the curves of a sensor and return the axes of the figure.

    Parameters
    ----------
    ax : where to draw; None: a figure of its own.

    Raises
    ------
    ImumonError : the record shows no curve.
    """
    curves = dict(_curves(report, sensor))
    shown = {axis: curve for axis, curve in curves.items() if curve.is_known}
    if not shown:
        reasons = [curve.reason for curve in curves.values() if curve.reason]
        text, cure = no_bias_curve(reasons[0] if reasons else "no_temperature")
        raise ImumonError("no_bias_curve", f"the bias has no curve against the temperature: {text}", cure)
    panel = axes_for(ax)
    _draw(panel, sensor, shown)
    return panel


def _draw(panel: Axes, sensor: str, shown: Mapping[str, BiasCurve]) -> None:
    """Draw the rise of the bias of each axis from that at the reference, with its band."""
    unit = unit_of(sensor, "B")
    for axis, curve in shown.items():
        low, middle, high = (
            _rise(curve, values, unit.factor) for values in (curve.low, curve.bias, curve.high)
        )
        panel.fill_between(curve.degC, low, high, color=COLOURS[axis], alpha=0.18, linewidth=0.0)
        panel.plot(curve.degC, middle, color=COLOURS[axis], marker=MARKERS[axis], markersize=3.5, label=axis)
    panel.set(xlabel="temperature, °C", ylabel=f"bias, {pretty(unit.unit)}")
    draw_legend(panel)


def with_error(value: float, half: float) -> str:
    """Return a value with the half-width of its limits, of which two digits count.

    >>> with_error(12.3456, 0.123), with_error(-1000012.3, 250.0), with_error(2e-6, 3e-7), with_error(1.0, 0.0)
    ('12.35 ±0.12', '-1,000,012 ±250', '2.0e-06 ±3e-07', '1.00')
    """
    if not half > 0.0:
        return figures(value)
    decimals = 1 - math.floor(math.log10(half))
    if decimals > 5:
        return f"{figures(value, 2)} ±{figures(half, 1)}"
    return f"{value:,.{max(decimals, 0)}f} ±{half:,.{max(decimals, 0)}f}"


def _curves(report: Report, sensor: str) -> Iterator[tuple[str, BiasCurve]]:
    return (
        (axis, channel.bias_curve)
        for axis, channel in sensor_axes(report, sensor)
        if channel.bias_curve is not None
    )


def _cells(curve: BiasCurve, factor: float) -> Iterator[str]:
    for term in curve.terms:
        yield with_error(term.value * factor, 0.5 * (term.high - term.low) * factor)
    noise = (curve.std_without, curve.std_with)
    yield " → ".join("–" if std is None else figures(std * factor, 2) for std in noise)


def _rise(curve: BiasCurve, values: tuple[float, ...], factor: float) -> list[float]:
    return [(value - curve.bias[len(curve.bias) // 2]) * factor for value in values]
