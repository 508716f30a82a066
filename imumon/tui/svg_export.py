"""SVG: a saved picture of the screen that looks the same everywhere.

Rich writes every cell as text, so braille, blocks and lines look as the reader's font happens to have
them, blanks shift in some readers, and the fonts are fetched from the net. Here the drawn
characters become shapes, each text stands at its own place, and nothing is fetched.
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


def redrawn(svg: str) -> str:
    """Picture by Rich with its drawn characters as shapes and its texts in their places."""
    colours = dict(_COLOUR.findall(svg))
    dots: dict[str, list[str]] = defaultdict(list)
    strokes: dict[str, list[str]] = defaultdict(list)
    blocks: dict[str, list[str]] = defaultdict(list)

    def replace(found: re.Match[str]) -> str:
        name, left, base, content = found.groups()
        x, y = float(left), float(base) - BASELINE
        characters = html.unescape(content)
        rest = []
        for k, character in enumerate(characters):
            at = x + k * WIDTH
            if "\u2800" <= character <= "\u28ff":
                dots[name] += _dots(character, at, y)
            elif character in _LINES:
                strokes[name] += _lines(character, at, y)
            elif character in _EIGHTHS or character == "▀":
                blocks[name].append(_block(character, at, y))
            else:
                rest.append(character)
                continue
            rest.append(" ")
        return _texts(name, "".join(rest), x, float(base))

    svg = _FONTS.sub("", _CLIP.sub("", svg))
    svg = svg.replace("Fira Code, monospace", '"Fira Code", "DejaVu Sans Mono", monospace')
    svg = _TEXT.sub(replace, _grounds(svg))
    shapes = [f'<path class="{name}" d="{"".join(d)}"/>' for name, d in blocks.items()]
    for found, wide, cap in ((strokes, 1.2, "butt"), (dots, 3.6, "round")):
        for name, d in found.items():
            line = f'fill="none" stroke="{colours[name]}" stroke-width="{wide}" stroke-linecap="{cap}"'
            shapes.append(f'<path {line} d="{"".join(d)}"/>')
    head, end, tail = svg.rpartition("</g>\n    </g>")
    return _shorter(head + "\n".join(shapes) + "\n" + end + tail)


def _grounds(svg: str) -> str:
    """The grounds of the cells as one shape a colour, the commonest as one sheet below the others."""
    areas: dict[str, float] = defaultdict(float)
    paths: dict[str, list[str]] = defaultdict(list)
    found = list(_RECT.finditer(svg))
    if not found:
        return svg
    right = bottom = 0.0
    for colour, *numbers in (match.groups() for match in found):
        x, y, wide, high = map(float, numbers)
        areas[colour] += wide
        right, bottom = max(right, x + wide), max(bottom, y + high)
        paths[colour].append(f"M{x:g} {y:g}h{wide:g}v{high:g}h-{wide:g}z")
    sheet = max(areas, key=lambda colour: areas[colour])
    del paths[sheet]
    shapes = [f'<rect fill="{sheet}" x="0" y="1.5" width="{right:g}" height="{bottom - 1.5:g}"/>']
    shapes += [
        f'<path fill="{colour}" shape-rendering="crispEdges" d="{"".join(d)}"/>'
        for colour, d in paths.items()
    ]
    return svg[: found[0].start()] + "".join(shapes) + _RECT.sub("", svg[found[0].start() :])


def _texts(name: str, text: str, x: float, y: float) -> str:
    """The words of a text, each group of them at its place; wide blanks carry nothing."""
    out = []
    for part in re.finditer(r"\S+(?: \S+)*", text.replace("\xa0", " ")):
        at, size = x + part.start() * WIDTH, len(part.group()) * WIDTH
        content = html.escape(part.group()).replace(" ", "&#160;")
        out.append(f'<text class="{name}" x="{at:.1f}" y="{y:.1f}" textLength="{size:.1f}">{content}</text>')
    return "\n".join(out) + "\n" if out else ""


def _dots(character: str, x: float, y: float) -> list[str]:
    """Dots of a braille character."""
    bits = ord(character) - 0x2800
    places = ((0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2), (0, 3), (1, 3))
    return [
        f"M{x + WIDTH * (0.25 + 0.5 * a):.1f} {y + HEIGHT * (0.125 + 0.25 * b):.1f}h.01"
        for k, (a, b) in enumerate(places)
        if bits >> k & 1
    ]


def _lines(character: str, x: float, y: float) -> list[str]:
    """Strokes of a line-drawing character from its middle to its sides."""
    mx, my = x + WIDTH / 2, y + HEIGHT / 2
    ends = {"N": f"V{y:.1f}", "S": f"V{y + HEIGHT:.1f}", "W": f"H{x:.1f}", "E": f"H{x + WIDTH:.1f}"}
    return [f"M{mx:.1f} {my:.1f}{ends[side]}" for side in _LINES[character]]


def _block(character: str, x: float, y: float) -> str:
    """Rectangle of a block character; it overlaps its neighbour by a hair, so that no seam is seen."""
    if character == "▀":
        return f"M{x:.1f} {y:.1f}h{WIDTH + 0.2:.1f}v{HEIGHT / 2 + 0.2:.1f}h-{WIDTH + 0.2:.1f}z"
    high = HEIGHT * (_EIGHTHS.index(character) + 1) / 8
    return f"M{x:.1f} {y + HEIGHT - high:.1f}h{WIDTH + 0.2:.1f}v{high + 0.4:.1f}h-{WIDTH + 0.2:.1f}z"


def _shorter(svg: str) -> str:
    """The same picture with a short name for what Rich gives a long one."""
    found = re.search(r"terminal-\d+", svg)
    return svg.replace(found.group(), "imumon") if found else svg
