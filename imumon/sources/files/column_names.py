"""Names of columns: words, the unit in a name, and columns whose names differ only by the axis."""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from imumon.model.report_json import plain
from imumon.model.samples import AXES, INERTIAL, Floats, Kind
from imumon.sources.files.sizes_at_rest import FEWEST, have_one_noise, median_size
from imumon.sources.files.unit_grammar import Unit, known_unit

ANGULAR = re.compile(
    r"gyr|angular|omega|(?:^| )(?:ang ?vel|w|wb|g|rate|rates|pqr|fog|turn|omg|rotation|rot|roll ?rate)(?: |$)"
    r"|rotation ?rate|turn ?rate",
    re.IGNORECASE,
)
LINEAR = re.compile(r"acc|(?:^| )(?:a|f|fb|ab|lin|gf)(?: |$)|linear|specific", re.IGNORECASE)
OTHER = re.compile(
    r"mag(?!nit)|ang(?:ular)? ?acc|rot(?:ation)? ?vec|quat|orient|euler|attitude|bias|drift|offset|cov"
    r"|(?:^| )(?:m|b|q|pos|gps|v|(?<!ang )(?<!angular )vel(?:ocity)?"
    r"|std|sigma|var|noise|cmd|motor|setpoint|sp|ned|user)(?: |$)"
    r"|gravity|dcm|matrix|position|north|east|earth|estimat|user ?acc",
    re.IGNORECASE,
)
DELTA = re.compile(
    r"delta|incr|(?:^| )(?:d ?theta|d ?vel|d ?v|d ?ang|theta|integral)(?: |$)|dtheta|dvel|dang", re.IGNORECASE
)
TIME = re.compile(
    r"time|stamp|clock|epoc|elapsed"
    r"|(?:^| )(?:t|utc|tow|date|ticks?|millis|micros|nanos|ts|cts|rtc|hms|secs?|seconds)(?: |$)",
    re.IGNORECASE,
)
COUNTER = re.compile(
    r"(?:^| )(?:count|counter|cntr|index|idx|seq|sequence|frame|packet|sample|n|id|line|iteration|row|number)(?: |$)",
    re.IGNORECASE,
)
COUNTS = re.compile(r"^(?:lsb|counts?|raw|adc|digits?|codes?)$", re.IGNORECASE)

_AXIS_SETS = (
    ("x", "y", "z"),
    ("0", "1", "2"),
    ("1", "2", "3"),
    ("roll", "pitch", "yaw"),
    ("p", "q", "r"),
    ("beta", "gamma", "alpha"),
    ("surge", "sway", "heave"),
)
_FOURTH = {"x": "w", "0": "3", "1": "4"}
_AXIS_PLACES = re.compile(
    r"(?i:roll|pitch|yaw|alpha|beta|gamma|surge|sway|heave|(?<![a-z])[xyzwpqr](?![a-z]))|(?<![0-9])[0-4](?![0-9])"
    r"|(?<=[a-z])[XYZW](?![a-z])|(?<=[A-Z])[XYZ](?![A-Za-z])|(?<=[A-Za-z])[xyzw](?![A-Za-z])|(?<![A-Za-z])[xyzXYZ](?=[Gg]yro|[Aa]cc|[Mm]ag|[Rr]ate|[Aa]ng)"
)
"""Where the letter of an axis may be: a word, a number, a capital within words, a last letter, or before a sensor."""


@dataclass(frozen=True, slots=True)
class NamedColumn:
    """A column as its name and numbers show it.

    Attributes
    ----------
    base : name without its unit.
    unit : as it is stated; empty: none is.
    known : what the unit means.
    values : (n,) numbers in the head; not finite is missing.
    """

    index: int
    name: str
    base: str
    unit: str
    known: Unit | None
    values: Floats

    @property
    def words(self) -> str:
        return words_of(self.base)

    @property
    def present(self) -> Floats:
        return self.values[np.isfinite(self.values)]

    @property
    def constant(self) -> bool:
        there = self.present
        return not len(there) or bool(np.ptp(there) == 0.0)

    @property
    def rises(self) -> bool:
        """Whether the numbers never fall, as those of a clock; single ones may, and a counter may wrap."""
        there = self.present
        if len(there) < 3 or there[-1] == there[0]:
            return False
        steps = np.diff(there)
        return bool((steps >= 0.0).mean() > 0.97) and bool((steps > 0.0).sum() >= min(5, len(steps) // 2))


def words_of(text: str) -> str:
    """Return the words of a name in lower case, apart by blanks.

    >>> words_of("UncalGyroXRadPerSec"), words_of("imu/angular_velocity.x"), words_of("GyrX")
    ('uncal gyro x rad per sec', 'imu angular velocity x', 'gyr x')
    """
    text = "".join(c for c in unicodedata.normalize("NFD", text) if not unicodedata.combining(c))
    text = re.sub(r"([a-z0-9])([A-Z])", r"\1 \2", text)
    text = re.sub(r"([A-Z]+)([A-Z][a-z])", r"\1 \2", text)
    return " ".join(re.findall(r"[^\W\d_]+|\d+", text.lower()))


_BRACKETS = re.compile(r"\s*(?:\[([^\[\]]*)\]|\(((?:[^()]|\([^()]*\))*)\)|\{([^{}]*)\})")
_NO_UNIT = re.compile(
    r"x?[0-9A-Fa-f]{1,4}|[-+]?\d+|txt|n|\W*|na|integer|flags?|wgs84|xyz|[xyz],[xyz],[xyz]|formatted",
    re.IGNORECASE,
)
_WITH_ONE_LETTER = {
    "g": r"acc|(?:^| )(?:[af]f?[xyz]?|g?f[xyz])(?: [xyz])?$",
    "s": r"(?:^| )(?:t|dt)$|time|stamp|elapsed",
    **dict.fromkeys("hm", r"time"),
    **dict.fromkeys("ck", r"temp"),
}
"""One letter at the end of a name is a unit only behind such words."""

_TIMES = r"time|stamp|(?:^| )(?:t|dt|ts|interval)(?: |$)|elapsed|epoc"
"""Words before a short word that is a unit of time, and else another word."""


def split_unit(name: str) -> tuple[str, str]:
    """Return a name without its unit, and the unit that it states; empty: none.

    >>> split_unit("A_X [mg]"), split_unit("gyro_rps_x"), split_unit("gyroADC[0]"), split_unit("t_ms")
    (('A_X', 'mg'), ('gyro_x', 'rps'), ('gyroADC[0]', ''), ('t', 'ms'))
    >>> split_unit("raw_angular_rate_x_deg_per_s"), split_unit("accelXMps2"), split_unit("ax_g"), split_unit("seconds")
    (('raw_angular_rate_x', 'deg_per_s'), ('accelX', 'Mps2'), ('ax', 'g'), ('seconds', 'seconds'))
    """
    text, *behind_bars = re.split(r"[\"']?\|[\"']?", name.strip().strip("\"'").lstrip("#% "))
    text = " ".join([text, *(f"[{part}]" for part in behind_bars if re.search(r"[^\W\d]", part))])
    text, stated = _without_brackets(text)
    if stated:
        return text.strip(), stated
    body, axis = re.fullmatch(r"(?is)(.*?)([\s_.]+(?:[xyz]|roll|pitch|yaw)|\[\d\])?", text).groups()  # type: ignore[union-attr]
    # the longest end of the name that is a unit: behind a sign, a blank or a capital
    for begin in re.finditer(
        r"(?:^|(?<=[\W_])|(?<=[a-z\d])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z]))(?=\w|°)", body
    ):
        before, unit = body[: begin.start()], body[begin.start() :]
        if _is_unit(unit, words_of(before)):
            rest = re.sub(r"[\s_.,;|:\"]+(?:in)?$|\s+in\s*$", "", before) or (text if not axis else before)
            return f"{rest}{axis or ''}", unit
    return text, ""


def _is_unit(text: str, before: str) -> bool:
    """Return whether the end of a name is a unit, by the words before it."""
    known = known_unit(text)
    if known is None or not before:  # alone, a word such as millis is a time, and a letter is a name
        return known is not None and known.quantity == "t" and len(text) > 2
    if len(text) == 1:
        return re.search(_WITH_ONE_LETTER.get(text.lower(), "$^"), before) is not None
    is_word = known.quantity == "t" and text.lower() in ("ms", "us", "ns", "min")
    return not is_word or re.search(_TIMES, before) is not None


def _without_brackets(text: str) -> tuple[str, str]:
    """Return a name without the text in brackets, and the unit in them; empty: none."""
    stated = ""
    for match in list(_BRACKETS.finditer(text))[::-1]:
        inside = next((part for part in match.groups() if part is not None), "").strip()
        if re.fullmatch("[0-8xyzXYZ]", inside):
            continue
        known = known_unit(inside) is not None
        if _NO_UNIT.fullmatch(inside) and not known:
            text = text[: match.start()] + text[match.end() :]
        elif known or (not stated and match.end() == len(text)):
            stated, text = inside, text[: match.start()] + text[match.end() :]
    return text, stated


@dataclass(frozen=True, slots=True)
class Triple:
    """Three columns whose names differ only by the axis, or one axis alone."""

    columns: tuple[NamedColumn, ...]
    axes: tuple[str, ...]
    stem: str
    guessed: bool = False  # no name states the axes

    @property
    def indices(self) -> tuple[int, ...]:
        return tuple(column.index for column in self.columns)

    @property
    def label(self) -> str:
        return ", ".join(label_of(column) for column in self.columns)

    @property
    def words(self) -> str:
        return words_of(self.stem)

    @property
    def rows(self) -> Floats:
        return np.column_stack([column.values for column in self.columns])

    @property
    def size(self) -> float:
        """Median length."""
        return median_size(self.rows) or 0.0

    @property
    def unit(self) -> str:
        return next((column.unit for column in reversed(self.columns) if column.unit), "")

    @property
    def known_quantity(self) -> str | None:
        """Quantity of the unit that is stated; None: none is, or it is not known."""
        return next((c.known.quantity for c in reversed(self.columns) if c.known is not None), None)

    @property
    def counts(self) -> bool:
        """Whether all numbers are whole, and differ."""
        there = self.rows[np.isfinite(self.rows)]
        return bool(len(there) >= FEWEST and np.ptp(there) > 1.0 and (there == np.rint(there)).all())


def triples(columns: Sequence[NamedColumn]) -> list[Triple]:
    """Return the triples of a table, in the order of their first columns; each column belongs to one at most."""
    complete = _axis_triples(columns)
    used: set[int] = set()
    result = []
    elements = Counter(k for triple in complete for k in triple.indices)
    for triple in sorted(complete, key=lambda t: (max(elements[k] for k in t.indices), min(t.indices))):
        if not used & set(triple.indices) and len(set(triple.indices)) == 3:
            used |= set(triple.indices)
            result.append(triple)
    return sorted(
        [*result, *_unnamed([c for c in columns if c.index not in used])], key=lambda t: min(t.indices)
    )


def _axis_triples(columns: Sequence[NamedColumn]) -> list[Triple]:
    """Return all triples of columns whose names differ only by the axis; a column may belong to several."""
    places: dict[tuple[str, str, str, int], dict[str, NamedColumn]] = {}
    # columns of a name so far: another sensor may have the same, with another unit
    earlier: Counter[str] = Counter()
    for column in columns:
        earlier[column.base] += 1
        for match in _AXIS_PLACES.finditer(column.base):
            letter = match[0].lower()
            before, behind = column.base[: match.start()].lower(), column.base[match.end() :].lower()
            for letters in _AXIS_SETS:
                if letter in letters or letter == _FOURTH.get(letters[0]):
                    key = letters[0], before, behind, earlier[column.base]
                    places.setdefault(key, {}).setdefault(letter, column)
    complete: list[Triple] = []
    for (first, before, behind, _), axes in places.items():
        letters = next(letters for letters in _AXIS_SETS if letters[0] == first)
        if all(letter in axes for letter in letters) and _FOURTH.get(first) not in axes:
            complete.append(Triple(tuple(axes[letter] for letter in letters), AXES, f"{before} {behind}"))
    return complete


_ELEMENT = re.compile(r"(.*?)(?:\[\d+\]|\.\d+|\d*)")


def _unnamed(columns: Sequence[NamedColumn]) -> Iterator[Triple]:
    """Yield the triples of neighbours that are elements of one list, have one sensor in their names, or one noise.

    Their order is that of the axes, which nothing states.
    """
    free = [c for c in columns if not c.constant and not (c.rises and not c.base.strip("0123456789"))]
    k = 0
    while k + 2 < len(free):
        three = free[k : k + 3]
        elements = [_ELEMENT.fullmatch(c.base) for c in three]
        stems = {match[1] for match in elements if match is not None}
        common = _common_words([words_of(c.base).split() for c in three])
        adjacent = three[2].index - three[0].index == 2 and not any(c.rises for c in three)
        is_sensor = have_one_noise([c.values for c in three]) if stems == {""} else len(stems) == 1
        if adjacent and (is_sensor or names_sensor(common)):
            stem = stems.pop() if len(stems) == 1 else common
            yield Triple(tuple(three), AXES, stem, guessed=True)
            k += 3
        else:
            k += 1


def _common_words(names: Sequence[Sequence[str]]) -> str:
    """Return the words that some names have in common, if each has one other word; empty: they do not.

    >>> _common_words([["gyro", "raw"], ["gyro", "yaw"]]), _common_words([["surge", "acc"], ["heave", "acc"]])
    ('gyro', 'acc')
    """
    common = [word for word in names[0] if all(word in words for words in names)]
    return " ".join(common) if all(len(words) == len(common) + 1 for words in names) else ""


def named_channel(name: str) -> tuple[str, str]:
    """Return the channel that a name alone shows, and the unit in it; empty: none.

    >>> named_channel("gx"), named_channel("acc_y"), named_channel("t_ms"), named_channel("speed")
    (('gyro/x', ''), ('accel/y', ''), ('t', 'ms'), ('', ''))
    """
    base, unit = split_unit(name)
    words = words_of(base)
    if words in ("t", "time", "timestamp", "millis", "micros"):
        return "t", unit or {"millis": "ms", "micros": "us"}.get(words, "")
    for channel, pattern in (("temperature", r"^temp"), ("pressure", r"^press?")):
        if re.search(pattern, words):
            return channel, unit
    match = re.fullmatch(r"(.*?)[\s_.]*([xyzXYZ])", base)
    stem = words_of(match[1]) if match else ""
    for sensor, meaning in (("mag", re.compile(r"^m$|mag")), ("gyro", ANGULAR), ("accel", LINEAR)):
        if match is not None and meaning.search(stem):
            return f"{sensor}/{match[2].lower()}", unit
    return "", ""


def names_sensor(name: str) -> bool:
    """Return whether a name is that of a gyroscope or an accelerometer."""
    words = words_of(split_unit(name)[0])
    return bool(ANGULAR.search(words) or LINEAR.search(words)) and not OTHER.search(words)


def names_time(name: str) -> bool:
    """Return whether a name is that of a time or an interval."""
    return (
        re.search(r"^dt$", words_of(name)) is not None
        or TIME.search(words_of(split_unit(name)[0])) is not None
    )


def inertial_sensor_of(words: str) -> str:
    """Return the sensor that words name; empty: none."""
    delta = DELTA.search(words)
    if ANGULAR.search(words) or (delta and re.search(r"theta|ang|gyr|rot", words)):
        return "gyro"
    return "accel" if LINEAR.search(words) or (delta and "vel" in words) else ""


def is_of_another_sensor(words: str, quantity: str | None) -> bool:
    """Return whether the unit or the words of a triple are those of something else than an inertial sensor."""
    if quantity in ("mag", "temperature", "pressure", "t"):
        return True
    is_inertial = quantity in ("gyro", "accel")
    # user acceleration and the rate of the earth frame have the unit, and are of a sensor
    other = re.search(r"bias|drift|offset|std|cov|gravity|mag", words) if is_inertial else True
    return bool(OTHER.search(words) and other)


def is_of_one_axis(column: NamedColumn, words: str) -> bool:
    """Return whether a single column is of an inertial sensor, by its unit or words."""
    if column.constant:
        return False
    if column.known is not None:
        return column.known.quantity in INERTIAL
    return bool(inertial_sensor_of(words)) and not column.rises and not column.unit


def label_of(column: NamedColumn) -> str:
    """Return what people call a column."""
    return plain(column.name.strip()) or f"column {column.index + 1}"


def kind_of(words: str) -> Kind:
    """Return whether words say that numbers are compensated."""
    if re.search(r"uncomp|(?:^| )(?:raw|uncal)", words):
        return "uncompensated"
    return "compensated" if re.search(r"(?:^| )comp|(?:^| )angular rate(?: |$)", words) else "unknown"
