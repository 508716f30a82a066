"""Figures of the Allan deviation, by matplotlib: an element of the HTML page, or a file (SVG, PNG).

One function draws a sensor into a panel: measured points with 95 % bands, fitted model, its noise alone, octaves
that the fit does not use, N, B and K with their limits, and the limits of the grades. Axes also differ in the shape of
their marks, for readers who cannot distinguish the colours. A file also has the values as text and a caption.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from imumon.documents.elements import DataTable
from imumon.documents.plotting import (
    COLOURS,
    INCHES,
    MARKERS,
    axes_for,
    draw_grid,
    draw_legend,
    figure_style,
    page_svg,
    saved,
)
from imumon.documents.report_texts import (
    SENSOR_TITLES,
    coefficient_text,
    readable_curves,
    record_line,
    sensor_axes,
    sensor_title,
    shown_letters,
    with_limits,
)
from imumon.model.coefficients import COEFFICIENTS, INDISTINCT_WORD, MARKOV, NOISE, Estimate
from imumon.model.errors import ImumonError
from imumon.model.messages import NOT_APART, has_indistinct
from imumon.model.report import Allan, LimitCurve, Report
from imumon.model.samples import ChannelName
from imumon.model.units import pretty

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TEXT_INCHES = 0.55
"""Height of the values below a panel of a file: a page of A4 holds three sensors."""
PAGE_HEIGHT = 0.85
"""Share of the usual height of a figure of the page: the first one fits below the tables."""
MARGIN_DECADES = 0.06  # decades between the data and the frame
WIDEST_LIMIT = 2.0  # factor beyond the points that the frame shows of their limits, which may span decades
ROOM = 1.35
"""Factor of averaging time or deviation in which a mark or a letter has room."""
BESIDE_POINTS = 10.0
"""Points to the right of a letter from which the next one is beside it."""
RISING_SHARE = 0.4
"""Where a coefficient is marked whose asymptote rises, as a share of the longest averaging time."""


class NoCurve(ImumonError):
    """The report has no Allan deviation yet."""


def figure_file(report: Report, form: str) -> bytes:
    """Return the curves of all sensors as a file: ``png`` or ``svg``, one panel per sensor.

    Raises
    ------
    NoCurve : the record is too short.
    """
    sensors = [sensor for sensor in SENSOR_TITLES if _drawable(readable_curves(report, sensor))]
    if not sensors:
        raise NoCurve("no_curve", "there is no curve to draw yet", "record longer")
    width, height = INCHES
    inches = (width, (height + TEXT_INCHES) * len(sensors) + 1.0)
    with figure_style("imumon"):
        from matplotlib.figure import Figure

        figure = Figure(figsize=inches, dpi=150, layout="constrained")
        figure.suptitle(sensor_title(report), x=0.01, ha="left", fontsize=12, fontweight="bold")
        rows = figure.subplots(
            2 * len(sensors), 1, gridspec_kw={"height_ratios": [height, TEXT_INCHES] * len(sensors)}
        )
        for panel, values, sensor in zip(rows[0::2], rows[1::2], sensors, strict=True):
            _draw(panel, report, sensor)
            panel.set_title(SENSOR_TITLES[sensor], loc="left", fontsize=10)
            _write_values(values, report, sensor)
        caption = f"{record_line(report)}. {legend_text(report, sensors)}."
        figure.supxlabel(caption, x=0.01, ha="left", fontsize=7.5, color=COLOURS["muted"], wrap=True)
        return saved(figure, form, sensor_title(report))


def _write_values(values: Axes, report: Report, sensor: str) -> None:
    """Write the coefficients of the axes with their limits below a panel."""
    values.set_axis_off()
    letters = shown_letters(channel for _, channel in sensor_axes(report, sensor))
    rows = [
        (axis, [_value_text(letter, channel.estimates.get(letter)) for letter in letters])
        for axis, channel in sensor_axes(report, sensor)
    ]
    # as wide as their longest text
    widths = [4 + max(map(len, column)) for column in zip(*(texts for _, texts in rows), strict=True)]
    places = [0.025 + 0.975 * sum(widths[:k]) / sum(widths) for k in range(len(widths))]
    for k, (axis, texts) in enumerate(rows):
        for left, text in zip([0.0, *places], [axis, *texts], strict=True):
            values.text(
                left,
                1.0 - 0.36 * k,
                text,
                fontsize=7.2,
                va="top",
                color=COLOURS[axis],
                transform=values.transAxes,
            )


def _value_text(letter: str, part: Estimate | None) -> str:
    """Return a coefficient with its letter, limits and unit; empty if a channel need not have it."""
    unit = f" {pretty(part.readable.unit)}" if part and part.status != "pending" else ""
    return f"{letter} {coefficient_text(part)}{unit}" if part or letter in NOISE else ""


def legend_text(report: Report, sensors: Sequence[str]) -> str:
    """Return what the marks of a figure mean."""
    limits = "; dotted: the limits of the grades" if any(s in report.limit_curves for s in sensors) else ""
    hump = dashes = ""
    if any(channel.M is not None for sensor in sensors for _, channel in sensor_axes(report, sensor)):
        hump, dashes = ", 0.617 M", "; dashed: correlated noise (Gauss–Markov, M) alone"
    return (
        "Overlapping Allan deviation with 95 % limits (bands) and fitted model (lines; thin: its noise alone, "
        f"where it has more); hollow: octaves that the fit does not use; bars: N/√τ, 0.664 B{hump} and K√(τ/3) with "
        f"95 % limits; arrows: 95 % upper bounds{dashes}"
        f"{limits}{f'; {INDISTINCT_WORD}: {NOT_APART}' if has_indistinct(report) else ''}"
    )


def curve_table(report: Report, sensor: str) -> DataTable:
    """Return the Allan deviation of the axes at every octave, with its limits."""
    curves = readable_curves(report, sensor)
    longest = max(curves.values(), key=lambda curve: len(curve.tau_s), default=Allan())
    rows = tuple(
        (f"{tau:.4g}", *(_point_text(curve, j) for curve in curves.values()))
        for j, tau in enumerate(longest.tau_s)
    )
    unit = pretty(COEFFICIENTS["B"].units[sensor].unit)
    return DataTable((f"{SENSOR_TITLES[sensor]}: τ, s", *(f"{axis}, {unit}" for axis in curves)), rows)


def _point_text(curve: Allan, octave: int) -> str:
    """Return the deviation at an averaging time with its 95 % limits."""
    if octave >= len(curve.sigma):
        return "–"
    return with_limits(curve.sigma[octave], curve.low[octave], curve.high[octave])


def svg(report: Report, sensor: str) -> str:
    """Return the curves of a sensor as an SVG element of the HTML page; empty if there are none."""
    if not _drawable(readable_curves(report, sensor)):
        return ""
    label = f"Allan deviation of the {SENSOR_TITLES[sensor].lower()}"
    return page_svg(lambda panel: _draw(panel, report, sensor), sensor, label, height=PAGE_HEIGHT)


def draw_allan(report: Report, sensor: str, ax: Axes | None = None) -> Axes:
    """Draw the curves of a sensor and return the axes of the figure.

    Parameters
    ----------
    ax : where to draw; None: a figure of its own.

    Raises
    ------
    NoCurve : the record is too short.
    """
    if not _drawable(readable_curves(report, sensor)):
        raise NoCurve("no_curve", "there is no curve to draw yet", "record longer")
    panel = axes_for(ax)
    _draw(panel, report, sensor)
    return panel


def _drawable(curves: Mapping[str, Allan]) -> bool:
    return any(sigma > 0.0 for curve in curves.values() for sigma in curve.sigma)


def _draw(panel: Axes, report: Report, sensor: str) -> None:
    """Draw the curves of a sensor into a panel, from the back to the front."""
    curves = readable_curves(report, sensor)
    scale = COEFFICIENTS["B"].units[sensor]
    marks = list(_marks(report, sensor, curves))
    x, y = _extent(curves, [mark.value for mark in marks if mark.letter == "B" and mark.value])
    panel.set(xscale="log", yscale="log", xlim=x, ylim=y)
    panel.set(xlabel="averaging time τ, s", ylabel=f"Allan deviation σ(τ), {pretty(scale.unit)}")
    draw_grid(panel)
    for grade, limit in report.limit_curves.get(sensor, {}).items():
        _draw_limit(panel, grade, limit, scale.factor)
    for axis, curve in curves.items():
        _draw_curve(panel, axis, curve)
    _draw_markov(panel, report, sensor, curves)
    _draw_marks(panel, marks)
    _draw_legend(panel, list(curves))


def _extent(
    curves: Mapping[str, Allan], floors: Sequence[float]
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the ends of both axes; `floors` are shown with room for their letter."""
    taus = [tau for curve in curves.values() for tau in curve.tau_s]
    sigmas = [sigma for curve in curves.values() for sigma in curve.sigma if sigma > 0.0]
    limits = [v for c in curves.values() for v in (*c.low, *c.high) if v is not None and v > 0.0]
    # the points decide; limits may be decades away where few samples count
    low = max(min([*sigmas, *limits]), min(sigmas) / WIDEST_LIMIT)
    high = min(max([*sigmas, *limits]), max(sigmas) * WIDEST_LIMIT)
    low = min([low, *(max(floor / ROOM, low / WIDEST_LIMIT) for floor in floors)])
    margin = 10.0**MARGIN_DECADES
    return (min(taus) / margin, max(taus) * margin), (low / margin, high * margin)


def _draw_limit(panel: Axes, grade: str, limit: LimitCurve, factor: float) -> None:
    """Draw the curve at the limits of a grade, with its name where it leaves the frame."""
    import numpy as np

    tau = np.geomspace(*panel.get_xlim(), 200)
    sigma = factor * np.exp(np.interp(np.log(tau), np.log(limit.tau_s), np.log(limit.sigma)))
    panel.plot(tau, sigma, color=COLOURS["muted"], linewidth=1.0, linestyle=(0, (1, 2)))
    bottom, top = panel.get_ylim()
    inside = np.flatnonzero((sigma > bottom) & (sigma < top))
    if len(inside):
        panel.annotate(
            grade, (tau[inside[-1]], sigma[inside[-1]]), (4, 2), textcoords="offset points", fontsize=8,
            color=COLOURS["muted"], annotation_clip=False,
        )  # fmt: skip


def _draw_curve(panel: Axes, axis: str, curve: Allan) -> None:
    """Draw one axis: band, noise, model over it, and points, hollow where the fit does not use them."""
    import numpy as np

    colour, used = COLOURS[axis], np.array(curve.used)
    low, high, model, noise, sigma = (
        np.array([v if v is not None and v > 0.0 else math.nan for v in values])  # matplotlib omits NaN
        for values in (curve.low, curve.high, curve.model, curve.noise, curve.sigma)
    )
    panel.fill_between(curve.tau_s, low, high, color=colour, alpha=0.16, linewidth=0.0)
    panel.plot(curve.tau_s, noise, color=colour, linewidth=0.6)
    panel.plot(curve.tau_s, model, color=colour, linewidth=1.2)
    for shown, face in ((used, colour), (~used, "none")):
        panel.plot(
            curve.tau_s, np.where(shown, sigma, math.nan), linestyle="none", marker=MARKERS[axis],
            markersize=4.5, color=colour, markerfacecolor=face, markeredgewidth=1.0,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Mark:
    """A coefficient of an axis as a point of its asymptote, in the unit of the panel."""

    axis: str
    letter: str
    tau_s: float
    value: float | None  # None: only bounded
    low: float
    high: float

    @property
    def level(self) -> float:
        """Height at which it is drawn: the value, or the bound."""
        return self.high if self.value is None else self.value


def _marks(report: Report, sensor: str, curves: Mapping[str, Allan]) -> Iterator[_Mark]:
    """Yield where the coefficients lie on their asymptotes."""
    factor = COEFFICIENTS["B"].units[sensor].factor
    for k, (axis, curve) in enumerate(curves.items()):
        channel = report.channels[ChannelName(f"{sensor}/{axis}")]
        first, last = curve.tau_s[0], curve.tau_s[-1]
        noise = [(value, tau) for value, tau in zip(curve.noise, curve.tau_s, strict=True) if value]
        lowest = min(noise)[1] if noise else math.sqrt(first * last)
        for letter, coefficient in channel.estimates.items():
            part = coefficient.stated
            if part.status == "pending" or part.high is None:
                continue
            row = COEFFICIENTS[letter]
            place = RISING_SHARE * last if row.slope > 0.0 else row.mark_s(lowest, channel.time_constant_s)
            if place is None:
                continue
            # beside one another, also at the end of the curve: the axes of a sensor are often equal
            tau = min(max(place, first * ROOM**2), last / ROOM**2) * ROOM ** (k - 1)
            scale = factor * row.deviation(tau, channel.time_constant_s)
            value = part.value * scale if part.value is not None and part.status == "measured" else None
            yield _Mark(axis, letter, tau, value, (part.low or 0.0) * scale, part.high * scale)


def _draw_markov(panel: Axes, report: Report, sensor: str, axes: Iterable[str]) -> None:
    """Draw the measured correlated noise alone, whose hump no straight line shows."""
    import numpy as np

    row = COEFFICIENTS[MARKOV.sigma]
    tau = np.geomspace(*panel.get_xlim(), 200)
    for axis in axes:
        channel = report.channels[ChannelName(f"{sensor}/{axis}")]
        part, time_constant_s = channel.estimates.get(row.letter), channel.time_constant_s
        if part is None or not part.value or time_constant_s is None:
            continue
        scale = part.value * row.units[sensor].factor
        sigma = [scale * row.deviation(tau_s, time_constant_s) for tau_s in tau.tolist()]
        panel.plot(tau, sigma, color=COLOURS[axis], linewidth=0.8, linestyle=(0, (5, 2)))


def _draw_marks(panel: Axes, marks: Sequence[_Mark]) -> None:
    """Draw the coefficients as bars over their 95 % limits, upper bounds as arrows, with one letter for the axes."""
    bottom, top = panel.get_ylim()
    # one that lies outside would be drawn at the edge, where nothing has its value
    marks = [mark for mark in marks if bottom < mark.level and mark.high < top]
    for mark in marks:
        _draw_mark(panel, mark)
    places: list[tuple[float, float]] = []
    for letter in COEFFICIENTS:
        if shown := [mark for mark in marks if mark.letter == letter]:
            places.append(_draw_letter(panel, letter, shown, places))


def _draw_mark(panel: Axes, mark: _Mark) -> None:
    """Draw a piece of the asymptote, and a bar over its limits or an arrow down from its bound."""
    bottom, _ = panel.get_ylim()
    slope, colour = COEFFICIENTS[mark.letter].slope, COLOURS[mark.axis]
    level, end = mark.level, mark.high / ROOM**2 if mark.value is None else mark.low
    wide = (mark.tau_s / ROOM, mark.tau_s * ROOM)
    line = [level * (t / mark.tau_s) ** slope for t in wide]
    panel.plot(wide, line, color=colour, linewidth=0.8, linestyle=(0, (3, 2)), zorder=3.0)
    panel.errorbar(
        mark.tau_s, level, [[level - max(end, bottom)], [mark.high - level]], uplims=mark.value is None,
        fmt="_", color=colour, markersize=15, markeredgewidth=1.4, elinewidth=1.4, capsize=4, zorder=3.1,
    )  # fmt: skip


def _draw_letter(
    panel: Axes, letter: str, marks: Sequence[_Mark], places: Sequence[tuple[float, float]]
) -> tuple[float, float]:
    """Write the letter of a coefficient once, at the outermost of the marks of its axes, and beside other letters.

    Parameters
    ----------
    places : of the letters before, as time and height.

    Returns
    -------
    time and height of the letter.
    """
    bottom, _ = panel.get_ylim()
    # the floor is below the curve, others on it
    mark = min(marks, key=lambda m: m.low) if letter == "B" else max(marks, key=lambda m: m.high)
    below = letter == "B" and mark.value is not None
    place = (mark.tau_s, max(mark.low, bottom) if below else mark.high)
    close = [
        p for p in places if all(abs(math.log(a / b)) < math.log(ROOM) for a, b in zip(p, place, strict=True))
    ]
    panel.annotate(
        letter, place, (BESIDE_POINTS * len(close), -3 if below else 3),
        textcoords="offset points", ha="center", va="top" if below else "bottom", fontsize=9,
        fontweight="bold", zorder=3.3,
    )  # fmt: skip
    return place


def _draw_legend(panel: Axes, axes: Sequence[str]) -> None:
    """Name the axes above the frame, and explain band, line and hollow marks."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    muted = COLOURS["muted"]
    entries = [
        *(Line2D([], [], color=COLOURS[a], marker=MARKERS[a], markersize=4.5, label=a) for a in axes),
        Patch(color=muted, alpha=0.25, linewidth=0.0, label="95 %"),
        Line2D([], [], color=muted, linewidth=1.2, label="model"),
        Line2D(
            [], [], color=muted, marker="o", markersize=4.5, fillstyle="none", linestyle="", label="not used"
        ),
    ]
    draw_legend(panel, entries)
