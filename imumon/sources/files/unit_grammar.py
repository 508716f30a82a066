"""Units as people write them: a grammar of numbers, prefixes, bases, powers, and what they are per.

A table of spellings never ends: ``rad s^-1``, ``RadPerSec``, ``rad_per_s``, ``mdeg/s``, ``10us``. Here a unit is a
product of bases, each with a number, a prefix and a power; what is behind a sign of division or the word per has
the opposite power. The powers of the dimensions give the quantity.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from imumon.model.units import STANDARD_GRAVITY

POSSIBLE_HZ = (1e-3, 2e4)
"""Hz, rates that are possible if the unit is given."""


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit: its quantity, and value in SI (gauss, degC, kPa) = number * factor - zero."""

    quantity: str
    factor: float
    zero: float = 0.0


_WORDS = {
    "angle": {
        "rad": 1.0,
        "deg": math.radians(1.0),
        "arcsec": math.radians(1.0 / 3600.0),
        "rev": 2.0 * math.pi,
    },
    "length": {"m": 1.0, "ft": 0.3048},
    "time": {"s": 1.0, "min": 60.0, "h": 3600.0, "day": 86400.0, "nano": 1e-9},
    "accel": {"g": STANDARD_GRAVITY, "gal": 1e-2},
    "gyro": {"dps": math.radians(1.0), "rps": 1.0, "dph": math.radians(1.0 / 3600.0)},
    "mag": {"gauss": 1.0, "t": 1e4},
    "temperature": {"degc": 1.0, "c": 1.0, "k": 1.0},
    "pressure": {"pa": 1e-3, "bar": 1e2},
}
"""Bases by dimension, with their factor to SI (gauss, degC, kPa)."""

_SPELLINGS = {
    **dict.fromkeys(("rads", "radian", "radians"), "rad"),
    **dict.fromkeys(("degs", "degree", "degrees", "°"), "deg"),
    **dict.fromkeys(("meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("mins", "minute", "minutes"), "min"),
    **dict.fromkeys(("hr", "hrs", "hour", "hours"), "h"),
    **dict.fromkeys(("gs", "gravity", "gee", "gn"), "g"),
    **dict.fromkeys(("°c", "celsius"), "degc"), "kelvin": "k", "tesla": "t", "gs(mag)": "gauss", "arcseconds": "arcsec",
}  # fmt: skip

_GLUED = {
    **dict.fromkeys(("mps2", "mpss", "ms2", "mss", "ms-2", "mps^2", "mpersec2", "m_s2"), "m/s^2"),
    "mmps2": "mm/s^2", "mps": "m/s", "ms-1": "m/s",
    **dict.fromkeys(("radps", "rads", "rads-1", "r/s"), "rad/s"),
    **dict.fromkeys(("degps", "degs", "degs-1", "d/s"), "deg/s"), "mdegps": "mdeg/s", "mradps": "mrad/s",
}  # fmt: skip
"""Units that are written without their signs: of a sensor, ``rads`` and ``degs`` are rates."""

_PREFIXES = {
    "m": 1e-3,
    "u": 1e-6,
    "n": 1e-9,
    "k": 1e3,
    "c": 1e-2,
    "h": 1e2,
    "milli": 1e-3,
    "micro": 1e-6,
    "nano": 1e-9,
}

DIMENSIONS = {
    "gyro": [{"gyro": 1}, {"angle": 1, "time": -1}],
    "accel": [{"accel": 1}, {"length": 1, "time": -2}],
    "angle": [{"angle": 1}],
    "velocity": [{"length": 1, "time": -1}, {"accel": 1, "time": 1}],
    "t": [{"time": 1}],
    **{name: [{name: 1}] for name in ("mag", "temperature", "pressure")},
}
"""Dimensions of each quantity; the powers of bases."""


def known_unit(text: str, quantity: str = "") -> Unit | None:
    """Return what a unit means, as people write it; None: it is none that is known.

    Parameters
    ----------
    quantity : that it is likely to have: ``G`` of a field is gauss.

    >>> known_unit("rad s^-1"), known_unit("m/(s^2)").quantity, known_unit("2s"), known_unit("ticks")
    (Unit(quantity='gyro', factor=1.0, zero=0.0), 'accel', Unit(quantity='t', factor=2.0, zero=0.0), None)
    >>> known_unit("deg_per_s") == known_unit("°/s") == known_unit("dps"), known_unit("mdeg").quantity
    (True, 'angle')
    """
    unit = _with_signs(text, quantity)
    product = _product(unit)
    if product is None:
        return None
    dimensions, factor = product
    quantity_of = next((name for name, of in DIMENSIONS.items() if dimensions in of), None)
    zero = 273.15 if quantity_of == "temperature" and unit in ("k", "kelvin") else 0.0
    return None if quantity_of is None else Unit(quantity_of, factor, zero)


def _with_signs(text: str, quantity: str) -> str:
    """Return a unit in lower case, with signs in place of words and blanks."""
    unit = unicodedata.normalize("NFKC", text.replace("º", "°").replace("˚", "°")).strip().strip("[](){}'\" ")
    unit = unit.replace("μ", "u").replace("**", "^").lower()
    if quantity == "mag":
        unit = re.sub(r"^(m?)gs?$", r"\1gauss", unit)
    unit = re.sub(r"\s+per\s+|_per_|per(?=s|h)", "/", unit)
    unit = re.sub(r"\s*squared\b", "^2", unit)
    unit = re.sub(r"[()]", "", unit)
    unit = _GLUED.get(re.sub(r"[\s_]", "", unit), unit) if quantity not in ("angle", "t") else unit
    unit = re.sub(r"(?<=[a-z])[\s*·._]+(?=[a-z])", "*", unit)
    return re.sub(r"\s+", "", unit)


def _product(unit: str) -> tuple[dict[str, int], float] | None:
    """Return the powers of the dimensions of a unit, and its factor; None: a base is not known."""
    powers: Counter[str] = Counter()
    factor = 1.0
    for place, part in enumerate(unit.split("/")):
        for item in part.split("*"):
            match = re.fullmatch(r"(.*?[^\d^-])\^?(-?\d)?", item)
            word = _base(match[1]) if match else None
            if match is None or word is None:
                return None
            power = int(match[2] or 1) * (-1 if place else 1)
            powers[word[0]] += power
            factor *= word[1] ** power
    return {name: power for name, power in powers.items() if power}, factor


def _base(text: str) -> tuple[str, float] | None:
    """Return the dimension of a base with a number and a prefix, and its factor; None: it is none."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?(?:e[-+]?\d+)?)?(.+)", text)
    if match is None:
        return None
    scale, word = float(match[1] or 1.0), match[2]
    for prefix, size in (("", 1.0), *_PREFIXES.items()):
        if not word.startswith(prefix) or (prefix and len(word) == len(prefix)):
            continue
        base = word[len(prefix) :]
        spelling = _SPELLINGS.get(base, base)
        for dimension, bases in _WORDS.items():
            if spelling in bases and (
                not prefix or (dimension not in ("temperature",) and spelling not in ("min", "h", "gal"))
            ):
                return dimension, scale * size * bases[spelling]
    return None


_NUMBER = r"[^\d\n\w]{0,12}(?:hz\W*|is )?(\d+(?:\.\d+)?)[ \t]*([^\W\d][^\s,;)]*)?"
_RATE = re.compile(
    r"([^,;|\n]{0,40}?)(rate|(?:\b|_)(?:frequency|freq|fs|odr|sampling)|\bat(?=\s+[\d.]+\s*k?hz))(?:_hz)?\b"
    + _NUMBER,
    re.IGNORECASE,
)
"""Text before the word of a rate, the word, a number, and the word behind it."""

_OF_SAMPLES = re.compile(
    r"sampl|data|update|output|meas|log|record|imu|gyr|acc|sensor|acqui|abtast|stream|publish|captur|^[^a-z]*$",
    re.IGNORECASE,
)
"""Words before a rate or a frequency of samples; none may be there, too."""

_PERIOD = re.compile(
    r"(?:(?:sampl|log|record|output|updat|print)\w{0,9}[\s_-]?(?:period|interval)|sample[\s_-]?time|\bdt)\b"
    rf"\s*(?:[\[(](\w+)[\])])?{_NUMBER}",
    re.IGNORECASE,
)
"""Unit of an interval of samples or rows in brackets, a number, and the word behind it."""

_OF_OTHERS = re.compile(
    r"baud|bit|gps|gnss|frame|video|camera|heart|refresh|mag|baro|press|temp|max|bandwidth|filter|pass|cut",
    re.IGNORECASE,
)
"""Words before a rate that is not that of samples of the sensor."""

_THINNED = re.compile(r"every\s+\d|decimat|(?:down|sub)-?sampl", re.IGNORECASE)
"""Words of a text whose rows are a part of the samples: the rate that it states is not that of the rows."""


class StatedRate(NamedTuple):
    """A rate that a text states.

    Attributes
    ----------
    hz : the rate, Hz.
    of_rows : it is that of the rows; else the output data rate, a setting of the chip, which may be read less often.
    """

    hz: float
    of_rows: bool = True


def stated_rate(text: str) -> StatedRate | None:
    """Return the rate beside the word rate or Fs, or of a stated interval; None: there is none, or several.

    >>> [each and each.hz for each in map(stated_rate, ("// Update Rate: 100.0Hz", "Fs,100", "at 52 Hz", "range 8"))]
    [100.0, 100.0, 52.0, None]
    >>> [each and each.hz for each in map(stated_rate, ("GPS rate: 5 Hz", "rate 2000 dps", "Sampling period: 10 ms"))]
    [None, None, 100.0]
    >>> stated_rate("ODR: 100 Hz"), stated_rate("ODR: 1000 Hz, every 10th is logged")
    (StatedRate(hz=100.0, of_rows=False), None)
    """
    stated = [
        StatedRate(
            float(number) * (1e3 if behind.lower().startswith("khz") else 1.0),
            not re.search(r"output data rate$|odr$", before + word, re.IGNORECASE),
        )
        for before, word, number, behind in _RATE.findall(text)
        if known_unit(behind) is None
        and not _OF_OTHERS.search(before)
        and (word.lower().strip("_") not in ("rate", "freq", "frequency") or _OF_SAMPLES.search(before))
    ]
    stated += map(StatedRate, _rates_of_intervals(text))
    rates = {rate.hz for rate in stated}
    hz = rates.pop() if len(rates) == 1 and not _THINNED.search(text) else 0.0
    return StatedRate(hz, any(r.of_rows for r in stated)) if POSSIBLE_HZ[0] <= hz <= POSSIBLE_HZ[1] else None


def _rates_of_intervals(text: str) -> Iterator[float]:
    """Yield the rate of each interval of samples that a text states, Hz."""
    for in_brackets, number, behind in _PERIOD.findall(text):
        unit = known_unit(in_brackets or behind)
        if unit is not None and unit.quantity == "t" and float(number) > 0.0:
            yield 1.0 / (float(number) * unit.factor)
