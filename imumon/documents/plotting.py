"""Plotting: colours, fonts, frames and files that all figures of a datasheet have in common, by matplotlib.

matplotlib is imported where it is needed: it costs other commands 50 MB.
"""

from __future__ import annotations

import io
import math
import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARKERS = {"x": "o", "y": "s", "z": "^"}
COLOURS = {
    "x": "#0b66b0", "y": "#c4500a", "z": "#0a8a62",
    "text": "#1b1f24", "muted": "#5b6470", "rule": "#d5dae0",
}  # fmt: skip
"""Colours on white, by axis and role. In a page, CSS variables replace them, which follow its light or dark scheme."""
STYLE: Any = {
    "svg.fonttype": "none",  # text stays text
    "font.family": "sans-serif",
    "text.color": COLOURS["text"],
    "axes.labelcolor": COLOURS["text"],
    "axes.edgecolor": COLOURS["muted"],
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": COLOURS["rule"],
    "grid.linewidth": 0.9,
    **{f"{side}.{name}": value for side in ("xtick", "ytick") for name, value in (
        ("color", COLOURS["muted"]), ("labelcolor", COLOURS["text"]), ("labelsize", 9))},
}  # fmt: skip
"""What all figures have in common, as settings of matplotlib."""
LEGEND: Any = {
    "frameon": False, "labelcolor": COLOURS["text"], "fontsize": 8, "borderaxespad": 0.1, "handlelength": 1.4,
    "columnspacing": 1.1, "handletextpad": 0.4,
}  # fmt: skip
"""Form of a legend, which is also above axes of a caller."""

INCHES = (8.4, 4.6)
"""Width and height of a figure of the page, and of a panel of a file."""
WIDE_INCHES = 4.5
"""Width of axes from which on a legend of one line is not wider than they are: a layout makes axes narrower for it."""
FEW_DECADES = 2.0  # decades up to which 2 and 5 are labelled too
_SVG_REPLACEMENTS = (
    (r"<metadata>.*?</metadata>|<!--.*?-->|<style.*?</style>", ""),
    (r' id="(?:figure|axes|patch|text|line2d|legend|[xy]tick|\w+Collection|matplotlib\.axis)_\d+"', ""),
    (r" font-family: [^;\"]*;?", ""),
    (r"(\.\d\d)\d+(?=[^<>]*>)", r"\1"),  # of numbers in tags, not in text
    ("xlink:href", "href"),
    (r"\s*\n\s*", "\n"),
)
"""Parts of an SVG by matplotlib that a page does not need, as patterns with their replacements."""


def page_svg(draw: Callable[[Axes], None], salt: str, label: str, height: float = 1.0) -> str:
    """Return what `draw` draws into a panel as an SVG element of the HTML page.

    Parameters
    ----------
    salt : makes the ids in the element differ from those of other elements.
    height : share of the usual height.
    """
    inches = (INCHES[0], height * INCHES[1])
    with figure_style(salt):
        from matplotlib.figure import Figure

        figure = Figure(figsize=inches, layout="constrained")
        draw(figure.subplots())
        drawn = saved(figure, "svg").decode()
    body = drawn[drawn.index("<svg ") : drawn.rindex("</svg>")].partition(">")[2]
    for pattern, replacement in _SVG_REPLACEMENTS:
        body = re.sub(pattern, replacement, body, flags=re.DOTALL)
    for role, colour in COLOURS.items():
        body = body.replace(colour, f"var(--{role})")
    width, high = (72.0 * side for side in inches)
    view = f'viewBox="0 0 {width:g} {high:g}"'
    return f'<svg class="allan" role="img" aria-label="{label}" {view}>{body}</svg>'


@contextmanager
def figure_style(salt: str) -> Iterator[None]:
    """Draw in the common style; `salt` makes ids that do not depend on the run."""
    load_fonts()
    from matplotlib import rc_context

    with rc_context({**STYLE, "svg.hashsalt": salt}):
        yield


def axes_for(ax: Axes | None) -> Axes:
    """Return the axes of the caller, or those of a figure of its own, which a notebook shows."""
    if ax is not None:
        return ax
    from matplotlib import pyplot

    return pyplot.subplots(figsize=INCHES, layout="constrained")[1]


def load_fonts() -> None:
    """Import matplotlib's fonts without leaving its list of fonts in the user's home directory."""
    if "MPLCONFIGDIR" in os.environ or "matplotlib.font_manager" in sys.modules:
        return
    with tempfile.TemporaryDirectory(prefix="imumon-") as directory:
        os.environ["MPLCONFIGDIR"] = directory
        try:
            import matplotlib.font_manager  # noqa: F401
        finally:
            del os.environ["MPLCONFIGDIR"]


def saved(figure: Figure, form: str, title: str | None = None) -> bytes:
    """Return a figure as a file; without a title, as an element of the page, on no ground of its own."""
    out = io.BytesIO()
    named = {} if title is None else {"Title": title}
    metadata = {"Date": None, **named} if form == "svg" else None
    figure.savefig(out, format=form, transparent=title is None, metadata=metadata)
    return out.getvalue()


def draw_grid(panel: Axes) -> None:
    """Draw the grid and the numbers of a panel with logarithmic axes, whose limits are set."""
    from matplotlib.ticker import LogLocator, StrMethodFormatter

    for axis, (low, high), lines, place in (
        (panel.xaxis, panel.get_xlim(), panel.vlines, panel.get_xaxis_transform()),
        (panel.yaxis, panel.get_ylim(), panel.hlines, panel.get_yaxis_transform()),
    ):
        few = math.log10(high / low) < FEW_DECADES
        # 30: by default, the locator omits decades where it expects no room for their labels
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,), numticks=30))
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.minorticks_off()  # a tick is an object of its own: they take most of the time of a figure
        between = LogLocator(subs=range(2, 10), numticks=30).tick_values(low, high)
        shown = [tick for tick in between if low < tick < high]
        lines(shown, 0.0, 1.0, transform=place, color=COLOURS["rule"], linewidth=0.4, alpha=0.6, zorder=0.5)


def draw_legend(panel: Axes, handles: Sequence[Any] = ()) -> None:
    """Draw a legend in one line above the frame, in two above a narrow one, by default of all that has a label."""
    entries = handles or panel.get_legend_handles_labels()[0]
    inches = panel.get_window_extent().width / panel.figure.dpi
    columns = len(entries) if inches >= WIDE_INCHES else -(-len(entries) // 2)
    # explicit: the axes may be those of a caller, whose settings are others, and a layout must not make room for it
    panel.legend(handles=entries, ncols=columns, loc="lower right", bbox_to_anchor=(1.0, 1.0), **LEGEND)
