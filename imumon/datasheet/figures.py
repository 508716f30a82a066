"""Figures of the Allan deviation, by matplotlib: an element of the HTML page, or a file (SVG, PDF, PNG).

One function draws a sensor into a panel: measured points with 95 % bands, fitted model, its noise alone, octaves
that the fit does not use, N, B and K with their limits, and the limits of the grades. Axes also differ in the shape of
their marks, for readers who cannot distinguish the colours. A file also has the values as text and a caption.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from imumon.datasheet.plotting import (
    MARKERS,
    PAGE,
    PAGE_INCHES,
    PRINT,
    draw_grid,
    load_fonts,
    page_svg,
    saved,
)
from imumon.datasheet.tables import (
    SENSOR_TITLES,
    coefficient_text,
    readable_curves,
    record_line,
    sensor_axes,
    sensor_title,
    shown_letters,
)
from imumon.errors import ImumonError
from imumon.report import COEFFICIENTS, NOISE, Allan, LimitCurve, Report
from imumon.units import pretty

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PANEL_INCHES = (7.4, 4.1)
TEXT_INCHES = 0.55
"""Height of the values below a panel of a file: a page of A4 holds three sensors."""
CAPTION_CHARACTERS = 128
"""Characters in a line of the caption of a file."""
MARGIN_DECADES = 0.06  # decades between the data and the frame
WIDEST_LIMIT = 2.0  # factor beyond the points that the frame shows of their limits, which may span decades
NAME_SHARE = (
    0.013,
    0.06,
)  # of the frame: width of a letter of a grade's name, height of its line
LETTER_ROOM = 1.3  # factor below a floor for its letter
VISIBLE = 0.03  # share by which the model differs from the noise where both are drawn


class NoCurve(ImumonError):
    """The report has no Allan deviation yet."""


def figure_file(report: Report, form: str) -> bytes:
    """Return the curves of all sensors as a file: ``png``, ``svg`` or ``pdf``, one panel per sensor.

    Raises
    ------
    NoCurve : the record is too short.
    """
    load_fonts()
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    sensors = [sensor for sensor in SENSOR_TITLES if _drawable(readable_curves(report, sensor))]
    if not sensors:
        raise NoCurve("no_curve", "there is no curve to draw yet", "record longer")
    width, height = PANEL_INCHES
    inches = (width, (height + TEXT_INCHES) * len(sensors) + 1.0)
    # text stays text in SVG and PDF; ids do not depend on the run
    with rc_context({"svg.fonttype": "none", "pdf.fonttype": 42, "svg.hashsalt": "imumon"}):
        figure = Figure(figsize=inches, dpi=150, layout="constrained")
        figure.suptitle(sensor_title(report), x=0.01, ha="left", fontsize=12, fontweight="bold")
        rows = figure.subplots(
            2 * len(sensors), 1, gridspec_kw={"height_ratios": [height, TEXT_INCHES] * len(sensors)}
        )
        for panel, values, sensor in zip(rows[0::2], rows[1::2], sensors, strict=True):
            _draw(panel, report, sensor, PRINT)
            panel.set_title(SENSOR_TITLES[sensor], loc="left", fontsize=10)
            _write_values(values, report, sensor)
        caption = textwrap.fill(f"{record_line(report)}. {legend_text(report, sensors)}.", CAPTION_CHARACTERS)
        figure.supxlabel(caption, x=0.01, ha="left", fontsize=7.5, color=PRINT["muted"])
        return saved(figure, form, sensor_title(report))


def _write_values(values: Axes, report: Report, sensor: str) -> None:
    """Write the coefficients of the axes with their limits below a panel."""
    values.set_axis_off()
    letters = shown_letters(channel for _, channel in sensor_axes(report, sensor))
    places = [0.0, 0.025, 0.365, 0.665]
    if len(letters) > len(NOISE):
        places = [0.0, *(0.025 + 0.975 * k / len(letters) for k in range(len(letters)))]
    for k, (axis, channel) in enumerate(sensor_axes(report, sensor)):
        columns = [axis]
        for letter in letters:
            part = channel.coefficients.get(letter)
            unit = f" {pretty(part.readable.unit)}" if part and part.status != "pending" else ""
            columns.append(f"{letter} {coefficient_text(part)}{unit}" if part or letter in NOISE else "")
        for at, text in zip(places, columns, strict=True):
            colour = PRINT.get(axis, PRINT["text"])
            values.text(
                at, 1.0 - 0.36 * k, text, fontsize=7.2, va="top", color=colour, transform=values.transAxes
            )


def legend_text(report: Report, sensors: Sequence[str]) -> str:
    """Return what the marks of a figure mean."""
    limits = "; dotted: the limits of the grades" if any(s in report.limit_curves for s in sensors) else ""
    exact = report.evaluation is not None and report.evaluation.exact
    dots = "; dots: fully overlapping, exact" if exact else ""
    return (
        "Overlapping Allan deviation with 95 % limits (bands) and fitted model (lines; thin: N, B and K alone, "
        "where it has more); hollow: octaves that the fit does not use; bars: N/√τ, 0.664 B and K√(τ/3) with "
        "95 % limits; arrows: 95 % upper bounds"
        f"{dots}{limits}"
    )


def svg(report: Report, sensor: str) -> str:
    """Return the curves of a sensor as an SVG element of the HTML page; empty if there are none."""
    if not _drawable(readable_curves(report, sensor)):
        return ""
    label = f"Allan deviation of the {SENSOR_TITLES[sensor].lower()}"
    return page_svg(lambda panel: _draw(panel, report, sensor, PAGE), sensor, label, PAGE_INCHES)


def _drawable(curves: Mapping[str, Allan]) -> bool:
    return any(sigma > 0.0 for curve in curves.values() for sigma in curve.sigma)


def _draw(panel: Axes, report: Report, sensor: str, colours: Mapping[str, str]) -> None:
    curves = readable_curves(report, sensor)
    scale = COEFFICIENTS["B"].units[sensor]
    marks = list(_marks(report, sensor, curves))
    x, y = _extent(curves, [mark.value for mark in marks if mark.letter == "B" and mark.value])
    panel.set(xscale="log", yscale="log", xlim=x, ylim=y)
    panel.set_xlabel("averaging time τ, s", color=colours["text"])
    panel.set_ylabel(f"Allan deviation σ(τ), {pretty(scale.unit)}", color=colours["text"])
    draw_grid(panel, x, y, colours)
    taken = [(m.tau_s, max(m.low, y[0]), m.high) for m in marks]
    taken += [(t, s, s) for c in curves.values() for t, s in zip(c.tau_s, c.sigma, strict=True) if s > 0.0]
    for grade, limit in report.limit_curves.get(sensor, {}).items():
        _draw_limit(panel, grade, limit, scale.factor, colours, taken)
    for axis, curve in curves.items():
        _draw_curve(panel, axis, curve, colours)
    exact = _draw_exact(panel, report, sensor, curves, colours)
    _draw_marks(panel, marks, colours)
    _draw_legend(panel, list(curves), colours, exact=exact)


def _extent(
    curves: Mapping[str, Allan], floors: Sequence[float]
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the ends of both axes; `floors` are shown with room for their letter."""
    taus = [tau for curve in curves.values() for tau in curve.tau_s]
    sigmas = [sigma for curve in curves.values() for sigma in curve.sigma if sigma > 0.0]
    limits = [v for c in curves.values() for v in (*c.low, *c.high) if v is not None and v > 0.0]
    low = max(min([*sigmas, *limits]), min(sigmas) / WIDEST_LIMIT)
    high = min(max([*sigmas, *limits]), max(sigmas) * WIDEST_LIMIT)
    low = min([low, *(max(floor / LETTER_ROOM, low / WIDEST_LIMIT) for floor in floors)])
    margin = 10.0**MARGIN_DECADES
    return (min(taus) / margin, max(taus) * margin), (low / margin, high * margin)


def _draw_limit(
    panel: Axes,
    grade: str,
    limit: LimitCurve,
    factor: float,
    colours: Mapping[str, str],
    taken: Sequence[tuple[float, float, float]],
) -> None:
    """Draw the curve at the limits of a grade, with its name as far right inside the frame as nothing covers it.

    Parameters
    ----------
    taken : averaging time, lower and upper end of what is drawn there.
    """
    import numpy as np

    (left, right), (bottom, top) = panel.get_xlim(), panel.get_ylim()
    tau = np.geomspace(left, right, 200)
    sigma = factor * np.exp(np.interp(np.log(tau), np.log(limit.tau_s), np.log(limit.sigma)))
    panel.plot(tau, sigma, color=colours["muted"], linewidth=1.0, linestyle=(0, (1, 2)), label="_")
    inside = np.flatnonzero((sigma > bottom) & (sigma < top))
    if len(inside):
        end = inside[-1]
        left_aligned = end < len(tau) / 4
        if not left_aligned:
            shares = [i for i in inside[::-4] if i >= len(tau) / 2] or [end]
            end = min(shares, key=lambda i: _covered(panel, grade, (float(tau[i]), float(sigma[i])), taken))
        panel.annotate(
            grade, (tau[inside[0] if left_aligned else end], sigma[end]), (6 if left_aligned else -3, 3),
            textcoords="offset points", ha="left" if left_aligned else "right", va="bottom", fontsize=8,
            color=colours["muted"],
        )  # fmt: skip


def _covered(
    panel: Axes, name: str, place: tuple[float, float], taken: Sequence[tuple[float, float, float]]
) -> int:
    """Return how much lies under a name that ends at `place` and is written above it."""

    def share(value: float, ends: tuple[float, float]) -> float:
        return math.log(value / ends[0]) / math.log(ends[1] / ends[0])

    x, y = panel.get_xlim(), panel.get_ylim()
    right, bottom = share(place[0], x), share(place[1], y)
    left, top = right - NAME_SHARE[0] * (len(name) + 1), bottom + NAME_SHARE[1]
    return sum(
        left < share(tau, x) < right + NAME_SHARE[0]
        and share(low, y) < top
        and share(high, y) > bottom - NAME_SHARE[1]
        for tau, low, high in taken
    )


def _draw_curve(panel: Axes, axis: str, curve: Allan, colours: Mapping[str, str]) -> None:
    """Draw one axis: band, model, noise where it differs, and points, hollow where the fit does not use them."""
    import numpy as np

    colour, marker, used = colours[axis], MARKERS[axis], np.array(curve.used)
    low, high, model, noise, sigma = (
        np.array([v if v is not None and v > 0.0 else math.nan for v in values])  # matplotlib omits NaN
        for values in (curve.low, curve.high, curve.model, curve.noise, curve.sigma)
    )
    panel.fill_between(curve.tau_s, low, high, color=colour, alpha=0.16, linewidth=0.0)
    panel.plot(curve.tau_s, model, color=colour, linewidth=1.2, label="_")
    if (np.abs(model / noise - 1.0) > VISIBLE).any():
        panel.plot(curve.tau_s, noise, color=colour, linewidth=0.6, label="_")
    for shown, face in ((used, colour), (~used, "none")):
        if shown.any():
            panel.plot(
                curve.tau_s, np.where(shown, sigma, math.nan), linestyle="none", marker=marker,
                markersize=4.5, color=colour, markerfacecolor=face, markeredgewidth=1.0, label="_",
            )  # fmt: skip


def _draw_exact(
    panel: Axes, report: Report, sensor: str, curves: Mapping[str, Allan], colours: Mapping[str, str]
) -> bool:
    """Draw the exact curves as dots on a thin line; return whether there are some."""
    exact = report.evaluation.exact if report.evaluation is not None else {}
    for axis in curves:
        if (curve := exact.get(f"{sensor}/{axis}")) is not None:
            sigma = [COEFFICIENTS["B"].units[sensor].factor * value or math.nan for value in curve.sigma]
            panel.plot(
                curve.tau_s, sigma, color=colours[axis], linewidth=0.5, marker=".", markersize=2.2,
                markeredgewidth=0.0, label="_", zorder=2.2,
            )  # fmt: skip
    return any(f"{sensor}/{axis}" in exact for axis in curves)


MARK_SHIFT = 1.35  # factor of tau between the marks of two axes
MARK_SPAN = 1.14  # factor of tau from the middle of a bar to its end
FALLING_S, RISING_SHARE = 1.0, 0.4
"""Where a coefficient is marked whose asymptote falls, s, or rises, as a share of the longest tau; B where the noise
is lowest."""


@dataclass(frozen=True, slots=True)
class _Mark:
    """A coefficient of an axis as a point of its asymptote, in the unit of the panel."""

    axis: str
    letter: str
    tau_s: float
    value: float | None  # None: only bounded
    low: float
    high: float


def _marks(report: Report, sensor: str, curves: Mapping[str, Allan]) -> Iterator[_Mark]:
    """Yield where the coefficients lie on their asymptotes."""
    factor = COEFFICIENTS["B"].units[sensor].factor
    for k, (axis, curve) in enumerate(curves.items()):
        channel = report.channels[f"{sensor}/{axis}"]
        first, last = curve.tau_s[0], curve.tau_s[-1]
        noise = [(value, tau) for value, tau in zip(curve.noise, curve.tau_s, strict=True) if value]
        lowest = min(noise)[1] if noise else math.sqrt(first * last)
        for letter, each in channel.coefficients.items():
            part = each.stated
            if part.status == "pending" or part.high is None:
                continue
            row = COEFFICIENTS[letter]
            place = FALLING_S if row.slope < 0.0 else RISING_SHARE * last if row.slope > 0.0 else lowest
            tau = place * MARK_SHIFT ** (k - 1)
            tau = min(max(tau, first * MARK_SPAN), last / MARK_SPAN)
            scale = factor * row.deviation(tau)
            value = part.value * scale if part.value is not None and part.status == "measured" else None
            yield _Mark(axis, letter, tau, value, (part.low or 0.0) * scale, part.high * scale)


def _draw_marks(panel: Axes, marks: Sequence[_Mark], colours: Mapping[str, str]) -> None:
    """Draw the coefficients as bars over their 95 % limits, upper bounds as arrows, with one letter for the axes."""
    bottom, top = panel.get_ylim()
    for mark in marks:
        colour, tau, high = colours[mark.axis], mark.tau_s, mark.high
        if not bottom < high < top:
            continue
        slope = COEFFICIENTS[mark.letter].slope
        wide = [tau / MARK_SPAN**4, tau * MARK_SPAN**4]
        level = mark.value if mark.value is not None else high
        line = [level * (t / tau) ** slope for t in wide]
        panel.plot(wide, line, color=colour, linewidth=0.8, linestyle=(0, (3, 2)), label="_", zorder=3.0)
        narrow = (tau / MARK_SPAN, tau * MARK_SPAN)
        if mark.value is None:
            panel.annotate(
                "", (tau, max(high / 1.7, bottom)), (tau, high), zorder=3.1,
                arrowprops={"arrowstyle": "-|>", "color": colour, "shrinkA": 0.0, "shrinkB": 0.0, "linewidth": 1.3},
            )  # fmt: skip
            panel.hlines(high, *narrow, color=colour, linewidth=1.8, zorder=3.1)
        else:
            panel.vlines(tau, max(mark.low, bottom), high, color=colour, linewidth=1.3, zorder=3.1)
            panel.hlines([max(mark.low, bottom), high], *narrow, color=colour, linewidth=1.3, zorder=3.1)
            panel.hlines(mark.value, *narrow, color=colour, linewidth=2.4, zorder=3.2)
    for letter in COEFFICIENTS:
        shown = [mark for mark in marks if mark.letter == letter and bottom < mark.high < top]
        if shown:  # the floor lies below the curve, the others on it
            mark = min(shown, key=lambda m: m.low) if letter == "B" else max(shown, key=lambda m: m.high)
            below = letter == "B" and mark.value is not None
            panel.annotate(
                letter, (mark.tau_s, max(mark.low, bottom) if below else mark.high), (0, -3 if below else 3),
                textcoords="offset points", ha="center", va="top" if below else "bottom", fontsize=9,
                fontweight="bold", color=colours["text"], zorder=3.3,
            )  # fmt: skip


def _draw_legend(panel: Axes, axes: Sequence[str], colours: Mapping[str, str], *, exact: bool) -> None:
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
        *(
            [Line2D([], [], color=muted, linewidth=0.5, marker=".", markersize=4.0, label="exact")]
            if exact
            else []
        ),
    ]
    panel.legend(
        handles=entries, frameon=False, ncols=len(entries), loc="lower right", bbox_to_anchor=(1.0, 1.0),
        borderaxespad=0.1, fontsize=8, handlelength=1.4, columnspacing=1.1, handletextpad=0.4,
        labelcolor=colours["text"],
    )  # fmt: skip
