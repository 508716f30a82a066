"""Plotting with braille characters: numbers in, character cells out.

A `Canvas` is an array of cells. Each cell holds eight braille dots (2 x 4) or a character, on a background.
Where lines cross, their dots merge and the cell takes the colour of the last one, so no line interrupts
another. A `PlotFrame` is the part of a canvas inside two axes. This module knows neither colours nor widgets:
what is drawn has a *role*, and the widget knows the colour of the role.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np
import numpy.typing as npt

from imumon.tui.formatting import Line

Floats = npt.NDArray[np.float64]

# bit of each dot of a cell by row and column in U+2800: six dots in columns of three, then the fourth row
_DOT = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]], dtype=np.uint8)
RESOLUTION = 1e-12
"""Length of an axis relative to its values, below which floating-point numbers do not resolve it."""
LONGEST_LINE = 20000.0
"""Dots of a line at most: far more than any screen has, and a bound for points far outside of it."""
_EIGHTHS = " ▁▂▃▄▅▆▇█"
TEXT_COST = 10_000
"""Cost of a text at a place where another text is."""


class Canvas:
    """Array of `height` x `width` cells, each two dots wide and four dots high.

    Dots count from the upper left corner, x to the right and y down.
    """

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = max(width, 1), max(height, 1)
        shape = (self.height, self.width)
        self.bits = np.zeros(shape, dtype=np.uint8)
        self.bits_role = np.zeros(shape, dtype=np.uint8)
        self.glyph = np.full(shape, ord(" "), dtype=np.uint32)
        self.glyph_role = np.zeros(shape, dtype=np.uint8)
        self.text_mask = np.zeros(shape, dtype=np.bool_)
        self.background = np.zeros(shape, dtype=np.uint8)
        self.shade = np.zeros(shape, dtype=np.uint8)
        self._roles = ["text"]

    def _role(self, role: str) -> int:
        if role not in self._roles:
            self._roles.append(role)
        return self._roles.index(role)

    def dots(self, x: Floats, y: Floats, role: str) -> None:
        """Set single dots.

        Parameters
        ----------
        x, y : (n,) dots; those outside the canvas are ignored.
        """
        inside = np.isfinite(x) & np.isfinite(y)
        column, row = np.rint(x[inside]).astype(np.int64), np.rint(y[inside]).astype(np.int64)
        inside = (column >= 0) & (column < 2 * self.width) & (row >= 0) & (row < 4 * self.height)
        column, row = column[inside], row[inside]
        cell = (row // 4, column // 2)
        # `|=` would keep only the last of several dots of one cell
        np.bitwise_or.at(self.bits, cell, _DOT[row % 4, column % 2])
        self.bits_role[cell] = self._role(role)

    def line(self, x: Floats, y: Floats, role: str, dash: tuple[int, int] | None = None) -> None:
        """Connect points by lines; a point that is not finite interrupts the line.

        Parameters
        ----------
        x, y : (n,) dots.
        dash : numbers of dots that are drawn and of dots that are not, alternating.
        """
        good = np.isfinite(x) & np.isfinite(y)
        for part in np.split(np.arange(len(x)), np.flatnonzero(~good)):
            part = part[good[part]]
            if len(part) < 2:
                continue
            px, py = x[part], y[part]
            # length along the line as the larger of both directions: one step of it never skips a dot
            path = np.concatenate(([0.0], np.cumsum(np.maximum(np.abs(np.diff(px)), np.abs(np.diff(py))))))
            steps = np.arange(0.0, min(path[-1], LONGEST_LINE) + 0.5)
            if dash is not None:
                steps = steps[steps % sum(dash) < dash[0]]
            self.dots(np.interp(steps, path, px), np.interp(steps, path, py), role)

    def fill(self, left: int, top: Floats, bottom: Floats, role: str) -> None:
        """Fill columns of cells, with edges to an eighth of a cell.

        Parameters
        ----------
        left : first column, cell.
        top, bottom : (n,) cells from above, per column; a column is empty for NaN.
        """
        index, page = self._role(role), self._role("page")
        rows = np.arange(self.height)[:, None]
        # eighths of each cell that are empty above and below the filled part
        with np.errstate(invalid="ignore"):
            above, below = np.rint(8 * (top - rows)), np.rint(8 * (rows + 1 - bottom))
            touched = (top < rows + 1) & (bottom > rows) & (np.maximum(above, below) < 8)
        for row, k in zip(*np.nonzero(touched), strict=True):
            column, empty_above, empty_below = left + int(k), int(above[row, k]), int(below[row, k])
            if not 0 <= column < self.width:
                continue
            if empty_above > 0 >= empty_below:  # the upper edge: a block in the role
                if not self.text_mask[row, column]:
                    self.put(column, row, _EIGHTHS[8 - empty_above], role)
                    self.shade[row, column] = index if empty_above <= 4 else 0
                continue
            self.background[row, column] = index
            if empty_below > 0 >= empty_above:  # the lower edge: the page covers the rest
                self.glyph[row, column], self.glyph_role[row, column] = ord(_EIGHTHS[empty_below]), page

    def put(self, column: int, row: int, character: str, role: str) -> None:
        """Write a character that dots may cover, such as a line of the grid."""
        if 0 <= row < self.height and 0 <= column < self.width:
            self.glyph[row, column], self.glyph_role[row, column] = ord(character), self._role(role)

    def text(self, column: int, row: int, text: str, role: str) -> None:
        """Write text that covers everything."""
        if not 0 <= row < self.height:
            return
        for k, character in enumerate(text):
            if 0 <= column + k < self.width:
                self.put(column + k, row, character, role)
                self.text_mask[row, column + k] = True

    def overlap(self, column: int, row: int, length: int) -> int:
        """Return the cost of a text at this place: 0 if nothing is there, large if it does not fit."""
        if not 0 <= row < self.height or column < 0 or column + length > self.width:
            return 1_000_000
        part = (row, slice(column, column + length))
        return TEXT_COST * int(self.text_mask[part].any()) + int(np.count_nonzero(self.bits[part]))

    def rows(self) -> list[Line]:
        """Return the canvas as lines of spans, joining neighbours of one role."""
        dotted = (self.bits > 0) & ~self.text_mask
        glyph = np.where(dotted, 0x2800 + self.bits.astype(np.uint32), self.glyph)
        role = np.where(dotted, self.bits_role, self.glyph_role)
        background = np.where(dotted & (self.background == 0), self.shade, self.background)
        key = role.astype(np.int64) * 256 + background
        lines: list[Line] = []
        for row in range(self.height):
            text = "".join(map(chr, glyph[row].tolist()))
            starts = [0, *(np.flatnonzero(np.diff(key[row])) + 1).tolist(), self.width]
            line: Line = []
            for a, b in pairwise(starts):
                name, behind = self._roles[role[row, a]], background[row, a]
                line.append((text[a:b], f"{name}/{self._roles[behind]}" if behind else name))
            lines.append(line)
        return lines


@dataclass(frozen=True, slots=True)
class AxisScale:
    """Scale of one axis, linear or logarithmic."""

    low: float
    high: float
    log: bool = False

    def share(self, values: Floats) -> Floats:
        """Return (n,) fraction of the axis, 0 at `low` and 1 at `high`; NaN if it cannot be drawn."""
        if self.log:
            with np.errstate(divide="ignore", invalid="ignore"):
                values = np.where(values > 0, np.log10(np.where(values > 0, values, 1.0)), np.nan)
            low, high = math.log10(self.low), math.log10(self.high)
        else:
            low, high = self.low, self.high
        if not high > low:
            return np.full(len(values), np.nan)
        return np.asarray((values - low) / (high - low), dtype=np.float64)

    def decades(self) -> list[int]:
        """Return the exponents of the powers of ten on a logarithmic axis."""
        low, high = math.log10(self.low), math.log10(self.high)
        return list(range(math.ceil(low - 1e-9), math.floor(high + 1e-9) + 1))

    def ticks(self, count: int) -> list[float]:
        """Return about `count` round values on a linear axis; none if it has no length."""
        step = (self.high - self.low) / max(count, 1)
        if not step > RESOLUTION * max(abs(self.low), abs(self.high)):
            return []
        return self.multiples(_round_up(step))

    def multiples(self, step: float) -> list[float]:
        """Return the multiples of a step on a linear axis."""
        # 1e-9: an end that is round but for rounding counts as round
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        return [k * step for k in range(first, last + 1)]


SCALE_STEP = 0.5
"""Decades, of which both ends of a logarithmic scale are multiples."""

LOG_MARGIN = 0.08
"""Decades between the outermost values and the ends of a logarithmic scale, at least."""

MARGIN = 0.06
"""Share of the range of some values that a linear scale is wider at each end."""


def logarithmic(values: Floats) -> AxisScale:
    """Return a logarithmic scale around some values, which does not move while a curve grows.

    Parameters
    ----------
    values : (n,) any unit; those that are not positive are ignored.
    """
    values = values[np.isfinite(values) & (values > 0)]
    if not len(values):
        return AxisScale(0.1, 10.0, log=True)
    low = math.floor((math.log10(float(values.min())) - LOG_MARGIN) / SCALE_STEP) * SCALE_STEP
    high = math.ceil((math.log10(float(values.max())) + LOG_MARGIN) / SCALE_STEP) * SCALE_STEP
    return AxisScale(10.0**low, 10.0**high, log=True)


def linear(values: Floats) -> AxisScale:
    """Return a linear scale around some values.

    Parameters
    ----------
    values : (n,) any unit.
    """
    values = values[np.isfinite(values)]
    if not len(values):
        return AxisScale(0.0, 1.0)
    low, high = float(values.min()), float(values.max())
    # values that are all the same still need an axis with a length
    extra = (high - low) * MARGIN or max(abs(high), 1e-12) * 1e-3
    return AxisScale(low - extra, high + extra)


MOST_TICKS = 10
"""Ticks of a vertical axis, at most."""


def ticked(values: Floats, rows: int, floor: float | None = None) -> tuple[AxisScale, list[float]]:
    """Return a linear scale around some values, and round values on it for about every second row.

    Parameters
    ----------
    values : (n,) any unit.
    rows : height of the frame, cells.
    floor : lower end of the scale; None: as the values need it.
    """
    scale = linear(values) if floor is None else AxisScale(floor, linear(values).high)
    ticks: list[float] = []
    for count in range(min(max(rows // 2, 2), MOST_TICKS - 2), MOST_TICKS):
        if len(ticks := scale.ticks(count)) > 1:  # one alone is no scale
            break
    return scale, ticks


def _round_up(step: float) -> float:
    """Return the least of 1, 2 and 5 times a power of ten that is not below a step."""
    power = 10.0 ** math.floor(math.log10(step))
    # 0.999: a step that is round but for rounding counts as round
    return next((m * power for m in (1.0, 2.0, 5.0) if m * power >= step * 0.999), 10.0 * power)


def _inside(share: Floats) -> Floats:
    """Return (n,) fractions of an axis; NaN outside the axis."""
    return np.where((share < -1e-9) | (share > 1 + 1e-9), np.nan, share)


class PlotFrame:
    """Two axes on a part of a canvas.

    Parameters
    ----------
    left, top, width, height : cells of the part inside the axes.
    """

    def __init__(self, canvas: Canvas, area: tuple[int, int, int, int], x: AxisScale, y: AxisScale) -> None:
        self.canvas, self.x, self.y = canvas, x, y
        self.left, self.top, self.width, self.height = area

    def across(self, values: Floats) -> Floats:
        """Return (n,) dots from the left of the canvas; NaN outside the frame."""
        return 2 * self.left + _inside(self.x.share(values)) * (2 * self.width - 1)

    def down(self, values: Floats) -> Floats:
        """Return (n,) dots from the top of the canvas; NaN outside the frame."""
        return 4 * self.top + (1.0 - _inside(self.y.share(values))) * (4 * self.height - 1)

    def cell(self, x: float, y: float) -> tuple[int, int] | None:
        """Return column and row of a point, None outside the frame."""
        a, b = self.across(np.array([x]))[0], self.down(np.array([y]))[0]
        return None if math.isnan(a) or math.isnan(b) else (round(float(a)) // 2, round(float(b)) // 4)

    def curve(self, x: Floats, y: Floats, role: str, dash: tuple[int, int] | None = None) -> None:
        """Draw a line through points of data, straight between them, also on logarithmic axes."""
        finer_x, finer_y = self._clipped(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
        self.canvas.line(finer_x, finer_y, role, dash)

    def _clipped(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Return points of the line in dots, so dense that it ends at the edge of the frame."""
        sx, sy = self.x.share(x), self.y.share(y)
        if len(sx) < 2:
            return self.across(x), self.down(y)
        n = 4 * (self.width + self.height)
        steps = np.linspace(0.0, len(sx) - 1.0, max(n, 4 * len(sx)))
        steps = np.unique(np.concatenate((steps, np.arange(len(sx), dtype=np.float64))))
        fx, fy = np.interp(steps, np.arange(len(sx)), sx), np.interp(steps, np.arange(len(sy)), sy)
        bad = ~np.isfinite(sx) | ~np.isfinite(sy)
        if bad.any():
            fx = np.where(np.interp(steps, np.arange(len(sx)), bad.astype(float)) > 0, np.nan, fx)
        outside = (fx < 0) | (fx > 1) | (fy < 0) | (fy > 1)
        fx = np.where(outside, np.nan, fx)
        return 2 * self.left + fx * (2 * self.width - 1), 4 * self.top + (1 - fy) * (4 * self.height - 1)

    def points(self, x: Floats, y: Floats, role: str) -> None:
        """Draw marks of 3 x 3 dots, which cannot be confused with a line; of 2 x 2 if they are close."""
        a, b = np.rint(self.across(x)), np.rint(self.down(y))
        # marks of 3 dots need 5 from one to the next for a gap that the eye sees
        apart = np.nanmin(np.diff(a), initial=np.inf)
        offsets = (-1, 0, 1) if apart >= 5 else (-1, 0)
        for dx, dy in product(offsets, offsets):
            self.canvas.dots(a + dx, b + dy, role)

    def band(self, x: Floats, low: Floats, high: Floats, role: str) -> None:
        """Fill the band between two curves, by columns of cells.

        Parameters
        ----------
        x, low, high : (n,) data, x growing.
        """
        share, lower, upper = self.x.share(x), self.y.share(low), self.y.share(high)
        good = np.isfinite(share) & np.isfinite(lower) & np.isfinite(upper)
        if not good.any():
            return
        share, lower, upper = share[good], lower[good], upper[good]
        columns = (np.arange(self.width) + 0.5) / self.width
        half = 0.5 / self.width
        outside = (columns < share[0] - half) | (columns > share[-1] + half)
        lower, upper = np.interp(columns, share, lower), np.interp(columns, share, upper)
        self._fill(np.where(outside, np.nan, lower), upper, role)

    def bars(self, x: Floats, low: Floats, high: Floats, wide: Floats, role: str) -> None:
        """Fill a bar between two values around each point, at least a column of cells wide.

        Parameters
        ----------
        x, low, high : (n,) data; without a bar where one is NaN.
        wide : (n,) data, along the x axis.
        """
        first, last = (self.x.share(x + sign * 0.5 * wide) * self.width for sign in (-1.0, 1.0))
        lower, upper = self.y.share(low), self.y.share(high)
        good = (
            np.isfinite(first) & np.isfinite(lower) & np.isfinite(upper) & (last >= 0) & (first < self.width)
        )
        least, greatest = np.full(self.width, np.nan), np.full(self.width, np.nan)
        for k in np.flatnonzero(good).tolist():
            # a column belongs to the bar that covers its middle; a bar that covers none has the one of its own middle
            begin, end = math.ceil(first[k] - 0.5), math.ceil(last[k] - 0.5)
            if end <= begin:
                begin = int(0.5 * (first[k] + last[k]))
                end = begin + 1
            columns = slice(max(begin, 0), max(end, 0))
            least[columns] = np.fmin(least[columns], lower[k])
            greatest[columns] = np.fmax(greatest[columns], upper[k])
        self._fill(least, greatest, role)

    def _fill(self, low: Floats, high: Floats, role: str) -> None:
        """Fill columns of cells between two fractions (width,) of the y axis; NaN leaves a column empty."""
        top = self.top + (1 - np.clip(high, 0, 1)) * self.height
        bottom = self.top + (1 - np.clip(low, 0, 1)) * self.height
        thin = ~(bottom - top >= 0.5)  # cells; the points cover a thinner band
        self.canvas.fill(self.left, np.where(thin, np.nan, top), bottom, role)

    def label(self, x: float, y: float, text: str, role: str, mark: str = "◆") -> None:
        """Draw a mark at a point, with its text where it covers least."""
        cell = self.cell(x, y)
        if cell is None:
            return
        column, row = cell
        self.canvas.text(column, row, mark, role)
        # right, left, centred; on the row of the mark itself not centred, where the text would cover it
        sides = (column + 2, column - len(text) - 1, column - len(text) // 2)
        places = [(c, row + d) for d in (-1, 1, 0, -2, 2, -3, 3) for c in sides[: 2 if d == 0 else 3]]
        last = self.left + self.width - len(text)
        inside = [p for p in places if self.left <= p[0] <= last and 0 <= p[1] - self.top < self.height]
        if inside:
            c, r = min(inside, key=lambda p: self.canvas.overlap(p[0], p[1], len(text)))
            self.canvas.text(c, r, text, role)

    def grid(self, across: Sequence[float], down: Sequence[float]) -> None:
        """Draw faint lines at values of the two axes."""
        columns = {int(c) // 2 for c in self.across(np.array(across, dtype=np.float64)) if not math.isnan(c)}
        rows = {int(r) // 4 for r in self.down(np.array(down, dtype=np.float64)) if not math.isnan(r)}
        for row in rows:
            for column in range(self.left, self.left + self.width):
                self.canvas.put(column, row, "─", "grid")
        for column in columns:
            for row in range(self.top, self.top + self.height):
                self.canvas.put(column, row, "┼" if row in rows else "│", "grid")

    def x_labels(self, ticks: Sequence[tuple[float, str]], row: int) -> None:
        """Write the labels of the x axis in a row of cells, each centred on its value."""
        end = -1  # of the label before; one that would touch it is left out
        for value, text in ticks:
            dot = self.across(np.array([value]))[0]
            if math.isnan(dot):
                continue
            column = max(int(dot) // 2 - len(text) // 2, 0)
            column = min(column, self.canvas.width - len(text))
            if column > end:
                self.canvas.text(column, row, text, "muted")
                end = column + len(text)

    def y_labels(self, ticks: Sequence[tuple[float, str]]) -> None:
        """Write the labels of the y axis to the left of the frame."""
        last = -2
        for value, text in sorted(ticks, reverse=True):
            dot = self.down(np.array([value]))[0]
            if math.isnan(dot):
                continue
            row = int(dot) // 4
            if row != last:
                self.canvas.text(self.left - 1 - len(text), row, text, "muted")
                last = row
