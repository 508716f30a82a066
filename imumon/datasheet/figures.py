"""Figures of the Allan deviation, by matplotlib: SVG for the HTML page, PNG for everything else.

One function draws a sensor into a panel: measured points with 95 % bands, fitted model, octaves that the fit
does not use, and the limits of the grades. Axes also differ in the shape of their marks, for readers who
cannot distinguish the colours. matplotlib is imported where it is needed: it costs other commands 50 MB.
"""

from __future__ import annotations

import io
import math
import os
import re
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from imumon.datasheet.tables import SENSOR_TITLES, readable_curves, record_title, sensor_title
from imumon.errors import ImumonError
from imumon.report import Allan, LimitCurve, Report
from imumon.units import READABLE, pretty

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARKERS = {"x": "o", "y": "s", "z": "^"}
PRINT = {
    "x": "#0b66b0", "y": "#c4500a", "z": "#0a8a62",
    "text": "#1b1f24", "muted": "#5b6470", "rule": "#d5dae0", "ground": "#ffffff",
}  # fmt: skip
"""Colours on white, by axis and role."""
PAGE = {role: f"#10{k:02d}fe" for k, role in enumerate(PRINT)}
"""Colours that `svg` replaces by the CSS variables of the page, which follow its light or dark scheme."""

DPI = 150
PANEL_INCHES = (5.6, 4.8)
PAGE_INCHES = (8.4, 4.6)
MARGIN_DECADES = 0.06  # decades between the data and the frame
WIDEST_LIMIT = 2.0  # factor beyond the points that the frame shows of their limits, which may span decades
FEW_DECADES = 2.0  # decades up to which 2 and 5 are labelled too
_SVG_REPLACEMENTS = (
    (r"<metadata>.*?</metadata>|<!--.*?-->|<style.*?</style>", ""),
    (r' id="(?:figure|axes|patch|text|line2d|legend|[xy]tick|\w+Collection|matplotlib\.axis)_\d+"', ""),
    (r" font-family: [^;\"]*;?", ""),
    (r"(\.\d\d)\d+", r"\1"),
    ("xlink:href", "href"),
    (r"\s*\n\s*", "\n"),
)
"""Parts of an SVG by matplotlib that a page does not need, as patterns with their replacements."""


class NoCurve(ImumonError):
    """The report has no Allan deviation yet."""


def png(report: Report) -> bytes:
    """Return the curves of all sensors as PNG, one panel per sensor.

    Raises
    ------
    NoCurve : the record is too short.
    """
    _load_fonts()
    from matplotlib.figure import Figure

    sensors = [sensor for sensor in SENSOR_TITLES if _drawable(readable_curves(report, sensor))]
    if not sensors:
        raise NoCurve("no_curve", "there is no curve to draw yet", "record longer")
    width, height = PANEL_INCHES
    figure = Figure(figsize=(width * len(sensors), height), dpi=DPI, layout="constrained")
    figure.suptitle(f"{sensor_title(report)}: {record_title(report)}", fontsize=11)
    for panel, sensor in zip(figure.subplots(1, len(sensors), squeeze=False)[0], sensors, strict=True):
        _draw(panel, report, sensor, PRINT)
        panel.set_title(SENSOR_TITLES[sensor], loc="left")
    return _saved(figure, "png")


def svg(report: Report, sensor: str) -> str:
    """Return the curves of a sensor as an SVG element of the HTML page; empty if there are none."""
    if not _drawable(readable_curves(report, sensor)):
        return ""
    label = f"Allan deviation of the {SENSOR_TITLES[sensor].lower()}"
    return page_svg(lambda panel: _draw(panel, report, sensor, PAGE), sensor, label, PAGE_INCHES)


def page_svg(draw: Callable[[Axes], None], salt: str, label: str, inches: tuple[float, float]) -> str:
    """Return what `draw` draws into a panel as an SVG element of the HTML page.

    Parameters
    ----------
    salt : makes the ids in the element differ from those of other elements.
    """
    _load_fonts()
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    # text stays text, in the font of the page; ids do not depend on the run
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": salt, "font.family": "sans-serif"}):
        figure = Figure(figsize=inches, layout="constrained")
        draw(figure.subplots())
        drawn = _saved(figure, "svg").decode()
    body = drawn[drawn.index("<svg ") : drawn.rindex("</svg>")].partition(">")[2]
    for pattern, replacement in _SVG_REPLACEMENTS:
        body = re.sub(pattern, replacement, body, flags=re.DOTALL)
    for role, colour in PAGE.items():
        body = body.replace(colour, f"var(--{role})")
    width, height = (72.0 * side for side in inches)
    view = f'viewBox="0 0 {width:g} {height:g}"'
    return f'<svg class="allan" role="img" aria-label="{label}" {view}>{body}</svg>'


def _load_fonts() -> None:
    """Import matplotlib's fonts without leaving its list of fonts in the user's home directory."""
    if "MPLCONFIGDIR" in os.environ or "matplotlib.font_manager" in sys.modules:
        return
    with tempfile.TemporaryDirectory(prefix="imumon-") as directory:
        os.environ["MPLCONFIGDIR"] = directory
        try:
            import matplotlib.font_manager  # noqa: F401
        finally:
            del os.environ["MPLCONFIGDIR"]


def _saved(figure: Figure, form: str) -> bytes:
    out = io.BytesIO()
    metadata = {"Date": None} if form == "svg" else None
    figure.savefig(out, format=form, transparent=form == "svg", metadata=metadata)
    return out.getvalue()


def _drawable(curves: Mapping[str, Allan]) -> bool:
    return any(sigma > 0.0 for curve in curves.values() for sigma in curve.sigma)


def _draw(panel: Axes, report: Report, sensor: str, colours: Mapping[str, str]) -> None:
    curves = readable_curves(report, sensor)
    scale = READABLE[sensor, "B"]
    x, y = _extent(curves)
    panel.set(xscale="log", yscale="log", xlim=x, ylim=y)
    panel.set_xlabel("averaging time τ, s", color=colours["text"])
    panel.set_ylabel(f"Allan deviation σ(τ), {pretty(scale.unit)}", color=colours["text"])
    _draw_grid(panel, x, y, colours)
    for grade, limit in report.limit_curves.get(sensor, {}).items():
        _draw_limit(panel, grade, limit, scale.factor, colours)
    for axis, curve in curves.items():
        _draw_curve(panel, axis, curve, colours)
    _draw_legend(panel, curves, colours)


def _extent(curves: Mapping[str, Allan]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the ends of both axes."""
    taus = [tau for curve in curves.values() for tau in curve.tau_s]
    sigmas = [sigma for curve in curves.values() for sigma in curve.sigma if sigma > 0.0]
    limits = [v for c in curves.values() for v in (*c.low, *c.high) if v is not None and v > 0.0]
    low = max(min([*sigmas, *limits]), min(sigmas) / WIDEST_LIMIT)
    high = min(max([*sigmas, *limits]), max(sigmas) * WIDEST_LIMIT)
    margin = 10.0**MARGIN_DECADES
    return (min(taus) / margin, max(taus) * margin), (low / margin, high * margin)


def _draw_grid(
    panel: Axes, x: tuple[float, float], y: tuple[float, float], colours: Mapping[str, str]
) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    for axis, (low, high) in ((panel.xaxis, x), (panel.yaxis, y)):
        few = math.log10(high / low) < FEW_DECADES
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,), numticks=30))
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.set_minor_locator(LogLocator(subs=range(2, 10), numticks=30))
        axis.set_minor_formatter(NullFormatter())
    panel.grid(which="major", color=colours["rule"], linewidth=0.9)
    panel.grid(which="minor", color=colours["rule"], linewidth=0.4, alpha=0.6)
    panel.set_axisbelow(True)
    panel.tick_params(which="both", color=colours["muted"], labelcolor=colours["text"], labelsize=9)
    for spine in panel.spines.values():
        spine.set_color(colours["muted"])


def _draw_limit(
    panel: Axes, grade: str, limit: LimitCurve, factor: float, colours: Mapping[str, str]
) -> None:
    """Draw the curve at the limits of a grade, with its name at the right end inside the frame."""
    import numpy as np

    (left, right), (bottom, top) = panel.get_xlim(), panel.get_ylim()
    tau = np.geomspace(left, right, 200)
    sigma = factor * np.exp(np.interp(np.log(tau), np.log(limit.tau_s), np.log(limit.sigma)))
    panel.plot(tau, sigma, color=colours["muted"], linewidth=1.0, linestyle=(0, (1, 2)), label="_")
    inside = np.flatnonzero((sigma > bottom) & (sigma < top))
    if len(inside):
        end = inside[-1]
        left_aligned = end < len(tau) / 4
        panel.annotate(
            grade, (tau[inside[0] if left_aligned else end], sigma[end]), (6 if left_aligned else -3, 3),
            textcoords="offset points", ha="left" if left_aligned else "right", va="bottom", fontsize=8,
            color=colours["muted"],
        )  # fmt: skip


def _draw_curve(panel: Axes, axis: str, curve: Allan, colours: Mapping[str, str]) -> None:
    """Draw one axis: band, model, and points, hollow where the fit does not use them."""
    import numpy as np

    colour, marker, used = colours[axis], MARKERS[axis], np.array(curve.used)
    low, high, model, sigma = (
        np.array([v if v is not None and v > 0.0 else math.nan for v in values])  # matplotlib omits NaN
        for values in (curve.low, curve.high, curve.model, curve.sigma)
    )
    panel.fill_between(curve.tau_s, low, high, color=colour, alpha=0.16, linewidth=0.0)
    panel.plot(curve.tau_s, model, color=colour, linewidth=1.2, label="_")
    for shown, face in ((used, colour), (~used, "none")):
        if shown.any():
            panel.plot(
                curve.tau_s, np.where(shown, sigma, math.nan), linestyle="none", marker=marker,
                markersize=4.5, color=colour, markerfacecolor=face, markeredgewidth=1.0, label="_",
            )  # fmt: skip


def _draw_legend(panel: Axes, axes: Sequence[str] | Mapping[str, Allan], colours: Mapping[str, str]) -> None:
    """Name the axes above the frame, and explain band, line and hollow marks."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    muted = colours["muted"]
    hollow: dict[str, Any] = {
        "marker": "o",
        "markersize": 4.5,
        "markerfacecolor": "none",
        "linestyle": "none",
    }
    entries = [
        *(Line2D([], [], color=colours[a], marker=MARKERS[a], markersize=4.5, label=a) for a in axes),
        Patch(color=muted, alpha=0.25, linewidth=0.0, label="95 %"),
        Line2D([], [], color=muted, linewidth=1.2, label="model"),
        Line2D([], [], color=muted, label="not used", **hollow),
    ]
    panel.legend(
        handles=entries, frameon=False, ncols=len(entries), loc="lower right", bbox_to_anchor=(1.0, 1.0),
        borderaxespad=0.1, fontsize=8, handlelength=1.4, columnspacing=1.1, handletextpad=0.4,
        labelcolor=colours["text"],
    )  # fmt: skip
