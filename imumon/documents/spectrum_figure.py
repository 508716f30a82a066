"""Root of the power spectral density of a sensor, with the level of N and the spectral lines."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imumon.documents.plotting import COLOURS, axes_for, draw_grid, draw_legend, page_svg
from imumon.documents.report_texts import sensor_axes
from imumon.model.coefficients import COEFFICIENTS
from imumon.model.errors import ImumonError
from imumon.model.report import Report, Spectrum
from imumon.model.samples import ChannelName
from imumon.model.units import pretty

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MARGIN = 1.2
"""Factor between the data and the frame."""
HEIGHT = 0.7
"""Share of the usual height of a figure."""


def spectra(report: Report, sensor: str) -> dict[str, Spectrum]:
    """Return the spectra of a sensor by axis, those that have power."""
    return {
        axis: channel.spectrum
        for axis, channel in sensor_axes(report, sensor)
        if channel.spectrum is not None and any(power > 0.0 for power in channel.spectrum.density)
    }


def spectrum_svg(report: Report, sensor: str) -> str:
    """Return the spectra of a sensor as an SVG element of the HTML page."""
    return page_svg(
        lambda panel: _draw(panel, report, sensor),
        f"spectrum-{sensor}",
        f"Spectrum of the {sensor}",
        height=HEIGHT,
    )


def draw_spectrum(report: Report, sensor: str, ax: Axes | None = None) -> Axes:
    """Draw the spectra of the axes of a sensor and return the axes of the figure.

    Parameters
    ----------
    ax : where to draw; None: a figure of its own.

    Raises
    ------
    ImumonError : there is no spectrum yet.
    """
    if not spectra(report, sensor):
        raise ImumonError("no_curve", f"there is no spectrum of {sensor} yet", "record longer")
    panel = axes_for(ax)
    _draw(panel, report, sensor)
    return panel


def _draw(panel: Axes, report: Report, sensor: str) -> None:
    """Draw the spectra of a sensor into a panel."""
    shown = spectra(report, sensor)
    unit = COEFFICIENTS["N"].units[sensor]
    # the one-sided density of white noise N is 2 N^2: with this factor its level is N
    factor = unit.factor / math.sqrt(2.0)
    roots = [factor * math.sqrt(power) for s in shown.values() for power in s.density if power > 0.0]
    frequencies = [f for s in shown.values() for f in s.frequency_hz if f > 0.0]
    panel.set(xscale="log", yscale="log", xlim=(min(frequencies) / MARGIN, max(frequencies) * MARGIN))
    panel.set(ylim=(min(roots) / MARGIN, max(roots) * MARGIN))
    panel.set(xlabel="frequency, Hz", ylabel=f"√(density / 2), {pretty(unit.unit)}")
    draw_grid(panel)
    for axis, spectrum in shown.items():
        known = [
            (f, factor * math.sqrt(p))
            for f, p in zip(spectrum.frequency_hz, spectrum.density, strict=True)
            if f > 0.0 < p
        ]
        panel.plot(*zip(*known, strict=True), color=COLOURS[axis], linewidth=1.0, label=axis)
        n = report.channels[ChannelName(f"{sensor}/{axis}")].estimates.get("N")
        if n is not None and n.value:
            panel.axhline(n.value * unit.factor, color=COLOURS[axis], linewidth=0.8, linestyle=(0, (3, 2)))
        for line in spectrum.lines:
            panel.axvline(line.frequency_hz, color=COLOURS[axis], linewidth=0.6, linestyle=(0, (1, 2)))
    draw_legend(panel)
