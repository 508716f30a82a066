"""Units: factors from SI, and numbers to text.

Factors are exact by definition: a degree is pi/180 rad, an hour 3600 s, a g 9.80665 m/s^2.
JSON uses ASCII spellings, `pretty` returns those for a screen.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from itertools import pairwise

DEG = math.degrees(1.0)
MINUTE, HOUR, DAY, YEAR = 60.0, 3600.0, 86400.0, 365.25 * 86400.0
FLICKER = math.sqrt(2.0 * math.log(2.0) / math.pi)
"""Allan deviation of flicker noise over its B."""
STANDARD_GRAVITY = 9.80665


def pretty(unit: str) -> str:
    """Return a unit for a screen.

    >>> pretty("deg/sqrt(h)"), pretty("m/s^2/sqrt(Hz)"), pretty("rad/s*sqrt(Hz)")
    ('°/√h', 'm/s²/√Hz', 'rad/s·√Hz')
    """
    text = unit.replace("sqrt(h)", "√h").replace("sqrt(Hz)", "√Hz").replace("^2", "²")
    text = text.replace("ug/", "µg/").replace("uG/", "µG/")
    return text.replace("degC", "°C").replace("deg", "°").replace("*", "·")


_UNIT_WORDS = frozenset(("s", "h", "min", "rad", "deg", "gauss", "mg"))


def sentence(text: str) -> str:
    """Return a text as the beginning of a sentence; a unit or a name at its beginning keeps its case, as all else does.

    >>> sentence("waiting for /dev/ttyUSB0"), sentence("m/s^2 per degC"), sentence("gyro/x: constant")
    ('Waiting for /dev/ttyUSB0', 'm/s^2 per degC', 'gyro/x: constant')
    """
    word = text.split(" ", 1)[0].rstrip(",.:;")
    # A word with a sign or a capital in it is a unit, a channel or a name, and with a capital it would be another one.
    if not re.fullmatch("[a-z]+(['-][a-z]+)*", word) or word in _UNIT_WORDS:
        return text
    return f"{text[0].upper()}{text[1:]}"


def figures(value: float, digits: int = 3) -> str:
    """Return a number with `digits` significant digits, in plain notation if that is short.

    >>> figures(0.21037), figures(12.0), figures(12345.6), figures(3.2e-7)
    ('0.210', '12.0', '12,300', '3.20e-07')
    """
    if value == 0.0:
        return "0"
    size = abs(value)
    if not 1e-3 <= size < 1e6:
        return f"{value:.{digits - 1}e}"
    decimals = digits - 1 - math.floor(math.log10(float(f"{size:.{digits - 1}e}")))
    return f"{round(value, decimals):,.{max(decimals, 0)}f}"


def number(value: float, digits: int) -> str:
    """Return a number in at most eight cells without its sign.

    >>> number(0.30451, 4), number(8.858e-5, 4), number(123456.7, 4)
    ('0.3045', '8.86e-05', '123,500')
    """
    text = figures(value, digits)
    return figures(value, min(digits, 3)) if "e" in text else text


def short(value: float) -> str:
    """Return a positive number in at most seven cells.

    >>> short(0.03213), short(0.00057), short(12345.6)
    ('0.0321', '5.7e-04', '12,300')
    """
    text = figures(value, 3)
    return figures(value, 2) if "e" in text else text


def percent(relative: float) -> str:
    """Return a relative uncertainty below 100 % in at most five cells.

    >>> percent(0.0312), percent(1.234), percent(34.2)
    ('0.1 %', '1.2 %', '34 %')
    """
    return f"{max(relative, 0.1):.1f} %" if relative < 9.95 else f"{relative:.0f} %"


def share_text(share: float) -> str:
    """Return a share in percent with two digits.

    >>> share_text(0.03), share_text(0.0312), share_text(1.0), share_text(12.34)
    ('3 %', '3.1 %', '100 %', '1,200 %')
    """
    percent = 100.0 * share
    return f"{percent:.2g} %" if abs(percent) < 99.5 else f"{figures(percent, 2)} %"


WIDE_PERCENT = 50.0
"""Percent, half-width of limits beyond which they are shown as a factor: they are skewed, and above 0."""


def measured(value: float, low: float | None, high: float | None) -> str:
    """Return a value with the half-width of its limits in percent, or with their factor if they are wide.

    >>> measured(0.30451, 0.301, 0.308), measured(0.00123, 0.0002, 0.0031), measured(1.2, None, None)
    ('0.305 ±1.1 %', '0.0012 ×÷3.9', '1.20')
    """
    if low is None or high is None or value <= 0.0:
        return number(value, 3)
    relative = 50.0 * (high - low) / value
    if relative > WIDE_PERCENT:
        factor = math.sqrt(high / low) if low > 0.0 else math.inf
        return f"{number(value, 2)} ×÷{f'{factor:.1f}' if factor < 9.95 else '>9'}"
    digits = 4 if relative < 0.5 else 3 if relative < 10.0 else 2
    return f"{number(value, digits)} ±{percent(relative)}"


def plus_minus(value: float, low: float | None, high: float | None, digits: int) -> str:
    """Return a value, with some digits, and the half-width of its limits.

    >>> plus_minus(-0.206, -0.247, -0.165, 3)
    '-0.206 ±0.041'
    """
    half = "" if low is None or high is None else f" ±{number(0.5 * (high - low), 2)}"
    return f"{number(value, digits)}{half}"


def counted(count: int, what: str) -> str:
    """Return a number of things.

    >>> counted(1, "gap"), counted(1200, "sample")
    ('1 gap', '1,200 samples')
    """
    return f"{count:,} {what}{'' if count == 1 else 's'}"


def in_columns(rows: Iterable[Sequence[str]], gap: str = "  ") -> list[str]:
    """Return rows of cells as lines, whose columns are as wide as their longest cell.

    >>> in_columns([("gyro", "0.21"), ("acceleration", "1")])
    ['gyro          0.21', 'acceleration  1']
    """
    lines = list(rows)
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return [gap.join(map(str.ljust, line, widths)).rstrip() for line in lines]


def duration(seconds: float) -> str:
    """Return a length of time in its two largest units.

    >>> duration(7.2), duration(138), duration(5400), duration(200000)
    ('7 s', '2 min 18 s', '1 h 30 min', '2 d 7 h')
    """
    if seconds < 60:
        return f"{seconds:.0f} s"
    total = round(seconds)
    units = ((86400, "d"), (3600, "h"), (60, "min"), (1, "s"))
    (big, big_name), (small, small_name) = next(two for two in pairwise(units) if total >= two[0][0])
    rest, head = total % big // small, f"{total // big} {big_name}"
    return f"{head} {rest} {small_name}" if rest and total < 100 * big else head


_SECONDS = {"u": 1e-6, "ms": 1e-3, "s": 1.0, "m": 60.0, "min": 60.0, "h": HOUR, "d": DAY, "w": 7.0 * DAY}
_LENGTH = r"(\d+(?:\.\d*)?|\.\d+)\s*(u|ms|s|m|min|h|d|w)\s*"


def seconds(text: str) -> float:
    """Return the seconds of a length of time that somebody wrote; raise ValueError if it is none.

    The units are those of Zenoh, and min.

    >>> seconds("90"), seconds("90s"), seconds("10m"), seconds("1h30m"), seconds("0.5 d"), seconds("1e3")
    (90.0, 90.0, 600.0, 5400.0, 43200.0, 1000.0)
    """
    text = text.strip().lower()
    if re.fullmatch(f"({_LENGTH})+", text, re.ASCII):
        total = sum(float(value) * _SECONDS[unit] for value, unit in re.findall(_LENGTH, text, re.ASCII))
    else:
        total = float(text)
    if not 0.0 <= total < math.inf:
        raise ValueError("a length of time is finite")
    return total
