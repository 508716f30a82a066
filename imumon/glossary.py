"""Glossary: each word that screen, tables and documents use, in at most three sentences, with the page that has more.

Caveats have the texts of `messages`. Everything else that a user may meet without having read a document is here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from imumon.coefficients import COEFFICIENTS
from imumon.messages import CAVEATS, GRADE_WORDS, NOT_APART
from imumon.units import sentence


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
    "measured": ("The record shows this coefficient: it has a value with 95 % limits.", REPORTS),
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
        "sure of its bias after some minutes. The walk is the smallest that is not; --walk K gives plain K.",
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
    "time_lapse": (
        "The emulated sensor runs faster than the clock on the wall. Times are those of the sensor.",
        "docs/README.md",
    ),
    "excluded": ("Samples that count for nothing: knocks, motion, repeated values, the warm-up.", THEORY),
    "disturbance": ("A knock or a motion that is excluded from the statistics.", THEORY),
    "gap": ("Samples that the clock of the sensor shows to exist and that did not arrive.", REPORTS),
}
_OTHER_NAMES = {
    "open": "indistinct", "bound": "upper_bound", "<": "upper_bound", "meets": "grade", "nearest": "grade",
    "x/": "×÷", "+-": "±", "random_walk": "K", "noise_density": "N", "arw": "N", "vrw": "N", "rrw": "K",
    "bias_instability": "B", "delta": "deltas", "time_lapse_factor": "time_lapse", "precision": "ready",
}  # fmt: skip


def explanations() -> Iterator[Explanation]:
    """Yield every word that has an explanation."""
    for letter, row in COEFFICIENTS.items():
        yield Explanation(letter, f"{letter} is {row.about}. {_COEFFICIENTS[letter]}", THEORY)
    for caveat, meaning in CAVEATS.items():
        details = f" {meaning.details}" if meaning.details else ""
        yield Explanation(caveat, f"{sentence(meaning.line)}.{details}", REPORTS)
    for word, (text, page) in _WORDS.items():
        yield Explanation(word, text, page)


def explain(word: str) -> Explanation | None:
    """Return what a word means, in whatever case and with blanks, hyphens or underscores; None: it is not known.

    >>> explain("alias factor").page, explain("open").word, explain("k").word
    ('docs/VN100.md', 'indistinct', 'K')
    """
    known = {entry.word.lower(): entry for entry in explanations()}
    name = word.strip().lower().replace(" ", "_").replace("-", "_") or word
    return known.get(_OTHER_NAMES.get(name, name).lower())
