"""Numbers of a report as text of limited width, and lines of styled text.

A measuring instrument must never truncate a number, so every text made here has a maximum width, and the
columns of the table are that wide. `Notation` chooses readable units or SI.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from imumon.model.coefficients import INDISTINCT_WORD, Estimate, mean_unit, unit_of
from imumon.model.messages import no_value_text
from imumon.model.samples import UNITS, ChannelName
from imumon.model.units import measured, number, pretty

Span = tuple[str, str]
"""Text and its role; the widget knows the colour of the role."""
Line = list[Span]

CELL = 14
"""Cells of the text of a coefficient, at most."""

_ASCII = str.maketrans(
    "●○◌◐■▌✕◆◇" "│─┼└┴├┤┌┐╭╮╰╯" "·…×÷▪▒━┄╌•−–" "▁▂▃▄▅▆▇█▀" "✓↓↑←→↗▏" "⁻⁰¹²³⁴⁵⁶⁷⁸⁹" "°√µστχ±",
    "*ooo#>x#o" "|-+++++++++++" "-~x/##---*--" "       ##" "*v^<>/|" "-0123456789" "ovustx~",
)  # fmt: skip


def _braille(character: str) -> str:
    """Return an ASCII character of the same shape as the dots, roughly.

    >>> _braille("⠁"), _braille("⣀"), _braille("⠤"), _braille("⡇")
    ("'", '.', '-', ':')
    """
    bits = ord(character) - 0x2800
    high, low = bits & 0b00011011, bits & 0b11100100
    middle = bits & 0b00110110
    if middle == bits or (high and low):
        return "-" if middle == bits and not (bits & 0b00001001) else ":"
    if bits & 0b11000000 and not bits & 0b00100100:
        return "."
    return "'" if high else "-"


def to_ascii(text: str) -> str:
    """Return the text in ASCII, of the same width: on a terminal without other characters, each has a like one.

    >>> to_ascii("● live · 3 h")
    '* live - 3 h'
    """
    if text.isascii():
        return text
    text = text.translate(_ASCII)
    return "".join(c if c.isascii() else _braille(c) if "\u2800" <= c <= "\u28ff" else "?" for c in text)


_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True, slots=True)
class Notation:
    """Notation of numbers: SI or readable units."""

    si: bool = False

    def scale(self, channel: ChannelName) -> tuple[float, str]:
        """Return the factor from SI and the unit in which the values of a channel are shown."""
        sensor = channel.sensor
        si = UNITS.get(sensor, "")
        factor, unit = (1.0, si) if self.si else mean_unit(sensor, si)
        return factor, pretty(unit)

    def deviation(self, channel: ChannelName) -> tuple[float, str]:
        """Return the factor from SI and the unit in which an Allan deviation is shown: those of B."""
        return self.coefficient_scale(channel.sensor, "B")

    def coefficient_scale(self, sensor: str, name: str) -> tuple[float, str]:
        """Return the factor from SI and the unit in which a coefficient is shown."""
        known = unit_of(sensor, name, UNITS.get(sensor, ""))
        return (1.0, pretty(known.si)) if self.si else (known.factor, pretty(known.unit))

    def limits(self, part: Estimate) -> tuple[float | None, float | None, float | None]:
        """Return value and the 95 % limits that documents state, in the unit shown."""
        shown = part.stated if self.si else part.stated.readable
        return shown.value, shown.low, shown.high

    def limit(self, sensor: str, name: str, value: float) -> str:
        """Return the limit of a grade, given in SI, with the digits of its table.

        >>> Notation().limit("gyro", "N", 5.8178e-5), Notation(si=True).limit("gyro", "N", 5.8178e-5)
        ('0.2', '5.82e-05')
        """
        return f"{value * self.coefficient_scale(sensor, name)[0]:.3g}"

    def goal(self, share: float) -> str:
        """Return a configured precision.

        >>> Notation().goal(0.2)
        '±20 %'
        """
        return f"±{100.0 * share:g} %"

    def coefficient(self, part: Estimate | None, seconds: float | None) -> Span:
        """Return a coefficient in at most `CELL` cells: value and uncertainty, `< bound`, or remaining time.

        Parameters
        ----------
        seconds : s until the configured precision; None: unknown.
        """
        if part is None:
            return "–", "faint"
        value, low, high = self.limits(part)
        if part.status == "measured" and value is not None:
            text = measured(value, low, high)
            # Blanks go first, the one before % before the one that parts two numbers: a number without its last
            # sign is another number.
            forms = (text, text.replace(" %", "%"), text.replace(" ", ""), number(value, 3))
            return next(form for form in forms if len(form) <= CELL), "text"
        if part.is_bound and high is not None:
            text = f"< {number(high, 2)}"
            return f"{text} {INDISTINCT_WORD}" if part.status == "indistinct" else text, "bound"
        if (why := no_value_text(part)) is not None:
            return why, "warn"
        return (f"in {approximate_duration(seconds)}", "muted") if seconds else ("pending", "faint")


def decade(exponent: int) -> str:
    """Return a power of ten.

    >>> decade(-2)
    '10⁻²'
    """
    return "10" + str(exponent).translate(_SUPERSCRIPT)


def approximate_duration(seconds: float) -> str:
    """Return a predicted length of time, no finer than it is certain, in at most 9 cells.

    >>> [approximate_duration(seconds) for seconds in (42.0, 734.0, 9000.0, 2e5, 1e9)]
    ['42 s', '12 min', '2.5 h', '2.3 d', '> 1 year']
    """
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    if seconds < 172800:
        return f"{seconds / 3600:.1f} h"
    return f"{seconds / 86400:.1f} d" if seconds < 3.15e7 else "> 1 year"


def wrap(text: str, width: int) -> list[str]:
    """Break a text into lines of at most `width` cells, at blanks; longer words are broken too."""
    return textwrap.wrap(text, max(width, 1), break_on_hyphens=False) or [""]


def marked(texts: Iterable[str], width: int, role: str) -> list[Line]:
    """Return texts as wrapped lines, each with a mark before its first one."""
    lines: list[Line] = []
    for text in texts:
        for k, part in enumerate(wrap(text, max(width - 5, 10))):
            lines.append([("    " if k else "  ! ", "warn"), (part, role)])
    return lines


def length(line: Line) -> int:
    return sum(len(text) for text, _ in line)


def padded(line: Line, width: int) -> Line:
    """Return a line of exactly `width` cells: filled with blanks, or truncated with an ellipsis."""
    missing = width - length(line)
    if missing >= 0:
        return [*line, (" " * missing, "text")] if missing else line
    out: Line = []
    remaining_cells = max(width - 1, 0)
    for text, name in line:
        out.append((text[:remaining_cells], name))
        remaining_cells -= len(text)
        if remaining_cells <= 0:
            break
    return [*out, ("…", "faint")] if width > 0 else []


def fitted(parts: Sequence[Line], width: int) -> Line:
    """Return the parts that fit, the first always; a number is omitted rather than truncated."""
    line: Line = []
    for part in parts:
        if not line or length(line) + length(part) <= width:
            line = [*line, *part]
    return line


def with_background(line: Line, background: str) -> Line:
    """Return the line on another background."""
    return [(text, f"{role.partition('/')[0]}/{background}") for text, role in line]
