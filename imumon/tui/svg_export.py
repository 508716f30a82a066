"""Screenshots as SVG that look the same everywhere.

Rich writes every cell as text, so braille, blocks and lines depend on the font of the reader, blanks shift in
some readers, and the fonts are fetched from the net. Here the drawn characters become shapes, each text has
its own position, and nothing is fetched.
"""

from __future__ import annotations

import html
import re
from collections import defaultdict

WIDTH, HEIGHT = 12.2, 24.4
"""Cell in the units of Rich's SVG."""
BASELINE = 18.5
"""From the top of a cell to the baseline of its text."""

_TEXT = re.compile(r'<text class="([\w-]+-r\d+)" x="([\d.]+)" y="([\d.]+)"[^>]*>([^<]*)</text>\s*')
_COLOUR = re.compile(r"\.([\w-]+-r\d+) \{ fill: (#\w+)")
_RECT = re.compile(
    r'<rect fill="(#\w+)" x="([\d.]+)" y="([\d.]+)" width="([\d.]+)" height="([\d.]+)" '
    r'shape-rendering="crispEdges"\s*/>'
)
_CLIP = re.compile(r'<clipPath id="[\w-]+-line-\d+">\s*<rect[^>]*/>\s*</clipPath>\s*')
_FONTS = re.compile(r"@font-face \{.*?\}\s*", re.DOTALL)
_EIGHTHS = "▁▂▃▄▅▆▇█"
_LINES = {"─": "EW", "│": "NS", "┼": "NESW", "┴": "NEW", "━": "EW"}


def portable_svg(svg: str) -> str:
    """Return a screenshot by Rich with shapes for drawn characters and a position for each text."""
    colours = dict(_COLOUR.findall(svg))
    dots: dict[str, list[str]] = defaultdict(list)
    strokes: dict[str, list[str]] = defaultdict(list)
    blocks: dict[str, list[str]] = defaultdict(list)

    def replace(match: re.Match[str]) -> str:
        """Return a text of Rich without its drawn characters, which become shapes."""
        name, left, base, content = match.groups()
        x, y = float(left), float(base) - BASELINE
        characters = html.unescape(content)
        rest = []
        for k, character in enumerate(characters):
            cell_x = x + k * WIDTH
            if "\u2800" <= character <= "\u28ff":
                dots[name] += _dots(character, cell_x, y)
            elif character in _LINES:
                strokes[name] += _lines(character, cell_x, y)
            elif character in _EIGHTHS or character == "▀":
                blocks[name].append(_block(character, cell_x, y))
            else:
                rest.append(character)
                continue
            rest.append(" ")
        return _texts(name, "".join(rest), x, float(base))

    svg = _FONTS.sub("", _CLIP.sub("", svg))
    svg = svg.replace("Fira Code, monospace", '"Fira Code", "DejaVu Sans Mono", monospace')
    svg = _TEXT.sub(replace, _backgrounds(svg))
    shapes = [f'<path class="{name}" d="{"".join(d)}"/>' for name, d in blocks.items()]
    for paths, width, cap in ((strokes, 1.2, "butt"), (dots, 3.6, "round")):
        for name, d in paths.items():
            line = f'fill="none" stroke="{colours[name]}" stroke-width="{width}" stroke-linecap="{cap}"'
            shapes.append(f'<path {line} d="{"".join(d)}"/>')
    head, end, tail = svg.rpartition("</g>\n    </g>")
    return _renamed(head + "\n".join(shapes) + "\n" + end + tail)


def _backgrounds(svg: str) -> str:
    """Merge the backgrounds of the cells into one shape per colour; the most common one covers everything."""
    areas: dict[str, float] = defaultdict(float)
    paths: dict[str, list[str]] = defaultdict(list)
    matches = list(_RECT.finditer(svg))
    if not matches:
        return svg
    right = bottom = 0.0
    for colour, *numbers in (match.groups() for match in matches):
        x, y, width, height = map(float, numbers)
        areas[colour] += width
        right, bottom = max(right, x + width), max(bottom, y + height)
        paths[colour].append(f"M{x:g} {y:g}h{width:g}v{height:g}h-{width:g}z")
    base = max(areas, key=lambda colour: areas[colour])
    del paths[base]
    shapes = [f'<rect fill="{base}" x="0" y="1.5" width="{right:g}" height="{bottom - 1.5:g}"/>']
    shapes += [
        f'<path fill="{colour}" shape-rendering="crispEdges" d="{"".join(d)}"/>'
        for colour, d in paths.items()
    ]
    return svg[: matches[0].start()] + "".join(shapes) + _RECT.sub("", svg[matches[0].start() :])


def _texts(name: str, text: str, x: float, y: float) -> str:
    """Return each group of words at its own position, without the wide blanks between them."""
    out = []
    for part in re.finditer(r"\S+(?: \S+)*", text.replace("\xa0", " ")):
        left, size = x + part.start() * WIDTH, len(part.group()) * WIDTH
        content = html.escape(part.group()).replace(" ", "&#160;")
        out.append(
            f'<text class="{name}" x="{left:.1f}" y="{y:.1f}" textLength="{size:.1f}">{content}</text>'
        )
    return "\n".join(out) + "\n" if out else ""


def _dots(character: str, x: float, y: float) -> list[str]:
    """Return the dots of a braille character."""
    # a line of almost no length with a round cap is a dot
    bits = ord(character) - 0x2800
    places = ((0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2), (0, 3), (1, 3))
    return [
        f"M{x + WIDTH * (0.25 + 0.5 * a):.1f} {y + HEIGHT * (0.125 + 0.25 * b):.1f}h.01"
        for k, (a, b) in enumerate(places)
        if bits >> k & 1
    ]


def _lines(character: str, x: float, y: float) -> list[str]:
    """Return the strokes of a line-drawing character from its centre to its sides."""
    mx, my = x + WIDTH / 2, y + HEIGHT / 2
    ends = {"N": f"V{y:.1f}", "S": f"V{y + HEIGHT:.1f}", "W": f"H{x:.1f}", "E": f"H{x + WIDTH:.1f}"}
    return [f"M{mx:.1f} {my:.1f}{ends[side]}" for side in _LINES[character]]


def _block(character: str, x: float, y: float) -> str:
    """Return the rectangle of a block character; it overlaps its neighbour so that no seam shows."""
    if character == "▀":
        return f"M{x:.1f} {y:.1f}h{WIDTH + 0.2:.1f}v{HEIGHT / 2 + 0.2:.1f}h-{WIDTH + 0.2:.1f}z"
    height = HEIGHT * (_EIGHTHS.index(character) + 1) / 8
    return f"M{x:.1f} {y + HEIGHT - height:.1f}h{WIDTH + 0.2:.1f}v{height + 0.4:.1f}h-{WIDTH + 0.2:.1f}z"


def _renamed(svg: str) -> str:
    """Return the picture with a short name instead of the long one by Rich."""
    match = re.search(r"terminal-\d+", svg)
    return svg.replace(match.group(), "imumon") if match else svg
