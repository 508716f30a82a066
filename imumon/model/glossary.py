"""Glossary: each word that screen, tables and documents use, in at most three sentences, with the page that has more.

Caveats have the texts of `messages`. Everything else that a user may meet without having read a document is here.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from typing import NamedTuple

from imumon.model.coefficients import COEFFICIENTS, GRADES
from imumon.model.messages import CAVEATS, GRADE_WORDS, NOT_APART
from imumon.model.units import sentence


class Explanation(NamedTuple):
    """What a word means.

    Attributes
    ----------
    word : as it is shown.
    text : at most three sentences.
    page : document that has more.
    """

    word: str
    text: str
    page: str

    @property
    def sentence(self) -> str:
        """The word and its meaning in one text.

        >>> explain("K").sentence[:12], explain("gap").sentence[:12]
        ('K is random ', 'gap: Samples')
        """
        if self.text.startswith(f"{self.word} "):
            return self.text
        return f"{self.word.replace('_', ' ')}: {self.text}"


THEORY, FILTERS, REPORTS, VN100 = "docs/THEORY.md", "docs/FILTERS.md", "docs/REPORTS.md", "docs/VN100.md"

_COEFFICIENTS: Mapping[str, str] = {
    "N": "The angle of a gyroscope that is integrated walks by N times the root of the time. Kalibr calls it "
    "noise_density.",
    "B": "The bias wanders without end, and no averaging makes the mean better than about 0.664 B. The flat part of "
    "the Allan deviation shows it.",
    "K": "The bias itself is a random walk: it moves by K times the root of the time. Kalibr calls it random_walk; "
    "imumon report makes that number larger, see walk.",
    "M": "The noise remembers its value for a time T, and then forgets it. It makes a hump in the Allan deviation.",
    "T": "After it, correlated noise M has forgotten its value.",
    "Q": "The steps of the values show as noise at the shortest times.",
    "R": "The mean moves steadily, by R per second. It is the drift of the model, and no noise.",
}
_WORDS: Mapping[str, tuple[str, str]] = {
    "measured": (
        "A coefficient that the record shows: it has a value with 95 % limits. In a chart, the points of the Allan "
        "deviation.",
        REPORTS,
    ),
    "growing": (
        "The record shows this coefficient, and its limits are still wider than the configured precision.",
        REPORTS,
    ),
    "upper_bound": (
        "The record does not show this coefficient: with 95 % it is smaller than the bound, which is printed with <. "
        "A longer record lowers the bound, or shows a value.",
        REPORTS,
    ),
    "indistinct": (
        f"The record shows slow noise, and not of which kind: {NOT_APART}. Each has a bound.",
        REPORTS,
    ),
    "pending": ("The record is too short for a value or a bound of this coefficient.", REPORTS),
    "ready": (
        "Every axis of gyroscope and accelerometer has the configured precision, report.precision_n, _b and _k of the "
        "settings. The program that it is about is report.program.",
        REPORTS,
    ),
    "convergence": (
        "What was stated of a coefficient when the record was shorter. A value that has stopped to move within its "
        "narrowing limits has converged.",
        REPORTS,
    ),
    "grade": (GRADE_WORDS, THEORY),
    "filter_not_known": (
        "Nothing says how the sensor filters its samples. If it does not average over the output interval, noise "
        "folds, and N is too high. For a recording, --filter names the filter.",
        REPORTS,
    ),
    "rounded_away": (
        "The values are coarser than the noise, so this coefficient does not show. Log more digits, or choose a finer "
        "range of the sensor.",
        REPORTS,
    ),
    "provisional": ("The 95 % limits still allow another grade, or a coefficient is pending.", THEORY),
    "±": ("Half of the 95 % limits, as a share of the value.", REPORTS),
    "×÷": (
        "The 95 % limits as a factor: 3 ×÷2 is from 1.5 to 6. It is used where the limits are so wide that ± would "
        "reach below zero.",
        REPORTS,
    ),
    "deltas": (
        "The sensor sends angles and velocities that it has integrated over each interval. They are true averages, "
        "and no noise is folded into them.",
        VN100,
    ),
    "compensation": ("The sensor subtracts the bias that its own filter estimates from the samples.", VN100),
    "alias_factor": (
        "The factor by which N is too high because the sensor takes samples of noise that is faster than half of the "
        "output rate. It is 1 for deltas, and unknown where the filter of the sensor is unknown.",
        VN100,
    ),
    "walk": (
        "The random walk of the bias for a Kalman filter. Flicker B is no random walk, so a filter with K alone is too "
        "sure of its bias after some minutes. The walk is the smallest that is not: larger than K beside flicker, and "
        "up to a tenth smaller without.",
        FILTERS,
    ),
    "horizon": (
        "The longest time for which a filter must not be too sure of itself without a fix. A camera at 20 Hz that may "
        "lose its track for 10 s needs --horizon 10s; a car in a tunnel of two minutes needs --horizon 2m.",
        FILTERS,
    ),
    "fix": (
        "A measurement of the angle or the velocity from another source, such as a camera or GNSS.",
        FILTERS,
    ),
    "nees": (
        "Normalised estimation error squared: the squared error of a filter over the variance that it states. 1 is "
        "right, above 1 the filter is too sure of itself.",
        FILTERS,
    ),
    "allan_deviation": (
        "Half of the mean squared difference of neighbouring averages, as a root, against the averaging time τ. Each "
        "kind of noise has its own slope in it.",
        THEORY,
    ),
    "model": (
        "The curve that N, B, K and M make together. The fit finds those whose curve agrees with the points.",
        THEORY,
    ),
    "octave": ("The Allan deviation has a point per octave: at twice the time of the point before.", THEORY),
    "χ²/dof": (
        "Squared distance of the points from the model, per degree of freedom: about 1 where the model is right.",
        THEORY,
    ),
    "p": (
        "How probable such a distance from the model is by chance. A small p speaks against the model.",
        THEORY,
    ),
    "spectrum": (
        "The amplitude of the noise by frequency. Its flat part is N; a narrow peak is a vibration.",
        THEORY,
    ),
    "skewness": ("Asymmetry of the distribution: 0 for Gaussian noise.", THEORY),
    "kurtosis": (
        "Weight of the tails of the distribution beyond that of Gaussian noise, which has 0.",
        THEORY,
    ),
    "drift": ("How much the mean moves in an hour, with 95 % limits.", THEORY),
    "bias": (
        "The mean of the channel; of an accelerometer, as far as it is known apart from gravity.",
        THEORY,
    ),
    "std": ("Standard deviation of the samples.", THEORY),
    "uncompensated": ("Samples before the sensor subtracts the bias that its own filter estimates.", VN100),
    "stream": ("Which values the sensor sends: deltas, uncompensated or compensated samples.", VN100),
    "overrun": ("The computer was too slow, and bytes of the sensor were lost.", "docs/SERVICE.md"),
    "checksum": ("A message whose checksum failed was damaged on the way and is not used.", REPORTS),
    "discarded": ("Bytes that belong to no valid message.", REPORTS),
    "duplicate": ("A sample that arrived twice; it counts once.", REPORTS),
    "restart": ("The daemon was started again and continued its record.", "docs/SERVICE.md"),
    "warm-up": (
        "The time in which temperature and mean come to rest. What shows of it is excluded at its end.",
        THEORY,
    ),
    "differs": ("The ratio of two sensors is not 1 within its 95 % limits.", REPORTS),
    "event": ("A moment that may explain a change of the numbers: view 4 lists them.", "docs/ZENOH.md"),
    "time_lapse": (
        "The emulated sensor runs faster than the clock on the wall. Times are those of the sensor.",
        "docs/README.md",
    ),
    "excluded": ("Samples that count for nothing: knocks, motion, repeated values, the warm-up.", THEORY),
    "disturbance": ("A knock or a motion that is excluded from the statistics.", THEORY),
    "gap": ("Samples that the clock of the sensor shows to exist and that did not arrive.", REPORTS),
}
OTHER_NAMES: Mapping[str, str] = {
    "open": "indistinct", "bound": "upper_bound", "<": "upper_bound", "meets": "grade", "below consumer": "grade",
    "x/": "×÷", "+-": "±", "random_walk": "K", "noise_density": "N", "arw": "N", "vrw": "N", "rrw": "K",
    "✓": "ready", "↗": "growing", "↓": "upper_bound", "chi2/dof": "χ²/dof", "warm_up": "warm-up",
    "σ(τ)": "allan_deviation", "sigma(tau)": "allan_deviation", "bias_instability": "B", "delta": "deltas",
    "time_lapse_factor": "time_lapse", "precision": "ready",
} | dict.fromkeys(GRADES, "grade")  # fmt: skip


def explanations() -> Iterator[Explanation]:
    """Yield every word that has an explanation."""
    for letter, row in COEFFICIENTS.items():
        yield Explanation(letter, f"{letter} is {row.about}. {_COEFFICIENTS[letter]}", THEORY)
    for caveat, meaning in CAVEATS.items():
        details = f" {meaning.details}" if meaning.details else ""
        yield Explanation(caveat, f"{sentence(meaning.line)}.{details}", REPORTS)
    for word, (text, page) in _WORDS.items():
        yield Explanation(word, text, page)


def names() -> list[str]:
    """Return every name that `explain` knows: each word, and its other names.

    >>> {"K", "random_walk", "open", "indistinct"} <= set(names())
    True
    """
    return [*(entry.word for entry in explanations()), *OTHER_NAMES]


def words_in(text: str, caveats: Collection[str] = ()) -> list[Explanation]:
    """Return the explanations of the words of a text, in its order, by the names that the text has.

    Parameters
    ----------
    caveats : those that are known to hold. The words of others mean something else: "3 gaps" is no caveat.

    >>> [entry.word for entry in words_in("N 0.3 ±1 %   < 5.6 open ↓   3 gaps", ["aliased"])]
    ['N', 'aliased', '<, ↓', 'open', '±', 'gap']
    """
    names: dict[str, list[str]] = {}
    for name, word in OTHER_NAMES.items():
        names.setdefault(word, []).append(name)
    out = []
    for entry in explanations():
        if entry.word in CAVEATS:
            out += [entry] if entry.word in caveats else []
        elif shown := [name for name in (entry.word, *names.get(entry.word, ())) if _is_in(name, text)]:
            out.append(entry._replace(word=", ".join(shown)))
    return out


def _is_in(word: str, text: str) -> bool:
    """Return whether a word, its plural or a sign is in a text; a letter has its case."""
    if not any(character.isalpha() for character in word):
        return word in text
    pattern = re.escape(word).replace("_", "[ _-]")
    end = r"s?(?!\w)" if word[-1].isalpha() and len(word) > 1 else r"(?!\w)" if word[-1].isalpha() else ""
    flags = re.IGNORECASE if len(word) > 1 else re.NOFLAG
    return re.search(rf"(?<!\w){pattern}{end}", text, flags) is not None


def explain(word: str) -> Explanation | None:
    """Return what a word means, in whatever case and with blanks, hyphens or underscores; None: it is not known.

    >>> explain("alias factor").page, explain("open").word, explain("k").word
    ('docs/VN100.md', 'indistinct', 'K')
    """
    known = {entry.word.lower(): entry for entry in explanations()}
    name = word.strip().lower().replace(" ", "_").replace("-", "_") or word
    return known.get(OTHER_NAMES.get(name, name).lower())
