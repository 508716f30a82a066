"""Picture: Allan curves of all sensors as PNG, by matplotlib, an optional part of the installation."""

from __future__ import annotations

import io
from typing import Any

from imumon.datasheet.config_snippets import who
from imumon.datasheet.content import SENSORS
from imumon.datasheet.svg_figure import curves, extent
from imumon.report import Report
from imumon.units import READABLE, duration, pretty

COLOURS = {"x": "#0b66b0", "y": "#c4500a", "z": "#0a8a62"}
MARKS = {"x": "o", "y": "s", "z": "^"}


def picture(made: Report) -> bytes:
    """PNG, one panel a sensor.

    Raises
    ------
    CannotDraw : matplotlib is not installed, or there is no curve yet.
    """
    from imumon.datasheet import CannotDraw

    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise CannotDraw("a PNG needs matplotlib: pip install matplotlib (HTML needs nothing)") from None
    found = {sensor: curves(made, sensor) for sensor in SENSORS}
    found = {sensor: axes for sensor, axes in found.items() if axes}
    if not found:
        raise CannotDraw("there is no curve to draw yet: the record is too short")
    figure = Figure(figsize=(5.6 * len(found), 4.8), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    device = made.device
    rate = f" at {device.sample_rate_hz:g} Hz" if device.sample_rate_hz else ""
    figure.suptitle(
        f"{who(made)}: {duration(made.session.elapsed_s)} of {device.stream or 'samples'}{rate}", fontsize=11
    )
    panels = figure.subplots(1, len(found), squeeze=False)[0]
    for panel, (sensor, axes) in zip(panels, found.items(), strict=True):
        _panel(panel, sensor, axes)
    out = io.BytesIO()
    figure.savefig(out, format="png")
    return out.getvalue()


def _panel(panel: Any, sensor: str, axes: Any) -> None:
    for axis, curve in axes.items():
        colour, mark = COLOURS[axis], MARKS[axis]
        model = [(t, m) for t, m in zip(curve.tau_s, curve.model, strict=True) if m is not None and m > 0.0]
        if model:
            panel.plot(*zip(*model, strict=True), color=colour, linewidth=1.0, alpha=0.8)
        for used, fill in ((True, colour), (False, "white")):
            points = [
                (t, s, s - (low if low is not None else s), (high if high is not None else s) - s)
                for t, s, low, high, u in zip(
                    curve.tau_s, curve.sigma, curve.low, curve.high, curve.used, strict=True
                )
                if u is used and s > 0.0
            ]
            if points:
                tau, sigma, below, above = zip(*points, strict=True)
                panel.errorbar(
                    tau,
                    sigma,
                    yerr=([max(v, 0.0) for v in below], [max(v, 0.0) for v in above]),
                    fmt=mark,
                    markersize=4,
                    color=colour,
                    markerfacecolor=fill,
                    elinewidth=0.9,
                    label=axis if used else None,
                )
    x0, x1, y0, y1 = extent(axes)
    panel.set(
        xscale="log",
        yscale="log",
        xlim=(10**x0, 10**x1),
        ylim=(10**y0, 10**y1),
        xlabel="τ, s",
        ylabel=f"σ(τ), {pretty(READABLE[sensor, 'B'].unit)}",
    )
    panel.set_title(SENSORS[sensor], loc="left")
    panel.grid(which="major", color="#cccccc", linewidth=0.6)
    panel.grid(which="minor", color="#e8e8e8", linewidth=0.4)
    panel.set_axisbelow(True)
    panel.legend(frameon=False, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)
