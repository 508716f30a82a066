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
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

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

PAGE_INCHES = (8.4, 4.6)
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


def page_svg(draw: Callable[[Axes], None], salt: str, label: str, inches: tuple[float, float]) -> str:
    """Return what `draw` draws into a panel as an SVG element of the HTML page.

    Parameters
    ----------
    salt : makes the ids in the element differ from those of other elements.
    """
    load_fonts()
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    # text stays text, in the font of the page; ids do not depend on the run
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": salt, "font.family": "sans-serif"}):
        figure = Figure(figsize=inches, layout="constrained")
        draw(figure.subplots())
        drawn = saved(figure, "svg").decode()
    body = drawn[drawn.index("<svg ") : drawn.rindex("</svg>")].partition(">")[2]
    for pattern, replacement in _SVG_REPLACEMENTS:
        body = re.sub(pattern, replacement, body, flags=re.DOTALL)
    for role, colour in PAGE.items():
        body = body.replace(colour, f"var(--{role})")
    width, height = (72.0 * side for side in inches)
    view = f'viewBox="0 0 {width:g} {height:g}"'
    return f'<svg class="allan" role="img" aria-label="{label}" {view}>{body}</svg>'


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


def font_directory() -> str:
    """Return the directory of the fonts that come with matplotlib."""
    import matplotlib

    return os.path.join(matplotlib.get_data_path(), "fonts", "ttf")


def saved(figure: Figure, form: str, title: str | None = None) -> bytes:
    """Return a figure as a file; without a title, as an element of the page, on no ground of its own."""
    out = io.BytesIO()
    named = {} if title is None else {"Title": title}
    metadata = {
        "svg": {"Date": None, **named},
        "pdf": {"CreationDate": None, "Creator": "imumon", **named},
    }.get(form)
    figure.savefig(out, format=form, transparent=title is None, metadata=metadata)
    return out.getvalue()


def draw_grid(
    panel: Axes, x: tuple[float, float], y: tuple[float, float], colours: Mapping[str, str]
) -> None:
    """Draw the grid, the numbers and the frame of a panel with logarithmic axes, as all figures have them."""
    from matplotlib.ticker import LogLocator, StrMethodFormatter

    for axis, (low, high), lines, place in (
        (panel.xaxis, x, panel.vlines, panel.get_xaxis_transform()),
        (panel.yaxis, y, panel.hlines, panel.get_yaxis_transform()),
    ):
        few = math.log10(high / low) < FEW_DECADES
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,), numticks=30))
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.minorticks_off()  # a tick is an object of its own: they take most of the time of a figure
        between = LogLocator(subs=range(2, 10), numticks=30).tick_values(low, high)
        shown = [tick for tick in between if low < tick < high]
        lines(shown, 0.0, 1.0, transform=place, color=colours["rule"], linewidth=0.4, alpha=0.6, zorder=0.5)
    draw_frame(panel, colours)


def draw_frame(panel: Axes, colours: Mapping[str, str]) -> None:
    """Draw the grid, the numbers and the frame of a panel, as all figures have them."""
    panel.grid(which="major", color=colours["rule"], linewidth=0.9)
    panel.set_axisbelow(True)
    panel.tick_params(which="both", color=colours["muted"], labelcolor=colours["text"], labelsize=9)
    for spine in panel.spines.values():
        spine.set_color(colours["muted"])
