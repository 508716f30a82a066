"""Powers of the terms of a model with coefficients in SI."""

from __future__ import annotations

from collections.abc import Mapping

from imumon.noise.fit.model import TERMS, NoiseTerm


def powers_of(coefficients: Mapping[str, float], tau0: float = 1.0) -> dict[NoiseTerm, float]:
    """Return the powers of terms with some coefficients, by letter, at a sampling interval, s."""
    by_letter = {term.letter: term for term in TERMS}
    return {
        by_letter[letter]: (value / by_letter[letter].coefficient_scale(tau0)) ** 2
        for letter, value in coefficients.items()
    }
